"""This module combines runs of the learner into a query of their recurring keyframes (thesis, 4.4 and Figure 4.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinedex.ops.arrays import F64, U64
from kinedex.ops.errors import ParameterError
from kinedex.ops.keyframes.genetic_algorithm import rank_bound, tune_gaps
from kinedex.ops.keyframes.training_task import EvolutionSettings, Individual, LearningRun, TrainingTask
from kinedex.ops.words import bits

AtLeast = Literal["median", "best"]

AGREEMENTS = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
"""Fractions of the keyframes at a template column that must fix an entry for the consensus to fix it. The thesis does
not specify the fraction, so each is tried, and the consensus of the highest rank is used.
"""


@dataclass(frozen=True)
class Consensus:
    """The query on which many runs agree, or the best run.

    Parameters
    ----------
    origin : {"consensus", "best run"}
        "best run" if the consensus ranked lower than the median run, or than the best run if that was required, or if
        the runs agree on no keyframe.
    query : Individual
        The consensus, or the query of the best run.
    fitness, rank : float
        The fitness and the rank of the query.
    agreement : float
        The fraction of keyframes that had to agree on an entry; 0 for the best run.
    median, best : float
        The ranks of the median run and of the best run.
    matrix : float64 array (N, f)
        See `agreement_matrix`.
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
    """Return the mean of many queries' keyframes at each template column (thesis, Figure 4.2 a).

    Parameters
    ----------
    queries : sequence of Individual
        The best individuals of the runs.
    columns, features : int
        The numbers of columns N and of features f of the template.

    Returns
    -------
    float64 array (N, f)
        The mean over the queries of the values to which they fix an entry. A wildcard counts as one half, as do all
        entries of a column in which a query has no keyframe.
    """
    total = np.full((columns, features), 0.5 * len(queries))
    for query in queries:
        fixed, ones = bits(query.masks, features), bits(query.values, features)
        np.add.at(total, query.positions, np.where(fixed == 1, ones - 0.5, 0.0))
    return np.clip(total / max(len(queries), 1), 0.0, 1.0)


def recurring_keyframes(
    queries: Sequence[Individual], agreement: float, tolerance: int, features: int
) -> Individual | None:
    """Return a query of the most frequent keyframes of several runs (thesis, Figure 4.2 b).

    Parameters
    ----------
    queries : sequence of Individual
        The best individuals of the runs.
    agreement : float
        The fraction of the keyframes at a column that must fix an entry to the same value for it to be fixed.
    tolerance : int
        The largest distance in columns of two keyframes that count as the same.
    features : int
        The number of features f.

    Returns
    -------
    Individual or None
        A query with the median number of keyframes of the queries, or fewer if the queries do not agree on so many. Its
        keyframes are ordered by their median columns, and its gaps range from 0 to twice the spacing of the columns.
        None if the queries agree on no keyframe.
    """
    positions = np.concatenate([query.positions for query in queries])
    masks = np.concatenate([query.masks for query in queries])
    values = np.concatenate([query.values for query in queries])
    wanted = int(np.median([len(query) for query in queries]))
    free = np.ones(len(positions), np.bool_)
    found: list[tuple[float, int, int]] = []
    while free.any() and len(found) < wanted:
        near = np.abs(positions[:, None] - positions[None, :]) <= tolerance
        votes = (near & free[None, :]).sum(axis=1) * free
        # of equally frequent columns, the leftmost is taken
        centre = min(np.flatnonzero(votes == votes.max()), key=lambda i: int(positions[i]))
        group = near[centre] & free
        free &= ~group
        mask, value = _majority(masks[group], values[group], agreement, features)
        if mask:
            found.append((float(np.median(positions[group])), mask, value))
    return _spaced(found) if found else None


def _majority(masks: U64, values: U64, share: float, features: int) -> tuple[int, int]:
    """Return mask and value of the entries that a majority of the keyframes, at least a fraction, fixes alike."""
    fixed, ones = bits(masks, features), bits(values, features)
    on = ones.sum(axis=0)
    off = (fixed - ones).sum(axis=0)
    enough = np.maximum(on, off) >= share * len(masks) - 1e-9
    decided = enough & (on != off)
    mask = sum(1 << int(f) for f in np.flatnonzero(decided))
    return mask, sum(1 << int(f) for f in np.flatnonzero(decided & (on > off)))


def _spaced(found: Sequence[tuple[float, int, int]]) -> Individual:
    """Return a query of keyframes (column, mask, value), with gaps up to twice the spacing of the columns."""
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
    task: TrainingTask,
    runs: Sequence[LearningRun],
    settings: EvolutionSettings,
    tolerance: int,
    seed: int | tuple[int, ...],
    at_least: AtLeast = "median",
) -> Consensus:
    """Combine many runs into one query of the recurring keyframes, with gaps tuned by mutations.

    Parameters
    ----------
    task, settings
        The task and the settings of the runs.
    runs : sequence of LearningRun
        One run or more.
    tolerance : int
        See `recurring_keyframes`.
    seed : int or tuple of int
        The seed of the mutations.
    at_least : {"median", "best"}
        The run below which the consensus must not rank.

    Returns
    -------
    Consensus
        The consensus, or the best run if the consensus ranks below the run of `at_least` or does not exist; of equally
        good runs the first. The result never ranks below the median run, but its fitness, which ignores costs, may be
        lower.

    Raises
    ------
    ParameterError
        If there is no run.
    """
    if not runs:
        raise ParameterError("runs", "at least one", 0)
    features = len(task.frames.on)
    ranks = np.array([run.rank for run in runs])
    best = runs[int(np.argmax(ranks))]
    median = float(np.median(ranks))
    matrix = agreement_matrix([run.query for run in runs], len(task.masks), features)
    wanted = best.rank if at_least == "best" else median
    tuned: tuple[float, LearningRun] | None = None
    tried: set[tuple[bytes, ...]] = set()
    for agreement in AGREEMENTS:
        query = recurring_keyframes([run.query for run in runs], agreement, tolerance, features)
        if query is None or query.key() in tried:
            continue
        tried.add(query.key())
        # gaps are only tuned where they could raise the rank far enough
        most = rank_bound(task, query, settings) + 1e-9
        if most < wanted or (tuned is not None and most <= tuned[1].rank):
            continue
        run = tune_gaps(task, query, settings, seed)
        if tuned is None or run.rank > tuned[1].rank:
            tuned = agreement, run
    if tuned is None or tuned[1].rank < wanted:
        return Consensus("best run", best.query, best.fitness, best.rank, 0.0, median, best.rank, matrix)
    agreement, run = tuned
    return Consensus("consensus", run.query, run.fitness, run.rank, agreement, median, best.rank, matrix)
