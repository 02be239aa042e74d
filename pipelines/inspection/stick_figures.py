"""Stick figures of a few frames of a motion: the data of a picture from the front and from the side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from kinedex.ops.arrays import F64

LEFT, RIGHT, MIDDLE = "#1f6fc4", "#d1495b", "#3c3c3c"
"""Colours of bones by the side of the body; bones of unknown side have the colour of the middle."""


@dataclass(frozen=True)
class Figure:
    """The content of a picture.

    Attributes
    ----------
    points : float64 array (J, 3, F)
        Positions of the joints in the F frames shown, Y up; NaN if a joint is unknown.
    bones : sequence of (int, int, str)
        Pairs of joints with the colour of the line between them.
    times : sequence of str
        The text below each frame.
    views : sequence of (str, int, int)
        For each row of the picture its title and the axes drawn to the right and up.
    ground : float
        Height of the ground line, in the unit of the points.
    title, note : str
        The lines at the top.
    legend : sequence of (str, str)
        Texts, each with the colour that it explains.
    """

    points: F64
    bones: Sequence[tuple[int, int, str]]
    times: Sequence[str]
    views: Sequence[tuple[str, int, int]]
    ground: float
    title: str
    legend: Sequence[tuple[str, str]]
    note: str
