"""Stage annotate: distance curves and labelled segments of takes, with preselection by keyframes where asked for."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
import polars as pl
import pyarrow as pa
import pyarrow.compute as pc
from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.classes import OWN, Classes, load_classes
from kinedex.catalog.configs import config_path
from kinedex.catalog.queries.queries import KeyframeQuery
from kinedex.catalog.queries.query_files import read_query_files
from kinedex.ops.annotation.decoding import background
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.pipelines.annotation.annotators import Annotator, make_annotator, targets_unknown
from kinedex.pipelines.annotation.batches import annotate_takes
from kinedex.pipelines.annotation.reuse import fingerprints, kept_annotations, setting_digest
from kinedex.pipelines.annotation.tables import annotations_table, curves_table, takes_table
from kinedex.pipelines.annotation.threshold_calibration import Calibration, calibrate
from kinedex.pipelines.console.wording import counted, few
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import files_digest
from kinedex.pipelines.keyframes.learning import every_query
from kinedex.pipelines.keyframes.runs import outcomes_of
from kinedex.pipelines.stages import learn_templates as learning
from kinedex.pipelines.templates.learning import (
    Kind,
    SubclassTemplate,
    TrainingClips,
    learn_templates,
    read_templates,
    run_of,
)
from kinedex.pipelines.templates.recipes import feature_weights
from kinedex.storage.store.store import Store
from kinedex.storage.store.writer import StoreWriter

F64 = npt.NDArray[np.float64]

CALIBRATED, DEFAULT_TAU = "calibrated", 0.13


class Params(BaseModel):
    """What the stage `annotate` takes."""

    model_config = ConfigDict(extra="forbid")

    where: str = Field("class IS NULL", description="takes to annotate: a SQL filter over the columns of takes")
    method: Literal["thesis", "best"] = Field(
        "thesis",
        description="thesis: where templates fit below tau, frames get the label of the nearest class, and its runs "
        "grow to either side as long as the class does not fit worse there (labels may overlap); best: the templates "
        "in a row, with background between them, that explain all frames of a take best together (tau does not matter "
        "then)",
    )
    templates: Kind = Field("soft", description="which of the learned templates: soft or hard")
    delta: float = Field(
        0.05, ge=0, lt=0.5, description="template values within delta of 0 or 1 count, the rest are wildcards"
    )
    tau: Annotated[float, Field(gt=0, le=1)] | Literal["calibrated"] = Field(
        DEFAULT_TAU,
        description="method thesis: distances below tau make an annotation; 'calibrated': each class has the threshold "
        "that divides its training clips from others best, matched with templates of the other actors' clips",
    )
    tau_by_class: dict[str, Annotated[float, Field(gt=0, le=1)]] = Field(
        {}, description="method thesis: class → its own tau, instead of the common or the calibrated one"
    )
    min_seconds: float = Field(0, ge=0, allow_inf_nan=False, description="shorter segments are left out")
    classes: str = Field(
        OWN, description="'own': every subclass is a class; or a class file, by its shipped name or its path"
    )
    queries: list[str] | str | None = Field(
        None,
        description="keyframe queries that preselect frames: files, by shipped names or paths; none: all frames; where "
        "the pipeline learns queries too, the hits of either count",
    )
    store_curves: bool = Field(True, description="keep the distance curves, which the report draws")

    @property
    def common_tau(self) -> float:
        """The threshold of classes that have none of their own."""
        return DEFAULT_TAU if self.tau == CALIBRATED else float(self.tau)

    @property
    def query_files(self) -> list[str]:
        """The query files as a list."""
        return [self.queries] if isinstance(self.queries, str) else list(self.queries or ())


def external_digest(params: Params, store: Store | None) -> str:
    """What the stage depends on outside the store: the text of its class and query files."""
    files = [config_path("queries", name) for name in params.query_files]
    if params.classes != OWN:
        files.append(config_path("classes", params.classes))
    return files_digest(files)


def run(context: StageContext, params: Params) -> dict[str, object]:
    """Annotate and store the results."""
    with context.writer() as writer:
        store = writer.store
        takes = takes_to_annotate(store, params)
        templates = read_templates(store, context.key(context.inputs["templates"]), params.templates)
        classes = classes_of(store, params, templates)
        queries, learned = queries_of(store, params), learned_queries(context, store)
        usual = usual_features(store, templates) if params.method == "best" else None
        annotator = make_annotator(
            store.feature_set, templates, classes, params.delta, params.common_tau, queries, usual, learned
        )
        calibration = calibrated(context, store, params, classes)
        annotator = refined(annotator, params, store.rate_hz, calibration.taus)
        remarks = [*annotator.remarks, *calibration.remarks, *without_effect(params)]
        for remark in remarks:
            context.say(remark)
        _say_what_is_left_out(context, classes, annotator, queries, learned)
        done = _annotate(context, writer, annotator, takes, params)
        writer.commit()
    share = _share_searched(done.searched, takes)
    context.say(
        f"{counted(done.segments, 'segment')} in {counted(takes.height, 'take')}"
        + (f"; templates were matched in {share:.1%} of the frames" if any(annotator.queries) else "")
        + (
            f"; {counted(done.kept, 'take')} kept as they were, {takes.height - done.kept} annotated"
            if done.kept
            else ""
        )
    )
    return {
        "takes": takes.height,
        "frames": int(takes["frames"].sum()),
        "classes": len(annotator.classes),
        "templates": len(annotator.templates),
        "segments": done.segments,
        "kept_takes": done.kept,
        "searched": round(share, 6),
        "method": params.method,
        "delta": params.delta,
        "tau": params.tau,
        "tau_by_class": _rounded(_own_taus(annotator)),
        "calibration_f": _rounded(calibration.scores.items()),
        "remarks": remarks,
    }


def _own_taus(annotator: Annotator) -> Iterator[tuple[str, float]]:
    """The thresholds of classes that have templates, where classes have thresholds of their own."""
    labelled = set(annotator.class_index.tolist())
    if annotator.taus is not None:
        yield from ((annotator.classes[index], float(annotator.taus[index])) for index in sorted(labelled))


def _rounded(pairs: Iterable[tuple[str, float]]) -> dict[str, float]:
    return {name: round(float(value), 6) for name, value in pairs}


def without_effect(params: Params) -> list[str]:
    """What is asked for, and does not matter to the method, in words."""
    asked = ["`tau: calibrated`"] * (params.tau == CALIBRATED) + ["`tau_by_class`"] * bool(params.tau_by_class)
    if params.method != "best" or not asked:
        return []
    have = "has" if len(asked) == 1 else "have"
    return [f"{' and '.join(asked)} {have} no effect with `method: best`, in which τ does not matter"]


def calibrated(
    context: StageContext,
    store: Store,
    params: Params,
    classes: Classes,
    clips: Sequence[TrainingClips] | None = None,
) -> Calibration:
    """The calibrated thresholds of classes, none where they are not asked for or do not matter.

    Parameters
    ----------
    clips: what to calibrate on; None: all clips that the templates were learned from.
    """
    if params.tau != CALIBRATED or params.method == "best":
        return Calibration({}, {}, ())
    learned = context.params[context.inputs["templates"]]
    assert isinstance(learned, learning.Params)
    counts = feature_weights(learned.weights, store.feature_set)

    def learn(some: Sequence[TrainingClips]) -> list[SubclassTemplate]:
        features, kinds = len(store.feature_set.features), [params.templates]
        found = [one for task in learn_templates(some, kinds, features, context.executor, counts) for one in task]
        return learning.completed(found, learned, store.feature_set, kinds, where_possible=True)

    if clips is None:
        clips = learning.clips_to_learn_from(store, learned, learning.takes_to_learn_from(store, learned))
    actors = dict(store.takes().select("name", "actor").iter_rows())  # a split's clips need not be the stage's
    return calibrate(clips, actors, classes, params.delta, learn, context.executor)


@dataclass(frozen=True)
class Done:
    """What was annotated: how many segments, how many takes were kept from an earlier run, and the share of each
    take's frames that templates were matched in, by take_id."""

    segments: int
    kept: int
    searched: dict[int, float]


