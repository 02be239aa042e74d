"""Hold the motion of named joints, the input of the writers of motion files."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, eq=False)
class JointMotion:
    """Positions of named joints over time, in metres with Y up.

    Attributes
    ----------
    name : str
        Name of the take or of the clip, for the headers of files.
    joints : tuple of str
        Names of the joints, at most the 24 named ones.
    places : float32 array (T, joints, 3)
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
    places: npt.NDArray[np.float32]
    rate_hz: float
    words: npt.NDArray[np.uint64] | None = None
    orientation: npt.NDArray[np.float32] | None = None
