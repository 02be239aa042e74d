"""All that does not change while a template is edited: held-out takes with their words, and training clips."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from kinedex.catalog.classes import Classes, MotionClass
from kinedex.explorer.class_annotation import PipelineMaterial, word_batches
from kinedex.explorer.held_out_truth import HeldOut, held_out_takes
from kinedex.explorer.template_edits import EditQuestion
from kinedex.explorer.template_use import TemplateUse, template_use
from kinedex.explorer.templates import named
from kinedex.ops.annotation.calibration import best_threshold
from kinedex.ops.evaluation.metrics import Counts
from kinedex.ops.words import TakeWords
from kinedex.pipelines.templates.learning import SubclassTemplate
from kinedex.pipelines.templates.stored_clips import StoredClip, stored_clips, template_costs
from kinedex.storage.store.store import Store

if TYPE_CHECKING:
    from kinedex.explorer.archive import Archive

F64 = npt.NDArray[np.float64]

KEPT = 2
"""Maximum number of templates whose held-out takes' words are kept in memory between two edits."""


@dataclass(frozen=True)
class TrainingCosts:
    """The training clips of all classes, and what they cost for the templates of one class.

    Attributes
    ----------
    clips : list of StoredClip
        The C clips.
    own : bool array (C,)
        True for the clips of the class.
    others : float64 array (C,)
        Their least distance to the templates of the class besides the one that is edited.
    delta : float
        Entries of a template within delta of 0 or 1 count.
    actors : int
        The number of actors of the clips; those without one count as one more.
    """

    clips: list[StoredClip]
    own: npt.NDArray[np.bool_]
    others: F64
    delta: float
    actors: int

    def of(self, one: SubclassTemplate) -> tuple[F64, F64] | None:
        """Return the smallest distance of the class's templates in its own clips and in all others.

        Parameters
        ----------
        one : SubclassTemplate
            The template before the edit.

        Returns
        -------
        (float64 array, float64 array) or None
            ∞ where nothing fits; None where no clip of the class is left, or none fits.
        """
        if not self.own.any():
            return None
        costs = np.minimum(template_costs([one], self.clips, self.delta)[0], self.others)
        own, rest = costs[self.own], costs[~self.own]
        return (own, rest) if np.isfinite(own).any() else None


@dataclass
class Prepared:
    """All that does not change while a template is edited.

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
    held_out : HeldOut
        The takes to judge by.
    batches : list of TakeWords
        Their words, in the order of their ids.
    training : TrainingCosts
        The training clips.
    material : PipelineMaterial
        What the pipeline annotates with besides templates.
    counts : dict of (float or None, bool) to Counts
        The counts of the learned template for some thresholds, with and without the other classes.
    """

    store: Store
    use: TemplateUse
    one: SubclassTemplate
    label: str
    others: tuple[SubclassTemplate, ...]
    held_out: HeldOut
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


class PreparedTemplates:
    """An LRU cache of the templates that are being edited. Several threads may use it."""

    def __init__(self) -> None:
        self._held: OrderedDict[tuple[object, ...], Prepared] = OrderedDict()
        self._lock = Lock()

    def prepared(self, archive: Archive, store: Store, asked: EditQuestion) -> Prepared:
        """Return the data for judging edits of a template: ground truth, words and costs; cached for later requests."""
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


def _prepare(store: Store, asked: EditQuestion) -> Prepared:
    use = template_use(store, asked.stage, asked.kind)
    one = named(use, asked.template)
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
