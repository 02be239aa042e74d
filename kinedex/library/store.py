"""Define a store as a Python object, with its takes, SQL, search and rankings, labels, and the export of clips."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Literal

from kinedex.library.arguments import checked, checked_methods
from kinedex.library.take_search import TakeSearch
from kinedex.ops.wording import counted
from kinedex.storage.store.store import open_store as open_stored_takes

if TYPE_CHECKING:
    import os

    import polars as pl

    from kinedex.library.labels import Labels


_SHOWN_TAKES = 10


@checked
def open_store(
    path: str | os.PathLike[str],
    files: Iterable[str | os.PathLike[str]] = (),
    at: int | Literal["newest"] | None = None,
) -> Store:
    """Open a version of a store for reading, by default the newest version that has an index.

    While an ingest runs, this is the version before the ingest. The returned object always shows the same version, even
    if others write to the store or remove from it; open the store again to see their changes.

    Parameters
    ----------
    path : str or os.PathLike
        The directory of the store, or an open store.
    files : iterable of str or os.PathLike, optional
        Folders whose files SQL may read, with ``read_csv`` for example. By default, SQL can read only the store.
    at : int or "newest", optional
        The number of a version, or "newest" for the newest version, even if its index has not been built yet.

    Returns
    -------
    Store
        The store at this version: a collection of takes, with methods to query them.

    Raises
    ------
    StoreError
        There is no store or no such version, the version is damaged, or its format is not supported.

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
class Store(TakeSearch):
    """One version of a store, read-only; `open_store` opens it.

    A store is a collection of takes: ``len(store)``, ``for take in store``, and ``store["name"]``, or ``store[17]`` for
    a take by its id. Arguments that are takes can be given by name, by id or as a `Take`. Tables are polars data
    frames, except that `sql` returns an Arrow table unless ``polars=True`` is given. Later versions may add columns.

    Attributes
    ----------
    path : Path
        The directory of the store.
    version : int
        The version that is shown.
    newest_version : int
        The newest version when the store was opened; it differs from `version` if its index had not been built yet.
    rate_hz : float
        Frames per second of the takes.
    feature_set : FeatureSet
        The features of the words, as recorded in the store.

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

        The store can still be used as long as the version exists.

        Examples
        --------
        >>> store.close()
        """
        self.stored.close()

    @property
    def labels(self) -> Labels:
        """Return the labels that people have given, to read them or to add further ones.

        Returns
        -------
        Labels
            The labels; adding labels changes no other result of this store.

        Examples
        --------
        >>> store.labels.table().height == len(store.labels)
        True
        """
        from kinedex.library.labels import Labels

        return Labels(self.stored)

    def export(
        self,
        folder: str | os.PathLike[str],
        takes: Sequence[str] = (),
        *,
        format: str = "npz",
        joints: bool = False,
        where: str | None = None,
        annotations: bool = False,
        labels: bool = False,
        hits: str | None = None,
        ranges: str | os.PathLike[str] | None = None,
        sql: str | None = None,
        classes: Sequence[str] = (),
        pipeline: str | None = None,
        min_confidence: float | None = None,
        margin: float = 0.0,
        context: float = 0.0,
        min_length: float = 0.0,
        mirror: bool = False,
        resample: float | None = None,
        in_place: bool = False,
        split: str | None = None,
        shares: Sequence[float] = (0.8, 0.1, 0.1),
        seed: int = 0,
        balance: bool = False,
        per_class: int | None = None,
        distinct: float | None = None,
        workers: int = 1,
    ) -> pl.DataFrame:
        """Write clips as files of a data set, with ``metadata.csv`` and ``dataset.json``.

        The clips are whole takes, unless one of `annotations`, `labels`, `hits`, `ranges` and `sql` is given. Equal
        arguments give equal files, and an interrupted export continues where it stopped.

        Parameters
        ----------
        folder : str or os.PathLike
            The folder, which must be new, empty, or the folder of an earlier export.
        takes : sequence of str, optional
            Names of takes; by default all takes are exported.
        format : str, optional
            The format of the files, such as "npz", "csv", "parquet" or "bvh".
        joints : bool, optional
            True writes the 24 joints even if the channels of the source file could be cut instead.
        where : str, optional
            A SQL filter over the columns of takes.
        annotations, labels : bool, optional
            True exports annotated segments, or the labels of people, as clips.
        hits : str, optional
            The name of saved hits, which are exported as clips.
        ranges : str or os.PathLike, optional
            A CSV file with the columns take, start, stop, and optionally class.
        sql : str, optional
            A query that returns take, and optionally start, stop, class, confidence, and further columns for
            ``metadata.csv``.
        classes : sequence of str, optional
            The classes to export; by default all.
        pipeline : str, optional
            The pipeline of the annotations; by default the current one.
        min_confidence : float, optional
            The lowest confidence of a clip.
        margin, context : float, optional
            Seconds to add before and after each interval. `margin` becomes part of the clip; `context` is in the file,
            but not part of the clip.
        min_length : float, optional
            The shortest duration of an interval in seconds.
        mirror : bool, optional
            True adds the mirror image of each clip, with left and right exchanged in the motion and in the class name.
        resample : float, optional
            Frames per second of the files.
        in_place : bool, optional
            True moves and turns each clip so that it begins above the origin, facing +Z.
        split : str, optional
            A column of takes, such as actor; takes with the same value are in the same split.
        shares : sequence of float, optional
            The shares of training, validation and test in the total duration, or of training and test.
        seed : int, optional
            The seed of the choice among equally good splits, and of the choice of clips.
        balance : bool, optional
            True selects, in each split, as many clips of each class as the rarest class has there.
        per_class : int, optional
            The largest number of clips of a class.
        distinct : float, optional
            Clips whose joints differ from those of an earlier clip by less than this, in metres, are excluded.
        workers : int, optional
            The number of processes. A script that uses more than one must guard its start with
            ``if __name__ == "__main__":``.

        Returns
        -------
        polars.DataFrame
            The rows of ``metadata.csv``, one per clip.

        Raises
        ------
        KinedexError
            Nothing is selected, no clip can be written, the folder holds other files, or cannot be written to.
        ParameterError
            A value is not valid.

        Warns
        -----
        UserWarning
            Clips were excluded, or could not be written.

        Examples
        --------
        >>> made = store.export(folder / "clips", [take.name], in_place=True)
        >>> made["file"].to_list() == [f"clips/{take.name}.npz"]
        True
        """
        import polars as pl

        from kinedex.console.terminal import collecting_terminal
        from kinedex.pipelines.engine.executors import make_executor
        from kinedex.pipelines.export.data_set import export_data_set
        from kinedex.pipelines.export.request import ClipOptions, IntervalSource, source_of

        kind, name = source_of(annotations=annotations, labels=labels, hits=hits, ranges=ranges, sql=sql)
        what = IntervalSource(kind, name, tuple(takes), where, tuple(classes), pipeline, min_confidence)
        how = ClipOptions(
            format, joints, margin, context, min_length, mirror, resample, in_place, split, tuple(shares), seed,
            balance, per_class, distinct,
        )  # fmt: skip
        executor, quiet = make_executor("processes", workers), collecting_terminal(io.StringIO())
        try:
            done = export_data_set(self.stored, what, how, Path(folder), executor=executor, progress=quiet.progress)
        finally:
            executor.close()
        for remark in (*done.remarks, *(f"{file}: {reason}" for file, reason in done.excluded.items())):
            warnings.warn(remark, stacklevel=3)
        return pl.DataFrame(done.rows, infer_schema_length=None)
