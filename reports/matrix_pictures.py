"""Draw templates as matrices of features over time with named rows, one or two side by side, as SVG or PNG."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from kinedex.catalog.features import FeatureSet
from kinedex.ops.arrays import F64, U8
from kinedex.ops.errors import KinedexError
from kinedex.ops.intervals import in_seconds
from kinedex.ops.templates.derived_templates import Contrast, consistency
from kinedex.ops.templates.templates import QuantisedTemplate, Template, quantise
from kinedex.reports.pixels import BLACK, TOLERANCE, VARYING, WHITE, WILDCARD, Colour, ramp
from kinedex.reports.plots import time_axis

ENDINGS = (".svg", ".png")

_ROW, _MAX_WIDTH, _MIN_CELL, _MAX_CELL = 15, 620, 2, 12
_NAMES, _NOTES, _EDGE, _HEAD, _GAP, _FOOT = 168, 96, 16, 92, 18, 44
_TEXT, _FAINT, _RULE, _FRAME = (34, 34, 34), (110, 110, 110), (200, 80, 10), (120, 120, 120)
_FINE = 2  # pixels of a PNG per SVG unit


@dataclass(frozen=True)
class Panel:
    """One matrix: its caption, and a colour for each entry, uint8 (features, columns, 3)."""

    caption: str
    colours: U8


@dataclass(frozen=True)
class MatrixPicture:
    """Panels side by side over the same named rows.

    Attributes
    ----------
    title, note : str
        The lines at the top.
    rows : sequence of str
        Names of the rows.
    panels : sequence of Panel
        The matrices.
    notes_head : str
        Heading of the notes.
    notes : sequence of str
        Text to the right of each row.
    rules : sequence of int
        Rows, counted from 0, that have a thin line above them.
    legend : sequence of (Colour, str)
        Colours and their meaning.
    rate_hz : float
        Columns per second.
    """

    title: str
    note: str
    rows: Sequence[str]
    panels: Sequence[Panel]
    notes_head: str
    notes: Sequence[str]
    rules: Sequence[int]
    legend: Sequence[tuple[Colour, str]]
    rate_hz: float


def write_matrices(picture: MatrixPicture, path: Path) -> None:
    """Write a picture in the format of the extension of its path, .svg or .png.

    Raises
    ------
    KinedexError
        If the path has another ending.
    OSError
        If the file cannot be written.
    """
    if path.suffix.lower() not in ENDINGS:
        raise KinedexError(f"{path}: expected an ending of {' or '.join(ENDINGS)}, got '{path.suffix}'")
    path.write_bytes(draw(picture, path.suffix.lower().lstrip(".")))


def draw(picture: MatrixPicture, form: str) -> bytes:
    """Draw a picture as "svg" or "png"."""
    columns = [panel.colours.shape[1] for panel in picture.panels]
    cell = min(max(_MAX_WIDTH / sum(columns), _MIN_CELL), _MAX_CELL)
    inner = cell * sum(columns) + _GAP * (len(columns) - 1)
    width = max(2 * _EDGE + _NAMES + inner + _NOTES, 2 * _EDGE + 7.2 * len(picture.note))
    height = _HEAD + _ROW * len(picture.rows) + _FOOT
    canvas: Svg | Png = Svg(width, height, picture.title) if form == "svg" else Png(width, height)
    canvas.text(_EDGE, 28, picture.title, 18, _TEXT)
    canvas.text(_EDGE, 48, picture.note, 12, _FAINT)
    _legend(canvas, picture)
    for row, name in enumerate(picture.rows):
        canvas.text(_EDGE + _NAMES - 8, _HEAD + _ROW * row + 11, name, 11, _TEXT, "end")
        canvas.text(_EDGE + _NAMES + inner + 8, _HEAD + _ROW * row + 11, picture.notes[row], 11, _TEXT)
    canvas.text(_EDGE + _NAMES + inner + 8, _HEAD - 8, picture.notes_head, 11, _FAINT)
    left: float = _EDGE + _NAMES
    for panel in picture.panels:
        _panel(canvas, picture, panel, left, cell)
        left += cell * panel.colours.shape[1] + _GAP
    return canvas.content()


def _legend(canvas: Svg | Png, picture: MatrixPicture) -> None:
    at: float = _EDGE
    for colour, words in picture.legend:
        canvas.rectangle(at - 1, 57, 12, 12, _FRAME)
        canvas.rectangle(at, 58, 10, 10, colour)
        canvas.text(at + 16, 67, words, 11, _TEXT)
        at += 34 + 6.1 * len(words)


def _panel(canvas: Svg | Png, picture: MatrixPicture, panel: Panel, left: float, cell: float) -> None:
    rows, columns, _ = panel.colours.shape
    width = cell * columns
    canvas.text(left, _HEAD - 8, panel.caption, 11, _FAINT)
    canvas.rectangle(left - 1, _HEAD - 1, width + 2, _ROW * rows + 1, _FRAME)
    for row in range(rows):
        colours = panel.colours[row]
        cuts = np.flatnonzero((colours[1:] != colours[:-1]).any(axis=1)) + 1
        for start, stop in zip([0, *cuts.tolist()], [*cuts.tolist(), columns], strict=True):
            red, green, blue = (int(channel) for channel in colours[start])
            canvas.rectangle(
                left + cell * start, _HEAD + _ROW * row, cell * (stop - start), _ROW - 1, (red, green, blue)
            )
    for row in picture.rules:
        canvas.rectangle(left - 1, _HEAD + _ROW * row - 1, width + 2, 1, _RULE)
    seconds = in_seconds(columns, picture.rate_hz)
    for percent, text in time_axis(seconds, most=max(1, int(width / 45)), room=0.9).ticks:
        x = left + width * percent / 100
        canvas.rectangle(x, _HEAD + _ROW * rows, 1, 5, _FRAME)
        canvas.text(x, _HEAD + _ROW * rows + 17, text, 11, _FAINT)


class Svg:
    """A canvas whose content is SVG; lengths are in SVG units."""

    def __init__(self, width: float, height: float, title: str) -> None:
        size = f'width="{width:.0f}" height="{height:.0f}" viewBox="0 0 {width:.0f} {height:.0f}"'
        self._parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="Helvetica, Arial, sans-serif">',
            f"<title>{escape(title)}</title>",
            '<rect width="100%" height="100%" fill="#fff"/>',
            '<g shape-rendering="crispEdges">',
        ]
        self._texts: list[str] = []

    def rectangle(self, x: float, y: float, width: float, height: float, colour: Colour) -> None:
        """Fill a rectangle."""
        self._parts.append(
            f'<rect x="{x:.6g}" y="{y:.6g}" width="{width:.6g}" height="{height:.6g}" fill="{_hex(colour)}"/>'
        )

    def text(self, x: float, y: float, text: str, size: int, colour: Colour, anchor: str = "start") -> None:
        """Write a line of text with its baseline at y; its start, middle or end is at x, as `anchor` says."""
        place = f'x="{x:.6g}" y="{y:.6g}" font-size="{size}" fill="{_hex(colour)}"'
        end = "" if anchor == "start" else f' text-anchor="{anchor}"'
        self._texts.append(f"<text {place}{end}>{escape(text)}</text>")

    def content(self) -> bytes:
        """Return the content of the file."""
        return "\n".join([*self._parts, "</g>", *self._texts, "</svg>", ""]).encode()


class Png:
    """A canvas that renders to PNG, with Pillow's built-in font, which is the same on all systems."""

    def __init__(self, width: float, height: float) -> None:
        self._image = Image.new("RGB", (round(width * _FINE), round(height * _FINE)), (255, 255, 255))
        self._pen = ImageDraw.Draw(self._image)

    def rectangle(self, x: float, y: float, width: float, height: float, colour: Colour) -> None:
        """Fill a rectangle."""
        right, bottom = round((x + width) * _FINE) - 1, round((y + height) * _FINE) - 1
        corner = round(x * _FINE), round(y * _FINE)
        self._pen.rectangle([*corner, max(right, corner[0]), max(bottom, corner[1])], fill=colour)

    def text(self, x: float, y: float, text: str, size: int, colour: Colour, anchor: str = "start") -> None:
        """Write a line of text, as `Svg.text` does."""
        at = {"start": "ls", "middle": "ms", "end": "rs"}[anchor]
        font = ImageFont.load_default(size * _FINE)
        self._pen.text((x * _FINE, y * _FINE), text, font=font, fill=colour, anchor=at)

    def content(self) -> bytes:
        """Return the content of the file."""
        out = io.BytesIO()
        self._image.save(out, "PNG", optimize=True)
        return out.getvalue()


