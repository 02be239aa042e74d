"""Draw motions as stick figures: a few frames from the front and the side, or rows of hits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from kinedex.ops.arrays import F64
from kinedex.ops.body.joint_tree import JOINT_PARENTS
from kinedex.ops.errors import KinedexError
from kinedex.ops.intervals import shown_seconds
from kinedex.pipelines.inspection.stick_figures import LEFT, MIDDLE, RIGHT, Figure
from kinedex.storage.durable_files import whole_file

if TYPE_CHECKING:
    from kinedex.pipelines.inspection.motion_file import Inspection


PAPER, GROUND, TEXT, FAINT = "#ffffff", "#9a8f80", "#222222", "#777777"
_CELL, _HEIGHT, _HEAD, _FOOT, _EDGE = 190, 250, 62, 26, 28  # pixels of a picture of a few frames


class Pen:
    """A pen that draws on an image with `fine` pixels per unit, so that lines are smooth when the image is reduced."""

    def __init__(self, image: Image.Image, fine: int) -> None:
        self.image, self._fine, self._draw = image, fine, ImageDraw.Draw(image)

    @classmethod
    def on_paper(cls, width: int, height: int, fine: int) -> Pen:
        """Return a pen on an empty sheet."""
        return cls(Image.new("RGB", (width * fine, height * fine), PAPER), fine)

    def line(self, x: float, y: float, to_x: float, to_y: float, colour: str, width: int = 1) -> None:
        """Draw a line."""
        fine = self._fine
        ends = [(float(x) * fine, float(y) * fine), (float(to_x) * fine, float(to_y) * fine)]
        self._draw.line(ends, fill=colour, width=width * fine)

    def dot(self, x: float, y: float, radius: float, colour: str) -> None:
        """Draw a filled circle."""
        u, v, r = float(x) * self._fine, float(y) * self._fine, radius * self._fine
        self._draw.ellipse([u - r, v - r, u + r, v + r], fill=colour)

    def write(self, x: float, y: float, text: str, size: int, colour: str, *, middle: bool = False) -> float:
        """Write a line in Pillow's built-in font, which is the same on all systems, and return its width."""
        font = ImageFont.load_default(size * self._fine)
        wide = float(self._draw.textlength(text, font=font)) / self._fine
        at = (float(x - wide / 2 if middle else x) * self._fine, float(y) * self._fine)
        self._draw.text(at, text, font=font, fill=colour)
        return wide


def write_picture(found: Inspection, path: Path) -> bool:
    """Write the picture of an inspection; return False if the inspection has none.

    Raises
    ------
    KinedexError
        If the file cannot be written.
    """
    if found.figure is None:
        return False
    try:
        draw(found.figure, path)
    except OSError as fault:
        raise KinedexError(f"{path}: cannot be written: {fault.strerror}") from None
    return True


