"""Read files that lie in .zip archives or are packed as .gz, within bounds, by paths such as archive.zip/walk.bvh."""

from __future__ import annotations

import gzip
import io
import os
import re
import stat
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.source_files import stamp_of

MAX_FILE = 2 << 30
"""The largest size of an unpacked file in bytes."""

MAX_ARCHIVE = 256 << 30
"""The largest size of all files of an archive in bytes, unpacked."""

MAX_MEMBERS = 100_000
"""The largest number of files in an archive."""

MAX_DIRECTORY = 16 << 20
"""The largest size in bytes of the list of files that ends an archive."""

MAX_RATIO, FREE_BYTES = 200, 64 << 20
"""The largest ratio of unpacked to packed size, and the unpacked size up to which any ratio is accepted."""

_MAX_NAME, _MAX_PART = 1000, 255
_CHUNK = 1 << 20
_ENCRYPTED = 0x1 | 0x40 | 0x2000
_ODD = re.compile(r"[\x00-\x1f\x7f]")
_UNPACK = "unpack the archive"


class ByteStream(Protocol):
    """Protocol of an open file, of which bytes are read in order."""

    def read(self, size: int, /) -> bytes:
        """Return the next bytes, at most `size` of them; empty at the end."""
        ...


def split_ending(path: str) -> tuple[str, str]:
    """Divide a path into what comes before its extension, and the extension; .gz counts as no extension of its own.

    Examples
    --------
    >>> split_ending("a/walk.bvh"), split_ending("a/walk.bvh.gz"), split_ending("walk.gz")
    (('a/walk', '.bvh'), ('a/walk', '.bvh'), ('walk', '.gz'))
    """
    stem, ending = os.path.splitext(path)
    if ending.lower() == ".gz":
        inner = os.path.splitext(stem)
        return inner if inner[1] else (stem, ending)
    return stem, ending


def container_of(path: Path) -> Path | None:
    """Return the file on the disk that holds a packed file: its archive, or itself if it ends with .gz; else None."""
    text = os.fspath(path).lower()
    if f".zip{os.sep}" in text:
        archives = (folder for folder in path.parents if folder.suffix.lower() == ".zip" and folder.is_file())
        if (found := next(archives, None)) is not None:
            return found
    return path if text.endswith(".gz") and os.path.isfile(path) else None


def file_exists(path: Path) -> bool:
    """Return whether there is a file at a path, on the disk or in an archive."""
    container = container_of(path)
    if container is None or container == path:
        return path.is_file()
    try:
        return _name_in(container, path) in archive(container).members
    except SourceError:
        return False


@dataclass(frozen=True)
class Member:
    """A file of an archive: its record there, and the reason why it is refused, empty if it can be read."""

    record: zipfile.ZipInfo
    reason: str = ""


@dataclass(frozen=True)
class Archive:
    """The files of a .zip archive.

    Attributes
    ----------
    path : Path
        The archive.
    mtime_ns : int
        The time of its last change, in nanoseconds since 1970.
    members : dict of str to Member
        The files by their names, with / between folders.
    refused : dict of str to str
        Name → reason of files whose names no path can have; the names are shown without control characters.
    """

    path: Path
    mtime_ns: int
    members: dict[str, Member]
    refused: dict[str, str]
    _packed: zipfile.ZipFile

    @contextmanager
    def opened(self, name: str) -> Iterator[ByteStream]:
        """Open a file of the archive; raise a SourceError if it is refused or damaged."""
        path = self.path / name
        member = self.members.get(name)
        if member is None:
            raise SourceError(path, "is not in the archive")
        if member.reason:
            raise SourceError(path, member.reason)
        with _unpack_errors(path):
            file = self._packed.open(member.record)
        with file:
            yield _Checked(path, file, member.record.compress_size, member.record.file_size)


def archive(path: Path) -> Archive:
    """Return the list of files of a .zip archive, which is read again only if the archive has changed.

    Raises
    ------
    SourceError
        The archive cannot be read, is damaged, or holds more than the bounds of this module allow.
    """
    return _archive(path, stamp_of(path))


