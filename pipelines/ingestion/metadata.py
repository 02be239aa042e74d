"""Describe takes by tables of metadata and by the patterns of paths, as columns of takes."""

from __future__ import annotations

import difflib
import fnmatch
import json
import os
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import chain, starmap
from pathlib import Path
from typing import Any

from kinedex.catalog.configs import config_path, load_yaml
from kinedex.ops.errors import AcceptError, ConfigError, SourceError
from kinedex.ops.wording import counted
from kinedex.pipelines.ingestion.known_files import KnownFiles, Row
from kinedex.pipelines.ingestion.parameters import IngestParameters
from kinedex.pipelines.ingestion.pattern_proposal import matched_count, propose_patterns
from kinedex.storage.formats.metadata_tables import (
    KEYS,
    Cell,
    MetadataRow,
    MetadataTable,
    converted,
    read_metadata,
    read_sidecar,
    wider,
)
from kinedex.storage.formats.motion.packed_files import split_ending
from kinedex.storage.formats.motion.sources import Scan, path_groups
from kinedex.storage.snapshot.schemas import RECORDED_FORMATS, TakeColumn, column_problem
from kinedex.storage.store.store import Store

EVERYWHERE = ("actor", "class", "clip")
"""The columns that every store has, and that patterns and tables fill."""

NO_PATTERN = "its path matches no pattern of the config"
"""The warning on a take whose path matches no pattern."""

_ORIGINS = ("pattern", "metadata")

MEANING = "a column of the user's tables (`metadata` of ingest)"
MAX_PATTERNS = 1000
"""The largest number of keys with * or ? in all tables, as each is compared with every take."""

_EXAMPLES = 2


def described_columns(columns: Mapping[str, TakeColumn]) -> tuple[str, ...]:
    """Return the columns of takes that patterns and tables fill, given the declared columns of a store."""
    return (*EVERYWHERE, *(name for name, column in columns.items() if column.origin in _ORIGINS))


def group_values(groups: Mapping[str, str]) -> dict[str, Any]:
    """Return the columns of every store that named groups fill, and all other groups as JSON text."""
    others = {name: value for name, value in groups.items() if name not in EVERYWHERE}
    return {name: groups.get(name) for name in EVERYWHERE} | {"groups": json.dumps(others, sort_keys=True)}


@cache
def _usual_patterns() -> tuple[str, ...]:
    """Return the patterns that pipelines have where nobody gives any."""
    return tuple(load_yaml(config_path("pipelines", "ingest")).mapping()["settings"]["patterns"])


def missed_patterns(groups: Mapping[str, str] | None, patterns: Sequence[re.Pattern[str]]) -> tuple[str, ...]:
    """Return the warning on a path in which none of the patterns is found; empty where the user gave no patterns."""
    given = tuple(pattern.pattern for pattern in patterns)
    return (NO_PATTERN,) if groups is None and given not in ((), _usual_patterns()) else ()


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
        return values | {"warnings": [*missed_patterns(found, self.patterns), *warnings]}

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


@dataclass
class JoinedMetadata:
    """The metadata from tables, by take.

    Attributes
    ----------
    values : dict of int to dict
        Take id → column → value.
    unused : list of MetadataRow
        The rows that match no take.
    without : list of str
        The names of takes without a row.
    """

    values: dict[int, dict[str, Any]] = field(default_factory=dict)
    unused: list[MetadataRow] = field(default_factory=list)
    without: list[str] = field(default_factory=list)


def load_metadata(paths: Iterable[str], found: Scan | None = None) -> Metadata:
    """Read tables of metadata, and the YAML files beside motion files.

    An invalid table raises a SourceError or ConfigError. A file beside a motion file that does not describe a take,
    such as one from capture software, yields a remark.

    Parameters
    ----------
    paths : iterable of str
        The tables.
    found : Scan, optional
        The files of the source.
    """
    tables = tuple(read_metadata(path) for path in paths)
    given = {os.path.realpath(table.path) for table in tables}
    sidecars: list[MetadataRow] = []
    remarks: list[str] = []
    for file in found.sidecars if found is not None else ():
        if os.path.realpath(file.absolute) in given:
            continue
        try:
            sidecars.append(read_sidecar(file.absolute, split_ending(file.path)[0]))
        except (SourceError, ConfigError) as fault:
            remarks.append(str(fault))
    return Metadata(tables, tuple(sidecars), tuple(remarks))