def _hex(colour: Colour) -> str:
    return "#" + "".join(f"{channel:02x}" for channel in colour)


FIRST_ON: Colour = (200, 80, 10)
SECOND_ON: Colour = (0, 114, 178)
NOT_COMPARED: Colour = (235, 235, 235)
AGREED: Colour = (205, 205, 205)


def template_picture(
    template: Template, title: str, note: str, delta: float, features: FeatureSet, rate_hz: float
) -> MatrixPicture:
    """Lay out a template, its quantised form at δ, and the consistency of each feature."""
    quantised = quantise(template, delta)
    agreement = consistency(template)
    return MatrixPicture(
        title=title,
        note=note,
        rows=row_names(features),
        panels=(
            Panel("average of the aligned clips", soft_colours(template.values)),
            Panel(f"quantised: within {delta:g} of off or on", quantised_colours(quantised, len(features.features))),
        ),
        notes_head="consistency",
        notes=[
            f"{share:.0%}" + ("  (no weight)" if silent else "")
            for share, silent in zip(agreement, _silent(template), strict=True)
        ],
        rules=set_rules(features),
        legend=(
            (BLACK, "off in every clip"),
            (WHITE, "on in every clip"),
            (VARYING[0], "mostly off"),
            (VARYING[2], "half and half"),
            (VARYING[-1], "mostly on"),
            (WILDCARD, "wildcard: anything fits"),
        ),
        rate_hz=rate_hz,
    )


