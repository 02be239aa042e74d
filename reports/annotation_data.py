"""Read the content of the annotation report from the results of a store, with the commands that repeat the run."""

from __future__ import annotations

import platform
import shlex
from collections.abc import Mapping, Sequence
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa

from kinedex.catalog.configs import config_path, read_text
from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.intervals import TakeSegment
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.engine.file_parameters import with_absolute_paths
from kinedex.pipelines.templates.examples import interval_of
from kinedex.reports.report_data import (
    Curve,
    Failure,
    FeatureNames,
    HitCount,
    ReportData,
    Score,
    StageRow,
    TakeRow,
    Template,
)
from kinedex.reports.take_selection import median_take, take_groups
from kinedex.storage.formats.json_text import setting_text
from kinedex.storage.snapshot.manifest import StageRecord
from kinedex.storage.store.history import SUMS, PipelineRun, last_run
from kinedex.storage.store.store import Store, data_frame

PACKAGES = ("numpy", "numba", "pyarrow", "duckdb", "polars", "jinja2")

ROLES = {
    "templates": "templates",
    "annotations": "annotations",
    "annotated_takes": "annotations",
    "not_applied": "annotations",
    "hits": "annotations",
    "ground_truth": "evaluation",
    "metrics": "evaluation",
}
"""A dict from kind of result to the role (the input of the stage `report`) of the stage that made it."""

BOOKKEEPING = {"uses", "params", "inputs", "fingerprint_parts", SUMS}
"""The keys that the runner adds to the summary of a stage."""


def read_report_data(
    store: Store,
    pipeline: str,
    *,
    created: datetime,
    inputs: Mapping[str, str],
    title: str | None = None,
    own_stage: str | None = None,
    curves_take: str | None = None,
) -> ReportData:
    """Read the content of an annotation report.

    Parameters
    ----------
    store : Store
        The store.
    pipeline : str
        Pipeline whose results are reported.
    created : datetime
        Time at which the page is made.
    inputs : mapping of str to str
        Input of the stage `report` → the stage whose results are reported.
    title : str or None
        Title of the page; if None, it is derived from the name of the archive.
    own_stage : str or None
        The stage that writes the page; its record is omitted.
    curves_take : str or None
        Take whose distance curves are shown; if None, the take with the median F (frames).

    Returns
    -------
    ReportData
        The content of the page.

    Raises
    ------
    KinedexError
        If `curves_take` was not annotated.
    """
    reader, takes = Reader(store, pipeline, inputs), store.takes()
    own, held = _scores(reader, "evaluation"), _scores(reader, "leave_one_out")
    pairs = data_frame(reader.curves("take, class, subclass"))
    annotations, annotate = reader.frame("annotations"), reader.record("annotations")
    other_method, otherwise = reader.other_annotations(annotations)
    subclasses = _subclasses(pairs, annotations)
    grouped_by, rows = _takes(store, takes, reader.frame("annotated_takes")["take"].to_list())
    chosen, why = _curves_take(curves_take, [row.name for row in rows], own, set(pairs["take"]), annotations)
    records = tuple(record for record in reader.records() if record.stage != own_stage)
    drawn, others = _templates(reader, annotate, subclasses)
    column = _held_out_column(reader)
    roots = tuple(sorted(takes["source_root"].drop_nulls().unique()))
    return ReportData(
        title=title or _title(roots),
        pipeline=pipeline,
        created=created,
        store_path=str(store.path.resolve()),
        source_roots=roots,
        kinedex_version=_version("kinedex"),
        feature_set=feature_names(store.feature_set),
        archive_takes=takes.height,
        archive_seconds=float(takes["seconds"].sum()),
        takes=rows,
        automatic=_automatic(annotations, otherwise),
        manual=_manual(reader.frame("ground_truth")),
        delta=_number(annotate, "delta"),
        tau=_number(annotate, "tau"),
        method=", ".join(sorted(annotations["method"].drop_nulls().unique())) or None,
        other_method=other_method,
        grouped_by=grouped_by,
        searched_share=_number(annotate, "searched"),
        scores=(*own, *held),
        evaluation=own[0].evaluation if own else None,
        held_out=held[0].evaluation if held else None,
        held_out_column=column,
        learned_from=_learned_from(takes, drawn, column),
        subclasses=subclasses,
        templates=drawn,
        other_templates=others,
        curves=_curves(reader, chosen),
        curves_take=chosen,
        curves_choice=why,
        hits=_hits(reader),
        failures=_failures(store),
        warnings=_warnings(takes),
        not_applied=_not_applied(reader),
        stages=records,
        versions=(("Python", platform.python_version()), *((name, _version(name)) for name in PACKAGES)),
        commands=(command(pipeline, store.path.resolve(), records),),
    )


