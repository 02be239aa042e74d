"""Make the tables of an annotation: takes, segments and distance curves."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Mapping
from itertools import repeat

import numpy as np
import polars as pl
import pyarrow as pa

from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.intervals import in_seconds
from kinedex.ops.wording import name_list
from kinedex.pipelines.annotation.annotators import Annotator
from kinedex.pipelines.annotation.batches import TakeAnnotation
from kinedex.pipelines.templates.template_learning import run_of
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.snapshot.visible_results import pipeline_of, pipelines_by_use
from kinedex.storage.store.store import Store, data_frame


def takes_table(
    takes: pl.DataFrame, run: str, searched: Mapping[int, float], prints: Mapping[int, str] | None = None
) -> pa.Table:
    """Return the annotated takes as results of the kind `annotated_takes`.

    Parameters
    ----------
    takes : polars.DataFrame
        Rows of takes.
    run : str
        The id of the run.
    searched : mapping of int to float
        The fraction of the frames of each take in which a template was matched, averaged over templates, by take_id.
    prints : mapping of int to str, optional
        The fingerprint of each take, by take_id. A later run keeps the annotation of a take with the same fingerprint.
    """
    ids = takes.sort("name")["take_id"].to_list()
    columns = takes.sort("name").select(
        pl.lit(run).alias("run"),
        "take_id",
        pl.col("name").alias("take"),
        "frames",
        pl.Series("searched", [searched[take_id] for take_id in ids], pl.Float64),
        pl.Series("fingerprint", [(prints or {}).get(take_id) for take_id in ids], pl.String),
    )
    return columns.to_arrow().cast(result_schema("annotated_takes"))


def annotation_stage(store: Store, wanted: str | None = None) -> str:
    """Find the stage whose annotations a user asks for.

    Parameters
    ----------
    store : Store
        The store to read.
    wanted : str, optional
        "<pipeline>/<stage>", the name of the pipeline, or the id of the run; by default, the stage of the pipeline
        that the view `annotations` shows.

    Returns
    -------
    str
        "<pipeline>/<stage>".

    Raises
    ------
    KinedexError
        The store has no annotations, none of this stage, or several stages fit.
    """
    annotating = {part.stage for part in store.manifest.results.get("annotated_takes", ())}
    records = {name: one for name, one in store.manifest.stages.items() if name in annotating}
    if not records:
        roots = store.takes()["source_root"].unique().to_list()
        source = shlex.quote(f"source={roots[0]}") if len(roots) == 1 else "source=…"
        command = f"kinedex run annotate --store {shlex.quote(str(store.path))} --set {source}"
        raise KinedexError(f"{store.path}: nothing was annotated; `{command}` annotates it")
    shown = next(name for name in pipelines_by_use(store.manifest) if name in map(pipeline_of, records))
    asked = wanted or shown
    fitting = [name for name, one in records.items() if asked in (name, pipeline_of(name), one.run)]
    if not fitting:
        raise KinedexError(f"no stage '{asked}' has annotated anything{did_you_mean(asked, records)}")
    if len(fitting) > 1:
        raise KinedexError(
            f"several stages of '{asked}' have annotated takes: {name_list(sorted(fitting))}; choose one with --stage"
        )
    return fitting[0]


def annotated_takes(store: Store, stage: str) -> pl.DataFrame:
    """Return the rows of the takes that a stage has annotated, sorted by name.

    Parameters
    ----------
    store : Store
        The store to read.
    stage : str
        "<pipeline>/<stage>".

    Raises
    ------
    KinedexError
        The stage has not run, or takes that it annotated have been replaced or dropped since then.
    """
    table = data_frame(store.result("annotated_takes", run=run_of(store, stage)))
    seen = table.select("take_id", pl.col("take").alias("name"), "frames")
    takes = store.takes().join(seen, on=seen.columns, how="semi", maintain_order="left")
    gone = sorted(set(seen["name"]) - set(takes["name"]))
    if gone or not seen.height:
        what = (
            f"takes that have been replaced or dropped since: {name_list(gone)}"
            if gone
            else "none of the store's takes"
        )
        raise KinedexError(f"stage {stage} annotated {what}; run it again: `--force {stage.split('/', 1)[-1]}`")
    return takes


def annotations_table(
    found: Iterable[TakeAnnotation], annotator: Annotator, names: dict[int, str], rate_hz: float, run: str
) -> pa.Table:
    """Return segments as results of the kind `annotations`, sorted by take name and start."""
    rows = [
        {
            "run": run,
            "take_id": one.take_id,
            "take": names[one.take_id],
            "class": annotator.classes[segment.class_index],
            "subclass": annotator.subclasses[segment.subclass],
            "start": segment.start,
            "stop": segment.stop,
            "start_seconds": in_seconds(segment.start, rate_hz),
            "stop_seconds": in_seconds(segment.stop, rate_hz),
            "cost": None if math.isnan(segment.cost) else segment.cost,
            "confidence": confidence,
            "method": annotator.label,
            "margin": segment.margin,
            "value": None if math.isnan(segment.value) else segment.value,
        }
        for one in sorted(found, key=lambda one: names[one.take_id])
        for segment, confidence in zip(one.segments, one.confidences or repeat(None), strict=False)
    ]
    return pa.Table.from_pylist(rows, schema=result_schema("annotations"))


def curves_table(found: Iterable[TakeAnnotation], annotator: Annotator, names: dict[int, str], run: str) -> pa.Table:
    """Return distance curves as results of the kind `distance_curves`, one row per take and subclass."""
    schema = result_schema("distance_curves")
    tables = []
    for one in sorted(found, key=lambda one: names[one.take_id]):
        if one.curves is None:
            continue
        count, length = one.curves.shape
        offsets = pa.array(np.arange(count + 1, dtype=np.int32) * length, pa.int32())
        columns = {
            "run": pa.repeat(run, count),
            "take_id": pa.repeat(one.take_id, count),
            "take": pa.repeat(names[one.take_id], count),
            "class": pa.array([annotator.classes[index] for index in annotator.class_index], pa.string()),
            "subclass": pa.array(annotator.subclasses, pa.string()),
            "costs": pa.ListArray.from_arrays(offsets, pa.array(one.curves.ravel(), pa.float32())),
            "preselected": one.preselected,
        }
        tables.append(pa.table(columns, schema=schema))
    return pa.concat_tables([schema.empty_table(), *tables])
