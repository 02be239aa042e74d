"""Evidence of segments frame by frame, with plain loops."""

from __future__ import annotations

import math
from collections.abc import Sequence

Span = tuple[int, int, int]
"""Start, stop and class of a segment."""


def others(segments: Sequence[Span], own: Span) -> float:
    """Return log(1 + n), n being the mean number of other segments of a frame."""
    counts = [sum(first <= frame < last for first, last, _ in segments) for frame in range(own[0], own[1])]
    return math.log(sum(counts) / len(counts))


def covered(segments: Sequence[Span], frames: int) -> float:
    """Return the share of the frames that some segment has."""
    return sum(any(first <= frame < last for first, last, _ in segments) for frame in range(frames)) / frames


def strongest_rival(segments: Sequence[Span], strengths: Sequence[float], own: int) -> float:
    """Return the greatest strength of a segment of another class with most of the frames, else the own one."""
    start, stop, label = segments[own]
    rivals = []
    for (first, last, other), strength in zip(segments, strengths, strict=True):
        shared = sum(first <= frame < last for frame in range(start, stop))
        if other != label and 2 * shared > stop - start:
            rivals.append(strength)
    return max(rivals, default=strengths[own])