def _not_applied(reader: Reader) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return the templates and queries that were not applied to some takes, each with the names of these takes."""
    table = reader.frame("not_applied").select("kind", "name", "take").unique().sort("kind", "name", "take")
    grouped = table.group_by("kind", "name", maintain_order=True).agg("take")
    return tuple((f"{kind} {name}", tuple(takes)) for kind, name, takes in grouped.iter_rows())


class Reader:
    """A reader of the results of the stages that are inputs of a report."""

    def __init__(self, store: Store, pipeline: str, inputs: Mapping[str, str]) -> None:
        self._store = store
        self._pipeline = pipeline
        self._inputs = inputs

    def table(self, kind: str, role: str | None = None) -> pa.Table:
        """Return the rows of results of `kind` from the stage that the report has as its input `role`.

        By default, the input is that of the kind in `ROLES`.
        """
        return self._store.result(kind, stage=f"{self._pipeline}/{self._inputs.get(role or ROLES[kind])}")

    def frame(self, kind: str) -> pl.DataFrame:
        """Return the results of a kind as a data frame."""
        return data_frame(self.table(kind))

    def other_annotations(self, own: pl.DataFrame) -> tuple[str | None, pl.DataFrame | None]:
        """Return the method and annotations of the last stage that annotated the same takes by another method.

        Both are None if there is no such stage.
        """
        method, takes = set(own["method"]), set(self.frame("annotated_takes")["take"])
        mine = f"{self._pipeline}/{self._inputs.get('annotations')}"
        stages = [record for key, record in self._store.manifest.stages.items() if key != mine]
        for record in sorted(stages, key=lambda record: record.finished, reverse=True):
            if record.summary.get("uses") != "annotate":
                continue
            found = data_frame(self._store.result("annotations", stage=record.stage))
            seen = data_frame(self._store.result("annotated_takes", stage=record.stage))["take"]
            others = set(found["method"])
            if others and others.isdisjoint(method) and takes <= set(seen):
                return ", ".join(sorted(others)), found.filter(pl.col("take").is_in(takes))
        return None, None

    def curves(self, columns: str, take: str | None = None) -> pa.Table:
        """Return some columns of the distance curves of one take or of all; all columns would need much memory."""
        annotate = self.record("annotations")
        chosen = f"SELECT {columns} FROM distance_curves WHERE run = $run AND ($take IS NULL OR take = $take)"
        return self._store.sql(chosen, {"run": annotate.run if annotate else "", "take": take})

    def records(self) -> tuple[StageRow, ...]:
        """Return the stages of the pipeline in the order in which they finished, but each after its inputs."""
        stages = self._store.manifest.stages
        own = [record for key, record in stages.items() if key.startswith(f"{self._pipeline}/")]
        waiting = sorted(own, key=lambda record: (record.finished, record.run, record.stage))
        rows: list[StageRow] = []
        while waiting:
            open_names = {_stage_name(record) for record in waiting}
            ready = (r for r in waiting if open_names.isdisjoint((r.summary.get("inputs") or {}).values()))
            first = next(ready, waiting[0])
            waiting.remove(first)
            rows.append(_stage_row(first))
        return tuple(rows)

    def record(self, role: str) -> StageRow | None:
        """Return the record of the stage that the report has as its input `role`; None if there is none."""
        return next((record for record in self.records() if record.stage == self._inputs.get(role)), None)


def feature_names(features: FeatureSet) -> FeatureNames:
    """Return the names and the digest of a feature set."""
    return FeatureNames(
        name=features.name,
        version=str(features.version),
        digest=features.digest,
        names=tuple(feature.name for feature in features.features),
        sets=tuple((word_set.name, word_set.first, word_set.count) for word_set in features.sets.values()),
    )


def _scores(reader: Reader, role: str) -> tuple[Score, ...]:
    rows = reader.table("metrics", role).to_pylist()
    return tuple(Score(**{key: value for key, value in row.items() if key != "run"}) for row in rows)


def _subclasses(pairs: pl.DataFrame, annotations: pl.DataFrame) -> dict[str, tuple[str, ...]]:
    """Return all subclasses of each class, or only those with annotations if no curves are stored."""
    columns = ["class", "subclass"]
    both = pl.concat([pairs.select(columns), annotations.select(columns)]).drop_nulls().unique().sort(columns)
    return {str(label): tuple(group["subclass"]) for (label,), group in both.group_by("class", maintain_order=True)}


def _takes(store: Store, takes: pl.DataFrame, annotated: Sequence[str]) -> tuple[str, tuple[TakeRow, ...]]:
    """Return the name of the column that annotated takes are grouped by, and the rows of the takes."""
    takes = takes.filter(pl.col("name").is_in(annotated))
    named = [name for name, column in store.manifest.columns.items() if column.origin in ("pattern", "metadata")]
    grouped_by, groups = take_groups(takes, named)
    columns = takes.select("name", "frames", "rate_hz", "actor", "warnings").sort("name")
    return grouped_by, tuple(
        TakeRow(name, frames, rate_hz, actor, tuple(warnings or ()), groups.get(name, ""))
        for name, frames, rate_hz, actor, warnings in columns.iter_rows()
    )


def _warnings(takes: pl.DataFrame) -> tuple[tuple[str, str], ...]:
    return tuple((name, text) for name, texts in takes.select("name", "warnings").iter_rows() for text in texts or ())


def _automatic(frame: pl.DataFrame, others: pl.DataFrame | None) -> tuple[TakeSegment, ...]:
    """Return annotations as segments, each with the classes that another method found instead if it disagrees."""
    found: dict[str, list[tuple[str, int, int]]] = {}
    for take, *one in others.select("take", "class", "start", "stop").iter_rows() if others is not None else ():
        found.setdefault(take, []).append(tuple(one))
    segments = []
    for row in frame.sort("take", "start", "stop", "class").iter_rows(named=True):
        take, label, start, stop = row["take"], row["class"], row["start"], row["stop"]
        there = [name for name, begin, end in found.get(take, ()) if begin < stop and start < end]
        doubted = None if others is None or label in there else ", ".join(sorted(set(there))) or "nothing"
        cost, sure = (None if value is None or np.isnan(value) else value for value in (row["cost"], row["confidence"]))
        segments.append(TakeSegment(take, label, start, stop, cost, row["subclass"], sure, doubted))
    return tuple(segments)


def _manual(frame: pl.DataFrame) -> tuple[TakeSegment, ...]:
    return tuple(
        TakeSegment(*row)
        for row in frame.sort("take", "start", "stop", "class").select("take", "class", "start", "stop").iter_rows()
    )


def _curves_take(
    wanted: str | None, names: Sequence[str], scores: Sequence[Score], with_curves: set[str], found: pl.DataFrame
) -> tuple[str | None, str]:
    if wanted is not None:
        if wanted not in names:
            raise KinedexError(f"curves_take: no annotated take is named '{wanted}'{did_you_mean(wanted, names)}")
        return wanted, "as requested"
    f1 = {s.name: s.f1 for s in scores if s.scope == "take" and s.f1 is not None}
    median = median_take({name: value for name, value in f1.items() if name in with_curves})
    if median is not None:
        return median, "the median take by F (frames)"
    counts = dict.fromkeys(with_curves, 0) | dict(
        found.filter(pl.col("take").is_in(list(with_curves))).group_by("take").len().iter_rows()
    )
    most = min(counts, key=lambda name: (-counts[name], name), default=None)
    return most, "the one with the most segments" if most else ""


def _curves(reader: Reader, take: str | None) -> tuple[Curve, ...]:
    if take is None:
        return ()
    rows = reader.curves("class, subclass, costs, preselected", take).to_pylist()
    curves = [
        Curve(row["class"], row["subclass"], np.asarray(row["costs"], np.float64), float(row["preselected"]))
        for row in rows
    ]
    return tuple(sorted(curves, key=lambda curve: (curve.label, curve.subclass)))


def _templates(
    reader: Reader, annotate: StageRow | None, subclasses: Mapping[str, Sequence[str]]
) -> tuple[tuple[Template, ...], int]:
    """Read the templates of the kind (soft or hard) that the annotation used, and count the others."""
    kind = str(annotate.params.get("templates", "soft")) if annotate else "soft"
    labels = {subclass: label for label, own in subclasses.items() for subclass in own}
    rows = reader.table("templates").to_pylist()
    templates = [
        Template(
            subclass=row["subclass"],
            label=labels.get(row["subclass"]),
            kind=row["kind"],
            values=np.asarray(row["values"], np.float64).reshape(row["columns"], row["features"]),
            clips=tuple(row["clips"]),
            rounds=row["rounds"],
            costs=tuple(row["costs"] or ()),
            origin=row["origin"] or "learned",
            remarks=tuple(row["remarks"] or ()),
        )
        for row in rows
        if row["kind"] == kind
    ]
    return tuple(sorted(templates, key=lambda template: template.subclass)), len(rows) - len(templates)


def _held_out_column(reader: Reader) -> str:
    record = reader.record("leave_one_out")
    if record is None:
        return "actor"
    splits = record.params.get("splits")
    if isinstance(splits, list) and splits:
        return str(splits[0].get("leave_out") or "actor")
    return str(record.params.get("column", "actor"))  # of a stage leave_one_out of an earlier version


def _learned_from(takes: pl.DataFrame, templates: Sequence[Template], column: str) -> tuple[str, ...]:
    names = set(takes["name"].to_list())
    clips = {interval_of(clip, names)[0] for template in templates for clip in template.clips}
    if column not in takes.columns:
        return ()
    values = takes.filter(pl.col("name").is_in(list(clips)))[column].drop_nulls().unique()
    return tuple(sorted(str(value) for value in values))


def _hits(reader: Reader) -> tuple[HitCount, ...]:
    grouped = (
        reader.frame("hits")
        .group_by("query")
        .agg(
            pl.len().alias("hits"),
            pl.col("take").n_unique().alias("takes"),
            (pl.col("stop_seconds") - pl.col("start_seconds")).sum().alias("seconds"),
        )
    )
    return tuple(HitCount(*row) for row in grouped.sort("query").iter_rows())


def _failures(store: Store) -> tuple[Failure, ...]:
    rows = store.result("ingest_log").to_pylist()
    failures = {Failure(row["source"], row["stage"], row["error"], row["message"], row["line"]): None for row in rows}
    return tuple(sorted(failures, key=lambda failure: (failure.source, failure.line or 0, failure.message)))


def _stage_name(record: StageRecord) -> str:
    return record.stage.split("/", 1)[-1]


def _stage_row(record: StageRecord) -> StageRow:
    params = record.summary.get("params") or {}
    summary = {key: value for key, value in record.summary.items() if key not in BOOKKEEPING}
    return StageRow(
        _stage_name(record), record.run, record.finished, record.seconds, record.fingerprint, params, summary
    )


def _number(record: StageRow | None, key: str) -> float | None:
    value = (record.params.get(key, record.summary.get(key))) if record else None
    return float(value) if isinstance(value, int | float) else None


def _title(roots: Sequence[str]) -> str:
    names = [root.replace("\\", "/").rstrip("/").rsplit("/", 1)[-1] for root in roots]
    return f"Annotation of {' and '.join(names)}" if names else "Annotation report"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def command(pipeline: str, store_path: Path, records: Sequence[StageRow]) -> str:
    """Return the shell commands that repeat the last run of a pipeline in a new store beside this one.

    For a shipped pipeline, the command is `kinedex run` with every parameter that differs from the pipeline file; it
    does not need the store. For other pipelines, the first command writes a pipeline file from the history of the
    store, because the original file may no longer exist, and the second command runs this file.

    Parameters
    ----------
    pipeline : str
        Name of the pipeline.
    store_path : Path
        The directory of the store, absolute.
    records : sequence of StageRow
        The stages with their parameters.
    """
    again = store_path.with_name(f"{store_path.name}-again")
    run = last_run(store_path, pipeline)
    if run is None or _is_shipped(run):
        return _shipped_command(pipeline, again, records)
    file = f"{pipeline}-{run.run}.yaml"
    export = ["kinedex", "history", "export", str(store_path), run.run, "-o", file]
    return f"{shlex.join(export)}\n{shlex.join(['kinedex', 'run', file, '--store', str(again)])}"


def _is_shipped(run: PipelineRun) -> bool:
    """Return whether a run used a shipped pipeline file and no mappings or other data that only its store has."""
    if run.files or run.mappings or run.other_sources or run.labels:
        return False
    try:
        return read_text(config_path("pipelines", run.pipeline)) == run.yaml
    except KinedexError:
        return False


def _shipped_command(pipeline: str, store_path: Path, records: Sequence[StageRow]) -> str:
    words = ["kinedex", "run", pipeline, "--store", str(store_path)]
    recorded = {record.stage: record.params for record in records}
    source = recorded.get("ingest", {}).get("source")
    settings = {} if source is None else {"source": str(Path(str(source)).expanduser().absolute())}
    try:
        planned = load_pipeline(pipeline, settings)
    except KinedexError:
        return f"{shlex.join(words)}    # with the file of pipeline “{pipeline}” in place of its name"
    for name, text in settings.items():
        words += ["--set", f"{name}={text}"]
    for stage in planned.stages:
        own = with_absolute_paths(type(stage.params), stage.params.model_dump(mode="json"))
        words += _differing(stage.name, own, with_absolute_paths(type(stage.params), recorded.get(stage.name, {})))
    return shlex.join(words)


def _differing(stage: str, own: Mapping[str, object], recorded: Mapping[str, object]) -> list[str]:
    words = []
    for key, value in recorded.items():
        if own.get(key) != value:
            words += ["--set", f"{stage}.{key}={setting_text(value)}"]
    return words
