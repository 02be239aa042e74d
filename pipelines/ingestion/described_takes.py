"""Describe takes by metadata: values from the patterns of a source and its tables, as columns of takes."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from kinedex.pipelines.ingestion.known_files import KnownFiles, Row
from kinedex.storage.formats.motion.sources import Scan, path_groups
from kinedex.storage.snapshot.schemas import RECORDED_FORMATS, TakeColumn

EVERYWHERE = ("actor", "class", "clip")
"""The columns that every store has, and that patterns and tables fill."""

NO_PATTERN = "its path matches no pattern of the config"
"""The warning on a take whose path matches no pattern."""

_ORIGINS = ("pattern", "metadata")


def described_columns(columns: Mapping[str, TakeColumn]) -> tuple[str, ...]:
    """Return the columns of takes that patterns and tables fill, given the declared columns of a store."""
    return (*EVERYWHERE, *(name for name, column in columns.items() if column.origin in _ORIGINS))


def group_values(groups: Mapping[str, str]) -> dict[str, Any]:
    """Return the columns of every store that named groups fill, and all other groups as JSON text."""
    others = {name: value for name, value in groups.items() if name not in EVERYWHERE}
    return {name: groups.get(name) for name in EVERYWHERE} | {"groups": json.dumps(others, sort_keys=True)}


@dataclass(frozen=True)
class Descriptions:
    """The metadata of the takes of one source.

    Attributes
    ----------
    patterns : tuple of re.Pattern
        Regular expressions for paths, whose named groups are values.
    tables : mapping of int to dict
        Take id → values of tables by column, which take precedence over those of patterns.
    """

    patterns: tuple[re.Pattern[str], ...]
    tables: Mapping[int, Mapping[str, Any]] = field(default_factory=dict)

    def of(self, row: Mapping[str, Any], columns: Mapping[str, TakeColumn]) -> dict[str, Any]:
        """Return the values of a take's columns that path patterns and tables give, and its warnings.

        Parameters
        ----------
        row : mapping
            The row of the take.
        columns : mapping of str to TakeColumn
            The declared columns of the store.
        """
        found = path_groups(row["source"], self.patterns)
        groups = found or {}
        given = self.tables.get(row["take_id"], {})
        values = group_values(groups)
        values |= {name: given[name] for name in EVERYWHERE if name in given}
        for name, column in columns.items():
            if column.origin in _ORIGINS:
                values[name] = (groups if column.origin == "pattern" else given).get(name)
        warnings = [one for one in row["warnings"] if one != NO_PATTERN]
        unmatched = found is None and bool(self.patterns)
        return values | {"warnings": [NO_PATTERN, *warnings] if unmatched else warnings}

    def changed(self, rows: Iterable[Row], columns: Mapping[str, TakeColumn]) -> Iterator[Row]:
        """Yield the rows of takes whose metadata has changed, with the new values."""
        for row in rows:
            values = self.of(row, columns)
            if any(row.get(name) != value for name, value in values.items()):
                yield row | values


def losses(rows: Iterable[Row], columns: Mapping[str, TakeColumn], now: Descriptions) -> dict[str, dict[str, Any]]:
    """Return the columns in which takes would lose their values, each with the names of these takes and the values.

    Parameters
    ----------
    rows : iterable of dict
        The rows of the takes, with the paths that they will have.
    columns : mapping of str to TakeColumn
        The declared columns of the store.
    now : Descriptions
        The metadata that the takes would get.
    """
    described = described_columns(columns)
    lost: dict[str, dict[str, Any]] = {}
    for row in rows:
        values = now.of(row, columns)
        for name in described:
            if row.get(name) is not None and values[name] is None:
                lost.setdefault(name, {})[row["name"]] = row[name]
    return {name: lost[name] for name in described if name in lost}


def rows_below(rows: Sequence[Row], found: Scan, root: str) -> list[Row]:
    """Return the rows of the takes of a source, including those whose archive was moved to it.

    Parameters
    ----------
    rows : sequence of dict
        The rows of all takes of a store.
    found : Scan
        The files of the source.
    root : str
        The source root.
    """
    here = [row for row in rows if row["source_root"] == root and row["format"] not in RECORDED_FORMATS]
    known = KnownFiles(rows)
    moved = (known.at_place(motion) for motion in found.motions)
    return here + [row for file in moved if file is not None and file.root != root for row in file.rows]
