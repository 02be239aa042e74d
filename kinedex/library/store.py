"""A store as a Python object: its takes, SQL, search and rankings."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Literal

from kinedex.library.arguments import checked, checked_methods
from kinedex.library.sql_tables import SqlTables
from kinedex.library.take_export import TakeExport
from kinedex.library.take_search import TakeSearch
from kinedex.ops.wording import counted
from kinedex.storage.store.store import open_store as open_stored_takes

if TYPE_CHECKING:
    import os

    from kinedex.library.labels import Labels

_SHOWN_TAKES = 10


@checked
def open_store(
    path: str | os.PathLike[str],
    files: Iterable[str | os.PathLike[str]] = (),
    at: int | Literal["newest"] | None = None,
) -> Store:
    """Open a version of a store for reading: by default the newest version that has its index.

    While an ingest runs, this is the version before it. The store keeps showing its version, whatever is written or
    removed meanwhile; open it again to see what is new.

    Parameters
    ----------
    path : str or os.PathLike
        The directory of the store, or an open store.
    files : iterable of str or os.PathLike, optional
        Folders whose files SQL may read as well, with ``read_csv`` for example. SQL reads the store alone without them.
    at : int or "newest", optional
        The number of a version, or "newest" for the newest one, even where its index is still to be built.

    Returns
    -------
    Store
        The takes, to be used as a mapping from names, and all that can be asked about them.

    Raises
    ------
    StoreError
        There is no store or no such version, it is damaged, or it has another format.

    Examples
    --------
    >>> store = kinedex.open_store(store_path)
    >>> len(store) == store.takes().height
    True
    >>> kinedex.open_store(store_path, at=store.version).version == store.version
    True
    """
    return Store(open_stored_takes(Path(path), [Path(folder) for folder in files], at))


@checked_methods
class Store(SqlTables, TakeSearch, TakeExport):
    """One version of a store, read-only; `open_store` opens it.

    A store is a collection of takes: ``len(store)``, ``for take in store``, and ``store["name"]`` or ``store[17]`` by
    the id. Wherever a method takes a take, its name, its id or the `Take` itself will do. Tables are polars data
    frames, except that `sql` returns an Arrow table unless ``polars=True`` is given. Later versions may add columns.

    Attributes
    ----------
    path : Path
        The directory of the store.
    version : int
        The version that is shown.
    newest_version : int
        The newest version when the store was opened; it is another one where its index was still to be built.
    rate_hz : float
        Frames per second of its takes.
    feature_set : FeatureSet
        The features of its words, as the store itself recorded them.

    Examples
    --------
    >>> [take.name for take in store][:2] == store.takes()["name"].to_list()[:2]
    True
    """

    def __fspath__(self) -> str:
        return str(self.path)

    def __repr__(self) -> str:
        return f"Store({str(self.path)!r}, version {self.version}, {counted(len(self), 'take')})"

    def _repr_html_(self) -> str:
        from kinedex.reports.notebook_html import table_html

        takes = self.takes()
        classes = takes["class"].drop_nulls().unique().sort().to_list()
        facts = [
            ("path", str(self.path)),
            ("version", str(self.version)),
            ("takes", f"{len(self):,}, {float(takes['seconds'].sum() or 0) / 3600:.2f} hours at {self.rate_hz:g} Hz"),
            ("classes", ", ".join(classes[:20]) + (f" and {len(classes) - 20} more" if len(classes) > 20 else "")),
            ("features", f"{len(self.feature_set.features)} ({self.feature_set.name})"),
        ]
        columns = ["name", "class", "actor", "frames", "seconds"]
        rows = takes.select(columns).head(_SHOWN_TAKES).rows()
        note = f"and {takes.height - _SHOWN_TAKES:,} more takes" if takes.height > _SHOWN_TAKES else ""
        return table_html("kinedex store", facts, columns, rows, note)

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the database connections of `sql`, and let `kinedex gc` remove the version.

        The store can still be used for as long as the version is there.

        Examples
        --------
        >>> store.close()
        """
        self.stored.close()

    @property
    def labels(self) -> Labels:
        """Return the labels of people, which can be read and recorded.

        Returns
        -------
        Labels
            The labels; recording one changes no other result of this store.

        Examples
        --------
        >>> store.labels.table().height == len(store.labels)
        True
        """
        from kinedex.library.labels import Labels

        return Labels(self.stored)
