"""This module defines observations of a body over time, rays of keypoints or positions of joints, and terms of priors.

The cost of a track is the sum of the terms of observations and of priors (thesis, Section 6.4).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.errors import ParameterError

if TYPE_CHECKING:
    pass

MIN_CONFIDENCE = 0.1
"""Confidence below which a keypoint counts as not seen."""


@dataclass(frozen=True, eq=False)
class BodyPoints:
    """Points that are fixed to nodes of a kinematic chain, one for each keypoint.

    Attributes
    ----------
    nodes : int64 array (P,)
        The node that moves each point.
    offsets : float64 array (P, 3)
        The position of each point in the frame of that node, from the node's centre, in metres.
    joints : int64 array (P,)
        The joint of the chain at each point, −1 for other points (a nose, an ear).
    """

    nodes: I64
    offsets: F64
    joints: I64

    def __post_init__(self) -> None:
        if self.offsets.shape != (len(self.nodes), 3) or len(self.joints) != len(self.nodes):
            raise ParameterError("offsets", f"of shape ({len(self.nodes)}, 3)", self.offsets.shape)


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays of keypoints in calibrated cameras (thesis, Eq. 6.3).

    A pixel is the ray C + λ n, λ > 0, from the camera's centre C.

    Attributes
    ----------
    centres : float64 array (V, 3)
        Centres of the cameras in the world, in metres.
    focal_px : float64 array (V,)
        Focal length of each camera in pixels, the mean of both axes.
    directions : float64 array (T, V, P, 3)
        Unit vectors of the rays in the world.
    confidence : float64 array (T, V, P)
        Confidence in [0, 1]; 0 if the keypoint is not seen.
    """

    centres: F64
    focal_px: F64
    directions: F64
    confidence: F64

    def __post_init__(self) -> None:
        frames, cameras, points = self.confidence.shape
        if self.directions.shape != (frames, cameras, points, 3):
            raise ParameterError("directions", f"of shape {(frames, cameras, points, 3)}", self.directions.shape)
        if self.centres.shape != (cameras, 3) or self.focal_px.shape != (cameras,):
            raise ParameterError("centres", f"of shape ({cameras}, 3)", self.centres.shape)


@dataclass(frozen=True, eq=False)
class JointPositions:
    """Positions of joints, from a track of another program or from a take.

    Attributes
    ----------
    positions : float64 array (T, J, 3)
        Joints of the chain in metres, Y up; NaN if a joint was not tracked.
    sigma_m : float64 array (T, J)
        Standard deviation of each position in metres.
    """

    positions: F64
    sigma_m: F64

    def __post_init__(self) -> None:
        if self.positions.shape != (*self.sigma_m.shape, 3):
            raise ParameterError("places", f"of shape {(*self.sigma_m.shape, 3)}", self.positions.shape)


@dataclass(frozen=True, eq=False)
class PriorTerms:
    """The terms that priors add to the cost of a track.

    A rotation term (`turn_`) adds w_d · log(MᵀR)_d² to the cost for each axis d of a node in a frame. A tilt term adds
    w · ‖R₀ᵀe_y − t‖² for the rotation R₀ of the pelvis. A position term (`place_`) adds w · (uᵀ(y − z))² for a joint at
    y, a unit vector u and a position z.

    Attributes
    ----------
    turn_targets : float64 array (T, K, 3, 3)
        The target rotation M of each node; the identity if there is no term.
    turn_weights : float64 array (T, K, 3)
        Weight 1/σ² about X, Y and Z of the node, per rad²; 0 if there is no term.
    tilt_targets : float64 array (T, 3)
        The target t, a unit vector, of the world's up axis in the frame of the pelvis.
    tilt_weights : float64 array (T,)
        Weight of each tilt; 0 if there is no term.
    place_frames, place_joints : int64 array (N,)
        Frame and joint of each place term, frames ascending.
    place_directions : float64 array (N, 3)
        The unit vector u.
    place_targets : float64 array (N,)
        The number uᵀz, in metres.
    place_weights : float64 array (N,)
        Weight 1/σ², per m².
    """

    turn_targets: F64
    turn_weights: F64
    tilt_targets: F64
    tilt_weights: F64
    place_frames: I64
    place_joints: I64
    place_directions: F64
    place_targets: F64
    place_weights: F64


def no_priors(frames: int, nodes: int) -> PriorTerms:
    """Return terms without any prior, for T frames and K nodes."""
    none = np.zeros(0, np.int64)
    return PriorTerms(
        np.broadcast_to(np.eye(3), (frames, nodes, 3, 3)).copy(),
        np.zeros((frames, nodes, 3)),
        np.broadcast_to(np.array([0.0, 1.0, 0.0]), (frames, 3)).copy(),
        np.zeros(frames),
        none,
        none,
        np.zeros((0, 3)),
        np.zeros(0),
        np.zeros(0),
    )