@dataclass(frozen=True)
class Metadata:
    """The tables of metadata of one source.

    Attributes
    ----------
    tables : tuple of MetadataTable
        The tables.
    sidecars : tuple of MetadataRow
        The content of YAML files beside motion files; the key is the path of both without the extension.
    remarks : tuple of str
        Files beside motion files that are not used, with the reason.
    """

    tables: tuple[MetadataTable, ...] = ()
    sidecars: tuple[MetadataRow, ...] = ()
    remarks: tuple[str, ...] = ()

    @cached_property
    def types(self) -> dict[str, str]:
        """The columns of all tables with their types; the columns that every store has are texts."""
        types: dict[str, str] = {}
        for row in self._rows:
            for name, cell in row.cells.items():
                standing = types.get(name, cell.type)
                kind = "VARCHAR" if name.lower() in EVERYWHERE else wider(standing, cell.type)
                if kind is None:
                    raise row.error(f"'{name}' holds a list here, and {standing} elsewhere; a column has one type")
                types[name] = kind
        return types

    @property
    def _rows(self) -> Iterator[MetadataRow]:
        return chain(self._table_rows, self.sidecars)

    @property
    def _table_rows(self) -> Iterator[MetadataRow]:
        return (row for table in self.tables for row in table.rows)

    def columns(self, declared: Mapping[str, TakeColumn]) -> tuple[dict[str, TakeColumn], list[str]]:
        """Return the columns to declare, and a sentence for each table column that cannot be a column of takes.

        A column that tables have declared gets a wider type if the tables need it.

        Parameters
        ----------
        declared : mapping of str to TakeColumn
            The columns that the store has declared.
        """
        found: dict[str, TakeColumn] = {}
        problems: list[str] = []
        for name, kind in self.types.items():
            if name.lower() in EVERYWHERE:
                continue
            standing = _standing(name, declared)
            type_ = wider(standing[1].type, kind) if standing is not None else kind
            column = TakeColumn(type_ or kind, "metadata", meaning=MEANING)
            if standing is not None and type_ is not None:
                found[standing[0]] = replace(standing[1], type=type_)
            elif (problem := column_problem(name, column, {**declared, **found})) is not None:
                problems.append(f"the column '{name}' of metadata is no column of takes: {problem}; rename it there")
            else:
                found[name] = column
        return found, problems

    def join(self, rows: Sequence[Row], root: str, declared: Mapping[str, TakeColumn]) -> JoinedMetadata:
        """Match the rows of the tables with takes.

        A key is the name of a take; or the path of a file below the source, with or without extension; or the name of a
        file, with or without extension. A key with * or ? matches several takes. A row of a single take takes
        precedence over a YAML file beside the motion file, and such a file over rows with * or ?. If several rows with
        * or ? match, the last one counts.

        Parameters
        ----------
        rows : sequence of dict
            The rows of the takes of the source.
        root : str
            The source root.
        declared : mapping of str to TakeColumn
            The columns of the store, including those that `columns` has returned.

        Raises
        ------
        SourceError
            A key matches several files, or a take has two rows with a value in the same column; the message names the
            lines.
        """
        result = JoinedMetadata()
        if not self.tables and not self.sidecars:
            result.without = [row["name"] for row in rows]
            return result
        takes = _Takes(rows, root)
        exact: dict[int, dict[str, tuple[MetadataRow, Any]]] = {}
        patterns: list[tuple[MetadataRow, re.Pattern[str]]] = []
        for row in self._table_rows:
            ids = takes.of_key(row)
            values = self._values(row, declared)
            if not ids and re.search(r"[*?]", row.key):
                patterns.append((row, re.compile(fnmatch.translate(row.key))))
            elif not ids:
                result.unused.append(row)
            for take in ids:
                _add(exact.setdefault(take, {}), row, values, takes.names[take])
        if len(patterns) > MAX_PATTERNS:
            raise patterns[MAX_PATTERNS][0].error(f"is the key number {MAX_PATTERNS + 1:,} with * or ?; too many")
        for row, pattern in patterns:
            ids = takes.fitting(pattern)
            if not ids:
                result.unused.append(row)
            for take in ids:
                result.values.setdefault(take, {}).update(self._values(row, declared))
        for row in self.sidecars:
            for take in takes.beside(row.key):
                result.values.setdefault(take, {}).update(self._values(row, declared))
        for take, found in exact.items():
            result.values.setdefault(take, {}).update((name, value) for name, (_, value) in found.items())
        result.without = [name for take, name in takes.names.items() if take not in result.values]
        return result

    def _values(self, row: MetadataRow, declared: Mapping[str, TakeColumn]) -> dict[str, Any]:
        """Return the values of a row by the columns of takes."""
        return dict(_converted(row.cells, declared))


