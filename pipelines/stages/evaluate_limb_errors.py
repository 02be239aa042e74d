"""Stage evaluate_limb_errors: compare detected limb errors with people's labels, over thresholds."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any, ClassVar

from kinedex.catalog.published_results import load_published
from kinedex.ops.errors import KinedexError
from kinedex.ops.intervals import in_seconds
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading, files_digest, hash_of
from kinedex.pipelines.engine.display import ResultTable
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.inertial.limb_error_curves import RUNS, judged_limbs
from kinedex.pipelines.inertial.limb_error_metrics import LimbCounts, metric_rows, runs_by_limb
from kinedex.pipelines.inertial.limb_labels import (
    LimbLabels,
    PlacedLabel,
    placed_labels,
    read_limb_labels,
    stored_limb_labels,
    unused_labels,
)
from kinedex.pipelines.inertial.parameters import EvaluateLimbErrorsParameters
from kinedex.storage.formats.labels.formats import any_ground_truth, ground_truth_files
from kinedex.storage.snapshot.schemas import result_table
from kinedex.storage.snapshot.stored_labels import is_of_limbs
from kinedex.storage.store.store import Store

METRICS, LABELS = "limb_error_metrics", "limb_labels"

SIMULATED = "limb_labels.csv"
"""The label file of simulated annotators, which `break_track` writes into the folder of reports."""


class EvaluateLimbErrors(Stage[EvaluateLimbErrorsParameters]):
    """Compares detected limb errors with people's labels, over thresholds (thesis, Section 7.6.3)."""

    name = "evaluate_limb_errors"
    parameters = EvaluateLimbErrorsParameters
    inputs: ClassVar = {"errors": Input("limb_errors"), "broken": Input("break_track", optional=True)}

    def external_digest(self, params: EvaluateLimbErrorsParameters, store: Store | None) -> str:
        """Return a hash of the label files, and of the file with the published results."""
        printed = "" if params.printed is None else load_published(params.printed).model_dump_json()
        if params.ground_truth is None or store is None:
            return printed
        try:
            return printed + files_digest(_label_files(store, params.ground_truth))
        except KinedexError:
            return printed + "none to be read"

    def reading(self, params: EvaluateLimbErrorsParameters, store: Store) -> Reading:
        """Return a digest of the labels of limbs in the store, which are read if no label files are named."""
        if params.ground_truth is not None:
            return Reading(hash_of(), "")
        rows = list(filter(is_of_limbs, store.labels().to_pylist()))
        return Reading(hash_of(*(row["id"] for row in rows)), counted(len(rows), "label") if rows else "")

    def run(self, context: StageContext, params: EvaluateLimbErrorsParameters) -> dict[str, object]:
        """Count frames and segments of limbs against every annotator, and store the metrics."""
        store = context.open()
        labels = self._labels(context, store, params)
        context.report_unmatched(labels.unmatched)
        if not labels.looked_at:
            empty = {kind: result_table(kind, (), context.run) for kind in (METRICS, LABELS)}
            context.put_results(**empty)
            context.message(
                f"no labels, nothing to evaluate; `--set {context.stage}.ground_truth=PATTERN` names label files, and "
                f"`kinedex labels import {shlex.quote(str(context.store_path))} FILE` keeps them in the store"
            )
            return {"evaluated_takes": 0}
        counts, placed, remarks = _counted(context, store, labels, params)
        context.message(*remarks)
        printed = None if params.printed is None else load_published(params.printed)
        rows = list(metric_rows(counts, printed))
        context.put_results(
            limb_error_metrics=result_table(METRICS, rows, context.run),
            limb_labels=result_table(LABELS, map(_label_row, placed), context.run),
        )
        takes = {take_id for ids in counts.takes.values() for take_id in ids}
        if rows:
            context.terminal.show(_table(rows))
            context.message("sensors: at the τ with the largest F (frames); runs: as limb_errors stored them")
        context.message(
            f"{counted(len(takes), 'take')}, {counted(len(placed), 'label')} of "
            f"{counted(len(labels.annotators), 'annotator')}"
        )
        return {"evaluated_takes": len(takes), "labels": len(placed), "annotators": labels.annotators}

    def _labels(self, context: StageContext, store: Store, params: EvaluateLimbErrorsParameters) -> LimbLabels:
        """Return labels from the named files, from simulated annotators, or from the store."""
        if params.ground_truth is not None:
            return read_limb_labels(store, _label_files(store, params.ground_truth))
        if "broken" not in context.inputs:
            return stored_limb_labels(store)
        stage = store.manifest.stages[context.key(context.inputs["broken"])]
        written = [context.store_path / str(name) for name in stage.summary.get("files", ())]
        return read_limb_labels(store, (path for path in written if path.name.endswith(SIMULATED)))


