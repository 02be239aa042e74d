"""This module estimates depths of the empty room from a recording of a person, and compares frames with them."""

from __future__ import annotations

import numpy as np

from kinedex.ops.arrays import F32, F64

PERCENTILE = 90.0
"""The percentile of a pixel's depths over time that is used as the background behind a moving person."""

BEHIND = 0.06, 0.03
"""A depth d is behind the background if it is larger by more than BEHIND[0] + BEHIND[1] · d, in metres."""

PERSON_SHARE = 0.93
"""Factor of the background's depth below which a depth belongs to the person, in any unit."""

_ROWS = 16


def percentile_depths(images: F32, percentile: float = PERCENTILE) -> F32:
    """Return a percentile over time of each pixel's measured depths.

    Parameters
    ----------
    images : float32 array (T, H, W)
        Depths; 0 where nothing was measured.
    percentile : float, optional
        The percentile, 0 to 100; linearly interpolated between neighbouring depths.

    Returns
    -------
    float32 array (H, W)
        The percentile; 0 where nothing was ever measured.
    """
    height = images.shape[1]
    found = np.zeros(images.shape[1:], np.float32)
    for top in range(0, height, _ROWS):  # row by row, to bound the size of copies
        block = np.sort(np.where(images[:, top : top + _ROWS] > 0, images[:, top : top + _ROWS], np.inf), axis=0)
        counts = np.isfinite(block).sum(axis=0)
        place = np.maximum(counts - 1, 0) * (percentile / 100)
        low = np.floor(place).astype(np.int64)
        high = np.minimum(low + 1, np.maximum(counts - 1, 0))
        first = np.take_along_axis(block, low[None], axis=0)[0].astype(np.float64)
        second = np.take_along_axis(block, high[None], axis=0)[0].astype(np.float64)
        with np.errstate(invalid="ignore"):
            value = first + (second - first) * (place - low)
        found[top : top + _ROWS] = np.where(counts > 0, value, 0.0)
    return found


def behind_share(image: F32, background: F32) -> float:
    """Return the fraction of pixels behind the background; it is large only if the camera moved, not for a person.

    Parameters
    ----------
    image, background : float32 array (H, W)
        Depths in metres; pixels that are 0 in either image are ignored.

    Returns
    -------
    float
        A number from 0 to 1; 0 if no pixel is measured in both images.
    """
    both = (image > 0) & (background > 0)
    count = int(both.sum())
    if not count:
        return 0.0
    near, share = BEHIND
    return float((image[both] - background[both] > near + share * image[both]).sum()) / count


def person_extent(image: F32, background: F32 | None, rays: F64) -> tuple[float, float] | None:
    """Return the distance and the size of the person or object in front of the background.

    Parameters
    ----------
    image : float32 array (H, W)
        Depths; 0 where nothing was measured.
    background : float32 array (H, W), optional
        Depths of the empty room; None if every measured pixel belongs to the person.
    rays : float64 array (H, W, 2)
        The rays (a, b, 1) of the pixels.

    Returns
    -------
    tuple of (float, float), optional
        The median depth, and the extent of the points from the 1st to the 99th percentile along the longer axis of the
        image; None if fewer than 0.5 % of all pixels, or fewer than 20, are in front of the background.
    """
    seen = image > 0
    if background is not None:
        seen &= (background > 0) & (image < PERSON_SHARE * background)
    if seen.sum() < max(20, 0.005 * image.size):
        return None
    z = image[seen].astype(np.float64)
    extents = [float(np.diff(np.nanpercentile(rays[seen, axis] * z, [1, 99]))[0]) for axis in (0, 1)]
    return float(np.median(z)), max(extents)