@lru_cache(maxsize=32)
def _archive(path: Path, stamp: tuple[int, int]) -> Archive:
    with _unpack_errors(path):
        packed = zipfile.ZipFile(_Disk(path))
    records = [record for record in packed.infolist() if not record.orig_filename.endswith(("/", "\\"))]
    if len(records) > MAX_MEMBERS:
        raise SourceError(path, f"holds {len(records):,} files; archives have at most {MAX_MEMBERS:,}: {_UNPACK}")
    size = sum(record.file_size for record in records)
    if size > MAX_ARCHIVE or (size > 16 * FREE_BYTES and size > MAX_RATIO * stamp[0]):
        raise SourceError(
            path,
            f"holds {size / 1e9:,.1f} GB in {stamp[0] / 1e6:,.1f} MB; archives hold at most {MAX_ARCHIVE >> 30} GB and "
            f"{MAX_RATIO} times their size: {_UNPACK} if it is sound",
        )
    members: dict[str, Member] = {}
    refused: dict[str, str] = {}
    for record in records:
        name = record.orig_filename.replace("\\", "/")  # which old programs for Windows wrote
        if odd := _odd_name(name):
            refused[_ODD.sub("?", name)[:_MAX_NAME]] = odd
        elif name in members:
            members[name] = Member(record, "is in the archive more than once; pack it again with each file once")
        else:
            members[name] = Member(record, _refusal(name, record))
    return Archive(path, stamp[1], members, refused, packed)


def _odd_name(name: str) -> str:
    """Return the reason why a name in an archive is refused; empty for an ordinary name."""
    parts = name.split("/")
    if name.startswith("/") or re.match(r"[A-Za-z]:", name):
        return f"has an absolute path in the archive, which is not followed; {_UNPACK} into a folder of your own"
    if ".." in parts:
        return f"has a path that leads out of the archive, which is not followed; {_UNPACK} into a folder of your own"
    long = len(name.encode()) > _MAX_NAME or any(len(part.encode()) > _MAX_PART for part in parts)
    if "." in parts or "" in parts or _ODD.search(name) or long:
        return (
            "has a name in the archive that is no ordinary path (empty or '.' folders, control characters, or more "
            f"than {_MAX_PART} bytes, {_MAX_NAME} with its folders); rename it and pack it again"
        )
    return ""


def _refusal(name: str, record: zipfile.ZipInfo) -> str:
    """Return the reason why a file of an archive is refused, by its record; empty if it can be read."""
    kind = stat.S_IFMT(record.external_attr >> 16)
    if split_ending(name)[1].lower() == ".zip" or name.lower().endswith(".gz"):
        return "is packed within an archive; archives are unpacked one level deep: unpack the outer one"
    if record.flag_bits & _ENCRYPTED:
        return f"is encrypted; {_UNPACK} with its password"
    if kind not in (0, stat.S_IFREG):
        what = "a link" if kind == stat.S_IFLNK else "a device, a pipe or a socket"
        return f"is {what} in the archive, which is not followed; pack the file itself"
    if record.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        method = f"method {record.compress_type} of .zip"
        return f"is packed by {method}; only stored and deflated files are read: {_UNPACK}, or pack it by deflate"
    if record.file_size > MAX_FILE:
        return f"has {record.file_size / 1e9:,.1f} GB; packed files have at most {MAX_FILE >> 30} GB: {_UNPACK}"
    return _ratio_reason(record.file_size, record.compress_size)


def _ratio_reason(size: int, packed: int) -> str:
    if size > FREE_BYTES and size > MAX_RATIO * max(packed, 1):
        return (
            f"has {size / 1e6:,.0f} MB in {packed / 1e6:,.2f} MB, more than {MAX_RATIO} times as much, as if made to "
            "fill the disk; unpack it yourself if it is sound"
        )
    return ""


@contextmanager
def opened(path: Path) -> Iterator[ByteStream]:
    """Open a file for reading its bytes in order, on the disk or packed.

    Parameters
    ----------
    path : Path
        The file, such as walk.bvh, walk.bvh.gz or archive.zip/walk.bvh.

    Raises
    ------
    SourceError
        It cannot be read, is damaged, encrypted or cut off, or is larger than the bounds of this module allow; the
        error names the archive and the file in it.
    """
    container = container_of(path)
    if container is None:
        with _unpack_errors(path):
            raw = path.open("rb", buffering=0)
        with raw:
            yield _Checked(path, raw)
    elif container != path:
        with archive(container).opened(_name_in(container, path)) as file:
            yield file
    else:
        with _unpack_errors(path):
            unpacked = gzip.open(path)  # noqa: SIM115 (closed below; its errors are another matter)
        with unpacked:
            yield _Checked(path, unpacked, stamp_of(path)[0])


