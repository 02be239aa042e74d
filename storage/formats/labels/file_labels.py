"""Define the content of label files: labelled intervals of takes."""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from kinedex.ops.errors import SourceError
from kinedex.ops.intervals import in_seconds, nearest_frame

ERROR = "error"
"""The class of labels that mark a limb as wrong."""

_NEVER = {"Cc", "Cs", "Zl", "Zp"}


@dataclass(frozen=True)
class Label:
    """A class for the source frames [start, stop) of a take; other fields are None or empty if unknown."""

    label: str
    start: int
    stop: int
    subclass: str | None = None
    cost: float | None = None
    confidence: float | None = None
    limb: str = ""
    annotator: str = ""


@dataclass(frozen=True)
class LabelsOfTake:
    """The labels of one take.

    Attributes
    ----------
    take : str
        The take's name.
    rate_hz : float
        Frames per second of the source file.
    frames : int
        Number of frames of the source file.
    labels : tuple of Label
        The labels, sorted by start.
    made : str
        Time when the labels were made, ISO 8601 in UTC, for formats that store a date.
    covered : tuple of (str, str)
        Pairs of an examined limb and the annotator (a person or a method); either may be empty. Limbs with labels may
        be omitted.
    """

    take: str
    rate_hz: float
    frames: int
    labels: tuple[Label, ...]
    made: str = "1970-01-01T00:00:00+00:00"
    covered: tuple[tuple[str, str], ...] = ()

    @property
    def without_errors(self) -> tuple[tuple[str, str], ...]:
        """The limbs that were examined without finding an error, with the annotators, sorted."""
        found = {(one.limb, one.annotator) for one in self.labels if one.label == ERROR}
        return tuple(sorted(set(self.covered) - found))

    def seconds(self, frame: int) -> float:
        """Return the time at which a source frame begins; frame 0 begins at 0."""
        return in_seconds(frame, self.rate_hz)

    def milliseconds(self, frame: int) -> int:
        """Return the time at which a source frame begins, to the nearest millisecond."""
        return math.floor(1000 * self.seconds(frame) + 0.5)


@dataclass(frozen=True)
class ManualSegment:
    """An interval of a take that a person labelled, and its place in the label file.

    Attributes
    ----------
    take : str
        The take's name.
    label : str
        The class.
    start : float
        First source frame, or second if `in_seconds`.
    stop : float
        Source frame after the last, or second if `in_seconds`.
    path : str
        The label file; empty if the segment is not from a file.
    line : int, optional
        Line in the file, from 1.
    in_seconds : bool
        True if start and stop are seconds.
    place : str
        The element of the file, in formats where line numbers do not help.
    limb : str
        The limb that the label is about; empty if the label names none.
    annotator : str
        The person who made the label; empty if the label names none.
    """

    take: str
    label: str
    start: float
    stop: float
    path: str = ""
    line: int | None = None
    in_seconds: bool = False
    place: str = ""
    limb: str = ""
    annotator: str = ""

    def source_frames(self, rate_hz: float) -> tuple[int, int]:
        """Return the source frames [start, stop); seconds are rounded to the nearest frame, halves upwards."""
        if not self.in_seconds:
            return int(self.start), int(self.stop)
        return nearest_frame(self.start, rate_hz), nearest_frame(self.stop, rate_hz)

    @property
    def where(self) -> str:
        """File, line and element in one text."""
        return (
            self.path + (f":{self.line}" if self.line is not None else "") + (f": {self.place}" if self.place else "")
        )

    def error(self, message: str) -> SourceError:
        """Return an error that names the segment's file and line."""
        return SourceError(self.path, f"{self.place}: {message}" if self.place else message, line=self.line)


@dataclass(frozen=True)
class LabelFile:
    """The content of a label file.

    Attributes
    ----------
    path : str
        The file.
    takes : tuple of str
        Names of the takes that were examined, each once, in the order of the file, including takes without segments.
    segments : tuple of ManualSegment
        The labelled intervals.
    covered : tuple of (str, str, str)
        Take, limb and annotator for each limb that was examined without marking an error; the annotator may be "".
    """

    path: str
    takes: tuple[str, ...]
    segments: tuple[ManualSegment, ...]
    covered: tuple[tuple[str, str, str], ...] = ()

    @classmethod
    def of_take(
        cls, path: object, take: str, segments: Sequence[ManualSegment], covered: Iterable[tuple[str, str]] = ()
    ) -> LabelFile:
        """Return the content of a file of a single take, with the limbs and annotators that it covers."""
        takes = tuple(dict.fromkeys(one.take for one in segments)) or (take,)
        marked = {(one.limb, one.annotator) for one in segments if one.label == ERROR}
        rest = tuple((take, *one) for one in dict.fromkeys(covered) if one not in marked)
        return cls(str(path), takes, tuple(segments), rest)

    @property
    def looked_at(self) -> dict[str, set[str]]:
        """A dict from annotator of limb errors to the examined takes; empty for a file without limb errors.

        An annotator who marks errors of limbs in a file has examined all takes that the file names.
        """
        people = {one.annotator for one in self.segments if one.label == ERROR and one.limb}
        people |= {annotator for _, _, annotator in self.covered}
        return {annotator: set(self.takes) for annotator in sorted(people)}


def is_writable(labels: LabelsOfTake, *, quoted: bool) -> bool:
    """Return whether a file can store the names of a take, its classes, limbs and annotators unchanged.

    A name must not begin or end with spaces, which readers remove. In formats without quotes, names must not contain
    line breaks or characters that XML does not allow.
    """
    about = {text for one in labels.labels for text in (one.limb, one.annotator) if text}
    about |= {text for pair in labels.covered for text in pair if text}
    for text in (labels.take, *(one.label for one in labels.labels), *about):
        odd = any(unicodedata.category(letter) in _NEVER or letter in "\ufffe\uffff" for letter in text)
        if not text or text != text.strip() or (odd and not quoted):
            return False
    return True
