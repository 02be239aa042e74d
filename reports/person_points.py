"""Embed points of a depth camera in a page for its player: a sample of the points of the person in each frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.catalog.depth_cameras import placement_of
from kinedex.catalog.depth_recordings import load_depth_recordings
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.reconstruction.recording_tracks import make_scene
from kinedex.reports.motions import PACKED_STEP, pack
from kinedex.storage.formats.depth.recording import read_recording

F64 = npt.NDArray[np.float64]

POINTS = 160
"""Number of points of a frame that are drawn."""

MOST_BYTES = 6_000_000
"""The largest size of all points of a page."""


def packed_points(row: Mapping[str, Any], frames: int, rate_hz: float) -> dict[str, Any] | None:
    """Return points of the person in every frame of a take as the player draws them.

    Parameters
    ----------
    row : dict
        The take's row of `reconstructions`.
    frames : int
        The length of the take in analysis frames.
    rate_hz : float
        Analysis frames per second.

    Returns
    -------
    dict or None
        The object that the player reads; None if the recording no longer exists.
    """
    if row["file"] is None or not Path(row["file"]).is_file():
        return None
    try:
        recording = read_recording(load_depth_recordings(row["file"]), row["recording"])
    except KinedexError:
        return None
    camera, background = recording.camera, recording.background
    placement = placement_of(camera, background)
    scene = make_scene(camera, background, placement, row["stride"])
    points: F64 = np.full((POINTS, 3, frames), np.nan)
    for frame in range(0, frames, PACKED_STEP):
        image = recording.frames[min(round(frame * row["rate_hz"] / rate_hz), len(recording.frames) - 1)]
        if image is None:
            continue
        cloud = scene.preparation.prepare(image).points
        chosen = np.unique(np.linspace(0, len(cloud) - 1, min(POINTS, len(cloud))).astype(np.int64))
        points[: len(chosen), :, frame] = placement.in_world(cloud[chosen])
    return {**asdict(pack(str(row["take"]), points, rate_hz)), "count": POINTS}
