"""A recording by a depth camera: its files read together and checked; images are read one at a time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.depth_cameras import DepthCamera
from kinedex.catalog.depth_recordings import WorldPose
from kinedex.storage.formats.depth.frames import DepthFrames

F32 = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class DepthRecording:
    """A recording of one person by a depth camera.

    Attributes
    ----------
    name : str
        Its name.
    camera : DepthCamera
        The camera.
    background : float32 array (H, W) or None
        Depths of the empty room in metres, 0 where they are not known; None without a background.
    frames : DepthFrames
        The images, read one at a time.
    rate_hz : float
        Frames per second.
    body : str or None
        A take of the store whose bone lengths are the person's, or `estimate`; None if the recording does not say.
    truth : str or Path or None
        A take of the store, or a file of positions.
    truth_pose : WorldPose or None
        Where the axes of the truth lie in the world.
    markers : mapping of str to str
        Marker of the truth → the joint that it is fixed to.
    notes : tuple of str
        Sentences for the user: what was chosen, what looks wrong.
    """

    name: str
    camera: DepthCamera
    background: F32 | None
    frames: DepthFrames
    rate_hz: float
    body: str | None = None
    truth: str | Path | None = None
    truth_pose: WorldPose | None = None
    markers: Mapping[str, str] | None = None
    notes: tuple[str, ...] = ()
