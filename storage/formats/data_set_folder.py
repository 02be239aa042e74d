"""The folder of a data set: finished clips, the journal of an unfinished export, and files of earlier exports."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from kinedex.ops.errors import KinedexError
from kinedex.storage.durable_files import TEMPORARY, whole_file

DATA_SET, METADATA = "dataset.json", "metadata.csv"
FORMAT = "kinedex data set 1"

SPLITS = ("train", "val", "test")
"""The names of splits, in the order of their shares, which are also names of folders."""

CLIPS = "clips"
"""The folder of clips if there is no split."""

_JOURNAL, _LOCK = ".kinedex-export.jsonl", ".kinedex-export.lock"
_OWN = {DATA_SET, METADATA, _JOURNAL, _LOCK}
_FILE = re.compile(rf"(?:{'|'.join((CLIPS, *SPLITS))})/[^/\\:\0]+")
_BLOCK = 1 << 20


@dataclass(frozen=True)
class WrittenFile:
    """A file of a clip that was written.

    Attributes
    ----------
    file : str
        Its path, relative to the folder of the data set, with / as separator.
    fingerprint : str
        Hash of everything that determines its content.
    sha256 : str
        Checksum of its content.
    """

    file: str
    fingerprint: str
    sha256: str


class DataSetFolder:
    """The folder of a data set during an export; a context manager that locks it against other exports.

    A journal lists each finished file, so that an export that was killed continues where it stopped. It is removed when
    `finish` has written the metadata.

    Parameters
    ----------
    path : Path
        The folder; it is created if missing.

    Raises
    ------
    KinedexError
        The folder has files of other origin, cannot be written, or another export writes into it.
    """

    def __init__(self, path: Path) -> None:
        from filelock import FileLock  # imported here, since most commands export nothing

        self.path = path
        self._journal: IO[str] | None = None
        self._lock = FileLock(path / _LOCK, blocking=False)
        self.known: dict[str, WrittenFile] = {}

    def __enter__(self) -> DataSetFolder:
        from filelock import Timeout

        require_own(self.path)
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self._lock.acquire()
        except Timeout:
            raise KinedexError(f"{self.path}: another export writes into this folder; wait for its end") from None
        except OSError as fault:
            raise KinedexError(f"{self.path}: cannot be written: {fault.strerror}") from None
        self.known = {one.file: one for one in (*_of_data_set(self.path), *_of_journal(self.path))}
        return self

    def __exit__(self, *_: object) -> None:
        if self._journal is not None:
            self._journal.close()
        self._lock.release()
        (self.path / _LOCK).unlink(missing_ok=True)

    def checksums(self, wanted: Iterable[tuple[str, str]]) -> list[str] | None:
        """Return the checksums of the files of a clip; None if a file is missing or has other content.

        Parameters
        ----------
        wanted : iterable of (str, str)
            Path and fingerprint of each file.
        """
        found = []
        for file, fingerprint in wanted:
            known = self.known.get(file)
            if known is None or known.fingerprint != fingerprint or sha256_of(self.path / file) != known.sha256:
                return None
            found.append(known.sha256)
        return found

    def begin(self, folders: Iterable[str]) -> None:
        """Create the folders of clips, and turn the metadata of an earlier export into a journal."""
        for name in folders:
            (self.path / name).mkdir(exist_ok=True)
        with whole_file(self.path / _JOURNAL) as unfinished:
            unfinished.write_text("".join(map(_line, self.known.values())), encoding="utf-8")
        for name in (DATA_SET, METADATA):
            (self.path / name).unlink(missing_ok=True)
        self._journal = (self.path / _JOURNAL).open("a", encoding="utf-8")

    def add(self, written: Iterable[WrittenFile]) -> None:
        """Record files that are completely written to disk."""
        assert self._journal is not None
        for one in written:
            self.known[one.file] = one
            self._journal.write(_line(one))
        self._journal.flush()

    def finish(self, files: Iterable[str], data_set: str, metadata: str) -> None:
        """Remove files of earlier exports, and write the metadata, with `dataset.json` last.

        Parameters
        ----------
        files : iterable of str
            The files of the data set.
        data_set, metadata : str
            The contents of `dataset.json` and `metadata.csv`.
        """
        for file in sorted({*self.known} - {*files}):
            (self.path / file).unlink(missing_ok=True)
        for name in (CLIPS, *SPLITS):
            if (self.path / name).is_dir():
                for left in (self.path / name).glob(f"{TEMPORARY}*"):
                    left.unlink(missing_ok=True)
                if not any((self.path / name).iterdir()):
                    (self.path / name).rmdir()
        for name, text in ((METADATA, metadata), (DATA_SET, data_set)):
            with whole_file(self.path / name) as unfinished:
                unfinished.write_bytes(text.encode())
        if self._journal is not None:
            self._journal.close()
            self._journal = None
        (self.path / _JOURNAL).unlink(missing_ok=True)


def sha256_of(path: Path) -> str | None:
    """Return the SHA-256 of a file; None if it cannot be read."""
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(_BLOCK):
                digest.update(block)
    except OSError:
        return None
    return digest.hexdigest()


def require_own(path: Path) -> None:
    """Raise a KinedexError if a folder contains files other than those of an export."""
    if path.exists() and not path.is_dir():
        raise KinedexError(f"{path}: is a file; a data set is a folder: give another name with -o")
    if not path.is_dir():
        return
    others = sorted(name for name in os.listdir(path) if name not in (*_OWN, CLIPS, *SPLITS))
    ours = (path / _JOURNAL).is_file() or _content(path).get("format") == FORMAT
    if (others or os.listdir(path)) and not ours:
        shown = (others or sorted(os.listdir(path)))[0]
        raise KinedexError(
            f"{path}: is not empty and no data set of kinedex (it has '{shown}'); give a new folder, such as "
            f"-o {path / 'export'}"
        )
    links = [name for name in (CLIPS, *SPLITS) if (path / name).is_symlink()]
    if links:
        raise KinedexError(f"{path / links[0]}: is a link, through which nothing is written; remove it")


def written_by(path: Path) -> tuple[list[str], int]:
    """Return the files of the clips of a finished export, and the number of clips that could not be written."""
    excluded = _content(path).get("excluded")
    return [one.file for one in _of_data_set(path)], len(excluded) if isinstance(excluded, list) else 0


def _content(path: Path) -> Mapping[str, Any]:
    try:
        content = json.loads((path / DATA_SET).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def _of_data_set(path: Path) -> list[WrittenFile]:
    """Return the files that an earlier export lists in its metadata."""
    clips = _content(path).get("clips")
    rows = [one.get("files") for one in clips if isinstance(one, dict)] if isinstance(clips, list) else []
    return [one for files in rows if isinstance(files, list) for file in files if (one := _written(file)) is not None]


def _of_journal(path: Path) -> list[WrittenFile]:
    """Return the files that an unfinished export has written; its last line may be incomplete."""
    try:
        lines = (path / _JOURNAL).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    found = []
    for line in lines:
        try:
            row = json.loads(line)
        except (ValueError, RecursionError):
            continue
        if (one := _written(row)) is not None:
            found.append(one)
    return found


def _written(row: object) -> WrittenFile | None:
    """Return the record of a file; None if it is invalid, or names a file that an export would not write."""
    if not isinstance(row, dict):
        return None
    file, fingerprint, sha256 = (row.get(name) for name in ("file", "fingerprint", "sha256"))
    if not (isinstance(file, str) and isinstance(fingerprint, str) and isinstance(sha256, str)):
        return None
    if not _FILE.fullmatch(file) or file.split("/")[1] in (".", ".."):
        return None
    return WrittenFile(file, fingerprint, sha256)


def _line(one: WrittenFile) -> str:
    return json.dumps({"file": one.file, "fingerprint": one.fingerprint, "sha256": one.sha256}) + "\n"
