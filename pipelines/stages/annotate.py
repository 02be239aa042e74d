"""Stage annotate: distance curves and labelled segments of takes, with preselection by keyframes where asked for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import numpy.typing as npt
import polars as pl
from pydantic import BaseModel, ConfigDict, Field

from catalog.classes import OWN, Classes, load_classes
from catalog.configs import config_path
from catalog.queries import KeyframeQuery
from catalog.queryfiles import read_queries
from ops.decoding import background
from ops.errors import KinedexError
from pipelines.annotating import (
    Annotator,
    TakeAnnotation,
    annotate_takes,
    annotations_table,
    curves_table,
    make_annotator,
    takes_table,
    targets_unknown,
)
from pipelines.context import StageContext
from pipelines.digests import files_digest
from pipelines.keyframe_learning import keyframe_queries
from pipelines.keyframe_runs import outcomes_of
from pipelines.learning import Kind, SubclassTemplate, read_templates, run_of
from pipelines.wording import few
from storage.store import Store

F64 = npt.NDArray[np.float64]


class Params(BaseModel):
    """What the stage `annotate` takes."""

    model_config = ConfigDict(extra="forbid")

    where: str = Field("class IS NULL", description="takes to annotate: a SQL filter over the columns of takes")
    method: Literal["thesis", "best"] = Field(
        "thesis",
        description="thesis: each frame gets the label of the nearest template, below tau; best: the templates in a "
        "row, with background between them, that explain all frames of a take best together (tau does not matter then)",
    )
    templates: Kind = Field("soft", description="which of the learned templates: soft or hard")
    delta: float = Field(
        0.05, ge=0, lt=0.5, description="template values within delta of 0 or 1 count, the rest are wildcards"
    )
    tau: float = Field(0.13, gt=0, le=1, description="distances below tau make an annotation")
    classes: str = Field(
        OWN, description="'own': every subclass is a class; or a class file, by its shipped name or its path"
    )
    queries: list[str] | str | None = Field(
        None, description="keyframe queries that preselect frames: files, by shipped names or paths; none: all frames"
    )
    store_curves: bool = Field(True, description="keep the distance curves, which the report draws")

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
        queries = [*queries_of(store, params), *learned_queries(context, store)]
        usual = usual_features(store, templates) if params.method == "best" else None
        annotator = make_annotator(store.feature_set, templates, classes, params.delta, params.tau, queries, usual)
        _say_what_is_left_out(context, classes, annotator, queries)
        found: list[TakeAnnotation] = []
        names = dict(takes.select("take_id", "name").iter_rows())
        batches = _batches(context, annotator, takes, params, found)
        curves = (curves_table(batch, annotator, names, context.run) for batch in batches)
        writer.put_results("distance_curves", curves, stage=context.key(), run=context.run)
        segments = annotations_table(found, annotator, names, store.rate_hz, context.run)
        writer.put_results("annotations", segments, stage=context.key(), run=context.run)
        writer.put_results("annotated_takes", takes_table(takes, context.run), stage=context.key(), run=context.run)
        writer.commit()
    searched = _share_searched(found, takes)
    context.say(
        f"{segments.num_rows} segments in {takes.height} takes"
        + (f"; templates were matched in {searched:.1%} of the frames" if any(annotator.queries) else "")
    )
    return {
        "takes": takes.height,
        "frames": int(takes["frames"].sum()),
        "classes": len(annotator.classes),
        "templates": len(annotator.templates),
        "segments": segments.num_rows,
        "searched": round(searched, 6),
        "method": params.method,
        "delta": params.delta,
        "tau": params.tau,
        "remarks": list(annotator.remarks),
    }


def _batches(
    context: StageContext, annotator: Annotator, takes: pl.DataFrame, params: Params, found: list[TakeAnnotation]
) -> Iterator[list[TakeAnnotation]]:
    """Annotate batch by batch: a batch comes with its curves, `found` keeps it without them."""
    with context.progress("takes", takes.height) as progress:
        for batch in annotate_takes(context.store_path, annotator, takes, context.executor, params.store_curves):
            found += [replace(one, curves=None) for one in batch]
            progress.advance(len(batch))
            yield batch


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
    """How often each feature is on in the clips that templates were learned from, or in all takes where they are of
    none."""
    clips = {name for one in templates for name in one.clips}
    takes = store.takes().filter(pl.col("name").is_in(clips))
    words = store.words(takes["take_id"].to_list() if takes.height else None)
    return background([words.words], len(store.feature_set.features))


def learned_queries(context: StageContext, store: Store) -> list[KeyframeQuery]:
    """The queries that the pipeline's stage `learn_keyframes` learned; none where it has no such stage."""
    if "keyframes" not in context.inputs:
        return []
    table = store.result("queries", run=run_of(store, context.key(context.inputs["keyframes"])))
    return [query for outcome in outcomes_of(table) for query in keyframe_queries(outcome, store.feature_set)]


def queries_of(store: Store, params: Params) -> list[KeyframeQuery]:
    """All queries of the query files."""
    queries: dict[str, KeyframeQuery] = {}
    for name in params.query_files:
        for query in read_queries(name, store.feature_set, store.rate_hz):
            if query.name in queries:
                raise KinedexError(f"two keyframe queries are named '{query.name}' (the second one in {name})")
            queries[query.name] = query
    return list(queries.values())


def _say_what_is_left_out(
    context: StageContext, classes: Classes, annotator: Annotator, queries: Sequence[KeyframeQuery]
) -> None:
    for remark in annotator.remarks:
        context.say(remark)
    if classes.without_class:
        context.say(f"in no class and not annotated: {few(classes.without_class)}")
    empty = [one.name for one in classes.classes if not set(one.subclasses) & set(annotator.subclasses)]
    if empty:
        context.say(f"classes without a template, which nothing can be labelled with: {few(empty)}")
    unknown = targets_unknown(queries, classes)
    if unknown:
        context.say(f"keyframe queries for other classes, left out: {few(unknown)}")
    without = [name for name, own in zip(annotator.subclasses, annotator.queries, strict=True) if not own]
    if queries and without:
        context.say(f"without a keyframe query, matched in all frames: {few(without)}")


def _share_searched(found: Sequence[TakeAnnotation], takes: pl.DataFrame) -> float:
    """The share of all frames, over all templates, that curves were computed in."""
    frames = dict(takes.select("take_id", "frames").iter_rows())
    total = sum(frames.values())
    kept = sum(float(one.preselected.mean()) * frames[one.take_id] for one in found)
    return kept / total if total else 0.0
