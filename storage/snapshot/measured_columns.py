"""The columns of takes that a store declares for what is measured in files: persons, recognition and quality."""

from __future__ import annotations

from collections.abc import Mapping

from kinedex.catalog.quality_figures import FIGURES
from kinedex.storage.snapshot.schemas import TakeColumn, column_problem

PERSON_COLUMNS = {
    "person": TakeColumn("VARCHAR", "file", meaning="the person, of a file that holds several"),
    "persons": TakeColumn("BIGINT", "file", meaning="the number of persons in the file, where it holds several"),
}
"""The columns of takes that a store declares for files with several persons."""

RECOGNITION_COLUMNS = {
    "recognition_confidence": TakeColumn(
        "DOUBLE", "quality", "", "how surely the body was recognised, 0 to 1; 1 where the names fit a mapping"
    ),
    "estimated_joints": TakeColumn(
        "VARCHAR", "quality", "", "the joints that the file does not hold and that are estimated, with a blank between"
    ),
    "file_up": TakeColumn("VARCHAR", "quality", "", "the axis of the file that is taken as vertical, such as z or -y"),
    "filled_frames": TakeColumn(
        "BIGINT", "quality", "", "source frames in which a hidden marker is placed by the other markers of its segment"
    ),
    "filled_from": TakeColumn("BIGINT", "quality", "", "the smallest number of markers by which one is placed so"),
}
"""The declarations of the columns that describe how a skeleton was recognised."""

QUALITY_COLUMNS = RECOGNITION_COLUMNS | {
    figure.name: TakeColumn(figure.type, "quality", figure.unit, figure.meaning) for figure in FIGURES
}
"""The declarations of the columns of recognition and of quality figures."""


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
