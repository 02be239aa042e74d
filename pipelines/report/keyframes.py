"""The page about learned keyframe queries: how runs went, how stiff the gaps are, what the runs agree on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources

import numpy as np
import numpy.typing as npt

from catalog.features import FeatureSet
from catalog.queries import SAME_FRAME
from ops.learning.consensus import agreement_matrix
from ops.learning.lessons import HISTORY, Run
from pipelines.keyframes.learning import Outcome, keyframe_queries
from pipelines.keyframes.tables import sentence
from pipelines.report.environment import page_environment
from pipelines.report.pixels import Colour, png_uri

F64 = npt.NDArray[np.float64]

WIDTH, HEIGHT = 640, 200
BINS = 10
GREYS: list[Colour] = [(level, level, level) for level in range(256)]
LINES = HISTORY[:3]
"""Precision, recall and fitness, as in Figure 4.3."""


@dataclass(frozen=True)
class Course:
    """One line of the figure of generations: what it is, its path in SVG units, and its last value."""

    name: str
    path: str
    last: float


@dataclass(frozen=True)
class Bar:
    """One bar of a histogram: from and to which stiffness, how many gaps, and its place in SVG units."""

    low: float
    high: float
    count: int
    x: float
    y: float
    width: float
    height: float


@dataclass(frozen=True)
class Card:
    """One subclass: its queries in words, and two images, all runs added up and what was chosen."""

    outcome: Outcome
    sentences: tuple[str, ...]
    agreement: str
    chosen: str


def keyframes_page(
    title: str, outcomes: Sequence[Outcome], runs: Mapping[str, Sequence[Run]], feature_set: FeatureSet
) -> str:
    """Render the page.

    Parameters
    ----------
    outcomes: by subclass. runs: all runs of each subclass.

    Returns
    -------
    A complete HTML page without any outside reference; the same text for the same data.
    """
    every = [run for several in runs.values() for run in several]
    stiffness = stiffnesses(outcomes, feature_set)
    return (
        page_environment()
        .get_template("keyframes.html.j2")
        .render(
            title=title,
            style=resources.files("pipelines.report").joinpath("pages/style.css").read_text(encoding="utf-8"),
            courses=courses([run.history for run in every]),
            generations=max((len(run.history) for run in every), default=1) - 1,
            runs=len(every),
            bars=bars(stiffness),
            gaps=len(stiffness),
            soft=float(np.mean(np.array(stiffness) <= 0.8)) if stiffness else 0.0,
            cards=[_card(outcome, feature_set) for outcome in outcomes],
            features=[feature.name for feature in feature_set.features],
            width=WIDTH,
            height=HEIGHT,
        )
    )


def courses(histories: Sequence[F64]) -> list[Course]:
    """Average histories over runs and classes and draw them (thesis, Figure 4.3 a).

    Parameters
    ----------
    histories: float64 (G_i + 1, 4); one that is shorter than the longest goes on with its last row.
    """
    if not histories:
        return []
    longest = max(len(history) for history in histories)
    padded = [np.pad(history, ((0, longest - len(history)), (0, 0)), mode="edge") for history in histories]
    means = np.mean(padded, axis=0)
    found = []
    for column, name in enumerate(LINES):
        points = [
            f"{WIDTH * index / max(longest - 1, 1):.1f} {HEIGHT * (1 - value):.1f}"
            for index, value in enumerate(means[:, column].tolist())
        ]
        found.append(Course(name, "M" + "L".join(points), float(means[-1, column])))
    return found


def stiffnesses(outcomes: Sequence[Outcome], feature_set: FeatureSet) -> list[float]:
    """The stiffness of every gap of all chosen queries (thesis, Eq. 4.7), but for parts of one keyframe."""
    queries = [query for outcome in outcomes for query in keyframe_queries(outcome, feature_set)]
    return [gap.nominal_stiffness for query in queries for gap in query.gaps if gap != SAME_FRAME]


def bars(stiffness: Sequence[float]) -> list[Bar]:
    """A histogram of stiffness (thesis, Figure 4.4)."""
    counts, edges = np.histogram(np.array(stiffness), bins=BINS, range=(0.0, 1.0))
    top = max(int(counts.max()), 1)
    return [
        Bar(
            float(edges[index]), float(edges[index + 1]), int(count), WIDTH * index / BINS + 2,
            HEIGHT * (1 - count / top), WIDTH / BINS - 4, HEIGHT * count / top,
        )
        for index, count in enumerate(counts)
    ]  # fmt: skip


def agreement_image(matrix: F64) -> str:
    """Draw a matrix of keyframes (thesis, Figure 4.2): black is off, white is on, grey is a wildcard.

    The matrix is stretched so that its strongest entry is black or white: with many runs every entry is near one half.
    """
    strongest = float(np.abs(matrix - 0.5).max())
    stretched = 0.5 + (matrix - 0.5) * (0.5 / strongest) if strongest > 0 else matrix
    return png_uri(np.round(stretched * 255).astype(np.uint8).T, GREYS)


def _card(outcome: Outcome, feature_set: FeatureSet) -> Card:
    features = len(feature_set.features)
    chosen = agreement_matrix([outcome.chosen[0].query], outcome.columns, features)
    return Card(
        outcome,
        tuple(sentence(query, feature_set) for query in keyframe_queries(outcome, feature_set)),
        agreement_image(outcome.consensus.matrix),
        agreement_image(chosen),
    )
