"""Check a depth recording on a few of its frames, and suggest the cause of a fault."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kinedex.catalog.depth_cameras import DepthCamera
from kinedex.ops.depth.background import behind_share, person_extent

F32 = npt.NDArray[np.float32]

NEAREST_M, FARTHEST_M = 0.4, 8.0
"""The smallest and largest distance of a person from the camera, in metres."""

SMALLEST_M, LARGEST_M = 0.45, 4.5
"""The smallest and largest extent of the foreground in metres; two persons may be 3 m apart."""

PERSON_M = 0.5, 2.3
"""The smallest and largest size of a person in metres, by which the likely unit is chosen."""

MAX_BEHIND = 0.2
"""The fraction of pixels behind the background from which it follows that the camera has moved."""

OTHER_UNIT = 5.0
"""The ratio between the distances in the images and in the background from which it follows that the units differ."""

MAX_ROOM = 0.5
"""The fraction of measured pixels from which it follows that the images show the room."""

UNITS_M = (0.001, 0.0001, 0.0002, 0.00025, 0.000125, 0.0005, 0.01, 1.0, 0.0254)
"""Metres per unit of depth cameras and clouds that are tried, the usual ones first."""

_OFF_CENTRE = 0.25
_NEAR_PERCENTILE = 10.0
_USUAL_SIZE_M, _USUAL_DISTANCE_M = 1.5, 2.5


class Extents(NamedTuple):
    """Distance and size of the person in a few frames, or the distance of the nearest part of the room.

    Attributes
    ----------
    distance : float
        The median distance in metres.
    least, greatest : float
        Sizes in metres; infinity and 0 if the frames show the room.
    """

    distance: float
    least: float
    greatest: float

    @property
    def sized(self) -> bool:
        """True if the sizes are plausible for a person."""
        return self.greatest > 0


def measured_extents(camera: DepthCamera, images: Mapping[int, F32], background: F32 | None) -> Extents | None:
    """Return distance and size of the object in front of the background.

    Parameters
    ----------
    camera : DepthCamera
        The camera.
    images : mapping of int to float32 array (H, W)
        A few frames.
    background : float32 array (H, W), optional
        The empty room; None if the room was removed from the images.

    Returns
    -------
    Extents, optional
        The extents of the person, or of the nearest part of the room if the person cannot be distinguished from it;
        None if nothing is seen.
    """
    found = [
        one
        for image in images.values()
        if (one := person_extent(image, background, camera.rays)) is not None and np.isfinite(one).all()
    ]
    if not found:
        return None
    if background is None and shows_room(images):  # only the nearest part: halls are deeper than 8 m
        nearest = [float(np.percentile(image[image > 0], _NEAR_PERCENTILE)) for image in images.values() if image.any()]
        return Extents(float(np.median(nearest)), np.inf, 0.0)
    distances, sizes = zip(*found, strict=True)
    return Extents(float(np.median(distances)), min(sizes), max(sizes))


def unit_fault(extents: Extents, unit_m: float) -> str:
    """Return a message if distance or size contradict the unit; empty if the unit may be right.

    Parameters
    ----------
    extents : Extents
        Distance and size in the frames.
    unit_m : float
        The unit in metres in which the frames were read.
    """
    near = NEAREST_M <= extents.distance <= FARTHEST_M
    sized = not extents.sized or (extents.greatest >= SMALLEST_M and extents.least <= LARGEST_M)
    if near and sized:
        return ""
    seen = f"puts who is seen {extents.distance:.3g} m away"
    seen += f", {extents.greatest:.3g} m large" if extents.sized else ""
    fits = [
        unit
        for unit in UNITS_M
        if NEAREST_M <= extents.distance * unit / unit_m <= FARTHEST_M
        and (not extents.sized or PERSON_M[0] <= extents.greatest * unit / unit_m <= PERSON_M[1])
    ]
    if extents.sized:
        fits.sort(key=lambda unit: _unlikely(extents, unit / unit_m))
    expected = f"expected {NEAREST_M:g} to {FARTHEST_M:g} m" + (", and the size of a person" if extents.sized else "")
    if not fits:
        return f"{unit_m:g} {seen}; {expected}: are unit, fx and fy those of this recording?"
    size = f" and {extents.greatest * fits[0] / unit_m:.2f} m" if extents.sized else ""
    distance = f"{extents.distance * fits[0] / unit_m:.2f} m"
    return f"{unit_m:g} {seen}; {expected}: `depth_unit_m: {fits[0]:g}` gives {distance}{size}"


def _unlikely(extents: Extents, scale: float) -> float:
    """Return a measure of how implausible distance and size, multiplied by a scale, are for a person."""
    size = abs(np.log(extents.greatest * scale / _USUAL_SIZE_M))
    return float(size + abs(np.log(extents.distance * scale / _USUAL_DISTANCE_M)))


def moved_frames(images: Mapping[int, F32], background: F32) -> dict[int, float]:
    """Return, by frame, the fraction of pixels behind the background, for frames in which it is too large."""
    shares = {frame: behind_share(image, background) for frame, image in images.items()}
    return {frame: share for frame, share in shares.items() if share > MAX_BEHIND}


def other_unit(images: Mapping[int, F32], background: F32) -> float | None:
    """Return the ratio of distances in the images to the background's if it implies another unit; otherwise None."""
    ratios = [
        np.median(image[both] / background[both])
        for image in images.values()
        if (both := (image > 0) & (background > 0)).any()
    ]
    factor = float(np.median(ratios)) if ratios else 1.0
    return factor if factor > OTHER_UNIT or factor < 1 / OTHER_UNIT else None


def likely_unit(unit_m: float) -> float:
    """Return the usual unit that is nearest to a given unit in metres."""
    return min(UNITS_M, key=lambda one: abs(float(np.log(one / unit_m))))


def shows_room(images: Mapping[int, F32]) -> bool:
    """Return True if the images show the room behind the person."""
    return bool(images) and float(np.median([(image > 0).mean() for image in images.values()])) > MAX_ROOM


def intrinsics_note(camera: DepthCamera) -> str:
    """Return a note on a principal point far from the middle of the image; empty if it is near the middle."""
    for side, centre, name in (
        (camera.size[0], camera.matrix[0, 2], "cx"),
        (camera.size[1], camera.matrix[1, 2], "cy"),
    ):
        if abs(centre - (side - 1) / 2) > _OFF_CENTRE * side:
            return (
                f"{name} {centre:g} lies far from the middle of {side} pixels: are the intrinsics those of images of "
                "this size?"
            )
    return ""