def _converted(cells: Mapping[str, Cell], declared: Mapping[str, TakeColumn]) -> Iterator[tuple[str, Any]]:
    for name, cell in cells.items():
        if name.lower() in EVERYWHERE:
            yield name.lower(), cell.text
        elif (standing := _standing(name, declared)) is not None and wider(standing[1].type, cell.type) is not None:
            yield standing[0], converted(cell, standing[1].type)


def _standing(name: str, declared: Mapping[str, TakeColumn]) -> tuple[str, TakeColumn] | None:
    """Return the declared metadata column that a name refers to, ignoring case; None if there is none."""
    columns = ((other, column) for other, column in declared.items() if column.origin == "metadata")
    return next(((other, column) for other, column in columns if other.lower() == name.lower()), None)


def _add(found: dict[str, tuple[MetadataRow, Any]], row: MetadataRow, values: Mapping[str, Any], take: str) -> None:
    for name, value in values.items():
        if name in found and found[name][0] is not row:
            before = found[name][0]
            place = f"line {before.line}" if before.path == row.path else f"{before.path}:{before.line}"
            raise row.error(f"'{row.key}' is the take '{take}', of which {place} gives '{name}' already")
        found[name] = row, value


class _Takes:
    """The takes of a source, with lookup by the keys of tables."""

    def __init__(self, rows: Sequence[Row], root: str) -> None:
        self.names = {row["take_id"]: row["name"] for row in rows}
        self._root = root.rstrip("/") + "/"
        self._paths = {row["take_id"]: row["source"] for row in rows}
        self._by_name = {row["name"]: [row["take_id"]] for row in rows}
        stages: list[dict[str, list[int]]] = [{}, {}, {}, {}]
        for row in rows:
            path = row["source"]
            base = os.path.basename(path)
            for found, key in zip(stages, (path, split_ending(path)[0], base, split_ending(base)[0]), strict=True):
                found.setdefault(key, []).append(row["take_id"])
        self._stages = stages

    def of_key(self, row: MetadataRow) -> list[int]:
        """Return the takes of a key; raise a SourceError if it matches several files."""
        if row.key in self._by_name:
            return self._by_name[row.key]
        key = row.key.replace("\\", "/").removeprefix(self._root).removeprefix("./")
        for found in self._stages:
            ids = found.get(key, [])
            paths = list(dict.fromkeys(self._paths[take] for take in ids))
            if len(paths) > 1:
                raise row.error(
                    f"'{row.key}' fits {len(paths):,} files, such as {paths[0]} and {paths[1]}; give the path below "
                    "the source"
                )
            if ids:
                return ids
        return []

    def beside(self, path: str) -> list[int]:
        """Return the takes of the motion files with the given path without extension."""
        return self._stages[1].get(path, [])

    def fitting(self, pattern: re.Pattern[str]) -> list[int]:
        """Return the takes whose name or path matches a pattern."""
        return [take for take, name in self.names.items() if pattern.match(name) or pattern.match(self._paths[take])]


def metadata_in_source(root: str, given: Sequence[str]) -> str | None:
    """Return the path of `metadata.csv` (.tsv, .yaml, .yml) in a source; None if there is none, or the user gave it."""
    tables = (os.path.join(root, f"metadata{ending}") for ending in (".csv", ".tsv", ".yaml", ".yml"))
    known = {os.path.realpath(path) for path in given}
    return next((path for path in tables if os.path.isfile(path) and os.path.realpath(path) not in known), None)


def unused_lines(metadata: Metadata) -> list[str]:
    """Return a message about YAML files beside motion files that are not used; an empty list if all are used."""
    if not metadata.remarks:
        return []
    count = len(metadata.remarks)
    shown = "; ".join(metadata.remarks[:2])
    begin = f"{counted(count, 'YAML file')} beside motion files not used as metadata"
    return [f"{begin}{', such as' if count > 2 else ':'} {shown}"]


