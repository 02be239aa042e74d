"""Prepare the evaluation of a template on held-out takes: their ground truth and words, and the costs of clips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from threading import Lock
from typing import Literal

import numpy as np
import numpy.typing as npt

from kinedex.catalog.classes import Classes, MotionClass
from kinedex.explorer.class_annotation import PipelineMaterial, word_batches
from kinedex.explorer.open_archive import Archive
from kinedex.explorer.template_edits import EditRequest
from kinedex.explorer.templates import TemplateUse, template_named, template_use
from kinedex.ops.annotation.calibration import best_threshold
from kinedex.ops.arrays import F64
from kinedex.ops.cache import Cache
from kinedex.ops.evaluation.metrics import Counts
from kinedex.ops.intervals import in_seconds
from kinedex.ops.wording import counted, name_list
from kinedex.ops.words import TakeWords
from kinedex.pipelines.templates.examples import interval_of
from kinedex.pipelines.templates.stored_clips import StoredClip, stored_clips, template_costs
from kinedex.pipelines.templates.template_learning import SubclassTemplate
from kinedex.storage.snapshot.stored_labels import is_of_limbs
from kinedex.storage.store.store import Store

Source = Literal["evaluation", "labels"]

SOURCES: tuple[Source, ...] = ("evaluation", "labels")

MAX_SECONDS = 3600.0
"""Maximum number of seconds of held-out takes, in all, for an evaluation, unless all takes are asked for."""

Segments = dict[str, list[tuple[int, int]]]
"""A dict from take name to the segments [start, stop) of one class in it, in frames; an empty list if it has none."""


KEPT = 2
"""Maximum number of templates for which the words of held-out takes are cached between two edits."""

_PREPARING = Lock()
"""Held while the data of a template are read, so that further requests for them wait."""


@dataclass(frozen=True)
class HeldOutTakes:
    """The held-out takes that a template is evaluated on.

    Attributes
    ----------
    source : {"evaluation", "labels"}, optional
        The ground truth; None where the store has none.
    sources : tuple of str
        The kinds of ground truth that the store has.
    takes : dict of int to list of (int, int)
        The segments of the class in each take that is held out.
    every : tuple of int
        The ids of all takes that are held out; `takes` is a random part of them if all would take too long.
    among_examples : int
        The number of takes with ground truth that are excluded because they contain examples of the class.
    missing : str
        The reason why there is no held-out take, and what to do; empty if there are some.
    remarks : tuple of str
        Remarks on what was excluded, and on limits of the numbers.
    """

    source: Source | None
    sources: tuple[Source, ...]
    takes: dict[int, list[tuple[int, int]]]
    every: tuple[int, ...]
    among_examples: int
    missing: str = ""
    remarks: tuple[str, ...] = ()


def held_out_takes(
    store: Store,
    use: TemplateUse,
    label: str,
    templates: Sequence[SubclassTemplate],
    asked: Source | None = None,
    *,
    everything: bool = False,
) -> HeldOutTakes:
    """Return the takes with ground truth that contain no example of the class's templates.

    Parameters
    ----------
    store : Store
        The store.
    use : TemplateUse
        The stage that learned the templates, with the classes of its pipeline.
    label : str
        The class.
    templates : sequence of SubclassTemplate
        The templates of the class.
    asked : {"evaluation", "labels"}, optional
        The source of the ground truth; by default the evaluation if there is one, else labels.
    everything : bool, optional
        True for all takes; otherwise random ones with at most `MAX_SECONDS` in all.
    """
    found: dict[Source, tuple[Segments, list[str]]] = {}
    if use.evaluate is not None:
        found["evaluation"] = evaluated_segments(store, use.evaluate, label), []
    labelled = labelled_segments(store, use, label)
    if labelled[0]:
        found["labels"] = labelled
    sources = tuple(source for source in SOURCES if source in found)
    source = asked if asked in found else next(iter(sources), None)
    if source is None:
        return HeldOutTakes(None, (), {}, (), 0, _no_truth(use))
    known, remarks = found[source]
    examples = {interval_of(clip, store.take_ids)[0] for one in templates for clip in one.clips}
    unknown = [one.subclass for one in templates if not one.clips]
    if unknown:
        remarks = [
            *remarks,
            f"which takes these templates were made from is not known, as they are of files: {name_list(unknown)}",
        ]
    gone = sorted(set(known) - set(store.take_ids))
    if gone:
        remarks = [*remarks, f"takes with ground truth that the store has no more: {name_list(gone)}"]
    judged = {
        store.take_ids[take]: own for take, own in known.items() if take in store.take_ids and take not in examples
    }
    every = sorted(judged)
    takes = {take: judged[take] for take in (every if everything else sampled_takes(store, every))}
    among = sum(take in examples for take in known)
    missing = "" if takes else _all_examples(label, among)
    if takes and not any(takes.values()):
        remarks = [*remarks, f"none of these takes has a segment of {label}: recall is not defined, and F is no guide"]
    return HeldOutTakes(source, sources, takes, tuple(every), among, missing, tuple(remarks))


def sampled_takes(store: Store, takes: Sequence[int]) -> list[int]:
    """Return random takes of at most `MAX_SECONDS` in all, but at least one; the choice is the same each time."""
    order = np.random.default_rng(0).permutation(len(takes)).tolist()
    lengths = np.cumsum([in_seconds(store.take_frames[takes[place]], store.rate_hz) for place in order])
    count = max(1, int(np.searchsorted(lengths, MAX_SECONDS, side="right")))
    return [takes[place] for place in order[:count]]


def _no_truth(use: TemplateUse) -> str:
    return (
        "No take has ground truth. Label some takes in which the class occurs (page Label), or run a pipeline with "
        f"label files or classes to evaluate by: stage {use.stage} has no evaluation of its templates."
    )


def _all_examples(label: str, among: int) -> str:
    return (
        f"All {counted(among, 'take')} with ground truth are among the examples of {label}. Label further takes (page "
        "Label), or learn from a part of the takes, such as those of some actors: the setting `train` of a pipeline."
    )


def evaluated_segments(store: Store, stage: str, label: str) -> Segments:
    """Return the ground truth of a class that a stage has evaluated annotations with, in every evaluated take."""
    run = store.manifest.stages[stage].run
    metrics = store.result("metrics", run=run)
    judged = zip(metrics.column("scope").to_pylist(), metrics.column("name").to_pylist(), strict=True)
    found: Segments = {name: [] for scope, name in judged if scope == "take"}
    rows = store.result("ground_truth", run=run).select(["take", "class", "start", "stop"]).to_pylist()
    for row in rows:
        if row["class"] == label and row["take"] in found:
            found[row["take"]].append((row["start"], row["stop"]))
    return found


def labelled_segments(store: Store, use: TemplateUse, label: str) -> tuple[Segments, list[str]]:
    """Return the positive labels of a class in every take that has a label, and remarks on them."""
    found: Segments = {}
    beyond = []
    columns = ["take", "class", "start", "stop", "verdict", "limb"]
    for row in store.labels().select(columns).to_pylist():
        if is_of_limbs(row):
            continue
        own = found.setdefault(row["take"], [])
        if row["verdict"] != "positive" or (use.classes.class_of(row["class"]) or row["class"]) != label:
            continue
        frames = store.take_frames.get(store.take_ids.get(row["take"], -1))
        if frames is not None and row["stop"] > frames:
            beyond.append(f"{row['take']}[{row['start']}:{row['stop']}]")
            continue
        own.append((row["start"], row["stop"]))
    remarks = ["labels are taken as complete: what nobody has labelled in a take with labels counts as another motion"]
    if beyond:
        remarks.append(f"labels beyond the end of their take, excluded: {name_list(beyond)}")
    return found, remarks


@dataclass(frozen=True)
class TrainingCosts:
    """The training clips of all classes, and their distances to the templates of one class.

    Attributes
    ----------
    clips : list of StoredClip
        The C clips.
    own : bool array (C,)
        True for the clips of the class.
    others : float64 array (C,)
        The smallest distance of each clip to the templates of the class, except the edited one.
    delta : float
        Entries of a template within delta of 0 or 1 count.
    actors : int
        The number of actors of the clips; clips without an actor count as those of one more.
    """

    clips: list[StoredClip]
    own: npt.NDArray[np.bool_]
    others: F64
    delta: float
    actors: int

    def of(self, one: SubclassTemplate) -> tuple[F64, F64] | None:
        """Return the smallest distances to the templates of the class: of its own clips, and of all other clips.

        Parameters
        ----------
        one : SubclassTemplate
            The template, edited or not.

        Returns
        -------
        (float64 array, float64 array) or None
            ∞ where no template fits; None if the store has no clip of the class, or no template fits one.
        """
        if not self.own.any():
            return None
        costs = np.minimum(template_costs([one], self.clips, self.delta)[0], self.others)
        own, rest = costs[self.own], costs[~self.own]
        return (own, rest) if np.isfinite(own).any() else None


@dataclass
class Prepared:
    """The data for the evaluation of a template that do not change while it is edited.

    Attributes
    ----------
    store : Store
        The store.
    use : TemplateUse
        The templates of the stage.
    one : SubclassTemplate
        The template as it was learned.
    label : str
        Its class.
    others : tuple of SubclassTemplate
        The other templates of the class.
    held_out : HeldOutTakes
        The takes that the template is evaluated on.
    batches : list of TakeWords
        Their words, in the order of their ids.
    training : TrainingCosts
        The training clips.
    material : PipelineMaterial
        The inputs of the pipeline's annotation besides templates.
    counts : dict of (float or None, bool) to Counts
        The counts of the learned template for some thresholds, with and without the other classes.
    """

    store: Store
    use: TemplateUse
    one: SubclassTemplate
    label: str
    others: tuple[SubclassTemplate, ...]
    held_out: HeldOutTakes
    batches: list[TakeWords]
    training: TrainingCosts
    material: PipelineMaterial
    counts: dict[tuple[float | None, bool], Counts] = field(default_factory=dict)

    @property
    def tau(self) -> float:
        """The threshold of the class in the pipeline."""
        return self.use.tau(self.label)

    @property
    def takes(self) -> list[int]:
        """The ids of the held-out takes, in the order of their words."""
        return [take for batch in self.batches for take in batch.take_ids.tolist()]

    @property
    def own_class(self) -> Classes:
        """The class of the template, with its subclasses, as the only class."""
        names = tuple(each.subclass for each in (self.one, *self.others))
        return Classes((MotionClass(self.label, "", names),))


_PREPARED: Cache[tuple[object, ...], Prepared] = Cache(KEPT)


def prepared_template(archive: Archive, store: Store, asked: EditRequest) -> Prepared:
    """Return the data for evaluating edits of a template: ground truth, words and costs; cached for later requests."""
    which = (asked.stage, asked.kind, asked.template, asked.truth, asked.everything)
    key = (str(archive.path), store.manifest.version, archive.state()["labels"], *which)
    with _PREPARING:
        return _PREPARED.get(key) or _PREPARED.put(key, _prepare(store, asked))


def _prepare(store: Store, asked: EditRequest) -> Prepared:
    use = template_use(store, asked.stage, asked.kind)
    one = template_named(use, asked.template)
    label = use.class_of(one.subclass)
    every = use.class_templates(label)
    others = tuple(other for other in every if other.subclass != one.subclass)
    held_out = held_out_takes(store, use, label, every, asked.truth, everything=asked.everything)
    batches = word_batches(store, sorted(held_out.takes)) if held_out.takes else []
    training = training_costs(store, use, label, others)
    return Prepared(store, use, one, label, others, held_out, batches, training, PipelineMaterial(store, use))


def training_costs(
    store: Store, use: TemplateUse, label: str, others: Sequence[SubclassTemplate] = ()
) -> TrainingCosts:
    """Return the training clips of a stage with their costs for some templates of a class."""
    by_template = [(each, stored_clips(store, each)) for each in use.templates]
    clips = [clip for _, own in by_template for clip in own]
    mine = [use.class_of(each.subclass) == label for each, own in by_template for _ in own]
    costs = template_costs(others, clips, use.params.delta) if others and clips else np.empty((0, len(clips)))
    actor = dict(store.takes().select("name", "actor").iter_rows())
    actors = len({actor.get(clip.take) or "" for clip in clips})
    return TrainingCosts(clips, np.array(mine, np.bool_), costs.min(axis=0, initial=np.inf), use.params.delta, actors)


def dividing_threshold(costs: tuple[F64, F64] | None) -> tuple[float, float] | None:
    """Return the τ that best separates the clips of a class from all other clips, and its F; None without costs."""
    if costs is None:
        return None
    tau, score = best_threshold(*costs)
    return min(max(tau, 1e-6), 1.0), score
