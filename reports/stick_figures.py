"""Pictures of a few frames of a motion as stick figures, from the front and from the side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.inspection.inspection import Inspection
from kinedex.pipelines.inspection.stick_figures import Figure

F64 = npt.NDArray[np.float64]

_PAPER, _GROUND, _TEXT, _FAINT = "#ffffff", "#9a8f80", "#222222", "#777777"
_FINE = 3  # the picture is drawn this many times larger and then reduced, so that lines are smooth
_CELL, _HEIGHT, _HEAD, _FOOT, _EDGE = 190, 250, 62, 26, 28


def write_picture(found: Inspection, path: Path) -> bool:
    """Write the picture of an inspection; return False where there is none.

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
    """Draw a figure to one scale, with a row for each view and a column for each frame, and write it as PNG.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    columns, rows = len(figure.times), len(figure.views)
    width = max(2 * _EDGE + columns * _CELL, 2 * _EDGE + 640)
    height = _HEAD + rows * (_HEIGHT + _FOOT) + _EDGE
    image = Image.new("RGB", (width * _FINE, height * _FINE), _PAPER)
    pen = ImageDraw.Draw(image)
    _write(pen, _EDGE, 12, figure.title, 17, _TEXT)
    at = float(_EDGE)
    for word, colour in figure.legend:
        pen.line([_fine(at, 47), _fine(at + 18, 47)], fill=colour, width=4 * _FINE)
        at += 24 + _write(pen, at + 24, 39, word, 13, _TEXT) + 18
    _write(pen, at, 39, figure.note, 13, _FAINT)
    scale, middle, bottom = _fit(figure)
    for row, (name, across, up) in enumerate(figure.views):
        top = _HEAD + row * (_HEIGHT + _FOOT)
        floor = top + _HEIGHT - 12 - (figure.ground - bottom) * scale
        if up == 1:
            pen.line([_fine(_EDGE, floor), _fine(width - _EDGE, floor)], fill=_GROUND, width=_FINE)
        for column, time in enumerate(figure.times):
            centre = _EDGE + (column + 0.5) * _CELL
            x = centre + (figure.points[:, across, column] - middle[across, column]) * scale
            y = top + _HEIGHT - 12 - (figure.points[:, up, column] - (bottom if up == 1 else 0.0)) * scale
            _bones(pen, figure, x, y)
            _write(pen, centre, top + _HEIGHT + 2, time, 13, _TEXT, middle=True)
        _write(pen, _EDGE, top + 4, name, 14, _TEXT)
    image.resize((width, height), Image.Resampling.LANCZOS).save(path, "PNG")


def _bones(pen: ImageDraw.ImageDraw, figure: Figure, x: F64, y: F64) -> None:
    known = np.isfinite(x) & np.isfinite(y)
    for a, b, colour in figure.bones:
        if known[a] and known[b]:
            pen.line([_fine(x[a], y[a]), _fine(x[b], y[b])], fill=colour, width=3 * _FINE)
    for a, b, colour in figure.bones:
        for joint in (a, b):
            if known[joint]:
                (u, v), r = _fine(x[joint], y[joint]), 2.2 * _FINE
                pen.ellipse([u - r, v - r, u + r, v + r], fill=colour)


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
