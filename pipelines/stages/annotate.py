"""Stage annotate: compute distance curves and label segments of takes, optionally preselected by keyframe queries."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import chain
from typing import Any, ClassVar

import polars as pl
import pyarrow as pa
import pyarrow.compute as pc

from kinedex.catalog.classes import Classes, class_files
from kinedex.catalog.plugins import Plugins
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.catalog.queries.query_reader import query_file_paths
from kinedex.ops.wording import counted, name_list
from kinedex.pipelines.annotation.annotation_setup import (
    Preparation,
    annotation_classes,
    archive_material,
    learned_queries,
    own_thresholds,
    queries_of,
    takes_to_annotate,
    template_learner,
)
from kinedex.pipelines.annotation.annotation_tables import annotations_table, curves_table, takes_table
from kinedex.pipelines.annotation.annotators import Annotator, unknown_targets
from kinedex.pipelines.annotation.batches import annotate_stored
from kinedex.pipelines.annotation.confidence_calibration import CalibratedConfidence
from kinedex.pipelines.annotation.earlier_annotations import (
    earlier_annotations,
    fingerprints,
    setting_digest,
    with_confidence,
)
from kinedex.pipelines.annotation.methods import METHODS
from kinedex.pipelines.annotation.parameters import AnnotationParameters
from kinedex.pipelines.annotation.single_examples import earlier_ranges, ranges_table
from kinedex.pipelines.annotation.threshold_calibration import Calibration
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import files_digest
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.keyframes.applicability import known_masks, not_applied_table
from kinedex.pipelines.templates.examples import rejected_examples
from kinedex.pipelines.templates.template_learning import SubclassTemplate, read_templates
from kinedex.pipelines.templates.training import TemplateParameters, training_material
from kinedex.storage.store.store import Store
from kinedex.storage.store.writer import StoreWriter


class Annotate(Stage[AnnotationParameters]):
    """Computes distance curves and labels segments of takes, optionally preselected by keyframe queries."""

    name = "annotate"
    parameters = AnnotationParameters
    inputs: ClassVar = {
        "takes": Input("ingest", optional=True),
        "templates": Input("learn_templates"),
        "keyframes": Input("learn_keyframes", optional=True),
    }
    commits_once: ClassVar = True

    def external_digest(self, params: AnnotationParameters, store: Store | None) -> str:
        """Return a hash of the class file and the query files."""
        return files_digest([*query_file_paths(params.query_files), *class_files(params.classes)])

    def named_parts(self, params: AnnotationParameters) -> Sequence[tuple[Plugins[Any], str]]:
        """Return the annotation method."""
        return [(METHODS, params.method)]

    def run(self, context: StageContext, params: AnnotationParameters) -> dict[str, object]:
        """Annotate and store the results."""
        with context.writer() as writer:
            store = writer.store
            takes = takes_to_annotate(store, params.where)
            templates = read_templates(store, context.key(context.inputs["templates"]), params.templates)
            classes = annotation_classes(store, params.classes, templates)
            queries, keyframes = queries_of(store, params), context.inputs.get("keyframes")
            learned = learned_queries(store, context.key(keyframes)) if keyframes is not None else []
            annotator, calibration, confidence = _prepared(
                context, store, params, templates, classes, queries, learned, takes
            )
            known = known_masks(store.known, takes["take_id"].to_list())
            remarks = [*annotator.remarks, *calibration.remarks, *params.without_effect(), *annotator.remarks_on(known)]
            context.message(*remarks)
            context.message(confidence.remark)
            _report_exclusions(context, classes, annotator, queries, learned)
            done = _annotate(context, writer, annotator, takes, params)
            writer.forget_stage(context.key())
            writer.commit()
        share = _share_searched(done.searched, takes)
        matched = "labels could be" if annotator.method.needs.templates == "none" else "templates were matched"
        context.message(
            f"{counted(done.segments, 'segment')} in {counted(takes.height, 'take')}"
            + (f"; {matched} in {share:.1%} of the frames" if any(annotator.queries) else "")
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
            "tau_by_class": _rounded(own_thresholds(params, calibration, annotator)),
            "calibration_f": _rounded(calibration.scores),
            "confidence_segments": confidence.segments,
            "confidence_right": confidence.right,
            "remarks": remarks,
        }


def _prepared(
    context: StageContext,
    store: Store,
    params: AnnotationParameters,
    templates: Sequence[SubclassTemplate],
    classes: Classes,
    queries: Sequence[KeyframeQuery],
    learned: Sequence[KeyframeQuery],
    takes: pl.DataFrame,
) -> tuple[Annotator, Calibration, CalibratedConfidence]:
    """Return the annotator, and the thresholds and confidence that were calibrated for it."""
    made_with = context.params_of("templates", TemplateParameters)
    learned_of_clips = params.annotation_method.needs.templates == "learned"
    examples = cache(lambda: training_material(store, made_with).clips)
    rejected = [] if learned_of_clips else rejected_examples(store, made_with, of_any=True)
    material = archive_material(store, params, made_with, templates, examples, lambda: rejected)
    prepared = Preparation(store, params, classes, queries, learned)
    learn, executor = template_learner(store, params, made_with, context.executor), context.executor
    calibration = prepared.thresholds(examples, learn, executor, lambda: rejected_examples(store, made_with))
    annotator = prepared.annotator(templates, material, calibration)
    confidence = prepared.confidence(examples(), takes, calibration, learn, executor, material, rejected)
    return replace(annotator, confidence=confidence.confidence), calibration, confidence


def _rounded(values: Mapping[str, float]) -> dict[str, float]:
    return {name: round(float(value), 6) for name, value in values.items()}


@dataclass(frozen=True)
class Done:
    """The result of an annotation.

    Attributes
    ----------
    segments : int
        The number of segments.
    kept : int
        The number of takes whose earlier annotations were up to date.
    searched : dict of int to float
        The fraction of the frames of each take in which templates were matched, by take_id.
    """

    segments: int
    kept: int
    searched: dict[int, float]


def _annotate(
    context: StageContext, writer: StoreWriter, annotator: Annotator, takes: pl.DataFrame, params: AnnotationParameters
) -> Done:
    """Annotate the takes whose annotations are out of date, and store the annotations of all takes.

    Curves are written batch by batch, and curves that are up to date stay in their files. All segments are held in
    memory, about a hundred bytes each.
    """
    setting = setting_digest(annotator, params.store_curves, context.code)
    prints = fingerprints(writer.store, takes, setting) if context.code else {}
    kept = earlier_annotations(writer.store, context.key(), {} if context.anew else prints)
    new = takes.filter(~pl.col("take_id").is_in(list(kept.searched)))
    names = dict(takes.select("take_id", "name").iter_rows())
    lengths = dict(takes.select("take_id", "frames").iter_rows())
    segments = [with_confidence(kept.annotations(context.run), annotator, lengths)]
    searched = dict(kept.searched)
    known = kept.curve_parts()
    earlier = (
        earlier_ranges(writer.store, context.key())
        if context.code and params.annotation_method.offers.keeps_ranges
        else {}
    )
    promising = {take_id: earlier[take_id] for take_id in kept.searched if take_id in earlier}
    again = {} if context.anew else earlier

    def curves() -> Iterator[pa.Table]:
        yield from kept.curves(known.again, context.run)
        with context.progress("takes", new.height) as progress:
            for batch in annotate_stored(
                writer.store, annotator, new, context.executor, params.store_curves, context.code, again
            ):
                segments.append(annotations_table(batch, annotator, names, writer.store.rate_hz, context.run))
                searched.update((one.take_id, float(one.preselected.mean())) for one in batch)
                promising.update((one.take_id, one.promising) for one in batch if one.promising is not None)
                progress.advance(len(batch))
                yield curves_table(batch, annotator, names, context.run)

    put = partial(writer.put_results, stage=context.key(), run=context.run)
    put("distance_curves", chain(known.stay, curves()))
    table = pa.concat_tables(segments)
    table = table.take(pc.sort_indices(table, [("take", "ascending")]))  # stable: rows of a take keep their order
    put("annotations", table)
    put("example_ranges", ranges_table(sorted(promising.items()) if context.code else (), names, context.run))
    put("annotated_takes", takes_table(takes, context.run, searched, prints))
    lacking = known_masks(writer.store.known, names)
    put("not_applied", not_applied_table(annotator.partly_known(lacking), lacking, names, context.run))
    return Done(table.num_rows, len(kept.searched), searched)


def _report_exclusions(
    context: StageContext,
    classes: Classes,
    annotator: Annotator,
    queries: Sequence[KeyframeQuery],
    learned: Sequence[KeyframeQuery],
) -> None:
    if classes.without_class:
        context.message(f"in no class and not annotated: {name_list(classes.without_class)}")
    empty = [one.name for one in classes.classes if not set(one.subclasses) & set(annotator.subclasses)]
    if empty:
        what = "an example" if annotator.method.needs.templates == "none" else "a template"
        context.message(f"classes without {what}, which nothing can be labelled with: {name_list(empty)}")
    unknown = sorted({*unknown_targets(queries, classes), *unknown_targets(learned, classes)})
    if unknown:
        context.message(f"keyframe queries for other classes, excluded: {name_list(unknown)}")
    used = dict(zip(annotator.subclasses, map(set, annotator.queries), strict=True))
    both = [name for name, own in used.items() if own & set(queries) and own & set(learned)]
    if both:
        context.message(f"with queries of files and learned ones, matched within the hits of either: {name_list(both)}")
    without = [name for name, own in used.items() if not own]
    if (queries or learned) and without:
        context.message(f"without a keyframe query, matched in all frames: {name_list(without)}")


def _share_searched(searched: Mapping[int, float], takes: pl.DataFrame) -> float:
    """Return the fraction of frames that templates were matched in, over all takes and templates."""
    frames = dict(takes.select("take_id", "frames").iter_rows())
    total = sum(frames.values())
    return sum(searched[take_id] * length for take_id, length in frames.items()) / total if total else 0.0
