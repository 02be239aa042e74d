"""Labelled stretches of takes, as they go into label files and as they come out of them."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass

from kinedex.ops.errors import KinedexError, SourceError

_NEVER = {"Cc", "Cs", "Zl", "Zp"}


@dataclass(frozen=True)
class Label:
    """Source frames [start, stop) of a take that bear a class; what else is known of them, None where it is not."""

    label: str
    start: int
    stop: int
    subclass: str | None = None
    cost: float | None = None
    confidence: float | None = None


@dataclass(frozen=True)
class TakeLabels:
    """The labels of one take, by start; its source rate and length, which turn frames into seconds.

    made: when the labels were made, as ISO 8601 in UTC, for formats that carry a date.
    """

    take: str
    rate_hz: float
    frames: int
    labels: tuple[Label, ...]
    made: str = "1970-01-01T00:00:00+00:00"

    def seconds(self, frame: int) -> float:
        """The time at which a source frame begins; frame 0 begins at 0."""
        return frame / self.rate_hz

    def milliseconds(self, frame: int) -> int:
        """The same, to the nearest millisecond."""
        return math.floor(1000 * self.seconds(frame) + 0.5)


@dataclass(frozen=True)
class ManualSegment:
    """A stretch of a take that a person labelled, and where it stands in its file.

    start, stop: half-open, source frames; or seconds where `in_seconds`. line: from 1; place: the element, where a
    format has no lines to speak of.
    """

    take: str
    label: str
    start: float
    stop: float
    path: str
    line: int | None = None
    in_seconds: bool = False
    place: str = ""

    def source_frames(self, rate_hz: float) -> tuple[int, int]:
        """The source frames [start, stop); seconds become the nearest frame, a half the later one."""
        if not self.in_seconds:
            return int(self.start), int(self.stop)
        return math.floor(self.start * rate_hz + 0.5), math.floor(self.stop * rate_hz + 0.5)

    @property
    def where(self) -> str:
        """File, line and element, for people."""
        return (
            self.path + (f":{self.line}" if self.line is not None else "") + (f": {self.place}" if self.place else "")
        )

    def error(self, message: str) -> SourceError:
        """An error that names the segment's file and line."""
        return SourceError(self.path, f"{self.place}: {message}" if self.place else message, line=self.line)


@dataclass(frozen=True)
class LabelFile:
    """The contents of a label file: the takes that were labelled, and their segments.

    Attributes
    ----------
    takes : sequence of str
        Names, each once, in the file's order; a take without any segment has no motion of the classes.
    """

    path: str
    takes: tuple[str, ...]
    segments: tuple[ManualSegment, ...]

    @classmethod
    def of_take(cls, path: object, take: str, segments: Sequence[ManualSegment]) -> LabelFile:
        """A file of a single take."""
        return cls(str(path), tuple(dict.fromkeys(one.take for one in segments)) or (take,), tuple(segments))


def check_writable(labels: TakeLabels) -> None:
    """Refuse names that some format would not give back.

    Raises
    ------
    KinedexError: the take's name or a label is empty, begins or ends with a space, or has characters that end lines
        or that XML does not know.
    """
    for what, text in (("take", labels.take), *(("class", one.label) for one in labels.labels)):
        odd = any(unicodedata.category(letter) in _NEVER or letter in "\ufffe\uffff" for letter in text)
        if not text or text != text.strip() or odd:
            raise KinedexError(
                f"{what} {text!r} cannot be written into label files: a name must not be empty, begin or end with a "
                "space, or have control characters in it"
            )
