"""Define the marker names of the 24 joints: those of Pose2Sim's HALPE_26 model where it has such a point."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import KinedexError
from kinedex.storage.formats.motion.joint_motion import JointMotion

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
    places = motion.places.astype(np.float32)
    seen = np.isfinite(places).all(axis=2)
    shown = np.flatnonzero(seen.any(axis=0))
    if not len(shown):
        raise KinedexError(f"'{motion.name}' has no joint that is seen in any of its {len(places)} frames")
    places[~seen] = np.nan
    return tuple(motion.joints[i] for i in shown), places[:, shown]
