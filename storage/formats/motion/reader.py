"""Define the interface of readers of motion files, their settings, and the body that they return.

A distribution adds a reader for its own files by an entry point of the group `kinedex.readers`::

    [project.entry-points."kinedex.readers"]
    joints = "my_package.joints:JointsReader"

The entry point names a subclass of `Reader`, which is instantiated without arguments.
`storage.formats.motion.reader_table` holds the built-in readers in the same form.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.mappings import Format, Mappings
from kinedex.storage.formats.source_files import file_size
from kinedex.storage.formats.source_files import source_bytes as source_bytes

ACCLAIM_HZ = 120.0
"""The rate of Acclaim files, which never state one; Vicon wrote them at 120 Hz."""

FASTEST_HZ, SLOWEST_HZ = 10_000.0, 1.0
"""The range of accepted rates; others are not of motion capture, and would need huge numbers of frames."""

MAX_POINTS = 10_000
"""The largest number of joints or markers of a body."""

SHORT_GAP_S = 0.1
"""The longest gap that is closed by default: nobody turns round in a tenth of a second."""


@dataclass(frozen=True)
class Body:
    """The named joints of a take at its source rate.

    Attributes
    ----------
    positions : float64 array (J, 3, T)
        Joint positions in metres, Y up; NaN for an unknown joint.
    orientation : float64 array (4, T)
        The root's unit quaternion w, x, y, z; NaN where the root is unknown.
    rate_hz : float
        Frames per second.
    unit : str
        The unit of the file's lengths, in words.
    skeleton : str
        Name of the skeleton mapping.
    unknown : tuple of str
        The joints that the skeleton does not have.
    warnings : tuple of str
        Warnings about the file.
    valid : bool array (T,), optional
        The frames in which all joints but the unknown ones are known; None if all are. The other frames are invalid:
        they get no word, and unknown positions in them are NaN.
    estimated : tuple of str
        The joints that are estimated because the file lacks them.
    confidence : float
        The confidence of the recognition from 0 to 1; 1 for a mapping that the names fit exactly.
    evidence : tuple of str
        Sentences on how body, axes and unit were found, for `kinedex inspect`.
    up : str
        The axis of the file that is taken as vertical, such as "z" or "-y"; empty if the reader does not tell.
    filled_frames : int
        The number of frames in which a hidden marker is placed by the other markers of its segment.
    filled_from : int, optional
        The smallest number of markers by which one is placed so; None where none is.
    """

    positions: npt.NDArray[np.float64]
    orientation: npt.NDArray[np.float64]
    rate_hz: float
    unit: str
    skeleton: str
    unknown: tuple[str, ...]
    warnings: tuple[str, ...]
    valid: npt.NDArray[np.bool_] | None = None
    estimated: tuple[str, ...] = ()
    confidence: float = 1.0
    evidence: tuple[str, ...] = ()
    up: str = ""
    filled_frames: int = 0
    filled_from: int | None = None

    @property
    def frames(self) -> int:
        """The number of source frames T."""
        return int(self.positions.shape[2])


@dataclass(frozen=True)
class ReadSettings:
    """Settings of the user for files with missing or wrong statements.

    Attributes
    ----------
    rate_hz : float, optional
        Frames per second of files that do not state it; 120 for Acclaim files by default.
    override_rate_hz : float, optional
        Frames per second of every file, which replaces the file's statement.
    fill_gap_frames : int, optional
        Longest gap of a point that is filled by linear interpolation, a tenth of a second by default; frames in a
        longer gap are invalid.
    body_model : str, optional
        Body model with the rest joints for AMASS files, see `storage.formats.motion.amass`.
    session_up : str
        The vertical axis of the other files of the folder, for a file in which no axis is clearly up.
    session_hz : float, optional
        The rate of the other files of the folder, for a file whose own is implausible or missing.
    session_unit_m : float, optional
        Metres per unit of the other files of the folder, for a file whose unit is doubtful.
    """

    rate_hz: float | None = None
    override_rate_hz: float | None = None
    fill_gap_frames: int | None = None
    body_model: str | None = None
    session_up: str = ""
    session_hz: float | None = None
    session_unit_m: float | None = None

    @property
    def acclaim_hz(self) -> float:
        """The rate of Acclaim files, which never state it."""
        return self.override_rate_hz or self.rate_hz or ACCLAIM_HZ

    def gap_frames(self, rate_hz: float) -> int:
        """Return the longest gap that is closed, in frames of a file of this rate."""
        return round(SHORT_GAP_S * rate_hz) if self.fill_gap_frames is None else self.fill_gap_frames

    def rate_of(self, stated_hz: float, warnings: list[str]) -> float:
        """Return the rate to use for a file with a stated rate; append a warning if the user's replaces it."""
        rate_hz = self.override_rate_hz or stated_hz
        if abs(rate_hz - stated_hz) > 1e-3 * stated_hz:
            warnings.append(f"the file states {stated_hz:.6g} Hz; it is read at {rate_hz:.6g} Hz, which was given")
        return rate_hz


