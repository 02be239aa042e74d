"""Stage compare_methods: several ways to annotate, on splits of the archive, side by side in one report."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import ClassVar, Literal, Self

import polars as pl
import pyarrow as pa
from pydantic import ConfigDict, Field, model_validator

from kinedex.catalog.classes import OWN, Classes, load_classes
from kinedex.catalog.configs import config_path
from kinedex.ops.errors import KinedexError
from kinedex.ops.evaluation.metrics import pooled
from kinedex.pipelines.console.wording import few
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import files_digest
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.evaluation.annotation_scores import Evaluation, Row, measures, metrics_rows
from kinedex.pipelines.evaluation.folds import Material, make_folds
from kinedex.pipelines.evaluation.grid import Cell, Found, cells_table, known_cells, remarks_of, run_cells
from kinedex.pipelines.evaluation.ground_truth import GroundTruth
from kinedex.pipelines.evaluation.label_files import NONE, GroundTruthParameters, ground_truth, ground_truth_digest
from kinedex.pipelines.evaluation.method_scores import Judgement, counts_of, fates, judge
from kinedex.pipelines.evaluation.preparation import Known, make_cell, said_of, with_templates
from kinedex.pipelines.evaluation.queries import QueryLearner
from kinedex.pipelines.evaluation.scheme import METRICS, Method, Metric, Split
from kinedex.pipelines.evaluation.study import SplitResult, Study, Threshold, content, shown_parts
from kinedex.pipelines.evaluation.tables import markdown, overview
from kinedex.pipelines.evaluation.test_takes import Fold
from kinedex.pipelines.keyframes.parameters import KeyframeParameters
from kinedex.pipelines.report.methods import methods_page
from kinedex.pipelines.report.motions import embed
from kinedex.pipelines.report.output import write_page
from kinedex.pipelines.templates.training import TemplateParameters, clips_to_learn_from, takes_to_learn_from
from kinedex.storage.snapshot.manifest import now
from kinedex.storage.store.store import Store


class Params(GroundTruthParameters):
    """What the stage `compare_methods` takes; templates are learned as `learn_templates` says, but for its takes."""

    model_config = ConfigDict(extra="forbid")

    title: str = Field("Methods compared", description="the title of the report")
    methods: list[Method] = Field(min_length=1, description="ways to annotate, each with a name")
    splits: list[Split] = Field(min_length=1, description="what is learned from, and what is annotated")
    classes: str = Field(OWN, description="'own': every subclass is a class; or a class file")
    divide_by: str = Field(
        "actor",
        description="the column of takes that Table 5.2 is divided by (in the metrics, scope 'group'); of clips laid "
        "end to end, those of one take have the same value",
    )
    taus: list[float] = Field(
        [],
        description="thresholds of the sweep (thesis, Figure 5.6), for all methods but those that τ does not matter to",
    )
    metrics: list[Metric] = Field(
        list(METRICS),
        description="what is reported: frames and segments (thesis, 5.4), overlap (mAP at IoU 0.1 to 0.7), boundaries, "
        "and joined: overlap and boundaries once more where touching segments of one class are one",
    )
    draws: int = Field(1000, ge=1, description="how often takes are drawn for the 95 % intervals")

    embed: Literal["auto", "all", "none"] | list[str] = Field(
        "auto",
        description="takes whose motion the page carries, so that a click on a segment shows it: auto (as many as keep "
        "the page below 20 MB), all that have a timeline, none, or a list of names",
    )

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        for what, names in (("methods", [m.name for m in self.methods]), ("splits", [s.name for s in self.splits])):
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise ValueError(f"{what}: two are named '{twice[0]}'")
        return self

    @property
    def distinct(self) -> list[Method]:
        """The methods, but those that are another one under a second name."""
        settings = [_setting(method) for method in self.methods]
        return [method for index, method in enumerate(self.methods) if settings[index] not in settings[:index]]

    @property
    def query_files(self) -> list[str]:
        """The query files of all methods, each once."""
        return list(dict.fromkeys(name for method in self.methods for name in method.query_files))


def _setting(method: Method) -> dict[str, object]:
    """What a method follows from."""
    fields = method.model_dump(exclude={"name", "queries"}) | {"queries": method.query_files}
    if method.method == "best":
        del fields["tau"], fields["tau_by_class"]
    return fields | {"learned": method.learned_queries}


class CompareMethods(Stage[Params]):
    """Several ways to annotate, on splits of the archive, side by side in one report."""

    name = "compare_methods"
    parameters = Params
    inputs: ClassVar = {"templates": Input("learn_templates"), "keyframes": Input("learn_keyframes", optional=True)}
    outputs = ("method_cells", "keyframe_runs", "metrics")

    def external_digest(self, params: Params, store: Store | None) -> str:
        """Return a hash of the class file, the query files and the ground truth."""
        files = [config_path("queries", name) for name in params.query_files]
        if params.classes != OWN:
            files.append(config_path("classes", params.classes))
        return files_digest(files) + ground_truth_digest(params, store)

    def run(self, context: StageContext, params: Params) -> dict[str, object]:
        """Compute the cells that are missing, judge all methods, and write the report."""
        store = context.open()
        same = [method.name for method in params.methods if method not in params.distinct]
        params = params.model_copy(update={"methods": params.distinct})
        known = _known(context, params, store)
        folds = {split.name: _folds(params, split, known) for split in params.splits}
        known = with_templates(context, params.methods, known, [fold for some in folds.values() for fold in some])
        remarks = [f"the same as a method before it, left out: {few(same)}"] if same else []
        remarks += said_of(params.methods, known)
        variants = [*params.methods, *_swept(params)]
        cells = {
            (fold.split, fold.name, method.name): make_cell(context, known, fold, method)
            for some in folds.values()
            for fold in some
            for method in variants
        }
        found = _run(context, list(cells.values()))
        splits = [_result(params, split, folds[split.name], cells, found, known.classes) for split in params.splits]
        study = _study(context, params, store, known.classes, splits, remarks)
        files = _write(context, params, study)
        context.terminal.show(overview(study))
        for remark in [*remarks, *_remarks(study)]:
            context.say(remark)
        context.say(f"report: {(context.store_path / files[0]).resolve()}")
        leading = study.splits[0].judgements[study.splits[0].leading].pooled
        return {
            "splits": len(splits),
            "methods": len(params.methods),
            "cells": len({cell.key for cell in cells.values()}),
            "leading": study.splits[0].leading,
            **measures(leading),
            "files": files,
        }


def _remarks(study: Study) -> list[str]:
    """The remarks of all splits, each once, with the splits that it is of where there are several."""
    found: dict[str, list[str]] = {}
    for result in study.splits:
        for remark in result.remarks:
            found.setdefault(remark, []).append(result.split.name)
    several = len(study.splits) > 1
    return [(f"{few(splits)}: " if several else "") + remark for remark, splits in found.items()]


def _known(context: StageContext, params: Params, store: Store) -> Known:
    learned_with = context.params_of("templates", TemplateParameters)
    labelled = set(store.takes()["class"].drop_nulls().unique())
    trained = {
        name for split in params.splits for name in store.takes(split.train)["class"].drop_nulls().unique().to_list()
    }
    made = set(learned_with.combine) | trained
    classes = load_classes(params.classes, made if params.classes == OWN else made | labelled)
    learner = None
    if any(method.learned_queries for method in params.methods):
        if "keyframes" not in context.inputs:
            names = few([method.name for method in params.methods if method.learned_queries])
            raise KinedexError(f"queries of {names} are to be learned, so the pipeline needs a stage 'learn_keyframes'")
        learner = QueryLearner(context, context.params_of("keyframes", KeyframeParameters))
    return Known(store, classes, learned_with, {}, learner)


def _folds(params: Params, split: Split, known: Known) -> list[Fold]:
    training_with = known.learned_with.model_copy(update={"where": split.train})
    training = takes_to_learn_from(known.store, training_with)
    clips = clips_to_learn_from(known.store, training_with, training)
    tested = known.store.takes(split.test)

    def place(takes: pl.DataFrame) -> GroundTruth:
        if params.ground_truth == NONE:
            raise KinedexError(
                f"split '{split.name}' has takes of its own, whose ground_truth must be given, not 'none'"
            )
        return ground_truth(known.store, params, takes, known.classes)

    material = Material(training, tuple(clips), tested, known.classes, place, params.divide_by)
    if params.divide_by not in tested.columns:
        raise KinedexError(f"divide_by: takes have no column '{params.divide_by}'")
    return make_folds(split, material)


def _swept(params: Params) -> list[Method]:
    """A method for each threshold and each kind of method that has one, the same kind once."""
    curves = {method.curve_name: method for method in params.methods if method.method == "thesis"}
    return [method.at(tau) for method in curves.values() for tau in params.taus]


def _run(context: StageContext, cells: Sequence[Cell]) -> dict[str, Found]:
    known = known_cells(context.open().result("method_cells", pipeline=context.pipeline))
    distinct = list({cell.key: cell for cell in cells}.values())

    def save(found: Mapping[str, Found]) -> None:
        with context.writer() as writer:
            table = cells_table(cells, found, context.run)
            writer.put_results("method_cells", table, stage=context.key(), run=context.run)
            writer.commit()

    already = sum(cell.key in known for cell in distinct)
    if already:
        context.say(f"{already} of {len(distinct)} cells are known")
    with context.progress("cells", len(distinct)) as progress:
        found = run_cells(distinct, context.store_path, context.executor, known, save, progress.advance)
    save(found)
    return found


def _result(
    params: Params,
    split: Split,
    folds: Sequence[Fold],
    cells: Mapping[tuple[str, str, str], Cell],
    found: Mapping[str, Found],
    classes: Classes,
) -> SplitResult:
    def outcome(method: Method) -> Found:
        keys = [cells[split.name, fold.name, method.name].key for fold in folds]
        return {name: segments for key in keys for name, segments in found[key].items()}

    exams = [exam for fold in folds for exam in fold.exams]
    outcomes = {method.name: outcome(method) for method in params.methods}
    judged: dict[str, Judgement] = {
        name: judge(one, exams, classes.names, params.draws) for name, one in outcomes.items()
    }
    sweep = [
        Threshold(
            method.curve_name, float(method.tau), pooled(counts_of(outcome(method), exams, classes.names).values())
        )
        for method in _swept(params)
    ]
    used = [cells[split.name, fold.name, method.name] for fold in folds for method in params.methods]
    labelled = {one.annotator.classes[index] for one in used for index in one.annotator.class_index.tolist()}
    lacking = sorted({label for exam in exams for label, _, _ in exam.truth} - labelled)
    notes = [f"without a template, so their segments cannot be found: {few(lacking)}"] if lacking else []
    notes += remarks_of(used)
    met = tuple(fates(outcomes, exams))
    return SplitResult(split, tuple(folds), dict(outcomes), judged, tuple(sweep), met, tuple(notes))


def _study(
    context: StageContext,
    params: Params,
    store: Store,
    classes: Classes,
    splits: Iterable[SplitResult],
    remarks: Sequence[str],
) -> Study:
    return Study(
        title=params.title,
        pipeline=context.pipeline,
        run=context.run,
        created=now(),
        store=str(context.store_path),
        archive=", ".join(sorted(store.takes()["source_root"].unique())),
        rate_hz=store.rate_hz,
        classes=classes.names,
        descriptions={one.name: one.description for one in classes.classes},
        group=params.divide_by,
        metrics=tuple(params.metrics),
        methods=tuple(params.methods),
        splits=tuple(splits),
        remarks=tuple(remarks),
    )


def _write(context: StageContext, params: Params, study: Study) -> list[str]:
    """Keep the metrics, write page, summary and JSON; their paths within the store, the page first."""
    with context.writer() as writer:
        tables = [
            metrics_rows(Evaluation(f"{result.split.name}: {name}", rows_of(judged, result.folds)), context.run)
            for result in study.splits
            for name, judged in result.judgements.items()
        ]
        writer.put_results("metrics", pa.concat_tables(tables), stage=context.key(), run=context.run)
        writer.commit()
    store = context.open()
    named = dict(store.takes().select("take_id", "name").iter_rows())
    shown = {title: [named[part] for part in parts] for title, parts in shown_parts(study).items()}
    motions = embed(store, shown, params.embed, context.stage)
    texts = {
        "methods.html": methods_page(study, motions),
        "methods.md": markdown(study),
        "methods.json": json.dumps(content(study), indent=1, ensure_ascii=False, allow_nan=False) + "\n",
    }
    files = []
    for name, text in texts.items():
        path = context.report_file(name)
        write_page(text, path)
        files.append(path.relative_to(context.store_path).as_posix())
    return files


def rows_of(judged: Judgement, folds: Sequence[Fold]) -> tuple[Row, ...]:
    """A judgement as lines of an evaluation; a group is of the takes that have the same value of `divide_by`."""
    by_fold = {fold.name: pooled(judged.by_take[exam.name] for exam in fold.exams) for fold in folds}
    return (
        Row("pooled", "all", judged.pooled),
        *(Row("fold", name, counts) for name, counts in by_fold.items() if len(by_fold) > 1),
        *(Row("group", name, counts) for name, counts in judged.by_group.items()),
        *(Row("class", name, counts) for name, counts in judged.by_class.items()),
        *(Row("take", name, counts) for name, counts in judged.by_take.items()),
    )
