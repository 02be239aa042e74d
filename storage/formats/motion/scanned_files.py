"""Record the files of an archive: those that hold motion, those that cannot be read, and those that are skipped."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.packed_files import split_ending


def readable(text: str) -> str:
    r"""Return a text in which bytes of a file name that are not UTF-8 (surrogates in Python) are shown as \xNN."""
    return text.encode("utf-8", sys.getfilesystemencodeerrors()).decode("utf-8", "backslashreplace")


@dataclass(frozen=True)
class SourceFile:
    r"""One motion file of an archive.

    Attributes
    ----------
    root : str
        The source root.
    path : str
        Path relative to the root, with /, as valid Unicode: bytes that are not UTF-8 are shown as \xNN. A file in an
        archive has that as a folder: archive.zip/walk.bvh.
    size : int
        Size in bytes, unpacked.
    mtime_ns : int
        Time of the last change of the file or of its archive, in nanoseconds since 1970.
    on_disk : str
        The path as the file system has it, if `path` differs.
    """

    root: str
    path: str
    size: int
    mtime_ns: int
    on_disk: str = ""

    @property
    def absolute(self) -> Path:
        """The absolute path of the file."""
        return Path(self.root) / (self.on_disk or self.path)

    @property
    def stem(self) -> str:
        """The file's name without folder and extension, which is the take's name."""
        return split_ending(os.path.basename(self.path))[0]

    @property
    def format(self) -> str:
        """The file's extension in lower case, without the dot, such as "amc", also of walk.amc.gz."""
        return split_ending(self.path)[1][1:].lower()


@dataclass(frozen=True)
class UnreadableFile:
    """A file or folder of an archive that cannot be read: its path relative to the source root, and the reason."""

    path: str
    fault: SourceError


@dataclass(frozen=True)
class SkippedFile:
    """A file of an archive that is not motion: its path relative to the source root, and its kind in the plural."""

    path: str
    kind: str

    @property
    def ending(self) -> str:
        """The file's extension in lower case, with the dot."""
        return os.path.splitext(self.path)[1].lower()
