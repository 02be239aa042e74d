"""Find how a pipeline uses the templates that one of its stages has learned: classes, δ, τ, evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pydantic import ValidationError

from kinedex.catalog.classes import OWN, Classes
from kinedex.ops.errors import KinedexError
from kinedex.ops.templates.templates import Kind
from kinedex.pipelines.annotation.parameters import DEFAULT_TAU, AnnotationParameters
from kinedex.pipelines.annotation.preparation import annotation_classes
from kinedex.pipelines.templates.subclass_template import SubclassTemplate, template_of
from kinedex.storage.snapshot.shown_results import all_parts, pipeline_of, shown_parts
from kinedex.storage.store.store import Store


@dataclass(frozen=True)
class TemplateUse:
    """The templates of a stage, and how its pipeline annotates with them.

    Attributes
    ----------
    stage : str
        The stage that learned the templates, "<pipeline>/<stage>".
    kind : {"soft", "hard"}
        The kind of the templates.
    templates : tuple of SubclassTemplate
        The templates of this kind, sorted by name.
    classes : Classes
        The classes that the pipeline annotates with; every template is a class of its own where it does not annotate.
    params : AnnotationParameters
        The parameters of its annotation; the defaults if it does not annotate.
    thresholds : dict of str to float
        τ of every class, whether set or calibrated.
    annotate, evaluate : str, optional
        The stages that annotate with these templates, and that have compared that with ground truth.
    keyframes : str, optional
        The stage that has learned keyframe queries for the annotation.
    remarks : tuple of str
        What could not be read.
    """

    stage: str
    kind: Kind
    templates: tuple[SubclassTemplate, ...]
    classes: Classes
    params: AnnotationParameters
    thresholds: dict[str, float]
    annotate: str | None
    evaluate: str | None
    keyframes: str | None = None
    remarks: tuple[str, ...] = ()

    @property
    def uses_thresholds(self) -> bool:
        """True where the pipeline's annotations depend on τ."""
        return self.params.annotation_method.uses_thresholds

    def template(self, name: str) -> SubclassTemplate:
        """Return the template of a name; a KinedexError where there is none."""
        for one in self.templates:
            if one.subclass == name:
                return one
        raise KinedexError(f"stage {self.stage} has no {self.kind} template of '{name}'")

    def class_of(self, name: str) -> str:
        """Return the class of a template, or the template's own name if the classes of the pipeline exclude it."""
        return self.classes.of_subclass().get(name, name)

    def class_templates(self, label: str) -> list[SubclassTemplate]:
        """Return the templates of a class."""
        return [one for one in self.templates if self.class_of(one.subclass) == label]

    def tau(self, label: str) -> float:
        """Return the threshold of a class."""
        return self.thresholds.get(label, self.params.common_tau)


def learning_stages(store: Store, kind: str) -> list[str]:
    """Return the stages with results of a kind, "templates" or "queries": those of the shown pipeline first."""
    shown = {part.stage for part in shown_parts(store.manifest, kind)}
    every = {part.stage for part in all_parts(store.manifest, kind)}
    return sorted(every, key=lambda stage: (stage not in shown, stage))


def template_use(store: Store, stage: str, kind: Kind | None = None) -> TemplateUse:
    """Return the templates of a stage, and how its pipeline annotates with them.

    Parameters
    ----------
    store : Store
        The store.
    stage : str
        The stage, "<pipeline>/<stage>".
    kind : {"soft", "hard"}, optional
        The kind of templates; by default the one that the pipeline annotates with, or the only one.

    Raises
    ------
    KinedexError
        The stage has no templates, or none of this kind.
    """
    rows = store.result("templates", stage=stage).to_pylist()
    if not rows:
        raise KinedexError(f"{store.path} has no templates of a stage '{stage}'")
    annotate = _reader(store, stage, "annotate", "templates")
    params, remarks = _parameters(store, annotate)
    has = {row["kind"] for row in rows}
    chosen: Kind = kind or (params.templates if params.templates in has else "soft" if "soft" in has else "hard")
    templates = tuple(sorted((template_of(row) for row in rows if row["kind"] == chosen), key=lambda one: one.subclass))
    if not templates:
        raise KinedexError(f"stage {stage} has no {chosen} templates (it has: {', '.join(sorted(has))})")
    classes, more = _classes(store, params, templates)
    thresholds = dict(params.tau_by_class)
    if annotate is not None:
        thresholds |= store.manifest.stages[annotate].summary.get("tau_by_class") or {}
    evaluate = None if annotate is None else _reader(store, annotate, "evaluate", "annotations")
    if evaluate is not None and not store.manifest.stages[evaluate].summary.get("evaluated_takes"):
        evaluate = None
    keyframes = None if annotate is None else _learned_queries(store, annotate)
    remarks = [*remarks, *more]
    return TemplateUse(
        stage, chosen, templates, classes, params, thresholds, annotate, evaluate, keyframes, tuple(remarks)
    )


def _learned_queries(store: Store, annotate: str) -> str | None:
    """Return the stage whose learned keyframe queries an annotation has used; None if it used none."""
    name = (store.manifest.stages[annotate].summary.get("inputs") or {}).get("keyframes")
    return None if name is None else f"{annotate.partition('/')[0]}/{name}"


def _reader(store: Store, stage: str, uses: str, role: str) -> str | None:
    """Return the last-run stage of kind `uses` whose input `role` is a stage of the same pipeline, or None."""
    pipeline, _, name = stage.partition("/")
    found = [
        record
        for key, record in store.manifest.stages.items()
        if pipeline_of(key) == pipeline
        and record.summary.get("uses") == uses
        and (record.summary.get("inputs") or {}).get(role) == name
    ]
    return max(found, key=lambda one: one.finished).stage if found else None


def _parameters(store: Store, annotate: str | None) -> tuple[AnnotationParameters, list[str]]:
    """Return the parameters of an annotation, the defaults if they cannot be read, and remarks."""
    usual = AnnotationParameters.model_validate({})
    if annotate is None:
        return usual, []
    try:
        return AnnotationParameters.model_validate(store.manifest.stages[annotate].summary.get("params") or {}), []
    except ValidationError:
        return usual, [
            f"the parameters of {annotate} are those of another version of kinedex; here δ = {usual.delta:g}, "
            f"τ = {DEFAULT_TAU:g}, and every template is a class of its own"
        ]


def _classes(
    store: Store, params: AnnotationParameters, templates: Sequence[SubclassTemplate]
) -> tuple[Classes, list[str]]:
    try:
        return annotation_classes(store, params.classes, templates), []
    except KinedexError as fault:
        text = f"every template is a class of its own here, as the class file cannot be read: {fault}"
        return annotation_classes(store, OWN, templates), [text]
