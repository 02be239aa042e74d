"""Calibrate the thresholds of classes by cross-validation over actors."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinedex.catalog.classes import Classes
from kinedex.ops.annotation.calibration import best_threshold
from kinedex.ops.arrays import F64
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.errors import KinedexError
from kinedex.ops.templates.derived_templates import restricted_template
from kinedex.ops.templates.templates import quantise
from kinedex.ops.wording import name_list
from kinedex.pipelines.annotation.batches import split_takes
from kinedex.pipelines.engine.executors import Executor
from kinedex.pipelines.templates.examples import Rejected
from kinedex.pipelines.templates.template_learning import SubclassTemplate, TrainingClips

HIGHEST = 1.0
"""The largest threshold, a distance that no warping path exceeds."""

_NO_COSTS = (
    "they have no clips",
    "their clips are of one actor",
    "no clip of theirs fits a template of other actors' clips",
)
"""The reasons why the clips of a class have no costs for its own templates, for 0, 1 and more actors."""

Learn = Callable[[Sequence[TrainingClips]], list[SubclassTemplate]]
"""A function that makes all templates of an archive from its clips, including those from files and combinations."""


@dataclass(frozen=True)
class Calibration:
    """The calibrated thresholds of classes, the F-measure that each reaches on the clips, and remarks."""

    taus: dict[str, float]
    scores: dict[str, float]
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class Fold:
    """One fold, as a task: an actor's clips and rejected intervals, and templates of the other actors' clips."""

    templates: tuple[SubclassTemplate, ...]
    clips: tuple[TrainingClips, ...]
    delta: float
    rejected: tuple[Rejected, ...] = ()


def calibrate(
    clips: Sequence[TrainingClips],
    actors: Mapping[str, str | None],
    classes: Classes,
    delta: float,
    learn: Learn,
    executor: Executor,
    rejected: Sequence[Rejected] = (),
) -> Calibration:
    """Choose for each class the threshold of the highest F-measure, on clips of actors that were held out of learning.

    The clips of one actor at a time are matched with templates learned from the clips of the other actors. The cost of
    a clip for a template is the smallest distance within the clip; the cost for a class is the smallest one over the
    templates of the class. The costs over all actors determine the threshold
    (`ops.annotation.calibration.best_threshold`).

    Parameters
    ----------
    clips : sequence of TrainingClips
        The training clips by subclass.
    actors : mapping of str to str
        The actor of each take by its name; clips without an actor count as clips of one more actor.
    classes : Classes
        The classes of the subclasses.
    delta : float
        Entries of a template within delta of 0 or 1 count, the others are wildcards.
    learn : callable
        Learns templates from clips; called once for each actor.
    executor : Executor
        The workers.
    rejected : sequence of Rejected, optional
        Intervals that a person has rejected for a class. For this class, the costs of an interval count like those of
        clips of other classes; for other classes, the interval does not count.

    Returns
    -------
    Calibration
        Thresholds of those classes that have templates. A class without clips, with clips of one actor, or with clips
        that match nothing gets the threshold that is best over all classes; `remarks` name such classes.

    Raises
    ------
    KinedexError
        The clips are of fewer than two actors, or match no template.
    """
    known = sorted({actors.get(take) or "" for one in clips for take in one.of_takes})
    if len(known) < 2:
        raise KinedexError(
            f"`tau: calibrated` leaves one actor out at a time, but all training clips are of {known[0] or 'no actor'}"
            if known
            else "`tau: calibrated` needs training clips"
        )
    folds = []
    for actor in known:
        names = {take for one in clips for take in one.of_takes if (actors.get(take) or "") == actor}
        theirs = [part for one in clips if (part := one.only(names)).names]
        rest = [part for one in clips if (part := one.without(names)).names]
        refused = tuple(one for one in rejected if (actors.get(one.take) or "") == actor)
        folds.append(Fold(tuple(learn(rest)), tuple(theirs), delta, refused))
    strangers = tuple(one for one in rejected if (actors.get(one.take) or "") not in known)
    if strangers:
        folds.append(Fold(tuple(learn(clips)), (), delta, strangers))
    return _calibration([*zip(folds, executor.map(fold_costs, folds), strict=True)], classes)


def fold_costs(fold: Fold) -> F64:
    """Compute the costs of clips and rejected intervals for each template, in a worker.

    The array is float64 (templates, clips and intervals), with intervals after clips. An entry is ∞ if the template
    does not match or is not applied.
    """
    words = [*(one for clips in fold.clips for one in clips.words), *(one.words for one in fold.rejected)]
    known = [*(clips.known for clips in fold.clips for _ in clips.words), *(one.known for one in fold.rejected)]
    templates = [quantise(one.learned.template, fold.delta) for one in fold.templates]
    costs = np.full((len(templates), len(words)), np.inf)
    for mask in sorted(set(known)):
        places = [place for place, one in enumerate(known) if one == mask]
        restricted = [restricted_template(one, mask) for one in templates]
        rows = [row for row, one in enumerate(restricted) if one is not None]
        applied = [one for one in restricted if one is not None]
        for batch in split_takes(places, (len(words[place]) for place in places)) if applied else ():
            edges = np.cumsum([0, *(len(words[clip]) for clip in batch)]).astype(np.int64)
            ranges = np.stack([edges[:-1], edges[1:]], axis=1)
            curves = distance_curves(applied, np.concatenate([words[clip] for clip in batch]), ranges)
            costs[np.ix_(rows, batch)] = np.minimum.reduceat(curves, edges[:-1], axis=1)
    # templates without fixed entries match anything, and are excluded from annotation
    costs[[not one.fixed for one in templates]] = np.inf
    return costs


def _calibration(found: Iterable[tuple[Fold, F64]], classes: Classes) -> Calibration:
    of_subclass = classes.of_subclass()
    own: dict[str, list[float]] = {}
    others: dict[str, list[float]] = {}
    actors: dict[str | None, set[int]] = defaultdict(set)
    for number, (fold, costs) in enumerate(found):
        truth = [of_subclass.get(one.subclass) for one in fold.clips for _ in one.names]
        for label in truth:
            actors[label].add(number)
        labels = [of_subclass.get(one.subclass) for one in fold.templates]
        refused = [_class_of_rejected(one, classes) for one in fold.rejected]
        for name in sorted({label for label in labels if label is not None}):
            least = costs[[label == name for label in labels]].min(axis=0).tolist()
            for label, cost in zip(truth, least[: len(truth)], strict=True):
                (own if label == name else others).setdefault(name, []).append(cost)
            for label, cost in zip(refused, least[len(truth) :], strict=True):
                if label == name:
                    others.setdefault(name, []).append(cost)
    every = [np.array([cost for costs in side.values() for cost in costs]) for side in (own, others)]
    if not np.isfinite(every[0]).any():
        raise KinedexError("`tau: calibrated`: no clip fits a template of its class that other actors' clips made")
    common, _ = best_threshold(*every)
    taus, scores, bare = {}, {}, defaultdict(list)
    for name in classes.names:
        if name not in own and name not in others:  # a class without templates labels nothing
            continue
        mine = np.array(own.get(name, ()))
        if np.isfinite(mine).any():
            tau, scores[name] = best_threshold(mine, np.array(others.get(name, ())))
        else:
            tau = common
            bare[_NO_COSTS[min(len(actors[name]), 2)]].append(name)
        taus[name] = min(tau, HIGHEST)
    remarks = [f"τ of all classes together ({common:.3g}), as {why}: {name_list(names)}" for why, names in bare.items()]
    return Calibration(taus, scores, tuple(remarks))


def _class_of_rejected(one: Rejected, classes: Classes) -> str | None:
    """Return the class that a rejected interval does not show; None if it was rejected for one subclass only."""
    if one.label in classes.names:
        return one.label
    found = next((each for each in classes.classes if one.label in each.subclasses), None)
    return found.name if found is not None and len(found.subclasses) == 1 else None
