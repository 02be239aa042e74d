"""Give packed files, and texts in UTF-16, to readers as ordinary files in UTF-8, in a folder that is removed."""

from __future__ import annotations

import codecs
import hashlib
import os
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from kinedex.ops.errors import ConfigError, KinedexError, SourceError
from kinedex.storage.formats.motion.packed_files import (
    MAX_FILE,
    container_of,
    files_beside,
    opened,
    split_ending,
)
from kinedex.storage.formats.motion.reader import Body
from kinedex.storage.formats.motion.reader_table import is_motion_file, readers_by_ending
from kinedex.storage.formats.source_files import stamp_of
from kinedex.storage.temporary_folders import temporary_folder

_CHUNK = 1 << 20
_HEAD = 1 << 16
"""The number of first bytes by which readers recognise their files; only an .npz file has its names at the end."""

_MARKS = {codecs.BOM_UTF16_LE: ("utf-16-le", b"<\0"), codecs.BOM_UTF16_BE: ("utf-16-be", b"\0<")}


def is_utf16(path: Path) -> bool:
    """Return whether a file begins like a text in UTF-16 that readers need in UTF-8; False if it cannot be read."""
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0))  # faster than a file object
    except OSError:
        return False
    try:
        return bool(_utf16_of(os.read(descriptor, 4)))
    except OSError:
        return False
    finally:
        os.close(descriptor)


def _utf16_of(head: bytes) -> str:
    """Return the encoding of a text in UTF-16 with a byte order mark, by its first four bytes; empty for other files.

    XML states its encoding itself, and its readers follow that.
    """
    encoding, xml = _MARKS.get(head[:2], ("", b""))
    return "" if head[2:4] == xml else encoding


@dataclass(frozen=True)
class Unpacked:
    """A file as readers can open it.

    Attributes
    ----------
    path : Path
        The file on the disk: the given one, or a copy of it in a temporary folder.
    skeleton : Path or None
        Its skeleton file, likewise.
    checksum : str
        The SHA-256 of the original if `path` is a copy; else empty.
    """

    path: Path
    skeleton: Path | None = None
    checksum: str = ""
    _names: tuple[tuple[str, str], ...] = ()

    def restated(self, text: str) -> str:
        """Return a text with the path of the original in place of that of the copy."""
        for copy, original in self._names:
            text = text.replace(copy, original)
        return text

    def restated_error(self, fault: KinedexError) -> KinedexError:
        """Return an error with the path of the original in place of that of the copy."""
        if not self._names or not isinstance(fault, (SourceError, ConfigError)):
            return fault
        path, reason = self.restated(fault.path), self.restated(fault.reason)
        if isinstance(fault, ConfigError):
            return ConfigError(path, reason, line=fault.line, key=fault.key)
        return SourceError(path, reason, line=fault.line)

    def restated_body(self, body: Body) -> Body:
        """Return a body whose warnings and evidence have the path of the original in place of that of the copy."""
        if not self._names:
            return body
        warnings, evidence = (tuple(map(self.restated, texts)) for texts in (body.warnings, body.evidence))
        return replace(body, warnings=warnings, evidence=evidence)


@contextmanager
def unpacked(path: Path, skeleton: Path | None = None) -> Iterator[Unpacked]:
    """Yield a file as readers can open it, for the `with` block, with the files beside it that its reader looks for.

    An ordinary file is yielded as it is. Errors on the copy of another one name the original.

    Parameters
    ----------
    path : Path
        The file, such as walk.bvh, walk.bvh.gz or archive.zip/walk.bvh.
    skeleton : Path, optional
        Its skeleton file.

    Raises
    ------
    SourceError
        A file cannot be unpacked, or is no valid UTF-16 although it begins with its mark.
    """
    if skeleton is None:
        with _unpacked(path) as file:
            yield file
        return
    with _unpacked(path) as file, _unpacked(skeleton) as bones:
        yield replace(file, skeleton=bones.path, _names=file._names + bones._names)


