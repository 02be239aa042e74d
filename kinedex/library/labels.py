"""Define the Python object for the labels that people have given in a store."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from kinedex.library.arguments import checked_methods
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.ops.wording import counted
from kinedex.storage.store.store import Store as StoredTakes
from kinedex.storage.store.store import data_frame

if TYPE_CHECKING:
    import os

    import polars as pl

    from kinedex.pipelines.labels.decisions import RecordedDecisions


@checked_methods
class Labels:
    """The labels that people have given in a store, as returned by `Store.labels`.

    A label states that an interval of a take shows a class or, with the verdict "negative", that it does not. Labels
    are recorded immediately, even while other processes read or write the store. The next commit of a writer publishes
    them, and no command deletes them: a label that is changed or withdrawn stays in the history.

    Examples
    --------
    >>> row = {"take": take.name, "class": "nod", "start": 3, "stop": 12}
    >>> made = store.labels.add([row], annotator="ann")
    >>> store.labels.table("class = 'nod'").select("take", "start", "stop", "origin").row(0)[1:]
    (3, 12, 'drawn')
    >>> removed = store.labels.remove(made["id"])
    >>> store.labels.table("class = 'nod'").height
    0
    """

    def __init__(self, stored: StoredTakes) -> None:
        self._stored = stored

    def __repr__(self) -> str:
        return f"Labels({str(self._stored.path)!r}, {counted(len(self), 'label')})"

    def __len__(self) -> int:
        return int(self._stored.labels().num_rows)

    def table(self, where: str | None = None, *, history: bool = False) -> pl.DataFrame:
        """Return labels as a data frame, one row per label.

        Parameters
        ----------
        where : str, optional
            A SQL filter over the columns of the view `labels`, such as ``"class = 'walk' AND annotator = 'ann'"``.
        history : bool, optional
            Also return rows that are not current; the column ``current`` distinguishes them.

        Returns
        -------
        polars.DataFrame
            One row per label, in the order in which they were made: the columns of the view `labels`.

        Raises
        ------
        KinedexError
            The filter is not valid; the message names the columns.
        StoreError
            Labels are damaged.

        Examples
        --------
        >>> store.labels.table().columns[:5]
        ['take', 'take_id', 'class', 'start', 'stop']
        """
        from kinedex.pipelines.labels.row_selection import RowSelection, selected_rows
        from kinedex.storage.sql.result_scans import shown_labels

        found = selected_rows(
            shown_labels(self._stored), RowSelection(where=where, every=True), "label", keep_order=True
        )
        return found if history else found.filter(found["current"]).drop("current")

    def add(
        self,
        rows: Iterable[Mapping[str, Any]] | pl.DataFrame,
        *,
        annotator: str | None = None,
        note: str | None = None,
    ) -> pl.DataFrame:
        """Record labels.

        Parameters
        ----------
        rows : polars.DataFrame or iterable of mapping
            ``take``, ``class``, ``start`` and ``stop`` (frames, half-open), and optionally ``verdict`` ("positive" or
            "negative"), ``limb``, ``origin`` ("drawn" unless given), ``confidence``, ``note``, ``annotator``,
            ``source``, and ``replaces``, the id of the label that the row replaces.
        annotator : str, optional
            The person who labelled, for rows without an annotator.
        note : str, optional
            A remark, for rows without a note.

        Returns
        -------
        polars.DataFrame
            The new rows, with their ids; labels that the store already has are not included.

        Raises
        ------
        KinedexError
            A take is not in the store, or an interval is not within its take.
        ParameterError
            A value is not valid; nothing is recorded.

        Examples
        --------
        >>> made = store.labels.add([{"take": take.name, "class": "nod", "start": 0, "stop": 5, "verdict": "negative"}])
        >>> made["verdict"].to_list()
        ['negative']
        >>> store.labels.remove(made["id"]).height
        1
        """
        from kinedex.pipelines.labels.decisions import record_decisions

        given = [dict(row) for row in (rows.to_dicts() if hasattr(rows, "to_dicts") else rows)]
        frames = dict(zip(self._stored.take_ids, self._stored.take_rows.column("frames").to_pylist(), strict=True))
        for row in given:
            missing = [name for name in ("take", "class", "start", "stop") if row.get(name) is None]
            if missing:
                raise ParameterError("rows", "take, class, start and stop in every row", f"a row without {missing[0]}")
            self._stored.take_id(row["take"])
            if row["stop"] > frames[row["take"]]:
                raise KinedexError(f"stop {row['stop']} is beyond the end of {row['take']}, at {frames[row['take']]}")
            row["origin"] = row.get("origin") or "drawn"
            row["annotator"] = row.get("annotator") or annotator
            row["note"] = row.get("note") or note
        return _rows(record_decisions(self._stored, given))

    def change(
        self,
        id: str,
        *,
        label: str | None = None,
        start: int | None = None,
        stop: int | None = None,
        verdict: Literal["positive", "negative"] | None = None,
        annotator: str | None = None,
    ) -> pl.DataFrame:
        """Change the class, the interval or the verdict of a label; the earlier label stays in the history.

        Parameters
        ----------
        id : str
            The id of the label, or its beginning.
        label : str, optional
            The new class.
        start, stop : int, optional
            The new interval of frames [start, stop).
        verdict : {"positive", "negative"}, optional
            "positive" if the interval shows the class, "negative" if it does not.
        annotator : str, optional
            The person who changes the label.

        Returns
        -------
        polars.DataFrame
            The row that replaces the label, with a new id.

        Raises
        ------
        KinedexError
            No label or several labels have such an id, or an equal label already exists.
        ParameterError
            Nothing would change, or the interval is not within the take.

        Examples
        --------
        >>> made = store.labels.add([{"take": take.name, "class": "nod", "start": 3, "stop": 12}])
        >>> changed = store.labels.change(made["id"][0], stop=10)
        >>> changed.select("start", "stop", "origin").row(0)
        (3, 10, 'corrected')
        >>> store.labels.remove(changed["id"]).height
        1
        """
        from kinedex.pipelines.labels.label_edits import change_label

        values = {"class": label, "start": start, "stop": stop, "verdict": verdict}
        return _rows(change_label(self._stored, id, annotator=annotator, **values))

    def remove(self, ids: Iterable[str], *, annotator: str | None = None, note: str | None = None) -> pl.DataFrame:
        """Withdraw labels; they stay in the history.

        Parameters
        ----------
        ids : iterable of str
            Ids of labels, or beginnings of ids.
        annotator : str, optional
            The person who withdraws the labels.
        note : str, optional
            The reason.

        Returns
        -------
        polars.DataFrame
            The rows that withdraw the labels.

        Raises
        ------
        KinedexError
            No label or several labels have such an id.

        Examples
        --------
        >>> made = store.labels.add([{"take": take.name, "class": "nod", "start": 3, "stop": 12}])
        >>> store.labels.remove(made["id"], note="a slip")["verdict"].to_list()
        ['withdrawn']
        """
        from kinedex.pipelines.labels.decisions import labels_by_id, withdraw_labels

        found = labels_by_id(self._stored, list(ids))
        return _rows(withdraw_labels(self._stored, found, annotator=annotator, note=note))

    def accept(
        self, annotations: pl.DataFrame, *, annotator: str | None = None, note: str | None = None
    ) -> pl.DataFrame:
        """Record annotations as accepted labels.

        Parameters
        ----------
        annotations : polars.DataFrame
            Rows of the view `annotations`, such as ``store.results("annotations")`` returns.
        annotator : str, optional
            The person who decides.
        note : str, optional
            A remark.

        Returns
        -------
        polars.DataFrame
            The new labels; annotations that were accepted before are not included.

        Examples
        --------
        >>> sure = store.results("annotations").head(2)
        >>> made = store.labels.accept(sure, annotator="ann")
        >>> made["origin"].to_list()
        ['accepted', 'accepted']
        >>> store.labels.remove(made["id"]).height
        2
        """
        return self._decide(annotations, True, annotator, note)

    def reject(
        self, annotations: pl.DataFrame, *, annotator: str | None = None, note: str | None = None
    ) -> pl.DataFrame:
        """Record annotations as negative labels: examples that do not show the class.

        Parameters
        ----------
        annotations : polars.DataFrame
            Rows of the view `annotations`.
        annotator : str, optional
            The person who decides.
        note : str, optional
            A remark.

        Returns
        -------
        polars.DataFrame
            The new labels.

        Examples
        --------
        >>> made = store.labels.reject(store.results("annotations").head(1))
        >>> made["verdict"].to_list()
        ['negative']
        >>> store.labels.remove(made["id"]).height
        1
        """
        return self._decide(annotations, False, annotator, note)

    def suspects(self, where: str | None = None) -> pl.DataFrame:
        """Return the labels that are probably wrong, the most suspect first.

        Each label, and each class that a take has of its path or of a table, is judged by those of other takes. Others
        that fit better are another class, the other side of the body, other edges, or twice or half the rate.

        Parameters
        ----------
        where : str, optional
            A SQL filter over the columns of the result, such as ``"kind = 'edges' AND suspicion > 3"``.

        Returns
        -------
        polars.DataFrame
            One row for each label that something else fits better: ``take``, ``take_id``, ``class``, ``start``,
            ``stop``; ``suspicion``, how far it fits better than is usual in the class, in spreads of the class;
            ``probability`` of the class, by other takes; ``kind`` ("class", "side", "edges" or "rate"); ``proposal``,
            a text, with ``new_class``, ``new_start``, ``new_stop`` and ``rate_factor`` where they apply; ``source``
            ("clip" or "label"), and the ``id`` of a label.

        Raises
        ------
        KinedexError
            The filter is not valid; the message names the columns.

        Examples
        --------
        >>> store.labels.suspects("suspicion > 5").select("take", "class", "kind").columns
        ['take', 'class', 'kind']
        """
        from kinedex.library.label_suspects import label_suspects
        from kinedex.pipelines.labels.row_selection import RowSelection, selected_rows

        found = label_suspects(self._stored)
        for remark in found.remarks:
            warnings.warn(remark, UserWarning, stacklevel=3)
        return selected_rows(found.rows, RowSelection(where=where, every=True), "suspect", keep_order=True)

    def _decide(self, annotations: pl.DataFrame, accept: bool, annotator: str | None, note: str | None) -> pl.DataFrame:
        from kinedex.pipelines.labels.decisions import decide_annotations

        missing = [name for name in ("take", "class", "start", "stop") if name not in annotations.columns]
        if missing:
            raise ParameterError("annotations", "rows of the view annotations", f"a table without {missing[0]}")
        return _rows(decide_annotations(self._stored, annotations, accept=accept, annotator=annotator, note=note))

    def read(
        self,
        files: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
        *,
        corrects: Literal["annotations", "labels"] | None = None,
        stage: str | None = None,
        annotator: str | None = None,
        note: str | None = None,
    ) -> pl.DataFrame:
        """Record the segments of label files as labels.

        Parameters
        ----------
        files : path or sequence of paths
            Label files (.csv, .json, .eaf, .vtt, .txt), or folders of them.
        corrects : {"annotations", "labels"}, optional
            States that the files are an export of annotations or labels that a person has corrected. Unchanged segments
            are then accepted, moved segments are corrected, and missing ones are rejected (annotations) or withdrawn
            (labels).
        stage : str, optional
            The stage whose annotations were corrected; by default that of the current pipeline.
        annotator : str, optional
            The person who labelled or corrected.
        note : str, optional
            A remark.

        Returns
        -------
        polars.DataFrame
            The new labels.

        Raises
        ------
        SourceError
            A file cannot be read, or a segment ends after the end of its take.
        KinedexError
            No take of the files is in the store.

        Examples
        --------
        >>> file = folder / "mine.csv"
        >>> _ = file.write_text(f"take,class,start_seconds,stop_seconds\\n{take.name},nod,0.1,0.5\\n")
        >>> made = store.labels.read(file)
        >>> made["origin"].to_list()
        ['imported']
        >>> store.labels.remove(made["id"]).height
        1
        """
        from kinedex.pipelines.labels.decisions import import_labels
        from kinedex.pipelines.labels.label_files import label_files

        paths = [files] if isinstance(files, str) or not isinstance(files, Sequence) else files
        found = label_files([Path(path) for path in paths])
        return _rows(import_labels(self._stored, found, corrects, stage, annotator=annotator, note=note))


def _rows(done: RecordedDecisions) -> pl.DataFrame:
    """Return the new rows, and warn about excluded rows."""
    for remark in done.remarks:
        warnings.warn(remark, UserWarning, stacklevel=4)
    return data_frame(done.rows)
