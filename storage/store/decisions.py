"""Record people's decisions about labels in the journal of a store, while others read or write the store."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa

from kinedex.storage.snapshot.checked_files import CheckedFiles
from kinedex.storage.snapshot.label_journal import append_rows
from kinedex.storage.snapshot.labels import new_labels
from kinedex.storage.snapshot.manifest_files import read_newest, require_current_format
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.store.store import all_labels


def record_labels(path: str | Path, labels: pa.Table) -> pa.Table:
    """Add labels to a store's journal without the writer's lock; they are on disk when the function returns.

    Readers show them at once, and the next commit of a writer publishes them.

    Parameters
    ----------
    path : str or Path
        The store's directory.
    labels : pyarrow.Table
        Columns of `labels_schema`; missing values are completed (`storage.snapshot.labels.new_labels`). A row
        whose id the store has is skipped.

    Returns
    -------
    pyarrow.Table
        The new rows, with their ids.

    Raises
    ------
    ParameterError
        A value is not allowed; nothing is stored.
    StoreError
        There is no store, it has an older format, its labels are damaged, or the disk cannot be written.
    """
    root = Path(path)
    newest = read_newest(root)
    require_current_format(root, newest)
    checked = CheckedFiles(root)
    known = all_labels(root, newest, checked)
    new = new_labels(labels, known, Snapshot(root, newest, checked).checksums)
    append_rows(root, new)
    return new
