"""Thresholds of classes, calibrated on training clips: every actor's clips against templates of the others'."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.catalog.classes import Classes
from kinedex.ops.annotation.calibration import best_threshold
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.errors import KinedexError
from kinedex.ops.templates.templates import quantise
from kinedex.pipelines.annotation.batches import split_takes
from kinedex.pipelines.console.wording import few
from kinedex.pipelines.engine.executors import Executor
from kinedex.pipelines.templates.learning import SubclassTemplate, TrainingClips

F64 = npt.NDArray[np.float64]

HIGHEST = 1.0

_NO_COSTS = (
    "they have no clips",
    "their clips are of one actor",
    "no clip of theirs fits a template of other actors' clips",
)
"""Why nothing is known of how the clips of a class fit its own templates, by the number of their actors."""

Learn = Callable[[Sequence[TrainingClips]], list[SubclassTemplate]]
"""How templates are learned from clips: those of the stage `learn_templates`, files and combinations included."""


@dataclass(frozen=True)
class Calibration:
    """Thresholds of classes, how well each divides the clips it was chosen on (F), and what is to be said of them."""

    taus: dict[str, float]
    scores: dict[str, float]
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class Fold:
    """The clips of one actor, and templates that were learned without him: the task of one worker."""

    templates: tuple[SubclassTemplate, ...]
    clips: tuple[TrainingClips, ...]
    delta: float


def calibrate(
    clips: Sequence[TrainingClips],
    actors: Mapping[str, str | None],
    classes: Classes,
    delta: float,
    learn: Learn,
    executor: Executor,
) -> Calibration:
    """Choose τ_p of each class so that it divides clips of the class from others best (F), over actors left out.

    The clips of one actor at a time are matched with templates that were learned from the clips of the others: the
    least distance within a clip is its cost for a template; a class takes the least over its subclasses. The costs of
    all actors together decide (`ops.annotation.calibration.best_threshold`).

    Parameters
    ----------
    clips: the training clips by subclass. actors: take name → actor; clips of nobody known are those of one more actor.
    learn: learns templates from clips; called once for each actor.

    Returns
    -------
    Thresholds of those classes that have templates. A class without clips, with clips of one actor, or with clips that
    fit nothing gets the threshold that divides own from other clips best over all classes; `remarks` say so.

    Raises
    ------
    KinedexError: the clips are of fewer than two actors.
    """
    known = sorted({actors.get(name) or "" for one in clips for name in one.names})
    if len(known) < 2:
        raise KinedexError(
            f"`tau: calibrated` leaves one actor out at a time, but all training clips are of {known[0] or 'no actor'}"
            if known
            else "`tau: calibrated` needs training clips"
        )
    folds = []
    for actor in known:
        theirs = [part for one in clips if (part := _of(one, actors, actor, his=True)).names]
        rest = [part for one in clips if (part := _of(one, actors, actor, his=False)).names]
        folds.append(Fold(tuple(learn(rest)), tuple(theirs), delta))
    return _choose([*zip(folds, executor.map(fold_costs, folds), strict=True)], classes)


def _of(clips: TrainingClips, actors: Mapping[str, str | None], actor: str, *, his: bool) -> TrainingClips:
    """The clips of an actor, or those of all others."""
    kept = [index for index, name in enumerate(clips.names) if ((actors.get(name) or "") == actor) == his]
    return TrainingClips(
        clips.subclass, tuple(clips.names[index] for index in kept), tuple(clips.words[index] for index in kept)
    )


def fold_costs(fold: Fold) -> F64:
    """The cost of every clip for every template, float64 (templates, clips), ∞ where it does not fit (in a worker)."""
    words = [one for clips in fold.clips for one in clips.words]
    templates = [quantise(one.learned.template, fold.delta) for one in fold.templates]
    costs = np.full((len(templates), len(words)), np.inf)
    for batch in split_takes(range(len(words)), map(len, words)) if templates else ():
        edges = np.cumsum([0, *(len(words[clip]) for clip in batch)]).astype(np.int64)
        ranges = np.stack([edges[:-1], edges[1:]], axis=1)
        curves = distance_curves(templates, np.concatenate([words[clip] for clip in batch]), ranges)
        costs[:, batch] = np.minimum.reduceat(curves, edges[:-1], axis=1)
    # what is wildcards alone fits anything, and is left out of annotation
    costs[[not one.fixed for one in templates]] = np.inf
    return costs


def _choose(found: Iterable[tuple[Fold, F64]], classes: Classes) -> Calibration:
    of_subclass = classes.of_subclass()
    own: dict[str, list[float]] = {}
    others: dict[str, list[float]] = {}
    actors: dict[str | None, set[int]] = defaultdict(set)
    for number, (fold, costs) in enumerate(found):
        truth = [of_subclass.get(one.subclass) for one in fold.clips for _ in one.names]
        for label in truth:
            actors[label].add(number)
        labels = [of_subclass.get(one.subclass) for one in fold.templates]
        for name in sorted({label for label in labels if label is not None}):
            least = costs[[label == name for label in labels]].min(axis=0)
            for label, cost in zip(truth, least.tolist(), strict=True):
                (own if label == name else others).setdefault(name, []).append(cost)
    every = [np.array([cost for costs in side.values() for cost in costs]) for side in (own, others)]
    if not np.isfinite(every[0]).any():
        raise KinedexError("`tau: calibrated`: no clip fits a template of its class that other actors' clips made")
    common, _ = best_threshold(*every)
    taus, scores, bare = {}, {}, defaultdict(list)
    for name in classes.names:
        if name not in own and name not in others:  # without a template, nothing is labelled with it
            continue
        mine = np.array(own.get(name, ()))
        if np.isfinite(mine).any():
            tau, scores[name] = best_threshold(mine, np.array(others.get(name, ())))
        else:
            tau = common
            bare[_NO_COSTS[min(len(actors[name]), 2)]].append(name)
        taus[name] = min(tau, HIGHEST)
    remarks = [f"τ of all classes together ({common:.3g}), as {why}: {few(names)}" for why, names in bare.items()]
    return Calibration(taus, scores, tuple(remarks))
