"""From distance curves to annotated segments (thesis, Chapter 5.2)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numba as nb
import numpy as np
import numpy.typing as npt

from ops.errors import ParameterError

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

TOLERANCE = 1e-9


@dataclass(frozen=True, order=True)
class Segment:
    """Frames [start, stop) that bear the label of a class.

    cost: the least distance in the segment. subclass: index of the curve that reached it. confidence: from 0 (something
    else explains the frames as well) to 1 (nothing else comes near).
    """

    start: int
    stop: int
    class_index: int
    cost: float
    subclass: int
    confidence: float = field(default=1.0, compare=False)


def local_minima(curve: F64, threshold: float) -> I64:
    """Return the frames where a distance curve has a local minimum below a threshold.

    A minimum is finite and not above either neighbour, ∞ beyond the ends: every frame of a low plateau counts.
    Costs closer than 1e-9 are equal.

    Parameters
    ----------
    curve: float64 (L,), ∞ where no path ends.
    threshold: τ > 0.

    Returns
    -------
    int64 (M,), ascending.
    """
    if not threshold > 0:
        raise ParameterError("threshold", "above 0", threshold)
    beyond = np.concatenate(([np.inf], curve, [np.inf]))
    low = curve < threshold - TOLERANCE
    low &= curve <= beyond[:-2] + TOLERANCE
    low &= curve <= beyond[2:] + TOLERANCE
    return np.flatnonzero(low).astype(np.int64)


def spread_minima(curve: F64, starts: I64, ends: I64) -> F64:
    """Give all frames from start to end of each minimum its distance at most: the modified curve (Eq. 5.4).

    Parameters
    ----------
    curve: float64 (L,), the distance curve.
    starts, ends: int64 (M,), first and last frame of each minimum's best path, both included.

    Returns
    -------
    float64 (L,), ∞ where no minimum reaches.
    """
    if len(starts) != len(ends) or np.any(starts > ends):
        raise ParameterError("starts", "one for each end, and not after it", (len(starts), len(ends)))
    spread = np.full(len(curve), np.inf)
    lower_stretches(spread, np.asarray(starts, np.int64), np.asarray(ends, np.int64), curve[ends])
    return spread


def annotate(modified: F64, classes: I64, threshold: float | F64 = np.inf) -> list[Segment]:
    """Label every frame with the class that explains it best, and grow the labelled runs (Eq. 5.5 to 5.7).

    A class takes the least of its subclasses' modified curves; ties go to the first class, and within it to the
    first subclass. A run of a label grows to the left while the class's modified curve, read leftwards, does not
    rise, and to the right likewise. Grown segments of one class that overlap or touch are one.

    Parameters
    ----------
    modified: float64 (S, L), the modified curve of each subclass (see `spread_minima`).
    classes: int64 (S,), the class of each subclass, 0 … P − 1.
    threshold: τ, or float64 with one for each class, which the confidence is measured against where no other class is
        nearer: 1 − cost / rival, the rival being the mean over the segment's frames of the nearest other class's
        modified curve, or the class's own τ where that is less.

    Returns
    -------
    Segments ordered by start, stop and class; those of different classes may overlap.
    """
    subclasses, frames = modified.shape
    if len(classes) != subclasses or (subclasses and classes.min() < 0):
        raise ParameterError("classes", f"one index for each of {subclasses} subclasses", len(classes))
    if not subclasses or not frames:
        return []
    curves, best = _class_curves(modified, classes)
    taus = np.broadcast_to(np.asarray(threshold, np.float64), np.shape(threshold) or (len(curves),)).tolist()
    labels = _labels(curves)
    segments = []
    for class_index in np.unique(labels[labels >= 0]).tolist():
        for start, stop in grow(curves[class_index], labels == class_index):
            at = start + int(np.argmin(curves[class_index, start:stop]))
            cost = float(curves[class_index, at])
            sure = _confidence(curves, class_index, slice(start, stop), cost, taus[class_index])
            segments.append(Segment(start, stop, class_index, cost, int(best[class_index, at]), sure))
    return sorted(segments)


def _confidence(curves: F64, class_index: int, frames: slice, cost: float, threshold: float) -> float:
    before = curves[:class_index, frames].min(axis=0, initial=threshold)
    after = curves[class_index + 1 :, frames].min(axis=0, initial=threshold)
    rival = float(np.minimum(before, after).mean())
    return 1.0 - min(cost / rival, 1.0) if rival > 0 else 0.0


def _class_curves(modified: F64, classes: I64) -> tuple[F64, I64]:
    """Return the least modified curve of each class, and which subclass it comes from."""
    count = int(classes.max()) + 1
    curves = np.full((count, modified.shape[1]), np.inf)
    best = np.zeros((count, modified.shape[1]), np.int64)
    for class_index in range(count):
        members = np.flatnonzero(classes == class_index)
        if len(members) == 1:
            curves[class_index], best[class_index] = modified[members[0]], members[0]
        elif len(members):
            curves[class_index] = modified[members].min(axis=0)
            best[class_index] = members[np.argmax(modified[members] <= curves[class_index] + TOLERANCE, axis=0)]
    return curves, best


def _labels(curves: F64) -> I64:
    """Return the first class of least cost at every frame, −1 where all are ∞."""
    least = curves.min(axis=0)
    labels = np.argmax(curves <= least + TOLERANCE, axis=0).astype(np.int64)
    labels[np.isinf(least)] = -1
    return labels


def grow(curve: F64, labelled: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Grow the runs of labelled frames along a modified curve, and merge what overlaps or touches (Eq. 5.7)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], labelled, [False])).astype(np.int8)))
    # rises[n]: the curve rises from frame n to n + 1; ∞ − ∞ is no rise, and no run comes to stand on ∞.
    ahead, behind = curve[1:], curve[:-1]
    rises = np.flatnonzero(ahead > behind + TOLERANCE)
    falls = np.flatnonzero(behind > ahead + TOLERANCE)
    grown: list[tuple[int, int]] = []
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        wall = np.searchsorted(falls, start)  # leftwards it rises where, read forwards, it falls
        left = int(falls[wall - 1]) + 1 if wall > 0 else 0
        wall = np.searchsorted(rises, stop - 1)
        right = int(rises[wall]) + 1 if wall < len(rises) else len(curve)
        if grown and left <= grown[-1][1]:
            grown[-1] = (min(left, grown[-1][0]), max(right, grown[-1][1]))
        else:
            grown.append((left, right))
    return grown


@nb.njit(cache=True, nogil=True)
def lower_stretches(curve: F64, starts: I64, ends: I64, costs: F64) -> None:
    """Lower the curve to each stretch's cost, from its start to its end, in place (kernel)."""
    for place in range(len(starts)):
        for frame in range(starts[place], ends[place] + 1):
            if costs[place] < curve[frame]:
                curve[frame] = costs[place]