@contextmanager
def _unpacked(path: Path) -> Iterator[Unpacked]:
    container = container_of(path)
    if container is None and not is_utf16(path):
        yield Unpacked(path)
        return
    base = path.parent if container in (None, path) else container
    assert base is not None
    with temporary_folder() as folder:
        copy = _place(folder, base, path)
        found = Unpacked(copy, None, _write(path, copy), ((str(copy), str(path)), (str(folder), str(base))))
        _write_all(folder, base, _others(path))
        try:
            yield found
        except KinedexError as fault:
            restated = found.restated_error(fault)
            if restated is fault:
                raise
            raise restated from fault


def _place(folder: Path, base: Path, path: Path) -> Path:
    """Return the path of an unpacked file in a temporary folder; `base` is the folder or archive with the file."""
    stem, ending = split_ending(path.relative_to(base).as_posix())
    return folder / f"{stem}{ending}"


def _beside(path: Path) -> tuple[str, ...]:
    """Return the extensions of the files that the readers of a file look for beside it."""
    readers = readers_by_ending().get(split_ending(path.name)[1].lower(), ())
    return tuple(ending for reader in readers for ending in reader.beside)


def _others(path: Path) -> Iterator[Path]:
    """Yield the other files that reading a file requires: the files of its sequence, models, and buffers."""
    kind = split_ending(path.name)[1].lower()
    for other in files_beside(path, _beside(path)):
        if other != path and (other.parent == path.parent or split_ending(other.name)[1].lower() != kind):
            yield other


def _write_all(folder: Path, base: Path, paths: Iterable[Path]) -> None:
    left = MAX_FILE
    for path in paths:
        copy = _place(folder, base, path)
        if copy.exists():
            continue  # a file beside a packed one of the same name
        _write(path, copy)
        left -= copy.stat().st_size
        if left < 0:
            raise SourceError(path, f"and the other files beside it have more than {MAX_FILE >> 30} GB; unpack them")


def _write(path: Path, copy: Path, most: int | None = None) -> str:
    """Write a file, or only its first bytes, to another place, text in UTF-8; return the SHA-256 of what was read."""
    hasher = hashlib.sha256()
    try:
        copy.parent.mkdir(parents=True, exist_ok=True)
        with opened(path) as file, copy.open("wb") as out:
            decoder, data = None, file.read(_CHUNK if most is None else most)
            if encoding := _utf16_of(data[:4]):
                # the first bytes may end within a character
                decoder = codecs.getincrementaldecoder(encoding)("strict" if most is None else "ignore")
            while data:
                hasher.update(data)
                out.write(data if decoder is None else decoder.decode(data).removeprefix("\ufeff").encode())
                data = file.read(_CHUNK) if most is None else b""
            if decoder is not None and most is None:
                decoder.decode(b"", True)
    except UnicodeDecodeError:
        raise SourceError(path, "is no text in UTF-16, though it begins with its byte order mark; cut off?") from None
    except OSError as fault:
        raise SourceError(
            path,
            f"cannot be unpacked into {tempfile.gettempdir()}: {fault.strerror}; the variable TMPDIR names another "
            "folder for unpacked files",
        ) from fault
    return hasher.hexdigest()


def recognised(paths: Sequence[Path]) -> frozenset[Path]:
    """Return those packed or UTF-16 files of one folder that readers recognise, by the rules of `is_motion_file`.

    A file that cannot be unpacked counts as one, so that its reader reports the fault.
    """
    return _recognised(tuple(paths), tuple(stamp_of(container_of(path) or path) for path in paths))


@lru_cache(maxsize=256)
def _recognised(paths: tuple[Path, ...], _stamps: tuple[tuple[int, int], ...]) -> frozenset[Path]:
    """Recognise files by their first bytes, together where readers look for files beside them."""
    found = set()
    with temporary_folder() as folder:
        together = []
        for path in paths:
            copy = _place(folder, path.parent, path)
            try:
                _write(path, copy, None if copy.suffix.lower() == ".npz" else _HEAD)
            except SourceError:
                found.add(path)
                continue
            if _beside(path):
                together.append((path, copy))
                continue
            if is_motion_file(copy):
                found.add(path)
            copy.unlink()
        found |= {path for path, copy in together if is_motion_file(copy)}
    return frozenset(found)
