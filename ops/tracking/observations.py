"""This module defines observations of a body over time: rays of keypoints, and positions of joints."""

from __future__ import annotations

from dataclasses import dataclass

from kinedex.ops.arrays import F64, I64
from kinedex.ops.errors import ParameterError


@dataclass(frozen=True, eq=False)
class BodyPoints:
    """Points that are fixed to nodes of a kinematic chain, one for each keypoint.

    Attributes
    ----------
    nodes : int64 array (P,)
        The node that moves each point.
    offsets : float64 array (P, 3)
        Its place in the frame of that node, from the node's centre, in metres.
    joints : int64 array (P,)
        The joint of the chain at the point, −1 for other points (a nose, an ear).
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
        Confidence in [0, 1]; 0 where the keypoint is not seen.
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
class Places:
    """Positions of joints, from a track of another program or from a take.

    Attributes
    ----------
    places : float64 array (T, J, 3)
        Joints of the chain in metres, Y up; NaN where a joint was not tracked.
    sigma_m : float64 array (T, J)
        Standard deviation of each position in metres.
    """

    places: F64
    sigma_m: F64

    def __post_init__(self) -> None:
        if self.places.shape != (*self.sigma_m.shape, 3):
            raise ParameterError("places", f"of shape {(*self.sigma_m.shape, 3)}", self.places.shape)
