"""Write NPZ files: named joints, also in the order of SMPL's joints, and words, as numpy loads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.storage.formats.motion.body_models import BODY
from kinedex.storage.formats.motion.joint_motion import JointMotion

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
        "positions": motion.places,
        "names": np.array(motion.joints),
        "smpl24": smpl_places(motion),
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


def smpl_places(motion: JointMotion) -> F32:
    """Return the positions of a motion in the order of SMPL's 24 joints, float32 (T, 24, 3), in metres.

    `spine3`, to which no named joint corresponds, is placed between chest and neck. Missing joints are NaN.
    """
    index = {joint: j for j, joint in enumerate(motion.joints)}
    absent = np.full((len(motion.places), 3), np.nan, np.float32)

    def track(named: str) -> F32:
        return motion.places[:, index[named]] if named in index else absent

    between = (track("chest") * (1.0 - SPINE3) + track("neck") * SPINE3).astype(np.float32)
    tracks = [between if joint == "spine3" else track(_SMPL_FROM_NAMED[joint]) for joint in SMPL_24]
    return np.ascontiguousarray(np.stack(tracks, axis=1))