DEFAULT_SETTINGS = ReadSettings()
"""The settings without any user input."""


@dataclass(frozen=True)
class MotionFile:
    """A motion file to read.

    Attributes
    ----------
    path : Path
        The file.
    skeleton : Path, optional
        Its skeleton file, for formats with a separate skeleton file (Acclaim's ASF).
    data : bytes, optional
        Its content, if it has been read already; only for readers with `reads_whole`.
    person : str
        The person to read, one of the reader's `persons`; empty for a file of one person.
    """

    path: Path
    skeleton: Path | None = None
    data: bytes | None = None
    person: str = ""


@dataclass(frozen=True)
class Extent:
    """The number of frames and the memory of a motion file, found without reading its frames.

    Attributes
    ----------
    frames : int
        Frames at the source rate; 0 if only the size of the file is known.
    bytes : int
        The largest memory that `read` takes, including the body that it returns.
    rate_hz : float, optional
        Frames per second, where the file or the settings state them.
    """

    frames: int
    bytes: int
    rate_hz: float | None = None


def body_bytes(frames: int, joints: int) -> int:
    """Return the memory of the positions, orientation and rotations of a body."""
    return frames * (24 * joints + 32 + 72)


class Reader(ABC):
    """A reader of one format of motion files; subclasses set the attributes and define `read`.

    Attributes
    ----------
    format : str
        Format of the skeleton mappings in which the reader looks up its joints.
    endings : tuple of str
        Endings of its files in lower case, with the dot.
    title : str
        The format in words, for `kinedex inspect`; by default its extension.
    reads_whole : bool
        True if the reader reads the whole file at once, so that its caller can pass the bytes.
    beside : tuple of str
        Endings of the files that the reader looks for in the folder of a file and below, so that they are unpacked with
        it.
    distribution : str
        The distribution of a plugin and its version, set by the table of readers; empty for a built-in reader.
    """

    format: ClassVar[Format]
    endings: ClassVar[tuple[str, ...]]
    title: ClassVar[str] = ""
    reads_whole: ClassVar[bool] = False
    beside: ClassVar[tuple[str, ...]] = ()
    distribution: str = ""

    def sniff(self, path: Path) -> bool:
        """Return whether a file with one of the extensions is of this format; by default return True.

        An unreadable file counts as one of the format, so that `read` reports the fault.
        """
        return True

    def relevant_settings(self, settings: ReadSettings) -> object:
        """Return the settings that can change a body, as JSON values: a take is read again if they change."""
        return astuple(settings)

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Return the frames and the memory of a file, by which `max_memory` refuses it before it is read.

        By default the memory is ten times the size of the file.

        Raises
        ------
        SourceError
            The file cannot be read.
        """
        return Extent(0, 10 * file_size(file.path))

    def persons(self, file: MotionFile, mappings: Mappings) -> tuple[str, ...]:
        """Return the names of the persons in a file, each of whom becomes a take; empty for a file of one person.

        By default files have one person.

        Raises
        ------
        SourceError
            The file cannot be read.
        """
        return ()

    @abstractmethod
    def read(self, file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings) -> Body:
        """Read a file as a body.

        Parameters
        ----------
        file : MotionFile
            The file.
        mappings : Mappings
            Skeleton mappings; `mappings.detect` finds the one that fits the file's nodes.
        joints : tuple of str
            The named joints, in the order of the result.
        settings : ReadSettings
            Settings of the user.

        Raises
        ------
        SourceError
            The file cannot be read; the error names the file and the line, key or frame of the first fault.
        """
