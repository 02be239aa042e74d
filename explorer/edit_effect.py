"""The effect of editing a template on takes that it was not learned from.

`POST /api/templates/effect` {stage, kind, template, weights?: {feature: factor}, first?, stop?, tau?, truth?, compete?,
 everything?}
→ {class, with: [name], method, queries, uses_tau, truth: {source, stage, takes, seconds, segments, all_takes,
   all_seconds, among_examples, sources}, tau, pipeline_tau, training: {learned, edited}, advice, rows: [row], wrong,
   missed, remarks, missing, seconds, command, python, pipeline}. `first` and `stop` are the columns that are kept. A
 row is {template: "learned" or "edited", threshold: "pipeline", "used" or "best", tau, p1, r1, f1, p2, r2, f2 and the
 counts}; `training` has, for each of the two templates, how well thresholds divide the training clips: {taus, scores,
 tau, f}, F = scores[i] from taus[i] on, and `tau` with the best of them; `advice` is the setting that gives each class
 a threshold of its own, where that is far better than the threshold of the pipeline, or null. `wrong` and `missed` are
 segments of the last template at the τ that is used: {total, segments: [hit]}. `missing` is a sentence where no take
 is held out, and there are no rows then. Without `everything` at most an hour of takes, drawn at random, is evaluated;
 `truth` describes all held-out takes and the evaluated ones. `pipeline` is the command that runs the pipeline again
 with the edited template. A request that accepts application/x-ndjson gets lines with the progress first (`endpoints`).

The class is annotated as its pipeline does it, keyframe queries included (`class_annotation`): with `compete` by the
templates of all classes, otherwise by its own alone. Where the method has no thresholds, `uses_tau` is false, τ of rows
is null, and there are no rows for other thresholds.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from starlette.requests import Request

from kinedex.explorer.class_annotation import class_segments
from kinedex.explorer.endpoints import Progress, post_with_progress
from kinedex.explorer.held_out_truth import Prepared, dividing_threshold, prepared_template
from kinedex.explorer.hits import shown_hits
from kinedex.explorer.open_archive import Archive
from kinedex.explorer.template_edits import Edit, EditRequest, edited_template, equivalent_edit, is_edited
from kinedex.ops.annotation.calibration import threshold_scores
from kinedex.ops.annotation.segments import Segment
from kinedex.ops.arrays import F64
from kinedex.ops.evaluation.metrics import compare, pooled
from kinedex.ops.intervals import Hit, Interval, in_seconds
from kinedex.ops.wording import name_list
from kinedex.pipelines.annotation.parameters import CALIBRATED
from kinedex.pipelines.evaluation.annotation_scores import scores
from kinedex.pipelines.templates.template_learning import SubclassTemplate

Row = dict[str, Any]

MAX_SEGMENTS = 24
"""Maximum number of segments of a list; its total counts all of them."""

FAR_BETTER = 0.05
"""A gain in F of training clips that is worth a remark."""


def show_effect(archive: Archive, asked: EditRequest, _request: Request, progress: Progress) -> Row:
    """Return the scores of a class in held-out takes, for the learned and for the edited template."""
    begin = time.perf_counter()
    store = archive.store()
    prepared = prepared_template(archive, store, asked)
    one, use, held_out = prepared.one, prepared.use, prepared.held_out
    changed = is_edited(one, asked)
    tau = prepared.tau if asked.tau is None else asked.tau
    edit = Edit(edited_template(store, one, asked) if changed else one, changed, tau)
    learned = prepared.training.of(one)
    costs = {"learned": learned, "edited": prepared.training.of(edit.one) if changed else learned}
    training = {name: _divided(own) for name, own in costs.items()}
    answer: Row = {
        "class": prepared.label,
        "with": [other.subclass for other in prepared.others],
        "method": use.params.method,
        "queries": any(prepared.material.queries),
        "uses_tau": use.uses_thresholds,
        "truth": {
            "source": held_out.source,
            "stage": use.evaluate if held_out.source == "evaluation" else None,
            "takes": len(held_out.takes),
            "seconds": in_seconds(sum(map(store.take_frames.__getitem__, held_out.takes)), store.rate_hz),
            "segments": sum(map(len, held_out.takes.values())),
            "all_takes": len(held_out.every),
            "all_seconds": in_seconds(sum(map(store.take_frames.__getitem__, held_out.every)), store.rate_hz),
            "among_examples": held_out.among_examples,
            "sources": list(held_out.sources),
        },
        "tau": edit.tau,
        "pipeline_tau": prepared.tau,
        "training": training,
        "rows": [],
        "wrong": {"total": 0, "segments": []},
        "missed": {"total": 0, "segments": []},
        "remarks": [*use.remarks, *held_out.remarks, *_without_effect(prepared, asked)],
        "advice": _better_threshold(prepared, training["learned"]),
        "missing": held_out.missing,
        **equivalent_edit(archive, use, one, edit),
    }
    if prepared.batches:
        best = {name: None if own is None else own["tau"] for name, own in training.items()}
        answer |= _judged(prepared, edit, asked.compete, best, progress)
    return {**answer, "seconds": time.perf_counter() - begin}


def _divided(costs: tuple[F64, F64] | None) -> Row | None:
    """Return F as a function of the threshold that divides training clips of the class from others, or None.

    The result is None if the costs of the clips are not known.
    """
    best = dividing_threshold(costs)
    if costs is None or best is None:
        return None
    taus, found = threshold_scores(*costs)
    return {"taus": taus.tolist(), "scores": found.tolist(), "tau": best[0], "f": best[1]}


def _better_threshold(prepared: Prepared, found: Row | None) -> str | None:
    """Return the option `--set` that calibrates thresholds by class, if they divide the clips far better, or None."""
    use = prepared.use
    own = use.params.tau == CALIBRATED or prepared.label in use.params.tau_by_class
    if found is None or own or use.annotate is None or not use.uses_thresholds or prepared.training.actors < 2:
        return None
    below = int(np.searchsorted(found["taus"], prepared.tau))
    now = found["scores"][below - 1] if below else 0.0
    if found["f"] - now < FAR_BETTER:
        return None
    return f"--set {use.annotate.partition('/')[2]}.tau={CALIBRATED}"


def _without_effect(prepared: Prepared, asked: EditRequest) -> list[str]:
    """Return a remark on edits that the method of the pipeline ignores."""
    method = prepared.use.params.annotation_method
    if method.needs.templates == "none":
        return [f"the method {method.name} labels by examples, so that an edit of a template changes no label"]
    weights = sorted(name for name, weight in asked.weights.items() if weight not in (0, 1))
    if method.offers.feature_weights or not weights:
        return []
    return [
        f"the method {method.name} knows features that count, and such of weight 0 that do not: these count as "
        f"before: {name_list(weights)}"
    ]


def _judged(prepared: Prepared, edit: Edit, compete: bool, best: dict[str, float | None], progress: Progress) -> Row:
    """Return the rows of the template before and after an edit, and its false and missed segments after the edit."""
    used = edit.tau if prepared.use.uses_thresholds else None
    wanted = _wanted(prepared, edit, best)
    known = prepared.counts if not edit.template else {}
    counts = {"learned": prepared.counts, "edited": known}
    todo = {
        name: {row["tau"] for row in wanted if row["template"] == name and (row["tau"], compete) not in counts[name]}
        for name in counts
    }
    todo["edited" if edit.template else "learned"].add(used)
    if not edit.template:
        todo = {"learned": todo["learned"] | todo["edited"]}
    progress.start(sum(map(len, todo.values())) * len(prepared.batches))
    current: list[tuple[Segment, ...]] = []
    for name, taus in todo.items():
        one = edit.one if name == "edited" else prepared.one
        # matches below the highest threshold are also those below all others
        for tau in sorted(taus, key=lambda tau: -(tau or 0)):
            found = annotate_class(prepared, one, tau, compete, progress)
            counts[name][tau, compete] = pooled(
                compare([(one.start, one.stop) for one in own], prepared.held_out.takes[take])
                for take, own in zip(prepared.takes, found, strict=True)
            )
            if tau == used and (one is edit.one):
                current = found
    rows = [{**row, **scores(counts[row["template"]][row["tau"], compete])} for row in wanted]
    return {"rows": rows, **_mistakes(prepared, current)}


def _wanted(prepared: Prepared, edit: Edit, best: dict[str, float | None]) -> list[Row]:
    """Return the rows of the table without their scores; each has a template and a threshold, which may be None."""
    pairs: list[tuple[str, str, float | None]]
    if not prepared.use.uses_thresholds:
        pairs = [("learned", "pipeline", None), *([("edited", "used", None)] if edit.template else [])]
    else:
        rows = [("learned", "pipeline", prepared.tau), ("learned", "best", best["learned"])]
        rows += [("edited", "used", edit.tau)] if edit.template or edit.tau != prepared.tau else []
        rows += [("edited", "best", best["edited"])] if edit.template else []
        pairs = [row for row in rows if row[2] is not None]
    return [{"template": template, "threshold": threshold, "tau": tau} for template, threshold, tau in pairs]


def annotate_class(
    prepared: Prepared, one: SubclassTemplate, tau: float | None, compete: bool, progress: Progress
) -> list[tuple[Segment, ...]]:
    """Return the segments of a class in each held-out take.

    Parameters
    ----------
    prepared : Prepared
        The template as it was learned, its class, and the words.
    one : SubclassTemplate
        The template, edited or not.
    tau : float, optional
        The threshold of the class, if the method uses thresholds.
    compete : bool
        True if the templates of all classes annotate, False if only the templates of the class do.
    progress : Progress
        It advances by a step for each batch of takes.
    """
    use, label = prepared.use, prepared.label
    templates = [one if each.subclass == one.subclass else each for each in use.templates]
    classes = use.classes if compete and label in use.classes.names else prepared.own_class
    taus = {name: use.tau(name) for name in classes.names} | ({} if tau is None else {label: tau})
    annotator = prepared.material.annotator(templates, classes, taus)
    return class_segments(prepared.store, annotator, label, prepared.batches, progress.advance)


def _mistakes(prepared: Prepared, found: Sequence[tuple[Segment, ...]]) -> Row:
    """Return found segments that overlap no true one, by ascending cost, and true ones that overlap no found one."""
    store, label = prepared.store, prepared.label
    wrong, missed = [], []
    for take, own in zip(prepared.takes, found, strict=True):
        name = store.take_names[take]
        true = [Interval(name, start, stop) for start, stop in prepared.held_out.takes[take]]
        judged = [Hit(Interval(name, one.start, one.stop), label, one.cost) for one in own]
        wrong += [one for one in judged if not any(map(one.interval.overlaps, true))]
        missed += [Hit(one, label) for one in true if not any(one.overlaps(hit.interval) for hit in judged)]
    wrong.sort(key=lambda one: (one.cost or 0.0, one.interval))
    return {
        name: {"total": len(hits), "segments": shown_hits(store, hits[:MAX_SEGMENTS])}
        for name, hits in (("wrong", wrong), ("missed", missed))
    }


routes = [post_with_progress("/api/templates/effect", show_effect, EditRequest)]
