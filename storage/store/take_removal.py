"""Remove takes for a user: plan which takes are removed, and which of their files an ingest skips afterwards."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import pyarrow as pa
import pyarrow.compute as pc

from kinedex.ops.errors import KinedexError
from kinedex.storage.snapshot.schemas import RECORDED_FORMATS
from kinedex.storage.store.store import Store
from kinedex.storage.store.writer import StoreWriter


@dataclass(frozen=True)
class Removal:
    """A plan for the removal of takes.

    Attributes
    ----------
    takes : pyarrow.Table
        The rows of the takes to remove.
    files : tuple of (str, str)
        Source folder and path of each file that loses all its takes; ingests skip these files from then on.
    returning : tuple of str
        Names of takes that the next ingest adds again, because other takes of their file remain.
    tracks : tuple of str
        Names of takes made from recordings, which have no motion file.
    labels : int
        Number of labels of these takes, which are kept in the store.
    """

    takes: pa.Table
    files: tuple[tuple[str, str], ...]
    returning: tuple[str, ...]
    tracks: tuple[str, ...]
    labels: int


def planned_removal(store: Store, names: Sequence[str] = (), where: str | None = None) -> Removal:
    """Return what removing takes would do, without changing anything.

    Parameters
    ----------
    store : Store
        The store.
    names : sequence of str
        Names of the takes.
    where : str, optional
        A SQL filter over the columns of takes; if names are given too, the named takes that pass the filter.

    Raises
    ------
    KinedexError
        Neither names nor filter is given, a name is unknown, or the filter selects no takes.
    """
    if not names and where is None:
        raise KinedexError("name the takes to remove, or choose them with --where")
    for name in names:
        store.take_id(name)
    chosen = store.takes_table(where)
    if names:
        chosen = chosen.filter(pc.is_in(chosen.column("name"), pa.array(list(names), pa.string())))
    if not chosen.num_rows:
        raise KinedexError(f"the filter `{where}` selects none of these takes")
    gone = set(chosen.column("name").to_pylist())
    by_file: dict[tuple[str, str], set[str]] = defaultdict(set)
    tracks = set()
    for row in store.take_rows.select(["name", "format", "source_root", "source"]).to_pylist():
        if row["format"] in RECORDED_FORMATS:
            tracks.add(row["name"])
        else:
            by_file[row["source_root"], row["source"]].add(row["name"])
    files = tuple(sorted(file for file, takes in by_file.items() if takes <= gone))
    whole = {name for file in files for name in by_file[file]}
    labels = sum(take in gone for take in store.labels().column("take").to_pylist())
    return Removal(chosen, files, tuple(sorted(gone - whole - tracks)), tuple(sorted(gone & tracks)), labels)


def remove_takes(writer: StoreWriter, removal: Removal) -> None:
    """Remove takes and commit; their labels and motion files are kept, and an ingest skips these files."""
    writer.drop_takes(removal.takes.column("take_id").to_pylist())
    for root in dict.fromkeys(root for root, _ in removal.files):
        writer.remove_files(root, [path for other, path in removal.files if other == root])
    writer.commit()
