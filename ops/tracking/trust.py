"""This module judges which keypoints and nodes are reliable, and restarts tracks where they are not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.body.kinematic_chain import ChainArrays, ChainBody, Poses, pose_nodes, rotation_of, vector_of
from kinedex.ops.tracking.blocks import frame_room, place_points
from kinedex.ops.tracking.observations import BodyPoints, Places, Rays
from kinedex.ops.tracking.rays import LEAST_DEPTH_M, SIGMA_PX, Evidence, make_evidence

TRUST_WIDTH = 3.0
"""The width c of the robust loss whose weights give trust."""

SEEN = 1.2
"""Minimum sum of confidence times robust weight over cameras for a keypoint to count as seen in a frame."""

AGREEMENT = 0.6
"""Share of a keypoint's confidence that robust weights must leave, or it is contested between cameras."""

NEEDED = {
    "hip": ("hip", "knee", "ankle"),
    "knee": ("knee", "ankle"),
    "ankle": ("ankle", "toes"),
    "shoulder": ("shoulder", "elbow", "wrist"),
    "elbow": ("elbow", "wrist"),
    "wrist": ("wrist",),
}
"""The joints of a side that must be seen for a node of this side to count as seen; nodes not listed always do."""


@dataclass(frozen=True, eq=False)
class Trust:
    """Trust in the observations of a track, by keypoint and node.

    Attributes
    ----------
    keypoints : float64 array (T, P)
        κ = Σ conf · ω over the cameras; 0 where the keypoint is contested. For places it is 2 ω.
    contested : bool array (T, P)
        True where the cameras disagree.
    nodes_seen : bool array (T, K)
        True where the joints that a node needs (`NEEDED`) are seen.
    """

    keypoints: F64
    contested: Bool
    nodes_seen: Bool


def trust(
    body: ChainBody,
    observations: Rays | Places,
    points: BodyPoints | None,
    poses: Poses,
    sigma_px: float = SIGMA_PX,
) -> Trust:
    """Compute how well the observations agree with a track.

    Parameters
    ----------
    body : ChainBody
        A body of the shipped chain's nodes.
    observations : Rays or Places
        The observations of T frames.
    points : BodyPoints or None
        The points that rays observe; None for places.
    poses : Poses
        The track, T poses.
    sigma_px : float, optional
        Standard deviation of a keypoint in pixels.
    """
    evidence = make_evidence(body, observations, points, sigma_px)
    agreed, given = np.empty((2, len(poses.places), len(evidence.nodes)))
    _sums(body.arrays, evidence, poses.places, poses.turns, agreed, given)
    contested = (given > 0) & (agreed < AGREEMENT * given)
    keypoints = np.where(contested, 0.0, agreed)
    joints = np.arange(len(evidence.nodes)) if points is None else points.joints
    return Trust(keypoints, contested, _nodes_seen(body, joints, keypoints > SEEN))


@njit(cache=True, nogil=True)
def _sums(chain: ChainArrays, evidence: Evidence, places: F64, turns: F64, agreed: F64, given: F64) -> None:
    """Compute Σ conf · ω and Σ conf of every keypoint; a place counts like two cameras."""
    room = frame_room(chain, evidence)
    agreed[:], given[:] = 0.0, 0.0
    for t in range(len(places)):
        pose_nodes(chain, places[t], turns[t], room.turned, room.centres)
        place_points(evidence.nodes, evidence.offsets, room.turned, room.centres, room.points)
        for p in range(len(room.points)):
            for v in range(len(evidence.centres)):
                confidence = evidence.confidence[t, v, p]
                if confidence > 0.0:
                    gap = room.points[p] - evidence.centres[v]
                    depth = (gap * evidence.directions[t, v, p]).sum()
                    gap -= depth * evidence.directions[t, v, p]
                    unit = evidence.scales[v] / max(LEAST_DEPTH_M, depth)
                    given[t, p] += confidence
                    agreed[t, p] += confidence * (1.0 + (gap * gap).sum() * (unit / TRUST_WIDTH) ** 2) ** -2
            if len(evidence.places) > 0 and not np.isnan(evidence.places[t, p, 0]):
                gap = room.points[p] - evidence.places[t, p]
                given[t, p] += 2.0
                square = (gap * gap).sum() * (evidence.precisions[t, p] / TRUST_WIDTH) ** 2
                agreed[t, p] += 2.0 * (1.0 + square) ** -2


def _nodes_seen(body: ChainBody, joints: I64, seen: Bool) -> Bool:
    """Return a mask (T, K) of the nodes that are seen, from keypoints (T, P); toes without keypoints are ignored."""
    chain = body.chain
    found = np.ones((len(seen), len(chain.nodes)), np.bool_)
    column = {chain.joints[joint]: p for p, joint in enumerate(joints) if joint >= 0}
    for k, node in enumerate(chain.nodes):
        for name in NEEDED.get(node[1:], ()):
            joint = node[0] + name
            if joint in column:
                found[:, k] &= seen[:, column[joint]]
            elif name != "toes":
                found[:, k] = False
    return found


def restart(body: ChainBody, poses: Poses, nodes_seen: Bool) -> Poses:
    """Return initial poses for tracking again, with unseen nodes interpolated, and the pelvis if neither hip is seen.

    A solver converges near its start; where cameras contradict each other, or too few of them see a limb, a start
    interpolated from neighbouring frames is better than one from these observations.

    Parameters
    ----------
    body : ChainBody
        A body of the shipped chain's nodes.
    poses : Poses
        The track, T poses.
    nodes_seen : bool array (T, K)
        True where a node is seen, see `Trust`.

    Returns
    -------
    Poses
        The poses, with the rotations of unseen nodes, and the position of the body if the pelvis is unseen,
        interpolated between the nearest frames before and after in which the node is seen, and constant before the
        first and after the last of these.
    """
    nodes = body.chain.nodes
    known = nodes_seen.copy()
    known[:, 0] = nodes_seen[:, [nodes.index("lhip"), nodes.index("rhip")]].any(axis=1)
    return interpolated(poses, known)


def interpolated(poses: Poses, known: Bool) -> Poses:
    """Return poses with unknown rotations interpolated; the position is interpolated with the first node.

    Parameters
    ----------
    poses : Poses
        T poses of K nodes.
    known : bool array (T, K)
        True where a rotation is kept. A node that is known in no frame is not changed.
    """
    places, turns = poses.places.copy(), poses.turns.copy()
    for k in range(known.shape[1]):
        frames = np.flatnonzero(known[:, k])
        if len(frames) in (0, len(known)):
            continue
        after = np.searchsorted(frames, np.arange(len(known)))
        low, high = frames[np.maximum(after - 1, 0)], frames[np.minimum(after, len(frames) - 1)]
        for t in np.flatnonzero(~known[:, k]):
            one, two = low[t], high[t]
            share = (t - one) / (two - one) if two > one else 0.0
            way = vector_of(np.ascontiguousarray(poses.turns[one, k].T) @ poses.turns[two, k])
            turns[t, k] = poses.turns[one, k] @ rotation_of(share * way)
            if k == 0:
                places[t] = (1.0 - share) * poses.places[one] + share * poses.places[two]
    return Poses(places, turns)
