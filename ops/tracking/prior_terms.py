"""This module defines the terms of priors in the energy of a track (thesis, Section 6.4), constant in a round."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64, I64


@dataclass(frozen=True, eq=False)
class PriorTerms:
    """The terms by which priors pull the poses of a track.

    A rotation (turn) term adds w_d · log(MᵀR)_d² for each axis d of a node in a frame; a tilt term adds w · ‖R₀ᵀe_y −
    t‖² for the rotation R₀ of the pelvis; a position (place) term adds w · (uᵀ(y − z))² for a joint y, a unit vector u
    and a position z.

    Attributes
    ----------
    turn_targets : float64 array (T, K, 3, 3)
        The rotation M that each node is pulled to; the identity where nothing pulls.
    turn_weights : float64 array (T, K, 3)
        Weight 1/σ² about X, Y and Z of the node, per rad²; 0 where nothing pulls.
    tilt_targets : float64 array (T, 3)
        The unit vector t that the up axis seen from the pelvis is pulled to.
    tilt_weights : float64 array (T,)
        Weight of each tilt; 0 where nothing pulls.
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
