"""Export clips of a store from Python as files of a data set, with metadata."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from kinedex.library.take_collection import TakeCollection
from kinedex.storage.store.store import Store as StoredTakes

if TYPE_CHECKING:
    import os

    import polars as pl

    from kinedex.pipelines.export.request import How, What


class TakeExport(TakeCollection):
    """The methods of `Store` for export."""

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

        The clips are whole takes, unless one of `annotations`, `labels`, `hits`, `ranges` and `sql` is given. The same
        request writes the same bytes, and an interrupted export continues where it stopped.

        Parameters
        ----------
        folder : str or os.PathLike
            The folder: new, empty, or that of an earlier export.
        takes : sequence of str, optional
            Names of takes; by default all.
        format : str, optional
            The format of the files, such as "npz", "csv", "parquet" or "bvh".
        joints : bool, optional
            True writes the 24 joints also where the source's own channels can be cut.
        where : str, optional
            A SQL filter over the columns of takes.
        annotations, labels : bool, optional
            True exports annotated segments, or the labels of people, as clips.
        hits : str, optional
            The name of saved hits, which are exported as clips.
        ranges : str or os.PathLike, optional
            A CSV file with the columns take, start, stop, and optionally class.
        sql : str, optional
            A query for take, and optionally start, stop, class, confidence, and columns for ``metadata.csv``.
        classes : sequence of str, optional
            Only these classes.
        pipeline : str, optional
            The pipeline of the annotations; by default the current one.
        min_confidence : float, optional
            The least confidence.
        margin, context : float, optional
            Seconds before and after each interval: `margin` becomes part of the clip, `context` is in its file only.
        min_length : float, optional
            The least seconds of an interval.
        mirror : bool, optional
            True adds the mirror image of each clip, with left and right exchanged, also in the name of its class.
        resample : float, optional
            Frames per second of the files.
        in_place : bool, optional
            True moves and turns each clip so that it begins above the origin, facing +Z.
        split : str, optional
            A column of takes, such as actor; takes with the same value are in the same split.
        shares : sequence of float, optional
            The shares of training, validation and test in the total duration; two shares are training and test.
        seed : int, optional
            The seed of the choice among equally good splits, and of the choice of clips.
        balance : bool, optional
            True takes, in each split, as many clips of each class as of its rarest.
        per_class : int, optional
            The largest number of clips of a class.
        distinct : float, optional
            Clips whose joints differ from those of an earlier clip by less than this, in metres, are excluded.
        workers : int, optional
            The number of processes. A script that asks for more than one must guard its start with
            ``if __name__ == "__main__":``.

        Returns
        -------
        polars.DataFrame
            The rows of ``metadata.csv``, one per clip.

        Raises
        ------
        KinedexError
            Nothing is selected, no clip can be written, the folder holds other files, or it cannot be written.
        ParameterError
            A value is out of its domain.

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
        from kinedex.pipelines.export.request import How, What, source_of

        kind, name = source_of(annotations=annotations, labels=labels, hits=hits, ranges=ranges, sql=sql)
        what = What(kind, name, tuple(takes), where, tuple(classes), pipeline, min_confidence)
        how = How(
            format, joints, margin, context, min_length, mirror, resample, in_place, split, tuple(shares), seed,
            balance, per_class, distinct,
        )  # fmt: skip
        return _exported(self.stored, what, how, Path(folder), workers)


def _exported(stored: StoredTakes, what: What, how: How, folder: Path, workers: int) -> pl.DataFrame:
    """Write a data set, return its rows, and warn about excluded clips."""
    import polars as pl

    from kinedex.console.terminal import collecting_terminal
    from kinedex.pipelines.engine.executors import make_executor
    from kinedex.pipelines.export.export import export_data_set

    executor, quiet = make_executor("processes", workers), collecting_terminal(io.StringIO())
    try:
        done = export_data_set(stored, what, how, folder, executor=executor, progress=quiet.progress)
    finally:
        executor.close()
    for remark in (*done.remarks, *(f"{file}: {reason}" for file, reason in done.excluded.items())):
        warnings.warn(remark, stacklevel=4)
    return pl.DataFrame(done.rows, infer_schema_length=None)
