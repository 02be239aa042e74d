"""This module defines intervals, which are ranges of frames of a take, with hits and segments, and converts times.

A hit is an interval that a search has found, and a segment is an interval with a class. A frame begins at frame / rate
seconds, so frame 0 begins at 0. Stored and computed seconds are never rounded. Displayed seconds are rounded to
hundredths, and times that a user enters are rounded to the nearest frame; both round halves upwards.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, overload

import numpy as np
import numpy.typing as npt


class Interval(NamedTuple):
    """A half-open range of analysis frames of a take.

    Parameters
    ----------
    take : str
        The name of the take.
    start, stop : int
        The first frame, and the frame after the last.
    """

    take: str
    start: int
    stop: int

    @property
    def frames(self) -> int:
        """Return the number of frames."""
        return self.stop - self.start

    def overlaps(self, other: Interval) -> bool:
        """Return whether this interval and another have a frame in common."""
        return self.take == other.take and self.start < other.stop and other.start < self.stop


class Hit(NamedTuple):
    """An interval that a template or a query has found; a person may have selected it from several.

    Parameters
    ----------
    interval : Interval
        The frames of the take.
    name : str
        The template or the query.
    cost : float, optional
        The distance from the template; None for a query, which has no distances.
    mirrored : bool
        True if the interval matches the mirror image of the template.
    similarity : float, optional
        The similarity to the examples of a search; None if it was not compared with any.
    probable : bool, optional
        True if it differs from the examples little more than similar intervals differ; None if it was not compared.
    """

    interval: Interval
    name: str = ""
    cost: float | None = None
    mirrored: bool = False
    similarity: float | None = None
    probable: bool | None = None


@dataclass(frozen=True)
class TakeSegment:
    """An interval of a take with a class, which a method found or a person marked.

    Many segments are stored as a table, either results of the kind `annotations` or labels
    (`storage.snapshot.schemas`). Methods use a `Segment` (`ops.annotation.segments`), which refers to classes and
    templates by numbers.

    Parameters
    ----------
    take : str
        The name of the take.
    label : str
        The class.
    start, stop : int
        The first frame, and the frame after the last.
    cost : float, optional
        The distance from the template; None if a person marked the segment.
    subclass : str, optional
        The subclass of the template.
    confidence : float, optional
        The probability that the class is right, from 0 to 1.
    doubted : str, optional
        The classes that another method found in these frames instead, or "nothing"; None if both methods agree, or if
        there is no other method.
    """

    take: str
    label: str
    start: int
    stop: int
    cost: float | None = None
    subclass: str | None = None
    confidence: float | None = None
    doubted: str | None = None

    @property
    def key(self) -> tuple[str, str, int, int]:
        """Return take, class, start and stop."""
        return self.take, self.label, self.start, self.stop

    @property
    def interval(self) -> Interval:
        """Return the interval."""
        return Interval(self.take, self.start, self.stop)


@overload
def in_seconds(frames: float, rate_hz: float) -> float: ...


@overload
def in_seconds(frames: npt.NDArray[Any], rate_hz: float) -> npt.NDArray[np.float64]: ...


def in_seconds(frames: float | npt.NDArray[Any], rate_hz: float) -> float | npt.NDArray[np.float64]:
    """Convert frames, or numbers of frames, to seconds without rounding.

    Parameters
    ----------
    frames : float or array
        Frames, or numbers of frames.
    rate_hz : float
        Frames per second.
    """
    return frames / rate_hz


def shown_seconds(frames: float, rate_hz: float, digits: int = 2) -> str:
    """Convert a frame, or a number of frames, to seconds as text without a unit, such as "22.67".

    Halves are rounded upwards: frame 15 at 120 Hz begins at 0.125 s, which gives "0.13".

    Parameters
    ----------
    frames : float
        A frame, or a number of frames.
    rate_hz : float
        Frames per second.
    digits : int
        The number of digits after the point; 2 is usual for times, and 1 for durations.
    """
    scale = 10**digits
    return f"{math.floor(scale * frames / rate_hz + 0.5) / scale:.{digits}f}"


def nearest_frame(seconds: float, rate_hz: float) -> int:
    """Return the frame that begins nearest to a time in seconds; of two equally near frames, the later one."""
    return math.floor(seconds * rate_hz + 0.5)


def analysis_frame(source_frame: int, source_rate_hz: float, rate_hz: float) -> int:
    """Return the first analysis frame at or after a source frame: ceil(source_frame · rate / source_rate)."""
    return math.ceil(round(source_frame * rate_hz / source_rate_hz, 9))


def source_frame(frame: int, source_rate_hz: float, rate_hz: float, frames: int) -> int:
    """Return the last source frame at or before an analysis frame, at most the number of source frames.

    `analysis_frame` is its inverse, unless the source rate is below the analysis rate.
    """
    return min(math.floor(round(frame * source_rate_hz / rate_hz, 9)), frames)
