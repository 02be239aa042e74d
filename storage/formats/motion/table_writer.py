"""Write joint positions as tables and arrays: CSV, Parquet, TRC for OpenSim, Pose2Sim and others, and NPZ."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from kinedex.ops.words import NO_WORD
from kinedex.storage.formats.motion.body_models import BODY
from kinedex.storage.formats.motion.joint_motion import MARKER_NAMES, JointMotion, seen_markers


def write_csv(path: Path, motion: JointMotion) -> None:
    """Write a CSV file: `frame`, `time` in seconds, then `<joint>_x`, `<joint>_y`, `<joint>_z` of every joint.

    Parameters
    ----------
    path : Path
        The file to write.
    motion : JointMotion
        The motion; unknown positions are written as nan.
    """
    frames = len(motion.positions)
    columns = {
        "frame": pa.array(np.arange(frames, dtype=np.int32)),
        "time": pa.array(np.arange(frames) / motion.rate_hz),
    }
    for j, joint in enumerate(motion.joints):
        columns |= {f"{joint}_{axis}": pa.array(motion.positions[:, j, k]) for k, axis in enumerate("xyz")}
    pa_csv.write_csv(pa.table(columns), path)


def write_parquet(path: Path, motion: JointMotion) -> None:
    """Write a Parquet file with the columns of the view `frames`: a STRUCT(x, y, z) for every joint, and the word.

    The rate is in the file's metadata as `kinedex.rate_hz`. The word of an invalid frame is null.

    Parameters
    ----------
    path : Path
        The file to write.
    motion : JointMotion
        The motion.
    """
    columns: dict[str, pa.Array] = {"frame": pa.array(np.arange(len(motion.positions), dtype=np.int32))}
    for j, joint in enumerate(motion.joints):
        columns[joint] = pa.StructArray.from_arrays(
            [pa.array(motion.positions[:, j, k]) for k in range(3)], list("xyz")
        )
    if motion.orientation is not None:
        rotations = [pa.array(motion.orientation[:, k]) for k in range(4)]
        columns["root_orientation"] = pa.StructArray.from_arrays(rotations, list("wxyz"))
    if motion.words is not None:
        columns["word"] = pa.array(motion.words, mask=motion.words == NO_WORD)
    metadata = {"kinedex.rate_hz": repr(float(motion.rate_hz)), "kinedex.unit": "m", "kinedex.up": "y"}
    pq.write_table(pa.table(columns).replace_schema_metadata(metadata), path)


_KEYS = (
    "DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate", "OrigDataStartFrame", "OrigNumFrames",
)  # fmt: skip
_BLOCK_FRAMES = 4096  # frames written at once


def write_trc(path: Path, motion: JointMotion) -> None:
    """Write the joints of a motion as the markers of a TRC file, in metres with Y up.

    Numbers have enough digits to restore the same single-precision values. A joint that is missing in a frame has blank
    cells there, and one that is always missing has no columns. Rows end with a tab, as in the files of OpenSim, whose
    reader would otherwise report a blank last cell as missing.

    Parameters
    ----------
    path : Path
        The file to write.
    motion : JointMotion
        The motion.

    Raises
    ------
    KinedexError
        All joints are missing in all frames.
    """
    joints, positions = seen_markers(motion)
    rate = f"{motion.rate_hz:.10g}"
    values = (rate, rate, str(len(positions)), str(len(joints)), "m", rate, "1", str(len(positions)))
    axes = "".join(f"X{i}\tY{i}\tZ{i}\t" for i in range(1, len(joints) + 1))
    name = "".join(letter if letter.isprintable() else "_" for letter in motion.name)
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{name}.trc",
        "\t".join(_KEYS),
        "\t".join(values),
        "Frame#\tTime\t" + "".join(f"{MARKER_NAMES[joint]}\t\t\t" for joint in joints),
        f"\t\t{axes}",
        "",
    ]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write("\n".join(lines) + "\n")
        for start in range(0, len(positions), _BLOCK_FRAMES):
            # the shortest texts that restore the numbers
            texts = positions[start : start + _BLOCK_FRAMES].reshape(-1, 3 * len(joints)).astype("U").tolist()
            for frame, row in enumerate(texts, start):
                cells = "\t".join("" if cell == "nan" else cell for cell in row)
                file.write(f"{frame + 1}\t{frame / motion.rate_hz:.6f}\t{cells}\t\n")


F32 = npt.NDArray[np.float32]

SMPL_24 = (*BODY, "left_hand", "right_hand")
"""The joints of SMPL's body, in its order."""

_SMPL_FROM_NAMED = {
    "pelvis": "root", "spine1": "belly", "spine2": "chest", "neck": "neck", "head": "head",
    **{
        f"{side}_{smpl}": f"{side[0]}{named}"
        for side in ("left", "right")
        for smpl, named in {
            "hip": "hip", "knee": "knee", "ankle": "ankle", "foot": "toes", "collar": "clavicle",
            "shoulder": "shoulder", "elbow": "elbow", "wrist": "wrist", "hand": "fingers",
        }.items()
    },
}  # fmt: skip
"""A dict from joint of SMPL to the named joint at its position; no named joint corresponds to spine3."""

SPINE3 = 0.2
"""The fraction of the way from chest (spine2) to neck at which spine3 is placed."""


def write_npz(path: Path, motion: JointMotion) -> None:
    """Write an NPZ file, which kinedex also reads as joint positions.

    It has `positions` (T, J, 3) float32 in metres with Y up and `names` (J,); `smpl24` (T, 24, 3), the joints in the
    order of SMPL, and `smpl24_names`; `words` (T,) uint64, `root_orientation` (T, 4) float32 (w, x, y, z) if they are
    known; `rate_hz`, `unit` and `up`. Equal motions give equal bytes.

    Parameters
    ----------
    path : Path
        The file to write.
    motion : JointMotion
        The motion; unknown positions are NaN.
    """
    arrays: dict[str, npt.NDArray[np.generic]] = {
        "positions": motion.positions,
        "names": np.array(motion.joints),
        "smpl24": smpl_positions(motion),
        "smpl24_names": np.array(SMPL_24),
        "rate_hz": np.array(float(motion.rate_hz)),
        "unit": np.array("m"),
        "up": np.array("y"),
    }
    if motion.words is not None:
        arrays["words"] = motion.words
    if motion.orientation is not None:
        arrays["root_orientation"] = motion.orientation
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def smpl_positions(motion: JointMotion) -> F32:
    """Return the positions of a motion in the order of SMPL's 24 joints, float32 (T, 24, 3), in metres.

    `spine3`, to which no named joint corresponds, is placed between chest and neck. Missing joints are NaN.
    """
    index = {joint: j for j, joint in enumerate(motion.joints)}
    absent = np.full((len(motion.positions), 3), np.nan, np.float32)

    def track(named: str) -> F32:
        return motion.positions[:, index[named]] if named in index else absent

    between = (track("chest") * (1.0 - SPINE3) + track("neck") * SPINE3).astype(np.float32)
    tracks = [between if joint == "spine3" else track(_SMPL_FROM_NAMED[joint]) for joint in SMPL_24]
    return np.ascontiguousarray(np.stack(tracks, axis=1))
