"""Render the page about learned keyframe queries: hits, stiffness, and convergence and agreement of learning runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import SAME_FRAME
from kinedex.ops.arrays import F64
from kinedex.ops.evaluation.reliability import wilson
from kinedex.ops.intervals import in_seconds
from kinedex.ops.keyframes.training_task import HISTORY_COLUMNS, Individual, LearningRun
from kinedex.ops.words import bits
from kinedex.pipelines.keyframes.query_learning import Learner, Outcome, every_query, keyframe_queries
from kinedex.pipelines.keyframes.stored_queries import query_sentence
from kinedex.reports.page_environment import page_environment
from kinedex.reports.plots import HistogramBar, histogram, line_path, share_ticks, time_axis

WIDTH, HEIGHT = 640, 200
BINS = 10
PANEL, ROW, NAMES = 330, 13, 170
"""Width of a matrix, height of a row, and width of the names of the rows, in SVG units."""
MIN_CELL = 3.0
"""Minimum width of a keyframe in the matrix of a long template, in SVG units."""
FAINT = 0.2
"""The share of the strongest feature below which a feature is omitted from a matrix, unless a query requires it."""
LINES = HISTORY_COLUMNS[:3]
"""Precision, recall and fitness, as in Figure 4.3."""


@dataclass(frozen=True)
class Curve:
    """One curve of the plot over generations: its name, its path in SVG units, and its last value."""

    name: str
    path: str
    last: float


@dataclass(frozen=True)
class Cell:
    """A cell of a matrix: place in SVG units, value (on or off), strength (0 to 1), query, and tooltip."""

    x: float
    y: int
    width: float
    on: bool
    strength: float
    query: int
    tip: str


@dataclass(frozen=True)
class Matrix:
    """A matrix of keyframes over the columns of a template, with a row per feature and a cell per keyframe entry.

    `names` has the names of the rows, `runs` the cells of all learning runs, `queries` the cells of the learned
    queries, and `ticks` the places and texts on the axis.
    """

    names: tuple[str, ...]
    runs: tuple[Cell, ...]
    queries: tuple[Cell, ...]
    ticks: tuple[tuple[float, str], ...]

    @property
    def height(self) -> int:
        """Return the height of all rows."""
        return ROW * len(self.names)


@dataclass(frozen=True)
class Card:
    """One subclass: its queries in words, their margins in seconds, the clips that they find, and a matrix.

    `found` counts the clips of the subclass, `others` those of other classes; `interval` and `precise` are the
    confidence intervals of recall and precision.
    """

    outcome: Outcome
    sentences: tuple[str, ...]
    margins: tuple[tuple[float, float], ...]
    found: int
    others: int
    interval: tuple[float, float]
    precise: tuple[float, float]
    matrix: Matrix

    @property
    def keyframes(self) -> str:
        """Return the numbers of keyframes of the queries."""
        return " · ".join(str(len(one.query)) for one in self.outcome.chosen)


def keyframes_page(
    title: str,
    outcomes: Sequence[Outcome],
    runs: Mapping[str, Sequence[LearningRun]],
    feature_set: FeatureSet,
    rate_hz: float,
    learner: Learner = "genetic",
    remarks: Sequence[str] = (),
) -> str:
    """Render the page about learned keyframe queries.

    Parameters
    ----------
    title : str
        Title of the page.
    outcomes : sequence of Outcome
        The learned queries of each subclass.
    runs : mapping of str to sequence of LearningRun
        All runs of each subclass.
    feature_set : FeatureSet
        The features of the queries.
    rate_hz : float
        The analysis rate.
    learner : Learner
        The algorithm of the runs.
    remarks : sequence of str
        Remarks on clips that were cut or excluded.

    Returns
    -------
    str
        A complete HTML page without outside references; equal data give equal text.
    """
    every = [run for several in runs.values() for run in several]
    stiffness = stiffnesses(outcomes, feature_set)
    generations = max((len(run.history) for run in every), default=1) - 1
    return (
        page_environment()
        .get_template("keyframes.html.j2")
        .render(
            title=title,
            courses=history_curves([run.history for run in every]),
            generations=generations,
            generation_ticks=[(WIDTH * part, f"{generations * part:.0f}") for part in (0, 0.25, 0.5, 0.75, 1)],
            stiffness_ticks=share_ticks(WIDTH, (0, 0.2, 0.4, 0.6, 0.8, 1)),
            runs=len(every),
            learner=learner,
            remarks=remarks,
            several=any(len(outcome.chosen) > 1 for outcome in outcomes),
            bars=bars(stiffness),
            gaps=len(stiffness),
            soft=float(np.mean(np.array(stiffness) <= 0.8)) if stiffness else 0.0,
            cards=[_card(outcome, feature_set, rate_hz) for outcome in outcomes],
            clips=sum(len(outcome.clips) for outcome in outcomes),
            width=WIDTH,
            height=HEIGHT,
            panel=PANEL,
            row=ROW,
            names=NAMES,
        )
    )


def history_curves(histories: Sequence[F64]) -> list[Curve]:
    """Average the histories of runs over all runs and classes, and return them as curves (thesis, Figure 4.3 a).

    Parameters
    ----------
    histories : sequence of float64 array (G_i + 1, 4)
        The history of each run; a shorter history is continued with its last row.

    Returns
    -------
    list of Curve
        The curves of the columns `LINES`; empty if there are no histories.
    """
    if not histories:
        return []
    longest = max(len(history) for history in histories)
    padded = [np.pad(history, ((0, longest - len(history)), (0, 0)), mode="edge") for history in histories]
    means = np.mean(padded, axis=0)
    found = []
    for column, name in enumerate(LINES):
        step = WIDTH / max(longest - 1, 1)
        points = [(step * index, HEIGHT * (1 - value)) for index, value in enumerate(means[:, column].tolist())]
        found.append(Curve(name, line_path(points), float(means[-1, column])))
    return found


def stiffnesses(outcomes: Sequence[Outcome], feature_set: FeatureSet) -> list[float]:
    """Return the stiffness of all gaps of the chosen queries (thesis, Eq. 4.7), except those within one keyframe."""
    queries = every_query(outcomes, feature_set)
    return [gap.nominal_stiffness for query in queries for gap in query.gaps if gap != SAME_FRAME]


def bars(stiffness: Sequence[float]) -> list[HistogramBar]:
    """Lay out a histogram of stiffness (thesis, Figure 4.4)."""
    return histogram(stiffness, 0.0, 1.0, BINS, (WIDTH, HEIGHT), 2)


def matrix_of(outcome: Outcome, feature_set: FeatureSet, rate_hz: float) -> Matrix:
    """Lay out the keyframes of all runs (thesis, Figure 4.2 a) and those of the chosen queries (Figure 4.2 b).

    The rows are the features that the queries require and those that many runs require. The strength of an entry is
    relative to the strongest entry, since with many runs every entry is near one half.
    """
    lean = outcome.consensus.matrix - 0.5
    strongest = max(float(np.abs(lean).max(initial=0.0)), 1e-9)
    fixed = [bits(one.query.masks, len(feature_set.features)).any(axis=0) for one in outcome.chosen]
    rows = np.flatnonzero(np.any([*fixed, np.abs(lean).max(axis=0) >= FAINT * strongest], axis=0)).tolist()
    names = [feature_set.features[row].name for row in rows]
    width = PANEL / outcome.columns
    runs = []
    for y, row in enumerate(rows):
        for column in np.flatnonzero(np.abs(lean[:, row]) > 1e-9).tolist():
            value = float(lean[column, row])
            word = "on" if value > 0 else "off"
            tip = f"{names[y]} {word} in {2 * abs(value):.0%} of the runs, column {column}"
            runs.append(_cell(column, y, width, value > 0, abs(value) / strongest, 0, tip))
    queries = [
        cell
        for number, one in enumerate(outcome.chosen)
        for cell in _query_cells(one.query, rows, names, width, number, len(feature_set.features))
    ]
    ticks = time_axis(in_seconds(outcome.columns, rate_hz), most=6, room=0.9).ticks
    return Matrix(tuple(names), tuple(runs), tuple(queries), ticks)


def _query_cells(
    query: Individual, rows: Sequence[int], names: Sequence[str], width: float, number: int, features: int
) -> list[Cell]:
    masks, values = bits(query.masks, features), bits(query.values, features)
    return [
        _cell(
            int(query.positions[k]), y, width, bool(values[k, row]), 1.0, number + 1,
            f"query {number + 1}, keyframe {k + 1}: {names[y]} {'on' if values[k, row] else 'off'}",
        )
        for k in range(len(query))
        for y, row in enumerate(rows)
        if masks[k, row]
    ]  # fmt: skip


def _cell(column: int, y: int, width: float, on: bool, strength: float, query: int, tip: str) -> Cell:
    wide = max(width, MIN_CELL)
    return Cell(
        round(min(width * column, PANEL - wide), 2), ROW * y, round(wide, 2), on, round(strength, 2), query, tip
    )


def _card(outcome: Outcome, feature_set: FeatureSet, rate_hz: float) -> Card:
    found = round(outcome.recall * len(outcome.clips))
    every = round(found / outcome.precision) if outcome.precision else 0
    return Card(
        outcome,
        tuple(query_sentence(query, feature_set) for query in keyframe_queries(outcome, feature_set)),
        tuple((in_seconds(one.left, rate_hz), in_seconds(one.right, rate_hz)) for one in outcome.chosen),
        found,
        every - found,
        wilson(found, len(outcome.clips)),
        wilson(found, every),
        matrix_of(outcome, feature_set, rate_hz),
    )