def packed_size(path: Path) -> int:
    """Return the size in bytes of the file in a .gz file, which its last four bytes state."""
    with _unpack_errors(path), path.open("rb") as file:
        if file.seek(0, io.SEEK_END) < 18:
            return 0
        file.seek(-4, io.SEEK_END)
        return int.from_bytes(file.read(4), "little")


def files_beside(path: Path, endings: tuple[str, ...]) -> list[Path]:
    """Return the files with given extensions in the folder of a file, and in an archive in the folders below, too."""
    container = container_of(path)
    if not endings:
        return []
    if container is None or container == path:
        folder = path.parent.resolve()
        found = (other for other in sorted(path.parent.iterdir()) if split_ending(other.name)[1].lower() in endings)
        # what a link leads to outside of the folder is not copied
        return [other for other in found if other.is_file() and other.resolve().is_relative_to(folder)]
    within = os.path.dirname(_name_in(container, path))
    start = f"{within}/" if within else ""
    return [
        container / name
        for name in archive(container).members
        if name.startswith(start) and os.path.splitext(name)[1].lower() in endings
    ]


def files_in(folder: Path) -> list[Path]:
    """Return the files in a folder, on the disk or in an archive, sorted by name."""
    if folder.is_dir():
        return sorted(path for path in folder.iterdir() if path.is_file())
    place = folder / "file"
    container = container_of(place)
    if container is None:
        return []
    start = os.path.dirname(_name_in(container, place))
    return sorted(container / name for name in archive(container).members if os.path.dirname(name) == start)


def _name_in(container: Path, path: Path) -> str:
    return path.relative_to(container).as_posix()


@contextmanager
def _unpack_errors(path: Path) -> Iterator[None]:
    """Turn the errors of reading packed files into a SourceError that names the file."""
    try:
        yield
    except (zipfile.BadZipFile, gzip.BadGzipFile, zlib.error, EOFError) as fault:
        raise SourceError(
            path, f"cannot be unpacked, since it is damaged or cut off ({fault}); copy or pack it again"
        ) from None
    except OSError as fault:
        raise SourceError(path, f"cannot be read: {fault.strerror}") from fault
    except (NotImplementedError, RuntimeError, ValueError, OverflowError) as fault:  # zipfile has no class for these
        raise SourceError(path, f"cannot be unpacked: {fault}; {_UNPACK} with another program") from None


class _Checked:
    """An open file whose faults name it; a packed one yields no more than the bounds, whatever its headers state."""

    def __init__(self, path: Path, file: ByteStream, packed: int | None = None, stated: int | None = None) -> None:
        self._path, self._file, self._packed, self._stated, self._size = path, file, packed, stated, 0

    def read(self, size: int, /) -> bytes:
        """Return the next bytes, at most `size` of them."""
        with _unpack_errors(self._path):
            data = self._file.read(size)
            self._size += len(data)
            if not data and self._stated not in (None, self._size):
                raise EOFError(f"it has {self._size} bytes of {self._stated}")
        if self._packed is not None and self._size > MAX_FILE:
            raise SourceError(self._path, f"unpacks to more than {MAX_FILE >> 30} GB: {_UNPACK} if it is sound")
        if self._packed is not None and (reason := _ratio_reason(self._size, self._packed)):
            raise SourceError(self._path, reason)
        return data


class _Disk(io.RawIOBase):
    """A file that is open only while it is read, so that processes share nothing and the file can be replaced."""

    def __init__(self, path: Path) -> None:
        self._path, self._at = path, 0

    def seekable(self) -> bool:
        """Return True."""
        return True

    def readable(self) -> bool:
        """Return True."""
        return True

    def tell(self) -> int:
        """Return the place of the next byte."""
        return self._at

    def seek(self, place: int, whence: int = io.SEEK_SET) -> int:
        """Go to a byte, counted from the beginning, the current place or the end."""
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._at}
        self._at = place + (base[whence] if whence in base else os.path.getsize(self._path))
        if self._at < 0:
            raise OSError(22, "Invalid argument")
        return self._at

    def readinto(self, buffer: Any, /) -> int:
        """Read bytes into a buffer of at most `MAX_DIRECTORY` bytes."""
        if len(buffer) > MAX_DIRECTORY:
            raise ValueError(f"its list of files has more than {MAX_DIRECTORY >> 20} MB")
        with self._path.open("rb", buffering=0) as file:
            file.seek(self._at)
            count = file.readinto(buffer)
        self._at += count
        return count
