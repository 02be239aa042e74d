"""Find joints that are computed from substitute points in frames in which their own points are hidden.

A joint is reported if its substitutes are used often, or if they place it clearly beside its own points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.skeleton_fit import Fit, Mix

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

_COMPARED = 500  # frames in which a joint is compared with the position that its substitutes give
_BESIDE_M = 0.02  # distance between the two from which on there is a warning
_OFTEN = 0.1  # share of frames with substitutes from which on a joint counts as estimated


class ReplacedJoints(NamedTuple):
    """The joints that are computed from substitute points where their own points are hidden.

    Attributes
    ----------
    warnings : list of str
        A warning on joints whose substitutes place them at a distance from their own points.
    estimated : dict of str to str
        Joint → how it is estimated, for joints with substitutes in a tenth of the frames or more.
    """

    warnings: list[str]
    estimated: dict[str, str]


def replaced_joints(points: F64, fit: Fit, positions: F64, joints: tuple[str, ...], unit_m: float) -> ReplacedJoints:
    """Find the joints that are computed from substitute points where their own points are hidden.

    Parameters
    ----------
    points : float64 array (N, 3, T)
        The points, whose short gaps are filled.
    fit : Fit
        The skeleton mapping.
    positions : float64 array (J, 3, T)
        The joints in metres.
    joints : tuple of str
        The names of the J joints.
    unit_m : float
        Metres of the points' unit.
    """
    found, estimated, count = [], dict[str, str](), points.shape[2]
    for joint, others in fit.instead.items():
        first = fit.joints[joint]
        if first is None or first.of_joints:
            continue
        lost = np.isnan(points[[fit.indices[name] for name in first.names]]).any(axis=(0, 1))
        if not lost.any():
            continue
        seen = np.flatnonzero(~lost)[:: max(1, np.count_nonzero(~lost) // _COMPARED)]
        frames, far, hidden = 0, 0.0, np.count_nonzero(lost)
        for other in others:
            there = lost & ~np.isnan(_other_points(points, fit, positions, joints, other)).any(axis=(0, 1))
            away = _moved(points, fit, positions, joints, joint, other, seen, unit_m) if there.any() else 0.0
            if away > _BESIDE_M:
                frames, far = frames + int(np.count_nonzero(there)), max(far, away)
            lost &= ~there
        replaced = hidden - np.count_nonzero(lost)
        if replaced >= _OFTEN * count:
            estimated[joint] = f"from other points in {replaced} of {count} frames"
        if frames:
            found.append(f"{joint} in {frames} frames (by {100 * far:.0f} cm)")
    text = "where their points are hidden, joints are placed by others, beside where they would be"
    return ReplacedJoints([f"{text}: {', '.join(found)}"] if found else [], estimated)


def _other_points(points: F64, fit: Fit, positions: F64, joints: tuple[str, ...], mix: Mix) -> F64:
    """Return the points, or the joints, that a mix combines (n, 3, T)."""
    if mix.of_joints:
        return positions[[joints.index(name) for name in mix.names]]
    return points[[fit.indices[name] for name in mix.names]]


def _moved(
    points: F64, fit: Fit, positions: F64, joints: tuple[str, ...], joint: str, mix: Mix, frames: I64, unit_m: float
) -> float:
    """Return the 90th percentile of the distance between a mix and its joint in metres; 0 if never seen together."""
    parts = _other_points(points, fit, positions, joints, mix)[:, :, frames]
    axes, scale = (np.eye(3), 1.0) if mix.of_joints else (fit.mapping.axes, unit_m)
    placed = scale * axes @ mix.apply(dict(zip(mix.names, parts, strict=True)), float(np.sign(np.linalg.det(axes))))
    away = np.linalg.norm(placed - positions[joints.index(joint)][:, frames], axis=0)
    away = away[np.isfinite(away)]
    return float(np.percentile(away, 90)) if len(away) else 0.0
