"""Convert annotations and labels of a store to labels in source frames, for label files."""

from __future__ import annotations

import math
import shlex
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import polars as pl

from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.wording import few
from kinedex.pipelines.annotation.tables import annotated_takes
from kinedex.pipelines.labels.rejections import Rejections
from kinedex.storage.formats.labels.segments import Label, TakeLabels
from kinedex.storage.snapshot.labels import is_of_limbs
from kinedex.storage.snapshot.shown_results import pipeline_of, pipelines_by_use
from kinedex.storage.store.store import Store


def annotate_stage(store: Store, wanted: str | None = None) -> str:
    """Find the stage whose annotations a user asks for.

    Parameters
    ----------
    store : Store
        The store to read.
    wanted : str, optional
        "<pipeline>/<stage>", the name of the pipeline, or the id of the run; the stage of the pipeline whose
        annotations the view `annotations` shows by default.

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
            f"several stages of '{asked}' have annotated takes: {few(sorted(fitting))}; choose one with --stage"
        )
    return fitting[0]


def source_frame(frame: int, source_rate_hz: float, rate_hz: float, frames: int) -> int:
    """Return the last source frame at or before an analysis frame, at most the number of source frames.

    `pipelines.evaluation.ground_truth.analysis_frame` is its inverse, unless the source rate is below the analysis
    rate.
    """
    return min(math.floor(round(frame * source_rate_hz / rate_hz, 9)), frames)


@dataclass(frozen=True)
class AnnotationLabels:
    """Annotations as labels, with the number of rejected ones.

    Attributes
    ----------
    takes : list of TakeLabels
        One for each annotated take, including those without labels, in the order of their names.
    rejected : int
        The number of annotations excluded because a person has rejected them.
    """

    takes: list[TakeLabels]
    rejected: int


def labels_of(store: Store, stage: str, takes: Sequence[str] = (), where: str | None = None) -> AnnotationLabels:
    """Return the annotations of a stage for each take, except those that a person has rejected.

    Parameters
    ----------
    store : Store
        The store to read.
    stage : str
        "<pipeline>/<stage>".
    takes : sequence of str
        The names of the takes to return; by default all.
    where : str, optional
        A SQL filter over the columns of takes.

    Raises
    ------
    KinedexError
        A take was not annotated by this stage, or has been replaced since then.
    """
    annotated = annotated_takes(store, stage)
    unknown = sorted(set(takes) - set(annotated["name"]))
    if unknown:
        raise KinedexError(
            f"stage {stage} did not annotate '{unknown[0]}'{did_you_mean(unknown[0], annotated['name'])}"
        )
    if takes:
        annotated = annotated.filter(pl.col("name").is_in(list(takes)))
    if where is not None:
        annotated = annotated.filter(pl.col("take_id").is_in(store.takes(where)["take_id"].to_list()))
        if not annotated.height:
            raise KinedexError(f"the filter `{where}` selects no take that stage {stage} annotated")
    record = store.manifest.stages[stage]
    found: dict[str, list[Label]] = defaultdict(list)
    rows = {str(row["name"]): row for row in annotated.iter_rows(named=True)}
    rejections, rejected = Rejections(store), 0
    for one in store.result("annotations", run=record.run).to_pylist():
        if one["take"] not in rows:
            continue
        if rejections.include(one):
            rejected += 1
        else:
            found[one["take"]].append(_label(one, rows[one["take"]]))
    labelled = [
        TakeLabels(name, float(row["source_rate_hz"]), int(row["source_frames"]), tuple(found[name]), record.finished)
        for name, row in rows.items()
    ]
    return AnnotationLabels(labelled, rejected)


def labels_kept(store: Store, takes: Sequence[str] = (), where: str | None = None) -> list[TakeLabels]:
    """Return the labels by people that a store holds, for each take.

    Negative labels are excluded, except those of limbs, by which label files record that an annotator has examined a
    limb, or all limbs of the take, without marking an error.

    Parameters
    ----------
    store : Store
        The store to read.
    takes : sequence of str
        The names of the takes to return; by default all that have labels.
    where : str, optional
        A SQL filter over the columns of takes.
    """
    rows = {str(row["name"]): row for row in store.takes(where).iter_rows(named=True)}
    found: dict[str, list[Label]] = defaultdict(list)
    covered: dict[str, list[tuple[str, str]]] = defaultdict(list)
    made = "1970-01-01T00:00:00+00:00"
    for one in sorted(store.labels().to_pylist(), key=lambda one: (one["take"], one["start"], one["stop"])):
        if one["take"] not in rows or (takes and one["take"] not in takes):
            continue
        if one["verdict"] == "positive":
            found[one["take"]].append(_label({**one, "subclass": "", "cost": None}, rows[one["take"]]))
            made = max(made, one["created"].isoformat(timespec="seconds"))
        elif is_of_limbs(one):
            found[one["take"]] += []
            covered[one["take"]].append((one["limb"] or "", one["annotator"] or ""))
    unknown = sorted(set(takes) - set(found))
    if unknown:
        raise KinedexError(f"no label is of '{unknown[0]}'{did_you_mean(unknown[0], found)}")
    return [
        TakeLabels(
            name,
            float(row["source_rate_hz"]),
            int(row["source_frames"]),
            tuple(found[name]),
            made,
            tuple(covered[name]),
        )
        for name, row in rows.items()
        if name in found
    ]


def classes_of_takes(store: Store, takes: Sequence[str] = (), where: str | None = None) -> list[TakeLabels]:
    """Return the class that each take has from its path or a table, as one label of all of its frames.

    Parameters
    ----------
    store : Store
        The store to read.
    takes : sequence of str
        The names of the takes to return; by default all that have a class.
    where : str, optional
        A SQL filter over the columns of takes.

    Raises
    ------
    KinedexError
        One of `takes` has no class, or no take has one.
    """
    rows = store.takes(where).filter(pl.col("class").is_not_null()).sort("name")
    unknown = sorted(set(takes) - set(rows["name"]))
    if unknown:
        raise KinedexError(f"'{unknown[0]}' is no take with a class{did_you_mean(unknown[0], rows['name'])}")
    if not rows.height:
        raise KinedexError(
            f"{store.path}: no take of these has a class; the class of a take comes from its path, by `patterns` of "
            "ingest (`kinedex init DIR` proposes some), or from a table of metadata"
        )
    return [
        TakeLabels(
            row["name"], float(row["source_rate_hz"]), int(row["source_frames"]),
            (Label(row["class"], 0, int(row["source_frames"])),), store.manifest.created,
        )
        for row in rows.iter_rows(named=True)
        if not takes or row["name"] in takes
    ]  # fmt: skip


def _label(one: dict[str, object], take: dict[str, object]) -> Label:
    rates = float(str(take["source_rate_hz"])), float(str(take["rate_hz"])), int(str(take["source_frames"]))
    start, stop = (source_frame(int(str(one[name])), *rates) for name in ("start", "stop"))
    cost, confidence = (None if one[name] is None else float(str(one[name])) for name in ("cost", "confidence"))
    limb, annotator = str(one.get("limb") or ""), str(one.get("annotator") or "")
    given = (str(one["subclass"]) or None, cost, confidence, limb, annotator)
    return Label(str(one["class"]), start, max(stop, start + 1), *given)