def join_lines(metadata: Metadata, joined: JoinedMetadata) -> list[str]:
    """Return messages about a join: the described takes, the rows without a take, and the takes without a row."""
    lines = unused_lines(metadata)
    if not metadata.tables and not metadata.sidecars:
        return lines
    sources = dict.fromkeys(f"'{table.key}' of {table.path}" for table in metadata.tables)
    if metadata.sidecars:
        sources[f"{counted(len(metadata.sidecars), 'YAML file')} beside motion files"] = None
    lines += [line for table in metadata.tables for line in _unnamed_key_lines(table)]
    lines.append(f"metadata by {', '.join(sources)}: {counted(len(joined.values), 'take')} described")
    if joined.unused:
        few = ", ".join(f"'{row.key}' (line {row.line})" for row in joined.unused[:2])
        lines.append(
            f"{counted(len(joined.unused), 'row')} of metadata without a take, such as {few}; a row names a take, the "
            "path of its file below the source, or its file"
        )
    if joined.without:
        few = ", ".join(f"'{name}'" for name in joined.without[:2])
        lines.append(f"{counted(len(joined.without), 'take')} without a row of metadata, such as {few}")
    return lines


def _unnamed_key_lines(table: MetadataTable) -> list[str]:
    """Return a message about a table whose first column is used as key because no column has the name of a key."""
    if table.key.lower() in KEYS:
        return []
    line = f"{table.path} has no column {', '.join(KEYS[:-1])} or {KEYS[-1]}: its first, '{table.key}', names the takes"
    for name in (table.key, *table.columns):
        if near := difflib.get_close_matches(name.lower(), KEYS, 1):
            return [f"{line}; if '{name}' means '{near[0]}', rename it"]
    return [line]


def descriptions(params: IngestParameters, joined: JoinedMetadata) -> Descriptions:
    """Return the metadata that patterns and joined tables give to the takes of a source."""
    return Descriptions(tuple(map(re.compile, params.patterns)), joined.values)


def refuse_losses(params: IngestParameters, store: Store, found: Scan) -> None:
    """Raise an error if an ingest would remove values of columns from takes.

    Parameters
    ----------
    params : IngestParameters
        The parameters of the ingest.
    store : Store
        The store, which is read only.
    found : Scan
        The files of the source.

    Raises
    ------
    AcceptError
        Takes would lose their values in some columns; the message names columns and takes.
    """
    rows = rows_below(store.take_rows.to_pylist(), found, params.root)
    metadata = load_metadata(params.tables, found)
    columns = {**store.manifest.columns, **metadata.columns(store.manifest.columns)[0]}
    joined = metadata.join(rows, params.root, columns)
    lost = losses(rows, columns, descriptions(params, joined))
    if lost:
        takes = len({name for values in lost.values() for name in values})
        which = f"{takes:,} of {counted(len(rows), 'take')} below {params.source} would lose values"
        lines = "".join(f"\n    {line}" for line in [*starmap(_loss_line, lost.items()), *unused_lines(metadata)])
        raise AcceptError(
            f"{which}:{lines}\nnothing was changed. The store remembers the settings of this source: an ingest without "
            "`patterns` and `metadata` of its own uses them"
        )


def _loss_line(column: str, values: Mapping[str, Any]) -> str:
    examples = [f"'{value}' of {name}" for name, value in list(values.items())[:_EXAMPLES]]
    return f"{column}: {counted(len(values), 'take')}, such as {', '.join(examples)}"


def unmatched_paths(params: IngestParameters, found: Scan) -> list[str]:
    """Return the paths of motion files that match none of the patterns; an empty list if there are no patterns."""
    patterns = [re.compile(pattern) for pattern in params.patterns]
    return [motion.path for motion in found.motions if patterns and path_groups(motion.path, patterns) is None]


def unmatched_line(params: IngestParameters, unmatched: Sequence[str], found: Scan, store: Path) -> str:
    """Return a message about paths that match no pattern, with the remedy.

    The remedy is `kinedex init` if it can propose patterns for some of them; otherwise the user has to write one.
    """
    examples = " and ".join(f"'{path}'" for path in dict.fromkeys((unmatched[0], unmatched[-1])))
    verb, whose = ("match", "their takes have") if len(unmatched) > 1 else ("matches", "its take has")
    line = (
        f"{len(unmatched):,} of {counted(len(found.motions), 'path')} {verb} no pattern, such as {examples}: {whose} "
        "neither class nor actor. "
    )
    if matched_count(propose_patterns(motion.path for motion in found.motions), unmatched):
        root = shlex.quote(found.motions[0].root)
        return (
            f"{line}`kinedex init {root} -o my.yaml` proposes patterns, and `kinedex run my.yaml --store "
            f"{shlex.quote(str(store))}` uses them"
        )
    return (
        f"{line}`kinedex init` has no pattern for {'them' if len(unmatched) > 1 else 'it'}: add one to `patterns` of "
        "the stage ingest, such as '(?P<class>[^/_]+)_(?P<actor>[^/_]+)', and run again, which reads no file anew; or "
        "leave it so"
    )
