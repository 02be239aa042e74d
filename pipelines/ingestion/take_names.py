"""Name takes: one name for every file and person, by the stem of the file, or by its path if stems are equal."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Literal

Naming = Literal["stem", "path", "file"]
"""The rule for the name of a take: the stem of its file, its path without the extension, or its path."""


def file_names(naming: Naming, path: str) -> tuple[str, ...]:
    """Return the names that the take of a file can have, the one by the given rule first.

    Parameters
    ----------
    naming : {"stem", "path", "file"}
        The rule.
    path : str
        The path of the file below the source root, with /.
    """
    without = os.path.splitext(path)[0]
    names = (os.path.basename(without), without, path)
    return names[("stem", "path", "file").index(naming) :]


def person_name(file_name: str, person: str) -> str:
    """Return the name of the take of one person in a file with several."""
    return f"{file_name}-{person}" if person else file_name


class TakeNames:
    """The names of the takes of a store, to which those of new files are added.

    An existing name is never changed: a file that is added later gets another name.

    Parameters
    ----------
    naming : {"stem", "path", "file"}
        The rule for new names.
    owners : mapping of str to str
        The names that are in use, each with the path of its file; an empty path stands for files elsewhere.
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
        """Name the take of a person in a file with several; return None if every possible name is in use.

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
