"""Hold the motion of named joints, the input of the writers of motion files, and the marker names of the joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import KinedexError


@dataclass(frozen=True, eq=False)
class JointMotion:
    """Positions of named joints over time, in metres with Y up.

    Attributes
    ----------
    name : str
        Name of the take or of the clip, for the headers of files.
    joints : tuple of str
        Names of the joints, at most the 24 named ones.
    positions : float32 array (T, joints, 3)
        Positions in metres; NaN where a joint is missing.
    rate_hz : float
        Frames per second.
    words : uint64 array (T,) or None
        The word of each frame, `NO_WORD` where the frame is invalid; None without words.
    orientation : float32 array (T, 4) or None
        Orientation of the root as unit quaternions (w, x, y, z); None if it is not known.
    """

    name: str
    joints: tuple[str, ...]
    positions: npt.NDArray[np.float32]
    rate_hz: float
    words: npt.NDArray[np.uint64] | None = None
    orientation: npt.NDArray[np.float32] | None = None


MARKER_NAMES = {
    "root": "Hip", "lhip": "LHip", "lknee": "LKnee", "lankle": "LAnkle", "ltoes": "LBigToe",
    "rhip": "RHip", "rknee": "RKnee", "rankle": "RAnkle", "rtoes": "RBigToe",
    "belly": "Belly", "chest": "Chest", "neck": "Neck", "head": "HeadBase", "headtop": "Head",
    "lclavicle": "LClavicle", "lshoulder": "LShoulder", "lelbow": "LElbow", "lwrist": "LWrist", "lfingers": "LFingers",
    "rclavicle": "RClavicle", "rshoulder": "RShoulder", "relbow": "RElbow", "rwrist": "RWrist", "rfingers": "RFingers",
}  # fmt: skip
"""A dict from named joint to marker, as the mappings `named-markers*` read them; `Head` is the top of the head."""


def seen_markers(motion: JointMotion) -> tuple[tuple[str, ...], npt.NDArray[np.float32]]:
    """Return the joints present in any frame, and their positions (T, joints, 3), NaN in all coordinates or none.

    Raises
    ------
    KinedexError
        The motion has no frames, or all joints are missing.
    """
    positions = motion.positions.astype(np.float32)
    seen = np.isfinite(positions).all(axis=2)
    shown = np.flatnonzero(seen.any(axis=0))
    if not len(shown):
        raise KinedexError(f"'{motion.name}' has no joint that is seen in any of its {len(positions)} frames")
    positions[~seen] = np.nan
    return tuple(motion.joints[i] for i in shown), positions[:, shown]
