"""From the best individuals of many runs to one query: the keyframes that recur most (thesis, 4.4 and Figure 4.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import ParameterError
from kinedex.ops.keyframes.genetic_algorithm import rank_bound, tune_gaps
from kinedex.ops.keyframes.individuals import Individual
from kinedex.ops.keyframes.training_task import EvolutionSettings, LearningRun, TrainingTask
from kinedex.ops.words import bits

F64 = npt.NDArray[np.float64]

AtLeast = Literal["median", "best"]

AGREEMENTS = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
"""Shares of the keyframes at a place that may have to fix an entry for it to be fixed; each is tried, and the fittest
consensus is taken. The thesis does not say how many runs have to agree."""


@dataclass(frozen=True)
class Consensus:
    """What the runs agree on.

    origin: "consensus", or "best run" where the consensus was less fit than the median run, or than the best. query,
    fitness and rank: of that origin. agreement: the share of keyframes that had to agree on an entry; 0 for a run.
    median, best: the rank of the median run and of the best one. matrix: float64 (N, f), see `agreement_matrix`.
    """

    origin: Literal["consensus", "best run"]
    query: Individual
    fitness: float
    rank: float
    agreement: float
    median: float
    best: float
    matrix: F64


def agreement_matrix(queries: Sequence[Individual], columns: int, features: int) -> F64:
    """Add up the keyframes of many queries at their template columns (thesis, Figure 4.2 a).

    Returns
    -------
    float64 (N, f): the mean over the queries of what they fix an entry to; a wildcard counts one half, and so does a
    column in which a query has no keyframe.
    """
    total = np.full((columns, features), 0.5 * len(queries))
    for query in queries:
        fixed, ones = bits(query.masks, features), bits(query.values, features)
        np.add.at(total, query.positions, np.where(fixed == 1, ones - 0.5, 0.0))
    return np.clip(total / max(len(queries), 1), 0.0, 1.0)


def recurring_keyframes(
    queries: Sequence[Individual], agreement: float, reach: int, features: int
) -> Individual | None:
    """Extract the keyframes that recur most (thesis, Figure 4.2 b).

    Parameters
    ----------
    queries: the best individuals of the runs.
    agreement: the share of keyframes at a place that must fix an entry to the same value for it to be fixed.
    reach: how many columns two keyframes may lie apart and still count as the same.

    Returns
    -------
    As many keyframes as the queries have in the median, or fewer where they have no more places or agree on nothing, in
    the order of their median columns; gaps reach from none to twice the spacing. None where they agree on nothing.
    """
    positions = np.concatenate([query.positions for query in queries])
    masks = np.concatenate([query.masks for query in queries])
    values = np.concatenate([query.values for query in queries])
    wanted = int(np.median([len(query) for query in queries]))
    free = np.ones(len(positions), np.bool_)
    found: list[tuple[float, int, int]] = []
    while free.any() and len(found) < wanted:
        near = np.abs(positions[:, None] - positions[None, :]) <= reach
        votes = (near & free[None, :]).sum(axis=1) * free
        # of equally crowded places the leftmost
        centre = min(np.flatnonzero(votes == votes.max()), key=lambda i: int(positions[i]))
        group = near[centre] & free
        free &= ~group
        mask, value = _majority(masks[group], values[group], agreement, features)
        if mask:
            found.append((float(np.median(positions[group])), mask, value))
    return _spaced(found) if found else None


def _majority(
    masks: npt.NDArray[np.uint64], values: npt.NDArray[np.uint64], share: float, features: int
) -> tuple[int, int]:
    fixed, ones = bits(masks, features), bits(values, features)
    on = ones.sum(axis=0)
    off = (fixed - ones).sum(axis=0)
    enough = np.maximum(on, off) >= share * len(masks) - 1e-9
    decided = enough & (on != off)
    mask = sum(1 << int(f) for f in np.flatnonzero(decided))
    return mask, sum(1 << int(f) for f in np.flatnonzero(decided & (on > off)))


def _spaced(found: Sequence[tuple[float, int, int]]) -> Individual:
    ordered = sorted(found)
    positions = np.array([round(place) for place, _, _ in ordered], np.int64)
    spacing = np.diff(positions)
    return Individual(
        np.array([mask for _, mask, _ in ordered], np.uint64),
        np.array([value for _, _, value in ordered], np.uint64),
        positions,
        np.zeros_like(spacing),
        2 * spacing,
    )


def find_consensus(
    material: TrainingTask,
    runs: Sequence[LearningRun],
    evolution: EvolutionSettings,
    reach: int,
    seed: int | tuple[int, ...],
    at_least: AtLeast = "median",
    agreements: Sequence[float] = AGREEMENTS,
) -> Consensus:
    """Make one query of many runs: what recurs most, with gaps tuned by the same mutations.

    Parameters
    ----------
    material, evolution: of the runs. runs: one or more.
    reach: see `recurring_keyframes`. seed: of the mutations. at_least: the consensus has to rank as high as this run.
    agreements: see `AGREEMENTS`.

    Returns
    -------
    The consensus, or, where it ranks lower than that, the best run; of equal ones the first. So the outcome never ranks
    lower than the median run; its fitness alone, without costs, can be.
    """
    if not runs:
        raise ParameterError("runs", "at least one", 0)
    features = len(material.frames.on)
    ranks = np.array([run.rank for run in runs])
    best = runs[int(np.argmax(ranks))]
    median = float(np.median(ranks))
    matrix = agreement_matrix([run.query for run in runs], len(material.masks), features)
    wanted = best.rank if at_least == "best" else median
    tuned: tuple[float, LearningRun] | None = None
    tried: set[tuple[bytes, ...]] = set()
    for agreement in agreements:
        query = recurring_keyframes([run.query for run in runs], agreement, reach, features)
        if query is None or query.key() in tried:
            continue
        tried.add(query.key())
        # what gaps can make of it at most is not enough, so they are not tuned
        most = rank_bound(material, query, evolution) + 1e-9
        if most < wanted or (tuned is not None and most <= tuned[1].rank):
            continue
        run = tune_gaps(material, query, evolution, seed)
        if tuned is None or run.rank > tuned[1].rank:
            tuned = agreement, run
    if tuned is None or tuned[1].rank < wanted:
        return Consensus("best run", best.query, best.fitness, best.rank, 0.0, median, best.rank, matrix)
    agreement, run = tuned
    return Consensus("consensus", run.query, run.fitness, run.rank, agreement, median, best.rank, matrix)
