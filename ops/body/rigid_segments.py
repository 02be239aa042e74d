"""Fit the pose of a rigid segment to those of its markers that are seen, and place the hidden ones by it.

The pose is the rotation and shift that fit the markers' places in a template by least squares (W. Kabsch, Acta
Crystallographica A32 (1976), 922-923).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.errors import ParameterError

MIN_MARKERS = 3
"""The smallest number of markers that determine a pose."""

_FLAT = 0.05  # ratio of the second to the first extent of a template, below which its markers lie on a line
_MOST_FRAMES = 64  # frames that a template is made of, spread evenly
_FEW_FRAMES = 8  # least frames in which all markers are seen
_MOST_PATTERNS = 12  # sets of markers that are seen together, the most frequent ones first
_FARTHEST = 1e100  # coordinates whose products are finite
_LEAST = 0.25  # share of the tolerance: errors of markers on the skin, even if fewer show
_NEAREST = (4, 3)  # further numbers of markers that are tried, those whose distance to the hidden one varies least


class Poses(NamedTuple):
    """The poses of a segment in T frames: a point p of the template lies at rotations[t] @ p + shifts[t]."""

    rotations: F64
    shifts: F64


class Placed(NamedTuple):
    """A hidden marker as its segment places it.

    Attributes
    ----------
    positions : float64 array (3, T)
        NaN in frames in which it is not placed.
    markers : int64 array (T,)
        The number of markers that the pose was fitted to; 0 where it is not placed.
    """

    positions: F64
    markers: I64


def fit_poses(template: F64, positions: F64) -> Poses:
    """Return the poses in which a template fits markers best, by the sum of squared distances.

    Parameters
    ----------
    template : float64 array (N, 3)
        The places of at least three markers in the axes of their segment, which do not lie on a line.
    positions : float64 array (N, 3, T)
        Their places in T frames, all of them finite.

    Raises
    ------
    ParameterError
        There are fewer than three markers, or they lie on a line, so that the turn about it is unknown.
    """
    if not is_spread(template):
        raise ParameterError("template", f"{MIN_MARKERS} markers or more that do not lie on a line", template.tolist())
    return _poses(template, positions)


def _poses(template: F64, positions: F64) -> Poses:
    middle, middles = template.mean(axis=0), positions.mean(axis=0)
    products = np.einsum("ni,njt->tji", template - middle, positions - middles)
    left, _, right = np.linalg.svd(products)
    left[:, :, 2] *= (_handedness(left) * _handedness(right))[:, None]
    rotations = left @ right
    return Poses(rotations, middles.T - rotations @ middle)


def _handedness(turns: F64) -> F64:
    """Return 1 for each rotation of (T, 3, 3) orthogonal matrices, and -1 for each reflection."""
    (a, b, c), (d, e, f), (g, h, i) = turns.transpose(1, 2, 0)
    signs: F64 = np.sign(a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g))
    return signs


def is_spread(template: F64) -> bool:
    """Return whether the markers of a template (N, 3) do not lie on a line, so that they determine a pose."""
    extents = np.linalg.svd(template - template.mean(axis=0), compute_uv=False)
    return bool(len(template) >= MIN_MARKERS and extents[1] > _FLAT * extents[0])


def mean_shape(positions: F64) -> F64:
    """Return the mean places (N, 3) of markers (N, 3, T) in the axes of their segment, which is that of a middle frame.

    Raises
    ------
    ParameterError
        There are fewer than three markers, or they lie on a line.
    """
    shape = positions[:, :, positions.shape[2] // 2]
    return in_segment(fit_poses(shape - shape.mean(axis=0), positions), positions).mean(axis=2)


def in_segment(poses: Poses, positions: F64) -> F64:
    """Return the places (N, 3, T) of markers in the axes of their segment."""
    return np.einsum("tji,njt->nit", poses.rotations, positions - poses.shifts.T)


def placed_by_segment(positions: F64, hidden: int, wanted: Bool, tolerance: float) -> Placed:
    """Place a hidden marker by the pose of its segment, which is fitted to the other markers.

    Sets of other markers are tried: those that are seen most often in the wanted frames. A set is tested in frames in
    which it and the hidden marker are seen: the mean place of the marker in the axes of the segment, from half of these
    frames, is compared with its places in the other half. In a gap, the place of the marker in the axes of the segment
    is interpolated between its places at both ends of the gap.

    Parameters
    ----------
    positions : float64 array (N, 3, T)
        The markers of a segment; NaN where one is not seen.
    hidden : int
        Index of the marker to place.
    wanted : bool array (T,)
        The frames in which it is to be placed.
    tolerance : float
        The largest error in nine of ten frames in which a set of markers is tested, in the unit of the positions.
    """
    seen: Bool = np.asarray((np.abs(positions) < _FARTHEST).all(axis=1))
    positions = np.where(seen[:, None], positions, np.nan)
    placed = np.full(positions.shape[1:], np.nan)
    used = np.zeros(positions.shape[2], np.int64)
    own = seen[hidden].copy()
    seen[hidden] = False
    spread = _distance_spread(positions, hidden)
    packed = np.packbits(seen[:, wanted], axis=0)
    shown = np.ascontiguousarray(packed.T).view(f"S{len(packed)}")[:, 0]  # bytes sort as the columns do
    _, firsts, which, counts = np.unique(shown, return_index=True, return_inverse=True, return_counts=True)
    frames = np.flatnonzero(wanted)
    made: dict[tuple[int, ...], _Template | None] = {}
    for k in np.argsort(-counts, kind="stable")[:_MOST_PATTERNS]:
        there = np.flatnonzero(seen[:, frames[firsts[k]]] & (spread <= tolerance))
        there = there[np.argsort(spread[there], kind="stable")]
        best = _good_template(positions, hidden, own, there, tolerance, made)
        if best is not None:
            at = frames[which.reshape(-1) == k]
            placed[:, at] = _between_ends(positions, hidden, own, best, at)
            used[at] = len(best.markers)
    return Placed(placed, used)


class PlacedByShape(NamedTuple):
    """A hidden marker as the shape of its segment in a static trial places it.

    Attributes
    ----------
    positions : float64 array (3, T)
        NaN in frames in which it is not placed.
    markers : int64 array (T,)
        The number of markers that the pose was fitted to; 0 where it is not placed.
    errors : float64 array (T,)
        The error to be expected, in the unit of the positions; infinite where it is not placed.
    """

    positions: F64
    markers: I64
    errors: F64


def placed_by_shape(positions: F64, hidden: int, wanted: Bool, shape: F64, tolerance: float) -> PlacedByShape:
    """Place a hidden marker by the shape that its segment has in a static trial, fitted to the markers that are seen.

    Of the markers that are seen together, the one that is farthest from its place is left out, one after the other,
    until all are within the tolerance in nine of ten frames. Where the hidden marker appears beside its place at the
    ends of a gap, the difference goes straight from one end to the other.

    Parameters
    ----------
    positions : float64 array (N, 3, T)
        The markers of a segment; NaN where one is not seen.
    hidden : int
        Index of the marker to place.
    wanted : bool array (T,)
        The frames in which it is to be placed.
    shape : float64 array (N, 3)
        The places of the markers in any axes of the segment; NaN for those that the static trial lacks.
    tolerance : float
        The largest distance of a marker from its place in the shape, in the unit of the positions.
    """
    frames = positions.shape[2]
    found = PlacedByShape(np.full((3, frames), np.nan), np.zeros(frames, np.int64), np.full(frames, np.inf))
    seen: Bool = np.asarray((np.abs(positions) < _FARTHEST).all(axis=1))
    positions = np.where(seen[:, None], positions, np.nan)
    own = seen[hidden].copy()
    seen[hidden] = False
    seen[~np.isfinite(shape).all(axis=1)] = False
    if not wanted.any() or not np.isfinite(shape[hidden]).all():
        return found
    patterns, which = np.unique(seen[:, wanted], axis=1, return_inverse=True)
    for k in range(patterns.shape[1]):
        at = np.flatnonzero(wanted)[which.reshape(-1) == k]
        best = _shape_template(positions, hidden, shape, np.flatnonzero(patterns[:, k]), at, tolerance)
        if best is not None:
            found.positions[:, at] = _between_ends(positions, hidden, own, best, at)
            found.markers[at], found.errors[at] = len(best.markers), best.error
    return found


def _shape_template(
    positions: F64, hidden: int, shape: F64, there: I64, frames: I64, tolerance: float
) -> _Template | None:
    """Return the template of those markers that keep their places in the shape; None if they are too few."""
    frames = _some(frames)
    while len(there) >= MIN_MARKERS and is_spread(shape[there]):
        places = positions[there][:, :, frames]
        away = np.linalg.norm(in_segment(_poses(shape[there], places), places) - shape[there][:, :, None], axis=1)
        errors = np.percentile(away, 90, axis=1)
        if errors.max() <= tolerance:
            noise = max(float(errors.max()), _LEAST * tolerance)
            return _Template(there, shape[there], shape[hidden], noise * leverage(shape[there], shape[hidden]))
        there = np.delete(there, np.argmax(errors))
    return None


def leverage(template: F64, place: F64) -> float:
    """Return by how much the error of a place exceeds that of each marker, if the pose is fitted to markers.

    Independent errors of the markers shift the pose, and turn it about each principal axis by as much less as the
    markers lie farther from this axis.

    Parameters
    ----------
    template : float64 array (N, 3)
        The places of the markers.
    place : float64 array (3,)
        The place that the pose determines.
    """
    middle = template.mean(axis=0)
    _, extents, axes = np.linalg.svd(template - middle, full_matrices=False)
    along = axes @ (place - middle)
    squares, lengths = along**2, extents**2
    turns = (squares.sum() - squares) / np.maximum(lengths.sum() - lengths, np.finfo(float).tiny)
    return float(np.sqrt(1.0 / len(template) + turns.sum() / 3))


def _some(frames: I64) -> I64:
    """Return at most `_MOST_FRAMES` of the given frames, spread evenly."""
    return frames[np.unique(np.linspace(0, len(frames) - 1, min(len(frames), _MOST_FRAMES)).astype(int))]


class _Template(NamedTuple):
    """Markers, their places in the segment, the place of the hidden one, and a bound of its error in other frames."""

    markers: I64
    shape: F64
    place: F64
    error: float


def _distance_spread(positions: F64, hidden: int) -> F64:
    """Return the standard deviation of the distance between each marker and the hidden one; infinite if never seen."""
    away = np.linalg.norm(positions - positions[hidden], axis=1)
    known = np.isfinite(away)
    counts = known.sum(axis=1)
    means = np.where(known, away, 0.0).sum(axis=1) / np.maximum(counts, 1)
    squares = np.where(known, (away - means[:, None]) ** 2, 0.0).sum(axis=1)
    return np.where(counts > 0, np.sqrt(squares / np.maximum(counts, 1)), np.inf)


def _good_template(
    positions: F64, hidden: int, own: Bool, there: I64, tolerance: float, made: dict[tuple[int, ...], _Template | None]
) -> _Template | None:
    """Return the template of all markers that are seen if it is good, or else the largest good one of the steadiest.

    Return None if none is good. Templates are cached in `made` by their markers, since different sets of seen markers
    often have the same steadiest ones.
    """
    for count in dict.fromkeys((len(there), *(n for n in _NEAREST if n < len(there)))):
        markers = tuple(there[:count].tolist())
        if count >= MIN_MARKERS and markers not in made:
            made[markers] = _template(positions, hidden, own, there[:count], tolerance)
        found = made.get(markers)
        if found is not None and found.error <= tolerance:
            return found
    return None


def _template(positions: F64, hidden: int, own: Bool, markers: I64, tolerance: float) -> _Template | None:
    """Return the template of markers; its error is infinite if that of nine in ten frames exceeds the tolerance."""
    frames = np.flatnonzero(own & np.isfinite(positions[markers]).all(axis=(0, 1)))
    if len(frames) < _FEW_FRAMES:
        return None
    frames = _some(frames)
    places = positions[np.append(markers, hidden)][:, :, frames]
    try:
        shape = mean_shape(places[:-1])
        inside = in_segment(fit_poses(shape, places[:-1]), places[-1:])[0]
    except ParameterError:  # they lie on a line
        return None
    first = inside[:, ::2].mean(axis=1)
    away = np.linalg.norm(inside[:, 1::2] - first[:, None], axis=0)
    far = np.count_nonzero(away > tolerance)
    good = bool(not far or (far < 0.1 * len(away) + 1 and np.percentile(away, 90) <= tolerance))
    return _Template(markers, shape, inside.mean(axis=1), tolerance if good else np.inf)


def _between_ends(positions: F64, hidden: int, own: Bool, template: _Template, frames: I64) -> F64:
    """Return the hidden marker (3, n) in frames; its place in the segment is interpolated between the ends of gaps."""
    known = np.flatnonzero(own & np.isfinite(positions[template.markers]).all(axis=(0, 1)))
    if not len(known):
        poses = _poses(template.shape, positions[template.markers][:, :, frames])
        return np.asarray(poses.rotations @ template.place + poses.shifts).T
    after = np.searchsorted(known, frames)
    ends = np.unique(np.concatenate([known[np.maximum(after - 1, 0)], known[np.minimum(after, len(known) - 1)]]))
    poses = _poses(template.shape, positions[template.markers][:, :, ends])
    at_ends = in_segment(poses, positions[hidden][None, :, ends])[0]
    inside = np.stack([np.interp(frames, ends, row) for row in at_ends])
    poses = _poses(template.shape, positions[template.markers][:, :, frames])
    return np.einsum("tij,jt->it", poses.rotations, inside) + poses.shifts.T
