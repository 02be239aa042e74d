"""A picture of hits: a row for each, with stick figures of frames from its first to its last."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from kinedex.ops.body.joint_tree import JOINT_PARENTS
from kinedex.ops.intervals import shown_seconds
from kinedex.pipelines.inspection.stick_figures import LEFT, MIDDLE, RIGHT
from kinedex.storage.disk import whole_file

FRAMES = 6
"""Number of frames, each a stick figure, in a row."""

_PAPER, _GROUND, _TEXT, _FAINT = "#ffffff", "#9a8f80", "#222222", "#777777"
_FINE, _CELL, _HEIGHT, _HEAD, _LINE, _EDGE = 2, 130, 150, 66, 24, 20
_VIEW = 0.6  # radians by which figures are turned from the front, so that left and right are apart


@dataclass(frozen=True)
class StripRow:
    """A hit in a picture.

    Attributes
    ----------
    title, note : str
        The texts above its figures.
    positions : float array (J, 3, T)
        Positions of the joints in its frames, metres, Y up; NaN where unknown.
    first : int
        Its first frame in the take.
    rate_hz : float
        Frames per second.
    """

    title: str
    note: str
    positions: npt.NDArray[np.floating]
    first: int
    rate_hz: float


def draw_strip(rows: Sequence[StripRow], joints: Sequence[str], title: str, note: str, path: Path) -> None:
    """Draw hits below each other and write the picture as PNG; on an error, no file is written.

    Parameters
    ----------
    rows : sequence of StripRow
        The hits.
    joints : sequence of str
        Names of the J joints.
    title, note : str
        The lines at the top.
    path : Path
        The file.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    width, step = 2 * _EDGE + FRAMES * _CELL, _LINE + _HEIGHT + _LINE
    image = Image.new("RGB", (width * _FINE, (_HEAD + len(rows) * step + _EDGE) * _FINE), _PAPER)
    pen = ImageDraw.Draw(image)
    _write(pen, _EDGE, 10, title, 17, _TEXT)
    at = _EDGE + _write(pen, _EDGE, 38, note, 13, _FAINT) + 20
    for word, colour in (("left", LEFT), ("right", RIGHT)):
        at += _write(pen, at, 38, word, 13, colour) + 12
    for number, row in enumerate(rows):
        top = _HEAD + number * step
        _write(pen, _EDGE, top + 2, f"{row.title}: {row.note}", 13, _TEXT)
        _draw_row(pen, row, joints, top + _LINE)
    with whole_file(path) as temporary:
        image.save(temporary, "PNG", optimize=True)


def _draw_row(pen: ImageDraw.ImageDraw, row: StripRow, joints: Sequence[str], top: float) -> None:
    frames = np.unique(np.linspace(0, row.positions.shape[2] - 1, FRAMES).round().astype(int))
    points = _turned(np.asarray(row.positions, np.float64)[:, :, frames], joints)
    known = np.isfinite(points)
    if not known.any():
        _write(pen, _EDGE, top + _HEIGHT / 2, "no joint is known in these frames", 13, _FAINT)
        return
    low, high = (edge(np.where(known, points, other), axis=0) for edge, other in ((np.min, np.inf), (np.max, -np.inf)))
    seen = np.isfinite(low).all(axis=0)
    ground = min(0.0, float(low[1, seen].min()))
    wide = float((high - low)[0, seen].max())
    scale = min((_HEIGHT - 16) / max(float(high[1, seen].max()) - ground, 1e-6), (_CELL - 12) / max(wide, 1e-6))
    floor = top + _HEIGHT - 8
    pen.line([_fine(_EDGE, floor), _fine(_EDGE + FRAMES * _CELL, floor)], fill=_GROUND, width=_FINE)
    for column, frame in enumerate(frames.tolist()):
        centre = _EDGE + (column + 0.5) * _CELL
        _write(
            pen,
            centre,
            top + _HEIGHT + 2,
            f"{shown_seconds(row.first + frame, row.rate_hz)} s",
            12,
            _FAINT,
            middle=True,
        )
        if not seen[column]:
            continue
        x = centre + (points[:, 0, column] - (low[0, column] + high[0, column]) / 2) * scale
        y = floor - (points[:, 1, column] - ground) * scale
        for joint, parent in JOINT_PARENTS.items():
            if parent in joints and joint in joints:
                a, b = joints.index(joint), joints.index(parent)
                if np.isfinite([x[a], x[b]]).all():
                    pen.line([_fine(x[a], y[a]), _fine(x[b], y[b])], fill=_colour(joint), width=3 * _FINE)


def _turned(points: npt.NDArray[np.float64], joints: Sequence[str]) -> npt.NDArray[np.float64]:
    """Return points (J, 3, F) turned about Y, so that the body is seen obliquely from the front in its first frame."""
    if not {"lhip", "rhip"} <= set(joints):
        return points
    across = points[joints.index("lhip")] - points[joints.index("rhip")]
    known = np.flatnonzero(np.isfinite(across).all(axis=0))
    if not len(known):
        return points
    turn = np.arctan2(across[2, known[0]], across[0, known[0]]) - _VIEW
    cos, sin = np.cos(turn), np.sin(turn)
    x, z = points[:, 0] * cos + points[:, 2] * sin, points[:, 2] * cos - points[:, 0] * sin
    return np.stack([x, points[:, 1], z], axis=1)


def _colour(joint: str) -> str:
    return MIDDLE if joint == "root" else {"l": LEFT, "r": RIGHT}.get(joint[0], MIDDLE)


def _fine(x: float, y: float) -> tuple[float, float]:
    return float(x) * _FINE, float(y) * _FINE


def _write(
    pen: ImageDraw.ImageDraw, x: float, y: float, text: str, size: int, colour: str, *, middle: bool = False
) -> float:
    """Write a line in Pillow's own font, which is the same on all systems, and return its width."""
    font = ImageFont.load_default(size * _FINE)
    wide = pen.textlength(text, font=font) / _FINE
    pen.text(_fine(x - wide / 2 if middle else x, y), text, font=font, fill=colour)
    return float(wide)
