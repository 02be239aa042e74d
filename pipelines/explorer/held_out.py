"""The effect of editing a template on takes that it was not learned from.

`POST /api/templates/effect` {stage, kind, template, weights?: {feature: factor}, first?, stop?, tau?, truth?, compete?,
 everything?}
→ {class, with: [name], method, truth: {source, stage, takes, seconds, segments, all_takes, all_seconds, among_examples,
   sources}, tau, pipeline_tau, best: {learned, edited}, rows: [row], wrong, missed, remarks, missing, seconds, command,
   python, pipeline}. `first` and `stop` are the columns that are kept. A row is {template: "learned" or "edited",
 threshold: "pipeline", "used" or "best", tau, p1, r1, f1, p2, r2, f2 and the counts}; `best` has the τ that divides
 the training clips best, with its F, for each of the two templates. `wrong` and `missed` are segments of the last
 template at the τ that is used: {total, segments: [hit]}. `missing` is a sentence where no take is held out, and there
 are no rows then. Without `everything` more than an hour of takes is judged by some of them, drawn at random; `truth`
 has the numbers of both. `pipeline` is the command that runs the pipeline again with the edited template.

The class is annotated as `method: thesis` does it (τ, minima of distance curves, segments that grow), by its own
templates alone, or with `compete` by the templates of all classes, of which the nearest has a frame. Keyframe queries
of the pipeline are not used.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from kinedex.catalog.classes import Classes, MotionClass
from kinedex.catalog.features import load_feature_set
from kinedex.ops.annotation.calibration import best_threshold
from kinedex.ops.annotation.segments import Segment
from kinedex.ops.evaluation.metrics import Counts, compare, pooled
from kinedex.ops.templates.templates import Learned, Template
from kinedex.ops.words import TakeWords, bits
from kinedex.pipelines.annotation.annotators import make_annotator
from kinedex.pipelines.annotation.batches import annotate_words
from kinedex.pipelines.annotation.methods import ThesisMethod
from kinedex.pipelines.annotation.parameters import least_frames
from kinedex.pipelines.evaluation.annotation_scores import scores
from kinedex.pipelines.explorer.addresses import post
from kinedex.pipelines.explorer.held_out_truth import HeldOut, held_out_takes
from kinedex.pipelines.explorer.remembered_matches import MatchMemory, RememberingThesisMethod
from kinedex.pipelines.explorer.template_edits import Edit, EditQuestion, edited_template, is_edited, same_edit
from kinedex.pipelines.explorer.template_use import TemplateUse, template_use
from kinedex.pipelines.explorer.templates import named
from kinedex.pipelines.templates.learning import SubclassTemplate
from kinedex.pipelines.templates.stored_clips import StoredClip, stored_clips, template_costs
from kinedex.storage.store.store import Store

if TYPE_CHECKING:
    from starlette.requests import Request

    from kinedex.pipelines.explorer.archive import Archive

Row = dict[str, Any]
F64 = npt.NDArray[np.float64]

MOST_SEGMENTS = 24
"""Most segments of a list; its total counts all of them."""

KEPT = 2
"""So many templates at most keep the words of their held-out takes in memory, between two edits."""


@dataclass
class Prepared:
    """All that does not change while a template is edited.

    Attributes
    ----------
    use : TemplateUse
        The templates of the stage.
    one : SubclassTemplate
        The template as it was learned.
    label : str
        Its class.
    others : tuple of SubclassTemplate
        The other templates of the class.
    held_out : HeldOut
        The takes to judge by.
    words : TakeWords, optional
        Their words; None where there are none.
    own : bool array (C,)
        The clips of the class among the training clips of all classes.
    clips : list of StoredClip
        The training clips.
    other_costs : float64 array (C,)
        Their least distance to the other templates of the class.
    best : (float, float), optional
        The threshold that divides the training clips best by the learned template, and its F.
    counts : dict of (float, bool) to Counts
        The counts of the learned template for some thresholds, with and without the other classes.
    memory : MatchMemory
        The matches of templates in the words, those of other classes among them.
    """

    use: TemplateUse
    one: SubclassTemplate
    label: str
    others: tuple[SubclassTemplate, ...]
    held_out: HeldOut
    words: TakeWords | None
    clips: list[StoredClip]
    own: npt.NDArray[np.bool_]
    other_costs: F64
    best: tuple[float, float] | None = None
    counts: dict[tuple[float, bool], Counts] = field(default_factory=dict)

    memory: MatchMemory = field(default_factory=MatchMemory)

    @property
    def tau(self) -> float:
        """The threshold of the class in the pipeline."""
        return self.use.tau(self.label)


class PreparedTemplates:
    """The templates that are being edited, the least recently used are forgotten. Several threads may use it."""

    def __init__(self) -> None:
        self._held: OrderedDict[tuple[object, ...], Prepared] = OrderedDict()
        self._lock = Lock()

    def prepared(self, archive: Archive, store: Store, asked: EditQuestion) -> Prepared:
        """Return what is needed to judge edits of a template."""
        labels = archive.state()["labels"]
        which = (asked.stage, asked.kind, asked.template, asked.truth, asked.everything)
        key = (str(archive.path), store.manifest.version, labels, *which)
        with self._lock:
            if key not in self._held:
                self._held[key] = _prepare(store, asked)
            self._held.move_to_end(key)
            while len(self._held) > KEPT:
                self._held.popitem(last=False)
            return self._held[key]


PREPARED = PreparedTemplates()


def _prepare(store: Store, asked: EditQuestion) -> Prepared:
    use = template_use(store, asked.stage, asked.kind)
    one = named(use, asked.template)
    label = use.class_of(one.subclass)
    every = use.class_templates(label)
    others = tuple(other for other in every if other.subclass != one.subclass)
    held_out = held_out_takes(store, use, label, every, asked.truth, everything=asked.everything)
    by_template = [(each, stored_clips(store, each)) for each in use.templates]
    clips = [clip for _, own in by_template for clip in own]
    mine = [use.class_of(each.subclass) == label for each, own in by_template for _ in own]
    costs = template_costs(others, clips, use.params.delta) if others and clips else np.empty((0, len(clips)))
    prepared = Prepared(
        use,
        one,
        label,
        others,
        held_out,
        store.words(sorted(held_out.takes)) if held_out.takes else None,
        clips,
        np.array(mine, np.bool_),
        costs.min(axis=0, initial=np.inf),
    )
    prepared.best = _best(prepared, one)
    return prepared


def _best(prepared: Prepared, one: SubclassTemplate) -> tuple[float, float] | None:
    """Return the τ that divides the clips of the class from those of all others best, and its F."""
    if not prepared.clips:
        return None
    costs = np.minimum(template_costs([one], prepared.clips, prepared.use.params.delta)[0], prepared.other_costs)
    own, rest = costs[prepared.own], costs[~prepared.own]
    if not np.isfinite(own).any():
        return None
    tau, score = best_threshold(own, rest)
    return min(max(tau, 1e-6), 1.0), score


def annotate_class(
    store: Store, prepared: Prepared, one: SubclassTemplate, tau: float, compete: bool
) -> list[tuple[Segment, ...]]:
    """Return the segments of a class in each held-out take.

    Parameters
    ----------
    store : Store
        The store.
    prepared : Prepared
        The template as it was learned, its class, and the words.
    one : SubclassTemplate
        The template, edited or not.
    tau : float
        The threshold of the class.
    compete : bool
        True where the templates of all classes annotate, of which the nearest has a frame; False where those of the
        class do so alone.
    """
    assert prepared.words is not None
    use, label = prepared.use, prepared.label
    every, classes = (prepared.one, *prepared.others), own_class(prepared)
    if compete and label in use.classes.names:
        every, classes = use.templates, use.classes
    annotator = make_annotator(
        store.feature_set,
        [one if each.subclass == one.subclass else each for each in every],
        classes,
        use.params.delta,
        {name: use.tau(name) for name in classes.names} | {label: tau},
        min_frames=least_frames(use.params.min_seconds, store.rate_hz),
    )
    method = annotator.method
    assert isinstance(method, ThesisMethod)
    kept = RememberingThesisMethod(method.templates, method.class_index, method.thresholds, prepared.memory)
    annotator = replace(annotator, method=kept)
    place = annotator.classes.index(label)
    return [
        tuple(segment for segment in each.segments if segment.class_index == place)
        for each in annotate_words(annotator, prepared.words)
    ]


def own_class(prepared: Prepared) -> Classes:
    """Return the class of a template without all others."""
    names = tuple(each.subclass for each in (prepared.one, *prepared.others))
    return Classes((MotionClass(prepared.label, "", names),))


def show_effect(archive: Archive, asked: EditQuestion, _request: Request) -> Row:
    """Return how well a class is found in held-out takes, by the template as it was learned and as it is edited."""
    begin = time.perf_counter()
    store = archive.store()
    prepared = PREPARED.prepared(archive, store, asked)
    one, use, held_out = prepared.one, prepared.use, prepared.held_out
    changed = is_edited(one, asked)
    edit = Edit(edited_template(store, one, asked) if changed else one, changed, prepared.tau, asked.tau)
    best = {"learned": prepared.best, "edited": _best(prepared, edit.one) if changed else prepared.best}
    answer: Row = {
        "class": prepared.label,
        "with": [other.subclass for other in prepared.others],
        "method": use.params.method,
        "truth": {
            "source": held_out.source,
            "stage": use.evaluate if held_out.source == "evaluation" else None,
            "takes": len(held_out.takes),
            "seconds": sum(store.take_frames[take] for take in held_out.takes) / store.rate_hz,
            "segments": sum(map(len, held_out.takes.values())),
            "all_takes": len(held_out.every),
            "all_seconds": sum(store.take_frames[take] for take in held_out.every) / store.rate_hz,
            "among_examples": held_out.among_examples,
            "sources": list(held_out.sources),
        },
        "tau": edit.tau,
        "pipeline_tau": prepared.tau,
        "best": {name: None if found is None else {"tau": found[0], "f": found[1]} for name, found in best.items()},
        "rows": [],
        "wrong": {"total": 0, "segments": []},
        "missed": {"total": 0, "segments": []},
        "remarks": [*use.remarks, *held_out.remarks],
        "missing": held_out.missing,
        **same_edit(archive, use, one, edit),
    }
    if prepared.words is not None:
        answer |= _judged(store, prepared, edit, asked.compete, None if best["edited"] is None else best["edited"][0])
    return {**answer, "seconds": time.perf_counter() - begin}


def _judged(store: Store, prepared: Prepared, edit: Edit, compete: bool, best: float | None) -> Row:
    """Return the rows of the template before and after an edit, and what it finds in vain and misses after it."""
    wanted = [("learned", "pipeline", prepared.tau), ("learned", "best", prepared.best and prepared.best[0])]
    if edit.template or edit.tau != prepared.tau:
        wanted.append(("edited", "used", edit.tau))
    if edit.template:
        wanted.append(("edited", "best", best))
    current = annotate_class(store, prepared, edit.one, edit.tau, compete)
    edited = {edit.tau: _counts(prepared, current)}
    if not edit.template:
        prepared.counts[edit.tau, compete] = edited[edit.tau]
    rows = []
    for name, threshold, tau in wanted:
        if tau is None:
            continue
        if name == "learned" and (tau, compete) not in prepared.counts:
            found = annotate_class(store, prepared, prepared.one, tau, compete)
            prepared.counts[tau, compete] = _counts(prepared, found)
        if name == "edited" and tau not in edited:
            edited[tau] = _counts(prepared, annotate_class(store, prepared, edit.one, tau, compete))
        own = prepared.counts[tau, compete] if name == "learned" else edited[tau]
        rows.append({"template": name, "threshold": threshold, "tau": tau, **scores(own)})
    return {"rows": rows, **_mistakes(store, prepared, current)}


def _counts(prepared: Prepared, found: Sequence[tuple[Segment, ...]]) -> Counts:
    assert prepared.words is not None
    takes = prepared.words.take_ids.tolist()
    return pooled(
        compare([(one.start, one.stop) for one in own], prepared.held_out.takes[take])
        for take, own in zip(takes, found, strict=True)
    )


def _mistakes(store: Store, prepared: Prepared, found: Sequence[tuple[Segment, ...]]) -> Row:
    """Return the segments that overlap no true one, the surest first, and the true ones that nothing overlaps."""
    assert prepared.words is not None
    names = {take_id: name for name, take_id in store.take_ids.items()}
    wrong, missed = [], []
    for take, own in zip(prepared.words.take_ids.tolist(), found, strict=True):
        true = prepared.held_out.takes[take]
        at = {"take_id": take, "take": names[take], "mirrored": False, "name": prepared.label}
        wrong += [
            {**at, "start": one.start, "stop": one.stop, "cost": one.cost}
            for one in own
            if not any(one.start < stop and start < one.stop for start, stop in true)
        ]
        missed += [
            {**at, "start": start, "stop": stop, "cost": None}
            for start, stop in true
            if not any(one.start < stop and start < one.stop for one in own)
        ]
    wrong.sort(key=lambda row: (row["cost"], row["take"], row["start"]))
    return {
        name: {"total": len(rows), "segments": rows[:MOST_SEGMENTS]}
        for name, rows in (("wrong", wrong), ("missed", missed))
    }


def warm_up() -> None:
    """Load the kernels of an annotation by annotating a few words, so that the first edit does not wait for them."""
    words = TakeWords(np.zeros(1, np.int64), np.array([0, 400], np.int64), np.arange(400, dtype=np.uint64) % 7)
    features = load_feature_set("body40")
    template = Template(bits(words.words[:30], len(features.features)).astype(np.float64), np.ones(30))
    one = SubclassTemplate("warm", "soft", Learned(template, 0, ()), ())
    classes = Classes((MotionClass("warm", "", ("warm",)),))
    annotate_words(make_annotator(features, [one], classes, 0.05, 0.1), words)


routes = [
    post("/api/templates/effect", show_effect, EditQuestion),
]
