"""This module finds the nearest poses of a database by their five end effectors, with a k-d tree and exact results."""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np

from kinedex.ops.arrays import F32, F64, I64
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.depth.pose_distance import END_EFFECTORS
from kinedex.ops.errors import ParameterError

LEAF = 16
"""Maximum number of poses in a leaf of the tree."""

AHEAD_M = 0.1
"""Distance in metres from the midpoint of root and neck forwards to the middle of the visible surface."""

_ROOT, _NECK = JOINTS.index("root"), JOINTS.index("neck")
_SLACK = np.float32(1.0 + 1e-5)  # tolerance for bounds, which are summed in another order than distances


def pose_centres(poses: F64) -> F64:
    """Return the expected centres (N, 3) of the visible points of poses (N, 24, 3) that face +Z."""
    centres: F64 = (poses[:, _ROOT] + poses[:, _NECK]) / 2
    centres[:, 2] += AHEAD_M
    return centres


def pose_features(poses: F64) -> F32:
    """Return the end effectors of poses (N, 24, 3) facing +Z, relative to their centres, float32 (N, 15) in metres."""
    ends = poses[:, END_EFFECTORS] - pose_centres(poses)[:, None]
    return np.ascontiguousarray(ends.reshape(len(poses), -1), np.float32)


class PoseTree(NamedTuple):
    """A k-d tree as arrays for compiled functions: a complete binary tree, whose root is node 1.

    Parameters
    ----------
    poses, centres : float64 array (N, 24, 3), (N, 3)
        The poses, and the centres of their visible points.
    features : float32 array (N, 15)
        The end effectors of the poses in the tree's order.
    order : int64 array (N,)
        The row in `poses` of each pose in the tree's order.
    edges : int64 array (nodes, 2)
        The half-open range of each node in the tree's order.
    boxes : float32 array (nodes, 2, 15)
        The minimum and the maximum of the features in each node.
    """

    poses: F64
    centres: F64
    features: F32
    order: I64
    edges: I64
    boxes: F32


class PoseIndex:
    """An index that finds poses by the positions of their five end effectors.

    The tree divides the poses at the median of the widest axis, and stores the bounding box of each half, so that most
    poses are never compared. The results equal those of a full scan, to the bit; in a tie, the lowest row comes first.

    Parameters
    ----------
    poses : float64 array (N, 24, 3)
        Poses of one body that face +Z, with the root at 0, see `ops.depth.thinned_poses.place_directions`.

    Attributes
    ----------
    poses : float64 array (N, 24, 3)
        The poses.
    features : float32 array (N, 15)
        The end effectors of the poses, see `pose_features`.
    tree : PoseTree
        The tree; node n has the children 2n and 2n + 1.

    Raises
    ------
    ParameterError
        There is no pose, or a pose is not finite.
    """

    def __init__(self, poses: F64) -> None:
        if poses.ndim != 3 or poses.shape[1:] != (len(JOINTS), 3) or not len(poses) or not np.isfinite(poses).all():
            raise ParameterError("poses", f"at least one pose of {len(JOINTS)} places, all of them finite", poses.shape)
        self.poses = np.ascontiguousarray(poses, np.float64)
        self.features = pose_features(self.poses)
        depth = max(0, int(np.ceil(np.log2(len(poses) / LEAF))))
        order: I64 = np.arange(len(poses))
        edges: I64 = np.zeros((2 << depth, 2), np.int64)
        boxes: F32 = np.zeros((2 << depth, 2, self.features.shape[1]), np.float32)
        _halve(self.features, order, edges, boxes, depth)
        ordered = np.ascontiguousarray(self.features[order])
        self.tree = PoseTree(self.poses, pose_centres(self.poses), ordered, order, edges, boxes)

    @property
    def nbytes(self) -> int:
        """Return the size of poses, features and tree in bytes."""
        tree = self.tree
        arrays = (self.poses, self.features, tree.features, tree.order, tree.edges, tree.boxes)
        return sum(array.nbytes for array in arrays)

    def nearest(self, features: F32, count: int) -> tuple[I64, F64]:
        """Find the poses whose end effectors are nearest to the queries.

        Parameters
        ----------
        features : float32 array (Q, 15)
            Positions of the five end effectors relative to a centre, in metres.
        count : int
            The number of poses for each query.

        Returns
        -------
        rows : int64 array (Q, K)
            Rows of the K = min(count, N) nearest poses, nearest first; at equal distances the lowest row comes first.
        distances : float64 array (Q, K)
            Euclidean distances of the features in metres.
        """
        if features.ndim != 2 or features.shape[1] != self.features.shape[1]:
            raise ParameterError("features", f"an array (Q, {self.features.shape[1]})", features.shape)
        if count < 1:
            raise ParameterError("count", "at least 1", count)
        shape = (len(features), min(count, len(self.poses)))
        rows, squares = np.full(shape, -1, np.int64), np.full(shape, np.inf, np.float32)
        queries = np.ascontiguousarray(features, np.float32)
        search(queries, self.tree, rows, squares)
        return rows, np.sqrt(squares.astype(np.float64))


