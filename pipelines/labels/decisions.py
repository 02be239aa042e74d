"""Record decisions of people as labels: drawn, imported, accepted, corrected, rejected and withdrawn ones."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import polars as pl
import pyarrow as pa

from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.ops.wording import name_list
from kinedex.pipelines.annotation.annotation_tables import annotated_takes, annotation_stage
from kinedex.pipelines.labels.file_segments import (
    PlacedFiles,
    SegmentDifference,
    placed_files,
    segment_differences,
    segment_of,
)
from kinedex.pipelines.labels.unmatched_labels import UnmatchedLabels
from kinedex.storage.formats.labels.file_labels import LabelFile, ManualSegment
from kinedex.storage.snapshot.schemas import labels_schema
from kinedex.storage.store.result_changes import record_labels
from kinedex.storage.store.store import Store, data_frame

Row = dict[str, Any]


@dataclass(frozen=True)
class ProposedDecisions:
    """Decisions that are not recorded yet.

    Attributes
    ----------
    rows : tuple of dict
        Rows for `record_decisions`.
    remarks : tuple of str
        Remarks on what was excluded.
    unmatched : tuple of UnmatchedLabels
        The labels that match no take, file by file.
    """

    rows: tuple[Row, ...]
    remarks: tuple[str, ...] = ()
    unmatched: tuple[UnmatchedLabels, ...] = ()


@dataclass(frozen=True)
class RecordedDecisions:
    """Labels that were recorded.

    Attributes
    ----------
    rows : pyarrow.Table
        The new rows of labels.
    known : int
        The number of decisions that the store already had.
    remarks : tuple of str
        Remarks on what was excluded.
    unmatched : tuple of UnmatchedLabels
        The labels of files that match no take, file by file; `remarks` describes them.
    """

    rows: pa.Table
    known: int = 0
    remarks: tuple[str, ...] = ()
    unmatched: tuple[UnmatchedLabels, ...] = ()

    @property
    def counts(self) -> dict[str, int]:
        """The number of new rows by decision, see `counts_of`."""
        return counts_of(self.rows.select(["verdict", "origin"]).to_pylist())


def counts_of(rows: Iterable[Mapping[str, Any]]) -> dict[str, int]:
    """Return the number of rows by origin; rows with a negative verdict count as "rejected".

    Imported rows with a negative verdict, on limbs that were examined, count as "without errors".
    """
    names = {("negative", "imported"): "without errors"}
    by_verdict = {"negative": "rejected", "withdrawn": "removed"}
    pairs = ((str(row["verdict"]), str(row["origin"])) for row in rows)
    return dict(Counter(names.get(pair) or by_verdict.get(pair[0], pair[1]) for pair in pairs))


def record_decisions(store: Store, rows: Sequence[Mapping[str, Any]], remarks: Iterable[str] = ()) -> RecordedDecisions:
    """Record the decisions that a store does not have yet; they replace decisions with another verdict.

    Parameters
    ----------
    store : Store
        The store; it shows the new labels afterwards.
    rows : sequence of mapping
        Columns of labels; `take`, `class`, `start`, `stop` and `origin` are required. `names` are the classes under
        which an earlier decision on the interval is looked up, such as class and subclass of an annotation; by default
        only `class`. If `of_person` is true, or `limb` is given, decisions of several persons are kept separately.
    remarks : iterable of str, optional
        Remarks on what was excluded before.
    """
    new, known = new_rows(store, rows)
    table = pa.Table.from_pylist(new, schema=labels_schema())
    recorded = record_labels(store.path, table)
    store.forget_labels()
    return RecordedDecisions(recorded, known, tuple(remarks))


def new_rows(store: Store, rows: Iterable[Mapping[str, Any]]) -> tuple[list[Row], int]:
    """Return the rows of decisions that a store does not have yet, and the number of decisions that it has.

    A decision replaces an existing one with another verdict; parameters are those of `record_decisions`.
    """
    standing = {key: row for row in store.labels().to_pylist() for key in _keys(row, row["class"])}
    new: list[Row] = []
    known = 0
    for row in rows:
        verdict = row.get("verdict", "positive")
        own = row.get("limb") or row.get("of_person")  # decisions of several persons on an interval are kept separately
        found = (standing.get(_keys(row, name)[bool(own)]) for name in row.get("names", (row["class"],)))
        earlier = next((one for one in found if one is not None), None)
        if earlier is not None and earlier["verdict"] == verdict and row.get("replaces") is None:
            known += 1
            continue
        made = {name: row.get(name) for name in labels_schema().names} | {"verdict": verdict}
        if earlier is not None and made["replaces"] is None:
            made["replaces"] = earlier["id"]
        standing |= dict.fromkeys(_keys(row, row["class"]), made)
        new.append(made)
    return new, known


def _keys(row: Mapping[str, Any], name: str) -> tuple[tuple[object, ...], tuple[object, ...]]:
    """Return two keys of a decision, the first without the person, and the second with the person."""
    key = (row["take"], name, row["start"], row["stop"], row.get("limb"))
    return key, (*key, row.get("annotator"))


def annotations_of(store: Store, stage: str | None) -> tuple[str, pa.Table]:
    """Return an annotation stage, by default the current one, as "<pipeline>/<stage>", and its annotations."""
    chosen = annotation_stage(store, stage)
    return chosen, store.result("annotations", run=store.manifest.stages[chosen].run)


def decide_annotations(
    store: Store, annotations: pl.DataFrame, *, accept: bool, source: str = "", **more: str | None
) -> RecordedDecisions:
    """Record decisions on annotations as labels, positive if annotations are accepted and negative if rejected.

    The label of an accepted annotation has the subclass of the annotation, and becomes an example of the subclass. The
    label of a rejected annotation has the class, because the interval is no example of any subclass of the class.

    Parameters
    ----------
    store : Store
        The store.
    annotations : polars.DataFrame
        Rows of the view `annotations`.
    accept : bool
        True to accept, False to reject.
    source : str, optional
        The stage of the annotations; by default the stage in the columns `pipeline` and `stage`.
    **more : str, optional
        `annotator` and `note`.
    """
    rows = []
    for one in annotations.iter_rows(named=True):
        pipeline, stage = one.get("pipeline"), one.get("stage")
        named = f"{pipeline}/{stage}" if pipeline and stage else ""
        rows.append(decision_row(one, accept, source or named, more))
    return record_decisions(store, rows)


def decision_row(one: Mapping[str, Any], accept: bool, source: str, more: Mapping[str, str | None]) -> Row:
    """Return the row of a decision on an annotation; parameters are those of `decide_annotations`."""
    return {
        "take": one["take"],
        "class": (one.get("subclass") or one["class"]) if accept else one["class"],
        "names": dict.fromkeys([one.get("subclass") or one["class"], one["class"]]),
        "start": int(one["start"]),
        "stop": int(one["stop"]),
        "verdict": "positive" if accept else "negative",
        "origin": "accepted",
        "confidence": one.get("confidence"),
        "source": source or None,
        **more,
    }


def withdraw_labels(store: Store, labels: pl.DataFrame, **more: str | None) -> RecordedDecisions:
    """Withdraw labels by further rows; the labels remain in the history.

    Parameters
    ----------
    store : Store
        The store.
    labels : polars.DataFrame
        Rows of the view `labels`.
    **more : str, optional
        `annotator` and `note`.
    """
    return record_decisions(store, [withdrawal(one) | more for one in labels.iter_rows(named=True)])


def withdrawal(label: Mapping[str, Any]) -> Row:
    """Return the row that withdraws a label."""
    kept = ("take", "class", "start", "stop", "limb", "origin")
    return {**{name: label[name] for name in kept}, "replaces": label["id"], "verdict": "withdrawn"}


def labels_by_id(store: Store, ids: Sequence[str]) -> pl.DataFrame:
    """Return labels by their ids, or by the beginnings of their ids.

    Raises
    ------
    KinedexError
        No label, or more than one, has an id that begins with the given text.
    """
    labels = data_frame(store.labels())
    for one in ids:
        count = labels.filter(pl.col("id").str.starts_with(one)).height if one else 0
        if count != 1:
            raise KinedexError(
                f"{count or 'no'} {'label has' if count < 2 else 'labels have'} an id that begins with '{one}'; "
                "`kinedex labels list` shows ids"
            )
    return labels.filter(pl.any_horizontal(pl.col("id").str.starts_with(one) for one in ids))


def import_labels(
    store: Store,
    files: Sequence[LabelFile],
    corrects: str | None = None,
    stage: str | None = None,
    **more: str | None,
) -> RecordedDecisions:
    """Record the segments of label files as labels, with their limbs and annotators, or as a person's corrections.

    If somebody has examined a limb of a take, or all limbs, without marking an error, a negative label `error` of the
    whole take records this.

    If the files correct annotations, decisions concern the takes that the files name. An annotation that is unchanged
    in the files is accepted, a moved one is corrected, a missing one is rejected, and a new segment is drawn. An
    annotation with another class is corrected, and rejected for its former class. An unchanged annotation that a person
    has rejected or moved before keeps the earlier decision. If the files correct labels, labels are moved, renamed,
    withdrawn and drawn likewise.

    Parameters
    ----------
    store : Store
        The store.
    files : sequence of LabelFile
        The files; segments that the store already has as labels are skipped.
    corrects : {"annotations", "labels"}, optional
        The kind of segments that `labels export` wrote and a person changed; None for files that were not exported.
    stage : str, optional
        The stage whose annotations were corrected; by default that of the current pipeline.
    **more : str, optional
        `annotator`, used where a file names none, and `note`.

    Raises
    ------
    ParameterError
        `corrects` has another value.
    KinedexError
        No take of the files is in the store, a segment ends after its take, or the files correct annotations of takes
        that were not annotated.
    """
    proposed = proposed_labels(store, files, corrects, stage, **more)
    return replace(record_decisions(store, proposed.rows, proposed.remarks), unmatched=proposed.unmatched)


def proposed_labels(
    store: Store,
    files: Sequence[LabelFile],
    corrects: str | None = None,
    stage: str | None = None,
    **more: str | None,
) -> ProposedDecisions:
    """Return what `import_labels` would record; parameters and errors are those of `import_labels`."""
    if corrects not in (None, "annotations", "labels"):
        raise ParameterError("corrects", '"annotations" or "labels"', corrects)
    placed = placed_files(store, files)
    if corrects == "annotations":
        return _corrected_annotations(store, placed, stage, more)
    if corrects == "labels":
        return ProposedDecisions(tuple(_corrected_labels(store, placed, more)), placed.remarks, placed.unmatched)
    rows = [_drawn(one, "imported", more) for one in placed.segments]
    rows += [_drawn(one, "imported", more) | {"verdict": "negative", "of_person": True} for one in placed.covered]
    return ProposedDecisions(tuple(rows), placed.remarks, placed.unmatched)


def _corrected_annotations(
    store: Store, placed: PlacedFiles, stage: str | None, more: Mapping[str, str | None]
) -> ProposedDecisions:
    chosen, annotations = annotations_of(store, stage)
    annotated = set(annotated_takes(store, chosen)["name"])
    takes = [take for take in placed.takes if take in annotated]
    if not takes:
        raise KinedexError(f"stage {chosen} annotated none of the takes of these files, such as {placed.takes[0]}")
    others = sorted(set(placed.takes) - annotated)
    remarks = [*placed.remarks, *([f"takes that {chosen} did not annotate: {name_list(others)}"] if others else [])]
    known = {segment_of(row): row for row in annotations.to_pylist() if row["take"] in takes}
    after = [one for one in placed.segments if one.take in annotated]
    found = segment_differences(known, after)
    decided = _decided_otherwise(store, [known[one.before] for one in found if one.before and one.change == "same"])
    if decided:
        shown = [f"{one.label} in {one.take}[{one.start}:{one.stop}]" for one in decided]
        remarks.append(
            f"unchanged, and rejected or moved by a person before, which stays: {name_list(shown)}; "
            "`kinedex labels accept` accepts them"
        )
    rows = (row for one in found if one.before not in decided for row in _corrections(one, known, chosen, more))
    return ProposedDecisions(tuple(rows), tuple(remarks), placed.unmatched)


def _decided_otherwise(store: Store, annotations: Iterable[Row]) -> list[ManualSegment]:
    """Return annotations that a person has rejected, or whose start or stop a person has corrected."""
    labels: dict[str, list[Row]] = defaultdict(list)
    for label in store.labels().to_pylist():
        labels[label["take"]].append(label)

    def differs(label: Row, row: Row) -> bool:
        same = (label["start"], label["stop"]) == (row["start"], row["stop"])
        if label["class"] not in (row["class"], row["subclass"]):
            return False
        if label["verdict"] == "negative":
            return same
        overlaps = label["start"] < row["stop"] and row["start"] < label["stop"]
        return label["origin"] == "corrected" and overlaps and not same

    return [segment_of(row) for row in annotations if any(differs(label, row) for label in labels[row["take"]])]


def _corrected_labels(store: Store, placed: PlacedFiles, more: Mapping[str, str | None]) -> Iterator[Row]:
    rows = store.labels().to_pylist()
    known = {segment_of(row): row for row in rows if row["take"] in placed.takes and row["verdict"] == "positive"}
    for one in segment_differences(known, placed.segments):
        before = known[one.before] if one.before is not None else None
        if one.after is not None and one.change != "same":
            row = _drawn(one.after, "drawn" if before is None else "corrected", more)
            yield row | {"replaces": before["id"]} if before is not None else row
        elif one.after is None and before is not None:
            yield {**withdrawal(before), **more}


def _corrections(
    one: SegmentDifference, known: Mapping[ManualSegment, Row], stage: str, more: Mapping[str, str | None]
) -> list[Row]:
    before = known[one.before] if one.before is not None else None
    if before is not None and one.change == "same":
        return [decision_row(before, True, stage, more)]
    rows = [decision_row(before, False, stage, more)] if before is not None and one.change != "moved" else []
    if one.after is not None:
        row = _drawn(one.after, "drawn" if before is None else "corrected", more)
        if before is not None and one.change == "moved":
            row["class"] = before["subclass"] or before["class"]  # the label becomes an example of this subclass
        rows.append(row)
    return rows


def _drawn(one: ManualSegment, origin: str, more: Mapping[str, str | None]) -> Row:
    """Return a row of labels for a segment, by the annotator in its file or the person who corrected its class."""
    edges = {"start": int(one.start), "stop": int(one.stop)}
    row = {"take": one.take, "class": one.label, **edges, "origin": origin, "source": one.where or None, **more}
    named = bool(one.annotator) and (bool(one.limb) or origin == "imported" or not more.get("annotator"))
    row |= {"limb": one.limb or None, "of_person": named and origin == "imported"}
    return row | {"annotator": one.annotator} if named else row
