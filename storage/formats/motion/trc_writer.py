"""Write TRC files: named joints as markers, for OpenSim, Pose2Sim and others."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kinedex.storage.formats.motion.joint_motion import JointMotion
from kinedex.storage.formats.motion.marker_names import MARKER_NAMES, seen_markers

_KEYS = (
    "DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate", "OrigDataStartFrame", "OrigNumFrames",
)  # fmt: skip
_AT_ONCE = 4096  # frames written at once


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
    joints, places = seen_markers(motion)
    rate = f"{motion.rate_hz:.10g}"
    values = (rate, rate, str(len(places)), str(len(joints)), "m", rate, "1", str(len(places)))
    axes = "".join(f"X{i}\tY{i}\tZ{i}\t" for i in range(1, len(joints) + 1))
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{_one_line(motion.name)}.trc",
        "\t".join(_KEYS),
        "\t".join(values),
        "Frame#\tTime\t" + "".join(f"{MARKER_NAMES[joint]}\t\t\t" for joint in joints),
        f"\t\t{axes}",
        "",
    ]
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write("\n".join(lines) + "\n")
        for start in range(0, len(places), _AT_ONCE):
            block = places[start : start + _AT_ONCE].reshape(-1, 3 * len(joints))
            file.writelines(_row(start + i, motion.rate_hz, cells) for i, cells in enumerate(_cells(block)))


def _one_line(name: str) -> str:
    """Return a name without tabs and line ends."""
    return "".join(letter if letter.isprintable() else "_" for letter in name)


def _cells(block: np.ndarray[tuple[int, ...], np.dtype[np.float32]]) -> list[list[str]]:
    """Return the shortest texts that restore the numbers; blank for NaN."""
    texts: list[list[str]] = block.astype("U").tolist()
    return [["" if cell == "nan" else cell for cell in row] for row in texts]


def _row(frame: int, rate_hz: float, cells: list[str]) -> str:
    return f"{frame + 1}\t{frame / rate_hz:.6f}\t" + "\t".join(cells) + "\t\n"