def draw(figure: Figure, path: Path) -> None:
    """Draw a figure with a row for each view and a column for each frame, all at one scale, and write it as PNG.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    columns, rows = len(figure.times), len(figure.views)
    width = max(2 * _EDGE + columns * _CELL, 2 * _EDGE + 640)
    height = _HEAD + rows * (_HEIGHT + _FOOT) + _EDGE
    pen = Pen.on_paper(width, height, 3)
    pen.write(_EDGE, 12, figure.title, 17, TEXT)
    at = float(_EDGE)
    for word, colour in figure.legend:
        pen.line(at, 47, at + 18, 47, colour, 4)
        at += 24 + pen.write(at + 24, 39, word, 13, TEXT) + 18
    pen.write(at, 39, figure.note, 13, FAINT)
    scale, middle, bottom = _fit(figure)
    for row, (name, across, up) in enumerate(figure.views):
        top = _HEAD + row * (_HEIGHT + _FOOT)
        floor = top + _HEIGHT - 12 - (figure.ground - bottom) * scale
        if up == 1:
            pen.line(_EDGE, floor, width - _EDGE, floor, GROUND)
        for column, time in enumerate(figure.times):
            centre = _EDGE + (column + 0.5) * _CELL
            x = centre + (figure.points[:, across, column] - middle[across, column]) * scale
            y = top + _HEIGHT - 12 - (figure.points[:, up, column] - (bottom if up == 1 else 0.0)) * scale
            _bones(pen, figure, x, y)
            pen.write(centre, top + _HEIGHT + 2, time, 13, TEXT, middle=True)
        pen.write(_EDGE, top + 4, name, 14, TEXT)
    pen.image.resize((width, height), Image.Resampling.LANCZOS).save(path, "PNG")


def _bones(pen: Pen, figure: Figure, x: F64, y: F64) -> None:
    known = np.isfinite(x) & np.isfinite(y)
    for a, b, colour in figure.bones:
        if known[a] and known[b]:
            pen.line(x[a], y[a], x[b], y[b], colour, 3)
    for a, b, colour in figure.bones:
        for joint in (a, b):
            if known[joint]:
                pen.dot(x[joint], y[joint], 2.2, colour)


def _fit(figure: Figure) -> tuple[float, F64, float]:
    """Return pixels per unit of length, the centre of each frame (3, F), and the lowest visible height."""
    points = figure.points
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    middle = (low + high) / 2
    bottom = float(min(low[1].min(), figure.ground))
    tall = float(high[1].max()) - bottom
    wide = float((high - low)[[0, 2]].max())
    scale = min((_HEIGHT - 44) / max(tall, 1e-9), (_CELL - 14) / max(wide, 1e-9))
    return scale, middle, bottom


FRAMES = 6
"""Number of frames, each a stick figure, in a row."""

_ROW_CELL, _ROW_HEIGHT, _ROW_HEAD, _LINE, _MARGIN = 130, 150, 66, 24, 20  # pixels of a picture of hits
_VIEW = 0.6  # radians by which figures are turned from the front, so that left and right are apart


@dataclass(frozen=True)
class StripRow:
    """A hit in a picture.

    Attributes
    ----------
    title, note : str
        The texts above the figures.
    positions : float array (J, 3, T)
        Positions of the joints in the frames of the hit, in metres, Y up; NaN where unknown.
    first : int
        The first frame of the hit in the take.
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
    width, step = 2 * _MARGIN + FRAMES * _ROW_CELL, _LINE + _ROW_HEIGHT + _LINE
    pen = Pen.on_paper(width, _ROW_HEAD + len(rows) * step + _MARGIN, 2)
    pen.write(_MARGIN, 10, title, 17, TEXT)
    at = _MARGIN + pen.write(_MARGIN, 38, note, 13, FAINT) + 20
    for word, colour in (("left", LEFT), ("right", RIGHT)):
        at += pen.write(at, 38, word, 13, colour) + 12
    for number, row in enumerate(rows):
        top = _ROW_HEAD + number * step
        pen.write(_MARGIN, top + 2, f"{row.title}: {row.note}", 13, TEXT)
        _draw_row(pen, row, joints, top + _LINE)
    with whole_file(path) as temporary:
        pen.image.save(temporary, "PNG", optimize=True)


def _draw_row(pen: Pen, row: StripRow, joints: Sequence[str], top: float) -> None:
    frames = np.unique(np.linspace(0, row.positions.shape[2] - 1, FRAMES).round().astype(int))
    points = _turned(np.asarray(row.positions, np.float64)[:, :, frames], joints)
    known = np.isfinite(points)
    if not known.any():
        pen.write(_MARGIN, top + _ROW_HEIGHT / 2, "no joint is known in these frames", 13, FAINT)
        return
    low, high = (edge(np.where(known, points, other), axis=0) for edge, other in ((np.min, np.inf), (np.max, -np.inf)))
    seen = np.isfinite(low).all(axis=0)
    ground = min(0.0, float(low[1, seen].min()))
    wide = float((high - low)[0, seen].max())
    scale = min((_ROW_HEIGHT - 16) / max(float(high[1, seen].max()) - ground, 1e-6), (_ROW_CELL - 12) / max(wide, 1e-6))
    floor = top + _ROW_HEIGHT - 8
    pen.line(_MARGIN, floor, _MARGIN + FRAMES * _ROW_CELL, floor, GROUND)
    for column, frame in enumerate(frames.tolist()):
        centre = _MARGIN + (column + 0.5) * _ROW_CELL
        pen.write(
            centre, top + _ROW_HEIGHT + 2, f"{shown_seconds(row.first + frame, row.rate_hz)} s", 12, FAINT, middle=True
        )
        if not seen[column]:
            continue
        x = centre + (points[:, 0, column] - (low[0, column] + high[0, column]) / 2) * scale
        y = floor - (points[:, 1, column] - ground) * scale
        for joint, parent in JOINT_PARENTS.items():
            if parent in joints and joint in joints:
                a, b = joints.index(joint), joints.index(parent)
                if np.isfinite([x[a], x[b]]).all():
                    pen.line(x[a], y[a], x[b], y[b], _colour(joint), 3)


def _turned(points: F64, joints: Sequence[str]) -> F64:
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
