"""Draw templates as indexed PNGs in data URIs, with a square of pixels for each entry."""

from __future__ import annotations

import base64
import io

import numpy as np
from PIL import Image

from kinedex.ops.arrays import F64, U8

Colour = tuple[int, int, int]

BLACK: Colour = (0, 0, 0)
WHITE: Colour = (255, 255, 255)
WILDCARD: Colour = (151, 176, 204)
# Purple to yellow: the lightness rises, and the colours can be distinguished with any colour vision.
VARYING: tuple[Colour, ...] = ((66, 10, 145), (126, 3, 168), (204, 71, 120), (248, 149, 64), (252, 206, 37))
TOLERANCE = 1e-9
SCALE = 4  # pixels per entry in each direction; several, because printers smooth images and entries must stay distinct


def ramp(position: float) -> Colour:
    """Return the colour of a value strictly between 0 and 1."""
    scaled = position * (len(VARYING) - 1)
    lower = min(int(scaled), len(VARYING) - 2)
    share = scaled - lower
    first, second = VARYING[lower], VARYING[lower + 1]
    red, green, blue = (round(a + (b - a) * share) for a, b in zip(first, second, strict=True))
    return red, green, blue


def soft_image(values: F64) -> str:
    """Draw a template: 0 is black, 1 is white, and values between have the colours of `ramp`.

    Parameters
    ----------
    values : float64 array (columns, features)
        Entries in [0, 1].

    Returns
    -------
    str
        Data URI of a PNG with SCALE rows per feature and SCALE columns per column.
    """
    palette = [BLACK, *(ramp(i / 253) for i in range(254)), WHITE]
    indices = np.clip(1 + np.round(values * 253), 1, 254).astype(np.uint8)
    indices[values <= TOLERANCE] = 0
    indices[values >= 1 - TOLERANCE] = 255
    return png_uri(indices.T, palette)


def quantised_image(values: F64, delta: float) -> str:
    """Draw a quantised template: values up to δ are black, from 1 − δ white, wildcards grey blue."""
    indices = np.full(values.shape, 2, dtype=np.uint8)
    indices[values <= delta + TOLERANCE] = 0
    indices[values >= 1 - delta - TOLERANCE] = 1
    return png_uri(indices.T, [BLACK, WHITE, WILDCARD])


def wildcard_share(values: F64, delta: float) -> float:
    """Return the fraction of entries that are wildcards once quantised with δ."""
    if not values.size:
        return 0.0
    return float(np.mean((values > delta + TOLERANCE) & (values < 1 - delta - TOLERANCE)))


def png_uri(indices: U8, palette: list[Colour]) -> str:
    """Encode a matrix of palette indices, first row on top, as a PNG data URI."""
    image = Image.fromarray(indices.repeat(SCALE, axis=0).repeat(SCALE, axis=1), "P")
    image.putpalette([channel for colour in palette for channel in colour])
    content = io.BytesIO()
    image.save(content, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(content.getvalue()).decode("ascii")
