"""Compute the motion of a clip from the store's joints or its source file, with the requested processing."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.ops.body.facing_direction import Placement, placement_of, start_at_origin, turned_quaternions
from kinedex.ops.body.mirrored_motion import mirrored_places, mirrored_quaternions
from kinedex.ops.body.resample import covered_frames, resample
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.pipelines.export.clips import Clip
from kinedex.pipelines.export.request import How
from kinedex.storage.formats.motion.joint_motion import JointMotion
from kinedex.storage.snapshot.frames import words_of
from kinedex.storage.snapshot.parts import joint_positions

if TYPE_CHECKING:
    from kinedex.catalog.skeletons.mappings import Mappings
    from kinedex.storage.formats.motion.source_cut import SourceCut

F64 = npt.NDArray[np.float64]

_PAIRS = ("hip", "shoulder")


def clip_motion(frames: pa.Table, clip: Clip, how: How, features: FeatureSet, rate_hz: float) -> JointMotion:
    """Return the motion of a clip's joints.

    Positions are interpolated between frames; words are those of the nearest frame. The words of a mirrored clip are
    those of the clip with left and right exchanged; it has none if the feature set does not define the pairs.

    Parameters
    ----------
    frames : pyarrow.Table
        All frames of the take.
    clip : Clip
        The clip.
    how : How
        The requested processing.
    features : FeatureSet
        The features of the store.
    rate_hz : float
        Frames per second of the store.

    Raises
    ------
    KinedexError
        The body's position or facing direction is unknown in the frame that should lie at the origin.
    """
    rows = frames.slice(clip.first, clip.last - clip.first).combine_chunks()
    places: F64 = joint_positions(rows, features.joints).transpose(2, 0, 1).astype(np.float64)
    parts = rows.column("root_orientation").combine_chunks().flatten()
    turns: F64 = np.stack([part.to_numpy(zero_copy_only=False) for part in parts], axis=1).astype(np.float64)
    words: npt.NDArray[np.uint64] | None = words_of(rows)
    if clip.mirrored:
        places, turns = mirrored_places(places, features.joints), mirrored_quaternions(turns)
        words = features.mirrored(words) if words is not None and features.mirror else None
    if how.in_place:
        start = clip_placement(places[clip.start - clip.first], features.joints, clip)
        places, turns = start_at_origin(places, start), turned_quaternions(turns, -start.yaw)
    if how.rate_hz is not None and how.rate_hz != rate_hz:
        nearest = np.floor(np.arange(frames_at(len(places), rate_hz, how.rate_hz)) * (rate_hz / how.rate_hz) + 0.5)
        words = None if words is None else words[np.minimum(nearest.astype(np.int64), len(words) - 1)]
        sampled = resample(places.transpose(1, 2, 0), turns.T, rate_hz, how.rate_hz)
        places, turns = sampled.positions.transpose(2, 0, 1), sampled.orientation.T
    stored, turned = (np.ascontiguousarray(one, np.float32) for one in (places, turns))
    return JointMotion(clip.name, tuple(features.joints), stored, how.rate_hz or rate_hz, words, turned)


def frames_at(frames: int, before_hz: float, after_hz: float) -> int:
    """Return the number of frames after resampling to another rate (`ops.body.resample`)."""
    if before_hz == after_hz or frames < 2:
        return frames
    return int(np.floor(round((frames - 1) * after_hz / before_hz, 9))) + 1


def clip_placement(places: F64, joints: tuple[str, ...], clip: Clip) -> Placement:
    """Return the position and facing direction of a body in one frame, from its root, hips and shoulders.

    Parameters
    ----------
    places : float64 array (J, 3)
        Positions of the joints in the frame, in metres.
    joints : tuple of str
        Their names.
    clip : Clip
        The clip, for the message.

    Raises
    ------
    KinedexError
        Position or direction are unknown in this frame.
    """
    known = dict(zip(joints, places, strict=True))
    gap = np.full(3, np.nan)
    left, right = (np.stack([known.get(f"{side}{pair}", gap) for pair in _PAIRS]) for side in "lr")
    try:
        return placement_of(known.get("root", gap), left, right)
    except ParameterError:
        raise KinedexError(
            f"frame {clip.start} of '{clip.take}' has no root, or neither hips nor shoulders, and cannot be put at the "
            "origin"
        ) from None


def source_cut(
    row: Mapping[str, Any], clip: Clip, how: How, skeleton: Path | None, mappings: Mappings | None
) -> SourceCut:
    """Return the part of a take's source that a clip covers.

    Parameters
    ----------
    row : mapping of str to object
        The row of the take.
    clip : Clip
        The clip.
    how : How
        The requested processing.
    skeleton : Path or None
        The skeleton file of an AMC file.
    mappings : Mappings or None
        Skeleton mappings of the store; None for the shipped ones.
    """
    from kinedex.storage.formats.motion.source_cut import SourceCut

    first, last = source_frames(row, clip.first, clip.last)
    start, stop = source_frames(row, clip.start, clip.stop)
    return SourceCut(
        Path(row["source_root"]) / row["source"],
        skeleton,
        row.get("person") or None,
        first,
        last,
        float(row["source_rate_hz"]),
        mirror=clip.mirrored,
        rate_hz=how.rate_hz,
        in_place=how.in_place,
        inner=(max(first, start), min(last, stop)),
        checksum=row["checksum"],
        mappings=mappings,
    )


def source_frames(row: Mapping[str, Any], start: int, stop: int) -> tuple[int, int]:
    """Return the frames of a take's source for analysis frames [start, stop); the whole source for the whole take."""
    rates = float(row["source_rate_hz"]), float(row["rate_hz"])
    return covered_frames(start, stop, int(row["source_frames"]), *rates)