def _annotate(
    context: StageContext, writer: StoreWriter, annotator: Annotator, takes: pl.DataFrame, params: Params
) -> Done:
    """Annotate what is new, and put it into the store with what is kept.

    Curves go to disk batch by batch, and those of takes that are kept stay in their files; of segments, rows of tables
    are held, about a hundred bytes each.
    """
    setting = setting_digest(annotator, params.store_curves, context.code)
    prints = fingerprints(writer.store, takes, setting) if context.code else {}
    kept = kept_annotations(writer.store, context.key(), {} if context.anew else prints)
    new = takes.filter(~pl.col("take_id").is_in(list(kept.searched)))
    names = dict(takes.select("take_id", "name").iter_rows())
    segments, searched = [kept.annotations(context.run)], dict(kept.searched)
    known = kept.curve_parts()

    def curves() -> Iterator[pa.Table]:
        yield from kept.curves(known.again, context.run)
        with context.progress("takes", new.height) as progress:
            for batch in annotate_takes(context.store_path, annotator, new, context.executor, params.store_curves):
                segments.append(annotations_table(batch, annotator, names, writer.store.rate_hz, context.run))
                searched.update((one.take_id, float(one.preselected.mean())) for one in batch)
                progress.advance(len(batch))
                yield curves_table(batch, annotator, names, context.run)

    put = partial(writer.put_results, stage=context.key(), run=context.run)
    put("distance_curves", curves(), keep=known.stay)
    table = pa.concat_tables(segments)
    table = table.take(pc.sort_indices(table, [("take", "ascending")]))  # stable: within a take they are in order
    put("annotations", table)
    put("annotated_takes", takes_table(takes, context.run, searched, prints))
    return Done(table.num_rows, len(kept.searched), searched)