def contrast_picture(
    first: Template,
    second: Template,
    names: tuple[str, str],
    found: Contrast,
    delta: float,
    note: str,
    features: FeatureSet,
    rate_hz: float,
) -> MatrixPicture:
    """Lay out two aligned templates, and the entries that contradict each other at δ."""
    count = len(features.features)
    one, other = (quantised_colours(quantise(template, delta), count) for template in (first, second))
    against = np.full((count, len(found.path), 3), AGREED, np.uint8)
    against[~found.compared.T] = NOT_COMPARED
    against[found.against.T > 0] = FIRST_ON
    against[found.against.T < 0] = SECOND_ON
    many = np.abs(found.against).sum(axis=0)
    return MatrixPicture(
        title=f"{names[0]} and {names[1]}",
        note=note,
        rows=row_names(features),
        panels=(
            Panel(names[0], one[:, found.path[:, 0]]),
            Panel(names[1], other[:, found.path[:, 1]]),
            Panel("contradictions", against),
        ),
        notes_head="columns against",
        notes=[str(columns) if columns else "" for columns in many.tolist()],
        rules=set_rules(features),
        legend=(
            (BLACK, "off"),
            (WHITE, "on"),
            (WILDCARD, "wildcard"),
            (FIRST_ON, f"on in {names[0]} only"),
            (SECOND_ON, f"on in {names[1]} only"),
            (AGREED, "alike"),
            (NOT_COMPARED, "a wildcard in one of them"),
        ),
        rate_hz=rate_hz,
    )


def row_names(features: FeatureSet) -> list[str]:
    """Return a name for the row of each feature: the feature's name and number."""
    return [f"{feature.name} {feature.number}" for feature in features.features]


def set_rules(features: FeatureSet) -> list[int]:
    """Return the first row of each set of features, except the first set."""
    return [word_set.first - 1 for word_set in features.sets.values() if word_set.first > 1]


def soft_colours(values: F64) -> U8:
    """Return the colours of a template, uint8 (features, columns, 3): 0 is black, 1 is white, a ramp between."""
    palette = np.array([ramp(i / 255) for i in range(256)], np.uint8)
    colours = palette[np.clip(np.round(values * 255), 0, 255).astype(np.int64)]
    colours[values <= TOLERANCE] = BLACK
    colours[values >= 1 - TOLERANCE] = WHITE
    turned: U8 = np.ascontiguousarray(colours.transpose(1, 0, 2))
    return turned


def quantised_colours(template: QuantisedTemplate, features: int) -> U8:
    """Return the colours of a quantised template, uint8 (features, columns, 3): off black, on white, wildcards blue."""
    palette = np.array([BLACK, WILDCARD, WHITE], np.uint8)
    turned: U8 = np.ascontiguousarray(palette[(2 * template.values(features)).astype(np.int64)].transpose(1, 0, 2))
    return turned


def _silent(template: Template) -> list[bool]:
    weights = template.feature_weights
    return [False] * template.values.shape[1] if weights is None else (weights == 0).tolist()