def _label_files(store: Store, pattern: str) -> list[Path]:
    """Return label files by a path or glob, absolute or relative to the takes' source folders or the current folder."""
    if Path(pattern).is_file():
        return [Path(pattern)]
    roots = sorted({row["source_root"] for row in store.take_rows.to_pylist() if row["source_root"]})
    roots = [root for root in roots if Path(root).is_dir()]
    places = [*roots, str(Path.cwd())]
    for folders in (roots, [] if "**" in pattern else [Path.cwd()]):
        if any_ground_truth(pattern, folders):
            return ground_truth_files(pattern, folders)
    raise KinedexError(
        f"ground_truth: no file '{pattern}' below {', '.join(places)}. Labels of limbs are CSV or JSON files with "
        "take, class (error), start, stop, limb and annotator, or files of ELAN with tiers such as A1:lshank; without "
        "labels leave `ground_truth` unset"
    )


def _counted(
    context: StageContext, store: Store, labels: LimbLabels, params: EvaluateLimbErrorsParameters
) -> tuple[LimbCounts, list[PlacedLabel], list[str]]:
    """Count frames and segments of every evaluated limb; return the counts, the labels of these limbs, and remarks."""
    stage = context.key(context.inputs["errors"])
    runs = runs_by_limb(store.result(RUNS, stage=stage).to_pylist())
    counts, placed = LimbCounts(params.taus), list[PlacedLabel]()
    judged: set[tuple[str, str]] = set()
    for take in judged_limbs(store, stage):
        own = placed_labels(labels, take)
        placed += own
        for limb in take:
            judged.add((limb.take, limb.limb))
            looked = [name for name in labels.annotators if limb.take in labels.looked_at[name]]
            counts.add(
                limb,
                looked,
                [one for one in own if one.judged.limb == limb.limb],
                runs.get((limb.take_id, limb.limb), []),
            )
    return counts, placed, unused_labels(labels, judged, {take for take, _ in judged})


def _label_row(one: PlacedLabel) -> dict[str, Any]:
    return {
        "take_id": one.judged.take_id,
        "take": one.judged.take,
        "limb": one.judged.limb,
        "annotator": one.annotator,
        "start": one.start,
        "stop": one.stop,
        "start_seconds": in_seconds(one.start, one.judged.rate_hz),
        "stop_seconds": in_seconds(one.stop, one.judged.rate_hz),
        "file": one.file,
    }


def _table(rows: list[dict[str, Any]]) -> ResultTable:
    """Return a table of the detectors, for all limbs and for labelled groups, each at its best threshold by frames."""
    names = ("limbs", "detector", "against", "τ", "P", "R", "F (frames)", "F (segments)")
    printed = any(row.get("printed_p1") is not None for row in rows)
    table = ResultTable((*names, *(("printed P / R",) if printed else ())), texts=frozenset({0, 1, 2}))
    wanted: dict[tuple[str, str, str], dict[str, Any]] = {}
    marked = {row["name"] for row in rows if row["frames_manual"]}
    for row in rows:
        key = (row["name"], row["detector"], row["annotator"])
        if row["scope"] == "limb" or (row["scope"] == "group" and row["name"] not in marked):
            continue
        if key not in wanted or (row["f1"] or 0.0) > (wanted[key]["f1"] or 0.0):
            wanted[key] = row
        if row.get("printed_p1") is not None:
            wanted[(*key[:2], f"{key[2]}, τ as printed")] = row
    for key, row in wanted.items():
        tau = "–" if row.get("tau_deg") is None else f"{row['tau_deg']:g}°"
        numbers = ("–" if row[name] is None else f"{row[name]:.2f}" for name in ("p1", "r1", "f1", "f2"))
        known = row.get("printed_p1") is not None
        beside = f"{row['printed_p1']:.2f} / {row['printed_r1']:.2f}" if known else ""
        table.add(*key, tau, *numbers, *((beside,) if printed else ()))
    return table