@nb.njit(cache=True, nogil=True)
def _halve(features: F32, order: I64, edges: I64, boxes: F32, depth: int) -> None:
    """Fill a complete binary tree of the given depth, whose root is node 1."""
    edges[1, 1] = len(order)
    for node in range(1, 2 << depth):
        start, stop = edges[node]
        box = boxes[node]
        box[0], box[1] = np.inf, -np.inf
        for place in range(start, stop):
            for k in range(features.shape[1]):
                box[0, k] = min(box[0, k], features[order[place], k])
                box[1, k] = max(box[1, k], features[order[place], k])
        if node < 1 << depth:
            axis, widest = 0, np.float32(-1.0)
            for k in range(features.shape[1]):
                if box[1, k] - box[0, k] > widest:
                    axis, widest = k, box[1, k] - box[0, k]
            values = np.empty(stop - start, np.float32)
            for place in range(start, stop):
                values[place - start] = features[order[place], axis]
            order[start:stop] = order[start:stop][np.argsort(values, kind="mergesort")]
            middle = (start + stop) // 2
            edges[2 * node, 0], edges[2 * node, 1] = start, middle
            edges[2 * node + 1, 0], edges[2 * node + 1, 1] = middle, stop


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _square(queries: F32, q: int, features: F32, row: int, most: np.float32) -> np.float32:
    """Return the squared distance, or a partial sum of it that already exceeds `most`."""
    total = np.float32(0.0)
    for k in range(0, 15, 3):
        a = queries[q, k] - features[row, k]
        b = queries[q, k + 1] - features[row, k + 1]
        c = queries[q, k + 2] - features[row, k + 2]
        total += a * a + b * b + c * c
        if total > most:
            break
    return total


@nb.njit(cache=True, nogil=True)
def _take(row: int, square: np.float32, q: int, rows: I64, squares: F32) -> np.float32:
    """Insert a pose into the sorted results, ties ordered by row, and return the greatest distance."""
    last = rows.shape[1] - 1
    place = last
    if square == squares[q, last] and row > rows[q, last] >= 0:
        return squares[q, last]
    while place > 0 and (
        squares[q, place - 1] > square or (squares[q, place - 1] == square and rows[q, place - 1] > row)
    ):
        squares[q, place], rows[q, place] = squares[q, place - 1], rows[q, place - 1]
        place -= 1
    squares[q, place], rows[q, place] = square, row
    return squares[q, last]


@nb.njit(cache=True, nogil=True)
def _gap(queries: F32, q: int, boxes: F32, node: int) -> np.float32:
    """Return the squared distance of a query to a box."""
    total = np.float32(0.0)
    for k in range(15):
        off = max(boxes[node, 0, k] - queries[q, k], queries[q, k] - boxes[node, 1, k], np.float32(0.0))
        total += off * off
    return total


@nb.njit(cache=True, nogil=True)
def search(queries: F32, tree: PoseTree, rows: I64, squares: F32) -> None:
    """Write the nearest rows and their squared distances; the arrays must be filled with −1 and infinity."""
    features, order, edges, boxes = tree.features, tree.order, tree.edges, tree.boxes
    leaves = len(edges) // 2
    stack, gaps = np.empty(64, np.int64), np.empty(64, np.float32)
    for q in range(len(queries)):
        most = squares[q, rows.shape[1] - 1]
        stack[0], gaps[0], height = 1, np.float32(0.0), 1
        while height > 0:
            height -= 1
            node, gap = stack[height], gaps[height]
            while gap <= most * _SLACK and node < leaves:
                left, right = 2 * node, 2 * node + 1
                near, beyond = _gap(queries, q, boxes, left), _gap(queries, q, boxes, right)
                if beyond < near:
                    left, right, near, beyond = right, left, beyond, near
                stack[height], gaps[height] = right, beyond
                height += 1
                node, gap = left, near
            if gap <= most * _SLACK:
                for place in range(edges[node, 0], edges[node, 1]):
                    square = _square(queries, q, features, place, most)
                    if square <= most:
                        most = _take(order[place], square, q, rows, squares)
