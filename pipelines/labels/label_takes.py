"""Find the takes of a store that label files refer to, by the names in the files."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

from kinedex.ops.wording import few
from kinedex.pipelines.ingestion.known_files import file_names, person_name
from kinedex.storage.formats.labels.segments import LabelFile
from kinedex.storage.snapshot.schemas import RECORDED_FORMATS
from kinedex.storage.snapshot.snapshot import Snapshot


def on_takes(store: Snapshot, files: Sequence[LabelFile]) -> tuple[list[LabelFile], list[str]]:
    """Replace names in label files that are no takes' names by the takes whose files have these names.

    If files have equal stems, their takes are named by paths, and a label file that gives the stem matches several
    takes. Its labels are assigned to each of them if all contain the same motion.

    Parameters
    ----------
    store : Snapshot
        The store.
    files : sequence of LabelFile
        The label files.

    Returns
    -------
    files : list of LabelFile
        The files with the names of takes.
    remarks : list of str
        Remarks on names of several takes, on names of one take that match others as well, and on names that match takes
        with different motion and are not replaced.
    """
    rows = _rows(store)
    named = {take for file in files for take in file.takes}
    exact = named & {str(row["name"]) for row in rows}
    fitting: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for row in (row for row in rows if row["format"] not in RECORDED_FORMATS):
        names = {person_name(name, row["person"] or "") for name in file_names("stem", str(row["source"]))}
        for name in names & named:
            fitting[name].append(row)
    others = {name: [row for row in fitting.pop(name, []) if row["name"] != name] for name in exact}
    same = _of_one_motion(store, fitting)
    chosen = {name: [str(row["name"]) for row in found] for name, found in fitting.items() if name in same}
    remarks = [
        f"labels of '{name}' belong to {few(takes)}, which hold the same motion"
        for name, takes in chosen.items()
        if len(takes) > 1
    ]
    remarks += [
        f"labels of '{name}' belong to the take of this name alone, not to {_takes(found)}, whose files are named so"
        for name, found in sorted(others.items())
        if found
    ]
    remarks += [
        f"'{name}' fits takes of different motion, {_takes(found)}: labels of it belong to "
        "none of them until the file names one of these"
        for name, found in fitting.items()
        if name not in same
    ]
    return [_renamed(file, chosen) for file in files], remarks


def _takes(rows: Iterable[dict[str, Any]]) -> str:
    return few([str(row["name"]) for row in rows])


def _rows(store: Snapshot) -> list[dict[str, Any]]:
    columns = ["name", "source", "format", "checksum", "person"]
    table = store.take_rows
    missing = dict.fromkeys(set(columns) - set(table.column_names))
    return [missing | row for row in table.select([one for one in columns if one not in missing]).to_pylist()]


def _of_one_motion(store: Snapshot, fitting: dict[str, list[dict[str, Any]]]) -> set[str]:
    """Return the names for which all matching takes contain the same motion; takes of equal files are not compared."""
    from kinedex.pipelines.inspection.duplicates import hold_one_motion

    firsts = {name: _first_of_each_file(rows) for name, rows in fitting.items()}
    return {name for name, takes in firsts.items() if hold_one_motion(store, takes)}


def _first_of_each_file(rows: Sequence[dict[str, Any]]) -> list[str]:
    by_file: dict[tuple[str, str | None], str] = {}
    for row in rows:
        by_file.setdefault((row["checksum"], row["person"]), str(row["name"]))
    return list(by_file.values())


def _renamed(file: LabelFile, chosen: dict[str, list[str]]) -> LabelFile:
    """Return a label file with names of takes; labels of several takes are repeated for each take."""
    if not chosen.keys() & set(file.takes):
        return file

    def names(take: str) -> list[str]:
        return chosen.get(take, [take])

    return replace(
        file,
        takes=tuple(dict.fromkeys(name for take in file.takes for name in names(take))),
        segments=tuple(replace(one, take=name) for one in file.segments for name in names(one.take)),
        covered=tuple((name, limb, by) for take, limb, by in file.covered for name in names(take)),
    )
