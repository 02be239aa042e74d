"""The learned templates of a store: a list with pictures, a template with its clips, and the differences of two.

`GET /api/templates?stage=&kind=` → {stages: [name], stage, kind, kinds, templates: [row], delta, annotate, evaluate,
 method, remarks}; a row is {name, class, columns, seconds, clips, wildcards, origin, remarks, tau, picture}, where
 `tau` is null for a method without thresholds, and `picture` has a byte for each feature and column in base64: 200
 times the fraction of the clips in which the feature is on.

`GET /api/templates/one?stage=&kind=&template=` → {name, class, kind, stage, columns, seconds,
 values: [feature][column], weights: [feature] or null, consistency: [feature], clips: [clip], missing,
 far: {limit, median, spread} or null, poses, delta, tau, remarks, origin, heading}. A clip is {name, take, take_id,
 start, stop, mirrored, to_others, to_template, far, frames}: the median cost to the other clips
 (`Learned.clip_costs`), the smallest distance of the template within it, and for each column the frame that shows it.
 `poses` is the index of the clip that the template fits best.

`GET /api/templates/difference?stage=&kind=&template=&other=&other_stage=` → {first, second, columns: [[column of the
 first, of the second]], values: [feature][aligned column], the one minus the other, share, features: [{bit, name,
 difference, first, second, words}], summary}.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import ValidationError
from starlette.requests import Request

from kinedex.catalog.classes import OWN, Classes
from kinedex.explorer.answers import NotFoundError, command_line, python_lines
from kinedex.explorer.curves import kind_of
from kinedex.explorer.endpoints import get
from kinedex.explorer.open_archive import Archive
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.ops.intervals import in_seconds, shown_seconds
from kinedex.ops.templates.clip_checks import far_limit
from kinedex.ops.templates.derived_templates import Contrast, consistency, contrast
from kinedex.ops.templates.templates import Kind, Template, quantise
from kinedex.ops.wording import counted
from kinedex.pipelines.annotation.annotation_setup import annotation_classes
from kinedex.pipelines.annotation.parameters import DEFAULT_TAU, AnnotationParameters
from kinedex.pipelines.templates.stored_clips import StoredClip, poses_of_columns, stored_clips, template_costs
from kinedex.pipelines.templates.stored_templates import SubclassTemplate, template_of
from kinedex.reports.template_text import contrast_lines, template_heading
from kinedex.storage.snapshot.visible_results import all_parts, pipeline_of, shown_parts
from kinedex.storage.store.store import Store

Row = dict[str, Any]

LEVELS = 200
"""The value of a byte of a picture that represents 1."""


def list_templates(archive: Archive, request: Request) -> Row:
    """Return the templates of a stage with their pictures, and the stages that have templates."""
    store = archive.store()
    stages = learning_stages(store, "templates")
    same = {"command": command_line("kinedex", "template", "list", archive.path)}
    if not stages:
        return {"stages": [], "templates": [], "remarks": [], **same}
    use = use_of(store, request)
    if use.stage != stages[0]:
        same["command"] = command_line("kinedex", "template", "list", archive.path, "--stage", use.stage)
    return {
        "stages": stages,
        "stage": use.stage,
        "kind": use.kind,
        "kinds": sorted(set(store.result("templates", stage=use.stage).column("kind").to_pylist()), reverse=True),
        "templates": [_list_row(store, use, one) for one in use.templates],
        "delta": use.params.delta,
        "annotate": use.annotate,
        "evaluate": use.evaluate,
        "method": use.params.method,
        "remarks": list(use.remarks),
        **same,
        "python": python_lines(archive.path, f"store.templates(stage={use.stage!r})"),
    }


def use_of(store: Store, request: Request, name: str = "stage") -> TemplateUse:
    """Return the templates of the stage and of the kind that an address names."""
    asked = request.query_params
    stages = learning_stages(store, "templates")
    stage = asked.get(name) or next(iter(stages), "")
    if stage not in stages:
        raise NotFoundError(f"no stage '{stage}' has templates; those that have: {', '.join(stages) or 'none'}")
    return template_use(store, stage, kind_of(asked["kind"]) if "kind" in asked else None)


def _list_row(store: Store, use: TemplateUse, one: SubclassTemplate) -> Row:
    template = one.learned.template
    label = use.class_of(one.subclass)
    return {
        "name": one.subclass,
        "class": label,
        "columns": len(template),
        "seconds": in_seconds(len(template), store.rate_hz),
        "clips": len(one.clips),
        "wildcards": 1 - quantise(template, use.params.delta).fixed / template.values.shape[1],
        "origin": one.origin,
        "remarks": list(one.remarks),
        "tau": use.tau(label) if use.uses_thresholds else None,
        "picture": picture(template.values),
    }


def picture(values: npt.NDArray[np.float64]) -> str:
    """Return values of 0 to 1, (columns, features), as bytes in base64, feature by feature."""
    return base64.b64encode(np.rint(LEVELS * values.T).astype(np.uint8).tobytes()).decode("ascii")


def describe_template(archive: Archive, request: Request) -> Row:
    """Return a template with the clips that it was learned from."""
    store = archive.store()
    use = use_of(store, request)
    one = template_named(use, request.query_params.get("template", ""))
    template, label = one.learned.template, use.class_of(one.subclass)
    clips = clip_rows(store, use, one)
    shown = [row for row in clips if row["frames"] is not None]
    nearest = min(shown, key=lambda row: (_distance(row), row["to_others"] or 0.0), default=None)
    chosen = ["--kind", use.kind, "--stage", use.stage]
    line = f"store.template({one.subclass!r}, {use.kind!r}, stage={use.stage!r}).plot()"
    return {
        "name": one.subclass,
        "class": label,
        "kind": use.kind,
        "stage": use.stage,
        "columns": len(template),
        "seconds": in_seconds(len(template), store.rate_hz),
        "values": np.round(template.values.T, 3).tolist(),
        "weights": None if template.feature_weights is None else template.feature_weights.tolist(),
        "consistency": np.round(consistency(template), 3).tolist(),
        "clips": clips,
        "missing": len(one.clips) - len(clips),
        "far": _far(one),
        "poses": None if nearest is None else clips.index(nearest),
        "delta": use.params.delta,
        "tau": use.tau(label),
        "rounds": one.learned.rounds,
        "remarks": list(one.remarks),
        "origin": one.origin,
        "heading": template_heading(one, store.rate_hz).removeprefix(f"{one.subclass}, "),
        "command": command_line("kinedex", "template", "show", archive.path, one.subclass, *chosen),
        "python": python_lines(archive.path, line),
    }


def template_named(use: TemplateUse, name: str) -> SubclassTemplate:
    """Return a template by its name; raise a NotFoundError if the stage has none."""
    for one in use.templates:
        if one.subclass == name:
            return one
    raise NotFoundError(f"stage {use.stage} has no {use.kind} template of '{name}'; it may have been learned again")


def clip_rows(store: Store, use: TemplateUse, one: SubclassTemplate) -> list[Row]:
    """Return the clips that a template was learned from, by descending distance to the other clips."""
    clips = stored_clips(store, one)
    costs = template_costs([one], clips, use.params.delta)[0] if clips else np.empty(0)
    rows = [_clip_row(store, one, clip, float(cost)) for clip, cost in zip(clips, costs, strict=True)]
    return sorted(rows, key=lambda row: (-(row["to_others"] or 0.0), -_distance(row), row["name"]))


def _distance(row: Row) -> float:
    cost = row["to_template"]
    return float("inf") if cost is None else float(cost)


def _clip_row(store: Store, one: SubclassTemplate, clip: StoredClip, cost: float) -> Row:
    to_others, limit = one.learned.clip_costs, far_limit(one.learned.clip_costs)
    own = to_others[clip.place] if clip.place < len(to_others) else None
    return {
        "name": clip.name,
        "take": clip.take,
        "take_id": store.take_ids[clip.take],
        "start": clip.start,
        "stop": clip.stop,
        "mirrored": clip.mirrored,
        "to_others": own,
        "to_template": cost if np.isfinite(cost) else None,
        "far": own is not None and limit is not None and own >= limit,
        "frames": None if clip.mirrored else poses_of_columns(one.learned.template, clip).tolist(),
    }


def _far(one: SubclassTemplate) -> Row | None:
    """Return the limit above which a clip is far from the others, with median and spread; None without a limit."""
    costs = one.learned.clip_costs
    limit = far_limit(costs)
    if limit is None:
        return None
    median = float(np.median(costs))
    return {"limit": limit, "median": median, "spread": float(np.median(np.abs(np.asarray(costs) - median)))}


def describe_difference(archive: Archive, request: Request) -> Row:
    """Return the alignment of two templates, and the features that distinguish them."""
    store, asked = archive.store(), request.query_params
    use = use_of(store, request)
    other_use = use_of(store, request, "other_stage") if asked.get("other_stage") else use
    first, second = template_named(use, asked.get("template", "")), template_named(other_use, asked.get("other", ""))
    one, other = first.learned.template, second.learned.template
    if one.values.shape[1] != other.values.shape[1]:
        raise ParameterError("templates", "templates of the same features", [first.subclass, second.subclass])
    found = contrast(one, other, use.params.delta)
    values = one.values[found.path[:, 0]] - other.values[found.path[:, 1]]
    names = (first.subclass, second.subclass)
    if names[0] == names[1]:
        names = (f"{names[0]} ({use.stage})", f"{names[1]} ({other_use.stage})")
    compared = int(found.compared.sum())
    words = [first.subclass, second.subclass, "--kind", use.kind, "--stage", use.stage]
    command = command_line("kinedex", "template", "diff", archive.path, *words)
    stages = [f"store.template({name.subclass!r}, {use.kind!r}, stage={each.stage!r})"
              for name, each in ((first, use), (second, other_use))]  # fmt: skip
    return {
        "first": names[0],
        "second": names[1],
        "columns": found.path.tolist(),
        "values": np.round(values.T, 3).tolist(),
        "share": int(np.abs(found.against).sum()) / compared if compared else None,
        "features": _differences(store, names, (one, other), found, values),
        "summary": next(iter(contrast_lines(names, found, store.feature_set, store.rate_hz))),
        **({"command": command} if use.stage == other_use.stage else {}),
        "python": python_lines(archive.path, f"print({stages[0]}.diff({stages[1]}, delta={use.params.delta:g}))"),
    }


def _differences(
    store: Store,
    names: tuple[str, str],
    templates: tuple[Template, Template],
    found: Contrast,
    values: npt.NDArray[np.float64],
) -> list[Row]:
    """Return the features in the order of their mean difference along the path, each in words."""
    means = np.abs(values).mean(axis=0)
    rows = []
    for bit in np.argsort(-means, kind="stable").tolist():
        feature = store.feature_set.features[bit]
        shares = [float(one.values[found.path[:, side], bit].mean()) for side, one in enumerate(templates)]
        rows.append(
            {
                "bit": bit,
                "name": feature.name,
                "difference": float(means[bit]),
                "first": shares[0],
                "second": shares[1],
                "words": _in_words(feature.description, names, shares, found, bit, store.rate_hz),
            }
        )
    return rows


def _in_words(what: str, names: tuple[str, str], shares: list[float], found: Contrast, bit: int, rate_hz: float) -> str:
    """Return a sentence on one feature: where the two contradict each other, or how often it is on in each."""
    parts = []
    for side, sign in enumerate((1, -1)):
        chosen = found.path[found.against[:, bit] == sign]
        if len(chosen):
            ends = (int(chosen[:, side].min()), int(chosen[:, side].max()) + 1)
            start, stop = (shown_seconds(end, rate_hz) for end in ends)
            parts.append(
                f"on in {names[side]} and off in {names[1 - side]} in {counted(len(chosen), 'column')} "
                f"from {start} to {stop} s of {names[side]}"
            )
    text = "; ".join(parts) or f"on for {shares[0]:.0%} of {names[0]}, for {shares[1]:.0%} of {names[1]}"
    return f"{what}: {text}"


routes = [
    get("/api/templates", list_templates),
    get("/api/templates/one", describe_template),
    get("/api/templates/difference", describe_difference),
]


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
        The classes that the pipeline annotates with; if it does not annotate, every template is a class.
    params : AnnotationParameters
        The parameters of its annotation; the defaults if it does not annotate.
    thresholds : dict of str to float
        τ of every class, whether set or calibrated.
    annotate, evaluate : str, optional
        The stages that annotate with these templates, and that have compared the annotations with ground truth.
    keyframes : str, optional
        The stage that has learned keyframe queries for the annotation.
    remarks : tuple of str
        Remarks on parameters and classes that could not be read.
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
        return self.params.annotation_method.needs.thresholds

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
    inputs = {} if annotate is None else store.manifest.stages[annotate].summary.get("inputs") or {}
    keyframes = f"{pipeline_of(stage)}/{inputs['keyframes']}" if inputs.get("keyframes") is not None else None
    remarks = [*remarks, *more]
    return TemplateUse(
        stage, chosen, templates, classes, params, thresholds, annotate, evaluate, keyframes, tuple(remarks)
    )


def _reader(store: Store, stage: str, uses: str, role: str) -> str | None:
    """Return the last-run stage of kind `uses` that has a given stage as its input `role`; None if there is none."""
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
