"""This module sums robust squared distances from rays as a matrix A and a vector b per body point (thesis, 6.2.2).

The ray with unit vector n of a camera at C has the Plücker line (n, m = C × n), and ‖y × n − m‖ of Eq. 6.3 is the
distance of a point y from the ray. It equals ‖e‖ with e = (I − nnᵀ)(y − C). For any number of cameras, a step needs
only the sums A = Σ w(I − nnᵀ) and b = Σ w e over the cameras: H += JᵀAJ and g += Jᵀb, with the Jacobian J of the point.

A residual r = ‖e‖ / (depth · σ_px / f) is in units of the pixels' noise. The loss of Geman and McClure is ρ(r) = r² /
(1 + r²/c²), with the weight ω = (1 + r²/c²)⁻²; c = ∞ gives least squares. Each term is multiplied by the square of the
keypoint's confidence. The depth is taken as constant within a step, so that its derivative is ignored.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.body.kinematic_chain import ChainBody
from kinedex.ops.errors import ParameterError
from kinedex.ops.tracking.observations import MIN_CONFIDENCE, BodyPoints, JointPositions, Rays

SIGMA_PX = 5.0
"""Standard deviation of a keypoint in pixels."""

MIN_DEPTH_M = 0.3
"""Minimum depth in metres; points nearer to the camera, or behind it, are treated as if at this depth."""


class Evidence(NamedTuple):
    """Observations of points of a body, as arrays for compiled functions.

    For rays `positions` is empty; for joint positions V is 0.

    Attributes
    ----------
    nodes : int64 array (P,)
        The node that moves each point.
    offsets : float64 array (P, 3)
        The position of each point in the frame of that node.
    centres : float64 array (V, 3)
        Centres of the cameras.
    directions : float64 array (T, V, P, 3)
        Unit vectors of the rays.
    confidence : float64 array (T, V, P)
        Confidence; 0 where it is below `MIN_CONFIDENCE`.
    scales : float64 array (V,)
        f/σ_px of each camera; divided by the depth, it converts metres to units of noise.
    positions : float64 array (T, P, 3), or (0, 0, 3)
        Observed positions of the points; NaN if there is none.
    precisions : float64 array (T, P), or (0, 0)
        1/σ of each position, per metre.
    """

    nodes: I64
    offsets: F64
    centres: F64
    directions: F64
    confidence: F64
    scales: F64
    positions: F64
    precisions: F64


def make_evidence(
    body: ChainBody, observations: Rays | JointPositions, points: BodyPoints | None, sigma_px: float = SIGMA_PX
) -> Evidence:
    """Return observations as arrays for compiled functions.

    Parameters
    ----------
    body : ChainBody
        The body.
    observations : Rays or JointPositions
        Rays of the P points, or positions of the joints of the chain.
    points : BodyPoints or None
        The points that rays observe; None for joint positions.
    sigma_px : float, optional
        Standard deviation of a keypoint in pixels.

    Raises
    ------
    ParameterError
        The points do not fit the observations or the body, or `sigma_px` is not positive.
    """
    if not (np.isfinite(sigma_px) and sigma_px > 0):
        raise ParameterError("sigma_px", "positive and finite", sigma_px)
    if isinstance(observations, JointPositions):
        return _position_evidence(body, observations)
    if points is None or len(points.nodes) != observations.confidence.shape[2]:
        count = observations.confidence.shape[2]
        raise ParameterError("points", f"the {count} points that the rays observe", points and len(points.nodes))
    if len(points.nodes) and not 0 <= points.nodes.min() <= points.nodes.max() < len(body.chain.nodes):
        raise ParameterError("nodes of points", f"from 0 to {len(body.chain.nodes) - 1}", points.nodes.tolist())
    seen = (observations.confidence >= MIN_CONFIDENCE) & np.isfinite(observations.directions).all(axis=3)
    return Evidence(
        np.ascontiguousarray(points.nodes, np.int64),
        np.ascontiguousarray(points.offsets, np.float64),
        np.ascontiguousarray(observations.centres, np.float64),
        np.ascontiguousarray(observations.directions, np.float64),
        np.ascontiguousarray(np.where(seen, observations.confidence, 0.0)),
        np.asarray(observations.focal_px, np.float64) / sigma_px,
        np.zeros((0, 0, 3)),
        np.zeros((0, 0)),
    )


def _position_evidence(body: ChainBody, observations: JointPositions) -> Evidence:
    frames, joints = observations.sigma_m.shape
    if joints != len(body.chain.joints):
        raise ParameterError("places", f"of the {len(body.chain.joints)} joints of the chain", joints)
    seen: Bool = np.asarray(np.isfinite(observations.positions).all(axis=2))
    if not np.all(observations.sigma_m[seen] > 0):
        raise ParameterError("sigma_m", "positive wherever a place is given", float(observations.sigma_m[seen].min()))
    return Evidence(
        body.arrays.joint_nodes,
        body.arrays.joint_offsets,
        np.zeros((0, 3)),
        np.zeros((frames, 0, joints, 3)),
        np.zeros((frames, 0, joints)),
        np.zeros(0),
        np.ascontiguousarray(np.where(seen[:, :, None], observations.positions, np.nan)),
        np.ascontiguousarray(1.0 / np.where(seen, observations.sigma_m, 1.0)),
    )


@njit(cache=True, nogil=True)
def point_terms(
    evidence: Evidence, t: int, points: F64, width: float, units: F64, matrices: F64, vectors: F64
) -> float:
    """Compute A and b of each point of one frame, and return the cost.

    Parameters
    ----------
    evidence : Evidence
        The observations.
    t : int
        The frame.
    points : float64 array (P, 3)
        The points of the body in the world.
    width : float
        The width c of the loss of Geman and McClure; infinite for least squares.
    units : float64 array (V, P)
        Output: (depth · σ_px / f)⁻², the square of the factor that converts metres to units of noise.
    matrices : float64 array (P, 3, 3)
        Output: A = Σ w(I − nnᵀ), with w = conf² ω / (depth · σ_px / f)².
    vectors : float64 array (P, 3)
        Output: b = Σ w e.

    Returns
    -------
    float
        The cost Σ conf² ρ(r).
    """
    total, flat = 0.0, width**-2.0
    matrices[:] = 0.0
    vectors[:] = 0.0
    for v in range(len(evidence.centres)):
        for p in range(len(points)):
            confidence = evidence.confidence[t, v, p]
            if confidence <= 0.0:
                continue
            i, j, k = evidence.directions[t, v, p]
            x = points[p, 0] - evidence.centres[v, 0]
            y = points[p, 1] - evidence.centres[v, 1]
            z = points[p, 2] - evidence.centres[v, 2]
            along = x * i + y * j + z * k
            x, y, z = x - along * i, y - along * j, z - along * k
            unit = (evidence.scales[v] / max(MIN_DEPTH_M, along)) ** 2
            units[v, p] = unit
            square = unit * (x * x + y * y + z * z)
            share = 1.0 / (1.0 + flat * square)
            total += confidence * confidence * square * share
            w = confidence * confidence * share * share * unit
            matrices[p, 0, 0] += w * (1.0 - i * i)
            matrices[p, 1, 0] -= w * i * j
            matrices[p, 1, 1] += w * (1.0 - j * j)
            matrices[p, 2, 0] -= w * i * k
            matrices[p, 2, 1] -= w * j * k
            matrices[p, 2, 2] += w * (1.0 - k * k)
            vectors[p, 0] += w * x
            vectors[p, 1] += w * y
            vectors[p, 2] += w * z
    if len(evidence.positions) > 0:
        total += _add_position_terms(evidence, t, points, flat, matrices, vectors)
    for p in range(len(points)):
        matrices[p, 0, 1] = matrices[p, 1, 0]
        matrices[p, 0, 2] = matrices[p, 2, 0]
        matrices[p, 1, 2] = matrices[p, 2, 1]
    return total


@njit(cache=True, nogil=True)
def _add_position_terms(evidence: Evidence, t: int, points: F64, flat: float, matrices: F64, vectors: F64) -> float:
    total = 0.0
    for p in range(len(points)):
        x = points[p, 0] - evidence.positions[t, p, 0]
        if np.isnan(x):
            continue
        y = points[p, 1] - evidence.positions[t, p, 1]
        z = points[p, 2] - evidence.positions[t, p, 2]
        unit = evidence.precisions[t, p] ** 2
        square = unit * (x * x + y * y + z * z)
        share = 1.0 / (1.0 + flat * square)
        total += square * share
        w = share * share * unit
        matrices[p, 0, 0] += w
        matrices[p, 1, 1] += w
        matrices[p, 2, 2] += w
        vectors[p, 0] += w * x
        vectors[p, 1] += w * y
        vectors[p, 2] += w * z
    return total


@njit(cache=True, nogil=True)
def point_cost(evidence: Evidence, t: int, points: F64, width: float, units: F64, fresh: bool) -> float:
    """Return the cost Σ conf² ρ(r) of one frame.

    Parameters
    ----------
    evidence : Evidence
        The observations.
    t : int
        The frame.
    points : float64 array (P, 3)
        The points of the body in the world.
    width : float
        The width c of the loss of Geman and McClure; infinite for least squares.
    units : float64 array (V, P)
        The squares of the factors that convert metres to units of noise, see `point_terms`.
    fresh : bool
        True to compute `units` from the depths of the points; False to use the given values, which are constant within
        a step.
    """
    total, flat = 0.0, width**-2.0
    for v in range(len(evidence.centres)):
        for p in range(len(points)):
            confidence = evidence.confidence[t, v, p]
            if confidence <= 0.0:
                continue
            i, j, k = evidence.directions[t, v, p]
            x = points[p, 0] - evidence.centres[v, 0]
            y = points[p, 1] - evidence.centres[v, 1]
            z = points[p, 2] - evidence.centres[v, 2]
            along = x * i + y * j + z * k
            if fresh:
                units[v, p] = (evidence.scales[v] / max(MIN_DEPTH_M, along)) ** 2
            x, y, z = x - along * i, y - along * j, z - along * k
            square = units[v, p] * (x * x + y * y + z * z)
            total += confidence * confidence * square / (1.0 + flat * square)
    if len(evidence.positions) > 0:
        for p in range(len(points)):
            square = 0.0
            for a in range(3):
                square += (points[p, a] - evidence.positions[t, p, a]) ** 2
            square *= evidence.precisions[t, p] ** 2
            if square == square:
                total += square / (1.0 + flat * square)
    return total
