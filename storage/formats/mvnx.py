"""Parse MVNX files of Xsens MVN: segments and sensors of one or several subjects, frame by frame.

This parser serves the reader of motion (positions and orientations of segments) and the reader of sensor data. A file
is parsed as a stream, because an hour of recording takes a gigabyte of XML. Files with entities are refused, and
nothing outside of the file is read.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.source_files import source_errors

F64 = npt.NDArray[np.float64]

BLOCK_BYTES = 1 << 20
"""The number of bytes that are parsed at once."""

LONGEST_TEXT = 1 << 20
"""The largest number of characters of an element; the longest in a frame of 23 segments has some two thousand."""

MAX_PARTS = 1_000
"""The largest number of segments, points, sensors or joints of a subject; MVN has 23 and some hundred points."""

DEEPEST = 30
"""The largest depth of nested elements; MVNX files have seven levels."""

FRAME_NUMBERS = {"orientation": 4, "position": 3, "velocity": 3, "acceleration": 3, "angularVelocity": 3}
"""A dict from field to the number of its values for every segment."""

SENSOR_NUMBERS = {"sensorOrientation": 4, "sensorFreeAcceleration": 3, "sensorMagneticField": 3}
"""A dict from field to the number of its values for every sensor."""

JOINT_NUMBERS = {"jointAngle": 3, "jointAngleXZY": 3}
"""A dict from field to the number of its values, in degrees, for every joint."""

_LONGEST_TAG = 256
_NORMAL = "normal"


@dataclass(eq=False)
class Subject:
    """A person of an MVNX file.

    Attributes
    ----------
    label : str
        The name in the file.
    rate_hz : float or None
        Frames per second; None if the file does not state it.
    configuration : str
        The suit that was worn, such as "FullBody" or "UpperBody"; empty if the file does not state it.
    segments : list of str
        Labels of the segments, in the order of the numbers of a frame.
    points : dict of str to dict
        Segment → label of a point on it → (x, y, z), metres in the segment's axes.
    sensors, joints : list of str
        Labels of the sensors and of the joints, in the order of the numbers of a frame.
    frames : int
        The number of frames of type "normal".
    indices : array of int
        The number that each of these frames has in the file, from 0; consecutive if the file does not number them.
    fields : dict of str to array
        The values of the wanted fields, frame after frame.
    """

    label: str
    rate_hz: float | None
    configuration: str
    segments: list[str] = field(default_factory=list)
    points: dict[str, dict[str, tuple[float, float, float]]] = field(default_factory=dict)
    sensors: list[str] = field(default_factory=list)
    joints: list[str] = field(default_factory=list)
    frames: int = 0
    indices: array[int] = field(default_factory=lambda: array("q"))
    fields: dict[str, array[float]] = field(default_factory=dict)

    def width(self, name: str) -> int:
        """Return the number of values of a field in a frame."""
        for table, parts in ((FRAME_NUMBERS, self.segments), (SENSOR_NUMBERS, self.sensors)):
            if name in table:
                return table[name] * len(parts)
        return JOINT_NUMBERS[name] * len(self.joints)

    def numbers(self, name: str) -> F64:
        """Return a field as an array (T, parts, values per part); T is 0 if no frame has it."""
        per_part = (FRAME_NUMBERS | SENSOR_NUMBERS | JOINT_NUMBERS)[name]
        frames = self.frames if self.fields[name] else 0
        return np.array(self.fields[name], np.float64).reshape(frames, self.width(name) // per_part, per_part)


def count_elements(path: Path, name: str) -> int:
    """Count the elements with a given name in an XML file by searching its text, without parsing.

    Raises
    ------
    SourceError
        The file cannot be read.
    """
    tag = re.compile(rb"<(?:[A-Za-z_][\w.-]*:)?" + name.encode() + rb"[\s/>]")
    count, tail = 0, b""
    with source_errors(path), path.open("rb") as file:
        while block := file.read(4 * BLOCK_BYTES):
            text = tail + block
            cut = text.rfind(b"<")  # a tag split by the end of the block is counted with the next block
            tail = text[cut:] if 0 <= len(text) - cut < _LONGEST_TAG and cut >= 0 else b""
            count += len(tag.findall(text, 0, len(text) - len(tail)))
    return count + len(tag.findall(tail))


def read_mvnx(path: Path, wanted: Collection[str] = (), subject: str | None = None) -> tuple[Subject, ...]:
    """Read the subjects of an MVNX file, with the wanted fields of the normal frames.

    Frames of type identity, tpose and tpose-isb are calibration poses and are skipped.

    Parameters
    ----------
    path : Path
        The file, of version 3 or 4.
    wanted : collection of str
        Names of fields, keys of `FRAME_NUMBERS`, `SENSOR_NUMBERS` or `JOINT_NUMBERS`. A field that no frame has is
        empty in the result; a field that only some frames have is an error.
    subject : str, optional
        The name (of `subject_names`) of the only subject whose frames are kept; None for all subjects.

    Returns
    -------
    tuple of Subject
        The subjects, in the order of the file.

    Raises
    ------
    SourceError
        The file is damaged or not MVNX; the error names the line.
    """
    document = _Document(path, tuple(wanted), subject)
    empty = True
    with source_errors(path), path.open("rb") as file:
        while block := file.read(BLOCK_BYTES):
            if empty and block.startswith((b"\xff\xfe", b"\xfe\xff")):
                raise SourceError(path, "is encoded as UTF-16; MVN writes UTF-8")
            empty = empty and block.isspace()
            document.feed(block)
    if empty:
        raise SourceError(path, "the file is empty")
    document.feed(b"", last=True)
    if not document.subjects:
        raise SourceError(path, "has no <subject>, the element of a person in MVNX files")
    return tuple(document.subjects)


def subject_names(subjects: Collection[Subject]) -> tuple[str, ...]:
    """Return a unique name for every subject: its label, with a number if labels are equal or missing."""
    names: list[str] = []
    for number, subject in enumerate(subjects, 1):
        label = subject.label.strip()
        names.append(label if label and label not in names else f"{label or 'subject'} {number}")
    return tuple(names)


@dataclass(eq=False)
class _Document:
    """The content of an MVNX file while it is parsed; the XML parser calls the methods."""

    path: Path
    wanted: tuple[str, ...]
    only: str | None
    stack: list[str] = field(default_factory=list)
    subjects: list[Subject] = field(default_factory=list)
    segment: str = ""
    point: str = ""
    text: list[str] | None = None
    letters: int = 0
    chosen: bool = False
    normal: bool = False

    def __post_init__(self) -> None:
        self.parser = expat.ParserCreate(namespace_separator=" ")
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._characters
        self.parser.EntityDeclHandler = self._entity

    def feed(self, block: bytes, last: bool = False) -> None:
        """Parse a block; raise a SourceError that names the line of the first fault."""
        try:
            self.parser.Parse(block, last)
        except expat.ExpatError as fault:
            what = expat.ErrorString(fault.code)
            raise SourceError(self.path, f"is no XML: {what}; is it cut off?", line=fault.lineno) from None
        except (ValueError, LookupError) as fault:  # an unknown encoding
            raise SourceError(self.path, f"cannot be decoded: {fault}") from None

    def _error(self, message: str) -> SourceError:
        return SourceError(self.path, message, line=self.parser.CurrentLineNumber)

    def _entity(self, *_: object) -> None:
        raise self._error("declares an entity, which an MVNX file has no need of; it is not read")

    def _start(self, name: str, given: Mapping[str, str]) -> None:
        name = name.rpartition(" ")[2]
        self.stack.append(name)
        if len(self.stack) > DEEPEST:
            raise self._error(f"has elements in more than {DEEPEST} levels, and MVNX files have seven")
        if len(self.stack) == 1 and name != "mvnx":
            raise self._error(f"is no MVNX file: expected the element mvnx, got {name[:60]!r}")
        inside = self.stack[-2] if len(self.stack) > 1 else ""
        if name == "subject":
            self._begin_subject(given)
        elif not self.subjects:
            return
        elif name == "frame" and inside == "frames":
            self._begin_frame(given)
        elif name == "segment" and inside == "segments":
            self.segment = self._label(given, self.subjects[-1].segments)
            self.subjects[-1].points[self.segment] = {}
        elif name == "sensor" and inside == "sensors":
            self._label(given, self.subjects[-1].sensors)
        elif name == "joint" and inside == "joints":
            self._label(given, self.subjects[-1].joints)
        elif name == "point" and self.segment and inside == "points":
            self.point = given.get("label", "")
        elif (name in self.wanted and self.normal and inside == "frame") or (name.startswith("pos_") and self.point):
            self.text, self.letters = [], 0

    def _begin_subject(self, given: Mapping[str, str]) -> None:
        if len(self.subjects) == MAX_PARTS:
            raise self._error(f"has more than {MAX_PARTS} subjects")
        rate = given.get("frameRate")
        try:
            rate_hz = None if rate is None else float(rate)
        except ValueError:
            raise self._error(f"frameRate must be frames per second, got {rate!r:.60}") from None
        subject = Subject(given.get("label", ""), rate_hz, given.get("configuration", ""))
        subject.fields = {name: array("d") for name in self.wanted}
        self.subjects.append(subject)
        self.chosen = self.only in (None, subject_names(self.subjects)[-1])

    def _begin_frame(self, given: Mapping[str, str]) -> None:
        subject = self.subjects[-1]
        self.normal = self.chosen and given.get("type", _NORMAL) == _NORMAL
        if self.normal:
            number = given.get("index", "")
            known = number.isascii() and number.isdecimal() and len(number) < 16
            subject.indices.append(int(number) if known else subject.frames)
            subject.frames += 1

    def _label(self, given: Mapping[str, str], labels: list[str]) -> str:
        label = given.get("label", "")
        if not label or label in labels:
            raise self._error(f"a {self.stack[-1]} must have a label of its own, got {label[:60]!r}")
        if len(labels) == MAX_PARTS:
            raise self._error(f"has more than {MAX_PARTS} elements {self.stack[-1]}")
        labels.append(label)
        return label

    def _characters(self, text: str) -> None:
        if self.text is not None:
            self.letters += len(text)
            if self.letters > LONGEST_TEXT:
                raise self._error(f"{self.stack[-1]} has more than {LONGEST_TEXT} letters")
            self.text.append(text)

    def _end(self, _: str) -> None:
        name = self.stack.pop()
        if self.text is not None and name in self.wanted and self.normal:
            self._keep(name, "".join(self.text))
        elif self.text is not None and name.startswith("pos_"):
            self._place(name, "".join(self.text))
        elif name == "frame" and self.normal:
            self._end_frame()
        elif name == "segment":
            self.segment = ""
        elif name == "point":
            self.point = ""
        self.text = None

    def _end_frame(self) -> None:
        subject = self.subjects[-1]
        for name, numbers in subject.fields.items():
            if numbers and len(numbers) != subject.frames * subject.width(name):
                raise self._error(f"<{name}> must be in every frame once, or in none; see frame {subject.indices[-1]}")
        self.normal = False

    def _keep(self, name: str, text: str) -> None:
        subject = self.subjects[-1]
        width = subject.width(name)
        words = text.split()
        if len(words) != width:
            raise self._error(f"<{name}> of frame {subject.indices[-1]} must be {width} numbers, got {len(words)}")
        subject.fields[name].extend(self._numbers(name, words))

    def _place(self, name: str, text: str) -> None:
        words = text.split()
        points = self.subjects[-1].points[self.segment]
        if len(words) != 3 or len(points) == MAX_PARTS:
            raise self._error(f"<{name}> must have 3 numbers, got {len(words)}; {MAX_PARTS} points at most")
        x, y, z = self._numbers(name, words)
        points[self.point] = (x, y, z)

    def _numbers(self, name: str, words: list[str]) -> list[float]:
        try:
            numbers = [float(word) for word in words]
        except ValueError as fault:
            raise self._error(f"<{name}> must be numbers: {str(fault)[:100]}") from None
        # comparisons with NaN are false
        if not all(abs(number) < 1e12 for number in numbers):
            raise self._error(f"<{name}> has numbers that are NaN, infinite or beyond 1e12")
        return numbers