def refined(
    annotator: Annotator, params: Params, rate_hz: float, calibrated: Mapping[str, float] | None = None
) -> Annotator:
    """An annotator with the thresholds of classes, which rows of templates have none of, and the least length of
    segments.

    Parameters
    ----------
    calibrated: class → τ, where that was asked for; `tau_by_class` goes before it.

    Raises
    ------
    KinedexError: `tau_by_class` names no class.
    """
    least = math.ceil(round(params.min_seconds * rate_hz, 9))
    wrong = sorted(set(params.tau_by_class) - set(annotator.classes))
    if wrong:
        raise KinedexError(f"tau_by_class: no class is named '{wrong[0]}'{did_you_mean(wrong[0], annotator.classes)}")
    given = {} if annotator.row is not None else {**(calibrated or {}), **params.tau_by_class}
    taus = np.array([given.get(name, annotator.tau) for name in annotator.classes]) if given else None
    return replace(annotator, taus=taus, min_frames=least)


def takes_to_annotate(store: Store, params: Params) -> pl.DataFrame:
    """The takes that the filter selects, sorted by name; a KinedexError where there are none."""
    takes = store.takes(params.where)
    if not takes.height:
        every = store.takes()
        raise KinedexError(
            f"no take to annotate: the filter `{params.where}` selects none of {every.height} takes, "
            f"{every.filter(pl.col('class').is_null()).height} of which have no class"
        )
    return takes


def classes_of(store: Store, params: Params, templates: Sequence[SubclassTemplate]) -> Classes:
    """The classes of the class file, or with "own" those that have templates.

    A class file may name every subclass that the archive has, also those that are not learned from.
    """
    learned = {one.subclass for one in templates}
    labelled = set(store.takes()["class"].drop_nulls().unique())
    return load_classes(params.classes, learned if params.classes == OWN else learned | labelled)


def usual_features(store: Store, templates: Sequence[SubclassTemplate]) -> F64:
    """The usual postures in the clips that templates were learned from, or in all takes where they are of none."""
    clips = {name for one in templates for name in one.clips}
    takes = store.takes().filter(pl.col("name").is_in(clips))
    words = store.words(takes["take_id"].to_list() if takes.height else None)
    return background([words.words], len(store.feature_set.features))


def learned_queries(context: StageContext, store: Store) -> list[KeyframeQuery]:
    """The queries that the pipeline's stage `learn_keyframes` learned; none where it has no such stage."""
    if "keyframes" not in context.inputs:
        return []
    table = store.result("queries", run=run_of(store, context.key(context.inputs["keyframes"])))
    return every_query(outcomes_of(table), store.feature_set)


def queries_of(store: Store, params: Params) -> list[KeyframeQuery]:
    """All queries of the query files."""
    return read_query_files(params.query_files, store.feature_set, store.rate_hz)


def _say_what_is_left_out(
    context: StageContext,
    classes: Classes,
    annotator: Annotator,
    queries: Sequence[KeyframeQuery],
    learned: Sequence[KeyframeQuery],
) -> None:
    if classes.without_class:
        context.say(f"in no class and not annotated: {few(classes.without_class)}")
    empty = [one.name for one in classes.classes if not set(one.subclasses) & set(annotator.subclasses)]
    if empty:
        context.say(f"classes without a template, which nothing can be labelled with: {few(empty)}")
    unknown = sorted({*targets_unknown(queries, classes), *targets_unknown(learned, classes)})
    if unknown:
        context.say(f"keyframe queries for other classes, left out: {few(unknown)}")
    used = dict(zip(annotator.subclasses, map(set, annotator.queries), strict=True))
    both = [name for name, own in used.items() if own & set(queries) and own & set(learned)]
    if both:
        context.say(f"preselected for by queries of files and learned ones, within the hits of either: {few(both)}")
    without = [name for name, own in used.items() if not own]
    if (queries or learned) and without:
        context.say(f"without a keyframe query, matched in all frames: {few(without)}")


def _share_searched(searched: Mapping[int, float], takes: pl.DataFrame) -> float:
    """The share of all frames, over all templates, that curves were computed in."""
    frames = dict(takes.select("take_id", "frames").iter_rows())
    total = sum(frames.values())
    return sum(searched[take_id] * length for take_id, length in frames.items()) / total if total else 0.0
