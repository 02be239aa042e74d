"""Rate the quality of takes: the figures that ingest measures, their columns of `takes`, and warnings."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from kinedex.catalog.quality import quality_columns, quality_warnings
from kinedex.catalog.quality_figures import FIGURES
from kinedex.ops.body.plausibility import Plausibility, plausibility
from kinedex.storage.formats.motion.reader import Body
from kinedex.storage.snapshot.schemas import TakeColumn, column_problem

RECOGNITION_COLUMNS = {
    "recognition_confidence": TakeColumn(
        "DOUBLE", "quality", "", "how surely the body was recognised, 0 to 1; 1 where the names fit a mapping"
    ),
    "estimated_joints": TakeColumn(
        "VARCHAR", "quality", "", "the joints that the file does not hold and that are estimated, with a blank between"
    ),
}
"""The declarations of the columns that describe how a skeleton was recognised."""

QUALITY_COLUMNS = RECOGNITION_COLUMNS | {
    figure.name: TakeColumn(figure.type, "quality", figure.unit, figure.meaning) for figure in FIGURES
}
"""The declarations of the columns of recognition and of quality figures."""


def figures_of(body: Body, joints: tuple[str, ...]) -> Plausibility:
    """Measure the quality figures of a body with the given joint names."""
    return plausibility(body.positions, joints, body.rate_hz, body.valid)


def judged(body: Body, joints: tuple[str, ...], stored: Collection[str]) -> tuple[dict[str, Any], list[str]]:
    """Return the quality figures of a body, and warnings about it.

    Parameters
    ----------
    body : Body
        The body that a reader returned.
    joints : tuple of str
        The names of its joints.
    stored : collection of str
        The columns of figures that the store has, see `stored_figures`.

    Returns
    -------
    columns : dict of str to value
        The figures of the stored columns, None for an unknown one.
    warnings : list of str
        A sentence for each figure beyond its limits.
    """
    figures = figures_of(body, joints)
    recognition = {"recognition_confidence": body.confidence, "estimated_joints": " ".join(body.estimated)}
    columns = {name: value for name, value in (recognition | quality_columns(figures)).items() if name in stored}
    return columns, quality_warnings(figures, body.rate_hz)


def stored_figures(columns: Mapping[str, TakeColumn]) -> frozenset[str]:
    """Return the names of figures among the declared columns of a store, excluding columns of the user."""
    return frozenset(name for name, column in columns.items() if name in QUALITY_COLUMNS and column.origin == "quality")


def declarable_figures(columns: Mapping[str, TakeColumn]) -> tuple[dict[str, TakeColumn], list[str]]:
    """Return the columns of figures that a store can declare, and a sentence for each that it cannot declare."""
    problems = {name: column_problem(name, column, columns) for name, column in QUALITY_COLUMNS.items()}
    sentences = [
        f"the figure '{name}' of the quality of takes is no column: {problem}; name that column otherwise to have both"
        for name, problem in problems.items()
        if problem is not None
    ]
    return {name: column for name, column in QUALITY_COLUMNS.items() if problems[name] is None}, sentences
