"""Describe the files from which a store has takes, by name, checksum and content, to compare a source with them."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import pyarrow as pa

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.packed_files import file_exists, split_ending
from kinedex.storage.formats.motion.scanned_files import SourceFile
from kinedex.storage.formats.motion.sources import checksum
from kinedex.storage.snapshot.schemas import RECORDED_FORMATS, result_schema

Naming = Literal["stem", "path", "file"]
"""The rule for the name of a take: the stem of its file, its path without the extension, or its path."""

_SCHEMA = result_schema("skeleton_files").remove(0)  # `run` is written by the store
Row = dict[str, Any]


def file_names(naming: Naming, path: str) -> tuple[str, ...]:
    """Return the names that the take of a file can have; the first follows the given rule.

    Parameters
    ----------
    naming : {"stem", "path", "file"}
        The rule.
    path : str
        The path of the file below the source root, with /.
    """
    without = split_ending(path)[0]
    names = (os.path.basename(without), without, path)
    return names[("stem", "path", "file").index(naming) :]


def person_name(file_name: str, person: str) -> str:
    """Return the name of the take of one person in a file with several persons."""
    return f"{file_name}-{person}" if person else file_name


class TakeNames:
    """The names of the takes of a store, to which those of new files are added.

    An existing name is never changed: a file that is added later gets another name.

    Parameters
    ----------
    naming : {"stem", "path", "file"}
        The rule for new names.
    owners : mapping of str to str
        The names that are in use, each with the path of its file below the source; empty for a file elsewhere.
    """

    def __init__(self, naming: Naming, owners: Mapping[str, str]) -> None:
        self.naming = naming
        self._owners = dict(owners)

    def add_files(self, paths: Iterable[str], named: Mapping[str, str]) -> dict[str, str]:
        """Name the files of a source; files with equal stems are named by their paths, then with their extensions.

        Parameters
        ----------
        paths : iterable of str
            The paths of all files of the source.
        named : mapping of str to str
            Path → name of the files that keep their names.

        Returns
        -------
        dict of str to str
            Path → name of every file for which a name was free.
        """
        choices = {path: file_names(self.naming, path) for path in paths}
        self._owners.update((name, path) for path, name in named.items())
        names = dict(named)
        for rank in range(len(file_names(self.naming, ""))):
            wanted = {path: those[rank] for path, those in choices.items()}
            count = Counter(wanted.values())
            for path, name in wanted.items():
                if path not in names and count[name] == 1 and self._owners.get(name, path) == path:
                    names[path] = name
                    self._owners[name] = path
        return names

    def add_person(self, path: str, file_name: str, person: str) -> str | None:
        """Name the take of a person in a file with several persons; return None if every possible name is in use.

        Parameters
        ----------
        path : str
            The path of the file.
        file_name : str
            The name of the file.
        person : str
            The person.
        """
        for name in (file_name, *file_names(self.naming, path)):
            whole = person_name(name, person)
            if whole not in self._owners:
                self._owners[whole] = path
                return whole
        return None


class SkeletonSums:
    """The checksums of skeleton files; those of an earlier run are reused if path, size and modification time match."""

    def __init__(self, known: pa.Table) -> None:
        """Start with the checksums of earlier runs, given as rows of `skeleton_files`."""
        self._known: dict[tuple[object, ...], str] = {
            tuple(row[name] for name in _SCHEMA.names[:-1]): row["checksum"] for row in known.to_pylist()
        }
        self._found: dict[tuple[object, ...], str] = {}

    def of(self, skeleton: SourceFile) -> str:
        """Return the checksum of a skeleton file.

        Raises
        ------
        SourceError
            The file cannot be read.
        """
        state = (skeleton.root, skeleton.path, skeleton.size, skeleton.mtime_ns)
        if state not in self._found:
            self._found[state] = self._known.get(state) or checksum(skeleton.absolute)
        return self._found[state]

    def table(self) -> pa.Table:
        """Return the checksums for the next run as rows of `skeleton_files`, including those of other sources."""
        here = {root for root, *_ in self._found}
        others = {state: content for state, content in self._known.items() if state[0] not in here}
        rows = [(*state, content) for state, content in (others | self._found).items()]
        return pa.Table.from_pylist([dict(zip(_SCHEMA.names, row, strict=True)) for row in rows], schema=_SCHEMA)


def file_name(row: Mapping[str, Any]) -> str:
    """Return the name of a take without the suffix that names the person, if the file has several."""
    person = row.get("person")
    return str(row["name"]).removesuffix(f"-{person}") if person else str(row["name"])


class FileContent:
    """A motion file of a source, whose content is read at most once.

    Parameters
    ----------
    motion : SourceFile
        The file.
    """

    def __init__(self, motion: SourceFile) -> None:
        self.motion = motion

    @cached_property
    def checksum(self) -> str:
        """The SHA-256 of the file; a SourceError is raised if it cannot be read."""
        return checksum(self.motion.absolute)


@dataclass(frozen=True)
class KnownFile:
    """A file from which a store has takes.

    Attributes
    ----------
    root : str
        The source root.
    path : str
        The path below the root.
    rows : tuple of dict
        The rows of its takes: one, or one for each person.
    """

    root: str
    path: str
    rows: tuple[Row, ...]

    @property
    def place(self) -> tuple[str, str]:
        """The root and the path."""
        return self.root, self.path

    @property
    def name(self) -> str:
        """The name that the file gives its takes."""
        return file_name(self.rows[0])

    @cached_property
    def is_there(self) -> bool:
        """True if the file still exists at its path, or in its archive."""
        return file_exists(Path(self.root) / self.path)

    def current_rows(
        self, content: FileContent, is_made_so: Callable[[Row], bool], damaged: Iterable[int]
    ) -> tuple[Row, ...]:
        """Return the rows of takes that need not be read again; none if a person in the file is missing.

        Parameters
        ----------
        content : FileContent
            The file as it is now.
        is_made_so : callable
            Returns whether a take, given by its row, has the recipe that it would have if it were read now.
        damaged : collection of int
            The ids of takes whose part of the store is damaged.

        Raises
        ------
        SourceError
            The file cannot be read.
        """
        sound = [row for row in self.rows if is_made_so(row) and row["take_id"] not in damaged]
        rows = tuple(row for row in sound if self._has_content(row, content))
        return rows if rows and len(rows) >= (rows[0].get("persons") or 1) else ()

    def has_content_of(self, content: FileContent) -> bool:
        """Return whether a take was read from this content; raise a SourceError if the file cannot be read."""
        return any(self._has_content(row, content) for row in self.rows)

    def _has_content(self, row: Row, content: FileContent) -> bool:
        """Return whether a file has the content that a take was read from.

        The file is read only if its size is the same, but its path or modification time is not.
        """
        motion = content.motion
        if row["source_bytes"] != motion.size:
            return False
        same_place = self.place == (motion.root, motion.path)
        untouched = same_place and row["source_mtime_ns"] == motion.mtime_ns
        return bool(untouched or row["checksum"] == content.checksum)

    def is_elsewhere(self, motion: SourceFile) -> bool:
        """Return whether this known file lies at another path than `motion`, and still exists there.

        If both have the same content, the motion file is then a copy and was not moved.
        """
        return self.place != (motion.root, motion.path) and self.is_there

    def rows_at(self, motion: SourceFile, rows: Iterable[Row]) -> list[Row]:
        """Return the rows that change with the new path or time of their file, with the new values; none for a copy."""
        place = {"source_root": motion.root, "source": motion.path, "source_mtime_ns": motion.mtime_ns}
        if self.is_elsewhere(motion):
            return []
        return [row | place for row in rows if any(row[name] != value for name, value in place.items())]


class KnownFiles:
    """All files from which a store has takes.

    Parameters
    ----------
    rows : iterable of dict
        The rows of its takes; tracked takes, which have no motion file, are ignored.
    """

    def __init__(self, rows: Iterable[Row]) -> None:
        places: dict[tuple[str, str], list[Row]] = {}
        for row in (row for row in rows if row["format"] not in RECORDED_FORMATS):
            places.setdefault((row["source_root"], row["source"]), []).append(row)
        self._at = {place: KnownFile(*place, tuple(those)) for place, those in places.items()}
        self._with_path: dict[str, list[KnownFile]] = {}
        self._named: dict[str, list[KnownFile]] = {}
        for file in self._at.values():
            self._with_path.setdefault(file.path, []).append(file)
            for name in {file_name(row) for row in file.rows}:
                self._named.setdefault(name, []).append(file)

    def __iter__(self) -> Iterator[KnownFile]:
        return iter(self._at.values())

    def at_place(self, motion: SourceFile) -> KnownFile | None:
        """Return the known file with a motion file's path, below its root or gone from another; None if unknown."""
        here = self._at.get((motion.root, motion.path))
        moved = (file for file in self._with_path.get(motion.path, ()) if not file.is_there)
        return here or next(moved, None)

    def of_same_content(
        self, content: FileContent, names: Iterable[str], taken: Container[tuple[str, str]]
    ) -> KnownFile | None:
        """Return the known file from which a motion file was moved or copied; None if none has its content.

        Parameters
        ----------
        content : FileContent
            The motion file, at whose path no file is known.
        names : iterable of str
            The possible names of its take.
        taken : container of (str, str)
            Root and path of known files that match other files of the source.

        Raises
        ------
        SourceError
            A known file with the same path below another root still exists and has other content; it may be another
            version of the same motion.
        """
        motion = content.motion
        for name in names:
            for file in self._named.get(name, ()):
                elsewhere = file.root != motion.root or not file.is_there
                if file.place in taken:
                    continue
                if elsewhere and file.has_content_of(content):
                    return file
                if file.root != motion.root and file.path == motion.path:
                    raise _name_conflict(file, motion)
        return None


def _name_conflict(file: KnownFile, motion: SourceFile) -> SourceError:
    """Return the error of a file with the name of an existing take but other content; it must not replace the take."""
    return SourceError(
        motion.absolute,
        f"the store has a take '{file.rows[0]['name']}' already, from {file.root}/{file.path}, and its content "
        "differs; rename it, put it into a folder of its own below the source, or use another store",
    )
