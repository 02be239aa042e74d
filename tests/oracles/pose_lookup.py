"""Naive twins of the pose database and its lookup: everything is compared with everything."""

from __future__ import annotations

import itertools
import math

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.body.joint_tree import JOINTS, PARENTS
from kinedex.ops.depth.pose_distance import COMPARED, END_EFFECTORS


def pose_distance(pose: F64, others: F64) -> F64:
    """Return the root mean square distance of the compared joints."""
    apart = np.asarray(others)[..., COMPARED, :] - np.asarray(pose)[COMPARED]
    return np.asarray(np.sqrt((apart**2).sum(axis=(-2, -1))) / math.sqrt(len(COMPARED)))


def placed(directions: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Put the directions of one pose on bones, with the root at 0 and the chest towards +Z."""
    pose = np.zeros((len(JOINTS), 3))
    for j, parent in enumerate(PARENTS):
        if parent >= 0:
            pose[j] = pose[parent] + lengths[j] * directions[j]
    at = dict(zip(JOINTS, pose, strict=True))
    across = at["lshoulder"] - at["rshoulder"] + at["lhip"] - at["rhip"]
    facing = np.cross(across, at["neck"] - at["root"])
    yaw = np.arctan2(facing[0], facing[2])
    turn = np.array([[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]])
    return pose @ turn.T


def thinned(poses: np.ndarray, distance: float) -> list[int]:
    """Return the rows that are farther than the distance from every row kept before."""
    kept: list[int] = []
    for row, pose in enumerate(poses):
        if not kept or pose_distance(pose, poses[kept]).min() > distance:
            kept.append(row)
    return kept


def nearest(queries: np.ndarray, features: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest rows and their distances by a sort of all, ties to the lowest row."""
    squares = np.zeros((len(queries), len(features)), np.float32)
    for first in range(0, 15, 3):
        off = queries[:, None, first : first + 3] - features[None, :, first : first + 3]
        squares += off[..., 0] * off[..., 0] + off[..., 1] * off[..., 1] + off[..., 2] * off[..., 2]
    order = np.argsort(squares, axis=1, kind="stable")[:, :count]
    return order, np.sqrt(np.take_along_axis(squares, order, axis=1).astype(float))


def near_maps(extrema: np.ndarray, ends: np.ndarray, near: float, most: int) -> list[tuple[int, ...]]:
    """Return the injective maps of least sum among all whose distances are below a limit."""
    found = []
    for chosen in itertools.permutations(range(len(extrema)), 5):
        apart = np.linalg.norm(extrema[list(chosen)] - ends, axis=1)
        if (apart < near).all():
            found.append((sum(apart.tolist()), chosen))
    return [chosen for _, chosen in sorted(found)[:most]]


def proposals(
    poses: np.ndarray,
    extrema: np.ndarray,
    centre: np.ndarray,
    yaw: float,
    maps: np.ndarray,
    previous: np.ndarray | None,
) -> list[tuple[float, int]]:
    """Return the cost and the row of the ten nearest poses of every map, cheapest first."""
    turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])  # +Z to the facing
    own = poses - ((poses[:, 0] + poses[:, JOINTS.index("neck")]) / 2 + [0, 0, 0.1])[:, None]
    found = []
    for chosen in maps:
        target = (extrema[chosen] - centre) @ turn
        apart = np.sqrt(((own[:, END_EFFECTORS] - target) ** 2).sum(axis=(1, 2)) / 5)
        for row in np.argsort(apart, kind="stable")[:10]:
            cost = 0.5 * apart[row]
            if previous is not None:
                cost += 0.5 * pose_distance((previous - centre) @ turn, own[row])
            found.append((float(cost), int(row)))
    return sorted(found)


def best_directions(forward: np.ndarray, backward: np.ndarray, costs: np.ndarray, change: float) -> tuple[int, ...]:
    """Return the cheapest of all 2^T choices, forward first."""
    apart = np.linalg.norm(forward - backward, axis=2).mean(axis=1)
    sums = {
        choice: sum(costs[t, one] for t, one in enumerate(choice))
        + sum(change * apart[t] for t in range(1, len(choice)) if choice[t] != choice[t - 1])
        for choice in itertools.product((0, 1), repeat=len(costs))
    }
    return min(sums, key=lambda choice: (sums[choice], choice[::-1]))
