"""This module thins an archive's poses for the pose database, which stores them as unit directions of bones.

From these directions, poses can be computed for a body with any bone lengths.
"""

from __future__ import annotations

from typing import NamedTuple

import numba as nb
import numpy as np

from kinedex.ops.arrays import F32, F64, I64
from kinedex.ops.body.joint_tree import JOINTS, PARENTS
from kinedex.ops.copies import copy_row
from kinedex.ops.depth.pose_distance import COMPARED
from kinedex.ops.errors import ParameterError

MIN_BONE_M = 1e-4
"""Length in metres below which a bone has no direction: in Acclaim skeletons the clavicles coincide with the neck."""

DISTANCE_M = 0.05
"""Minimum distance between two poses of a database: root mean square over `COMPARED` joints, in metres."""

_FAR = ("fingers", "toes", "wrist", "ankle", "elbow", "knee", "headtop")
_ORDERED = np.array(  # compared joints, those that vary most first, so that sums of squares exceed their limit early
    sorted(COMPARED, key=lambda j: next((k for k, end in enumerate(_FAR) if JOINTS[j].endswith(end)), len(_FAR)))
)

_ROOT, _NECK = JOINTS.index("root"), JOINTS.index("neck")
_LSHOULDER, _RSHOULDER = JOINTS.index("lshoulder"), JOINTS.index("rshoulder")
_LHIP, _RHIP = JOINTS.index("lhip"), JOINTS.index("rhip")


class ThinnedPoses(NamedTuple):
    """The poses that were kept, and a kept pose to represent each of the others.

    Attributes
    ----------
    rows : int64 array (K,)
        Rows of the kept poses, ascending.
    stands_for : int64 array (T,)
        For each pose the row of a kept pose near it, which is the pose's own row if it was kept.
    """

    rows: I64
    stands_for: I64


def bone_lengths_of(poses: F64) -> F64:
    """Return the median bone lengths (24,) of poses (T, 24, 3) in metres; 0 for the root."""
    lengths: F64 = np.zeros(len(JOINTS))
    child = np.flatnonzero(PARENTS >= 0)
    bones = np.linalg.norm(poses[:, child] - poses[:, PARENTS[child]], axis=2)
    lengths[child] = np.median(bones, axis=0)
    return lengths


def bone_directions(poses: F64) -> F32:
    """Return the unit directions of bones from their parents, 0 for the root and for bones without length.

    Parameters
    ----------
    poses : float64 array (T, 24, 3)
        The named joints in metres.

    Returns
    -------
    float32 array (T, 24, 3)
        A direction for each bone, which is named by its lower end.
    """
    child = np.flatnonzero(PARENTS >= 0)
    bones = poses[:, child] - poses[:, PARENTS[child]]
    lengths = np.linalg.norm(bones, axis=2, keepdims=True)
    directions: F32 = np.zeros(poses.shape, np.float32)
    directions[:, child] = np.where(lengths < MIN_BONE_M, 0.0, bones / np.maximum(lengths, MIN_BONE_M))
    return directions


def place_directions(directions: F32 | F64, bone_lengths: F64) -> F64:
    """Put bone directions on a body with given bone lengths, with the root at 0 and the chest facing +Z.

    Parameters
    ----------
    directions : float array (T, 24, 3)
        Unit directions of bones, see `bone_directions`.
    bone_lengths : float64 array (24,)
        The lengths of a body's bones in metres; the entry of the root is ignored.

    Returns
    -------
    float64 array (T, 24, 3)
        Poses in metres.

    Raises
    ------
    ParameterError
        The arrays have other shapes, or a length is negative or not finite.
    """
    contiguous = np.ascontiguousarray(directions)
    if contiguous.ndim != 3 or contiguous.shape[1:] != (len(JOINTS), 3):
        raise ParameterError("directions", f"an array (T, {len(JOINTS)}, 3)", directions.shape)
    lengths = np.asarray(bone_lengths, np.float64)
    if lengths.shape != (len(JOINTS),) or not (np.isfinite(lengths).all() and (lengths >= 0).all()):
        raise ParameterError("bone_lengths", f"{len(JOINTS)} lengths of at least 0 m", bone_lengths)
    poses: F64 = np.empty(directions.shape)
    _place(contiguous, np.ascontiguousarray(lengths), PARENTS, poses)
    return poses


@nb.njit(cache=True, nogil=True)
def _place(directions: F32 | F64, lengths: F64, parents: I64, poses: F64) -> None:
    facing = np.empty(3)
    for t in range(len(directions)):
        pose = poses[t]
        for j in range(len(parents)):
            for axis in range(3):
                start = pose[parents[j], axis] if parents[j] >= 0 else 0.0
                pose[j, axis] = start + lengths[j] * directions[t, j, axis] if parents[j] >= 0 else 0.0
        facing_of(pose, facing)
        if facing[0] != 0.0 or facing[2] != 0.0:
            turn_poses(pose, -facing[0], facing[2])


@nb.njit(cache=True, nogil=True)
def facing_of(pose: F64, facing: F64) -> None:
    """Write the horizontal unit direction (3,) that the chest of a pose (24, 3) faces, or 0 if it has none.

    It is the horizontal part of ((lshoulder − rshoulder) + (lhip − rhip)) × (neck − root), normalised.
    """
    ax = pose[_LSHOULDER, 0] - pose[_RSHOULDER, 0] + pose[_LHIP, 0] - pose[_RHIP, 0]
    ay = pose[_LSHOULDER, 1] - pose[_RSHOULDER, 1] + pose[_LHIP, 1] - pose[_RHIP, 1]
    az = pose[_LSHOULDER, 2] - pose[_RSHOULDER, 2] + pose[_LHIP, 2] - pose[_RHIP, 2]
    ux, uy, uz = (
        pose[_NECK, 0] - pose[_ROOT, 0],
        pose[_NECK, 1] - pose[_ROOT, 1],
        pose[_NECK, 2] - pose[_ROOT, 2],
    )
    x, z = ay * uz - az * uy, ax * uy - ay * ux
    length = np.hypot(x, z)
    scale = 1.0 / length if length > 0.0 else 0.0
    facing[0], facing[1], facing[2] = x * scale, 0.0, z * scale


@nb.njit(cache=True, nogil=True)
def turn_poses(points: F64, sine: float, cosine: float) -> None:
    """Rotate points (N, 3) in place about the Y axis, by the angle that maps +Z to (sine, 0, cosine)."""
    for j in range(len(points)):
        x, z = points[j, 0], points[j, 2]
        points[j, 0] = cosine * x + sine * z
        points[j, 2] = cosine * z - sine * x


class CellTable(NamedTuple):
    """The kept poses, hashed by grid cells, as arrays for compiled functions.

    Parameters
    ----------
    axes : float32 array (A, 60)
        The axes of the grid, see `_cell_axes`.
    steps : int64 array (3 ** A, A)
        The offsets from a cell to itself and to its neighbours.
    reach : float
        The largest Euclidean distance of near poses over all compared coordinates, in metres.
    kept : float32 array (N, 60)
        The compared coordinates of the kept poses, followed by free rows.
    cells : int64 array (N, A)
        The cells of the kept poses.
    following : int64 array (N,)
        For each kept pose, the kept pose that was added to the same hash slot before it; −1 for none.
    heads : int64 array (slots,)
        The kept pose that was added last to each hash slot; −1 for none.
    """

    axes: F32
    steps: I64
    reach: float
    kept: F32
    cells: I64
    following: I64
    heads: I64


class PoseThinning:
    """A growing set of poses that keeps a new pose only if no kept pose is near it.

    The kept poses are hashed by the cells of a grid, whose axes (`_cell_axes`) are unit directions in the space of
    compared joints. Near poses lie in the same cell or in neighbouring cells.

    Parameters
    ----------
    bone_lengths : float64 array (24,)
        The bone lengths in metres on which poses are compared.
    distance : float
        The largest distance of poses that count as near, as a root mean square over the `COMPARED` joints, in metres.

    Raises
    ------
    ParameterError
        The distance is not positive and finite.
    """

    def __init__(self, bone_lengths: F64, distance: float = DISTANCE_M) -> None:
        if not (np.isfinite(distance) and distance > 0):
            raise ParameterError("distance", "a positive number of metres", distance)
        self.bone_lengths = np.asarray(bone_lengths, np.float64)
        self.reach = float(distance) * np.sqrt(len(COMPARED))
        axes = _cell_axes()
        steps = np.stack(np.meshgrid(*[np.arange(-1, 2)] * len(axes), indexing="ij"), axis=-1).reshape(-1, len(axes))
        kept = np.empty((1024, 3 * len(COMPARED)), np.float32)
        cells = np.empty((1024, len(axes)), np.int64)
        self._table = CellTable(
            axes, steps, self.reach, kept, cells, np.empty(1024, np.int64), np.full(4096, -1, np.int64)
        )
        self.count = 0

    def add(self, directions: F32, *, always: bool = False) -> I64:
        """Add poses in order, keeping each one unless a kept pose is near it.

        Parameters
        ----------
        directions : float32 array (T, 24, 3)
            Unit directions of bones.
        always : bool, optional
            True to keep all poses without comparisons, because they are known to differ.

        Returns
        -------
        int64 array (T,)
            For each pose the index of the kept pose near it, which is the pose itself if it was kept.
        """
        poses = self._compared(directions)
        while self.count + len(poses) > len(self._table.kept):
            self._grow()
        near: I64 = np.empty(len(poses), np.int64)
        self.count = _add(poses, self._table, always, self.count, near)
        return near

    def near(self, directions: F32) -> I64:
        """Return for each pose (T, 24, 3) the index of a kept pose near it, −1 if there is none."""
        poses = self._compared(directions)
        near: I64 = np.empty(len(poses), np.int64)
        _find(poses, self._table, self.count, near)
        return near

    def _compared(self, directions: F32) -> F32:
        poses = place_directions(directions, self.bone_lengths)[:, _ORDERED]
        return np.ascontiguousarray(poses.reshape(len(poses), 3 * len(_ORDERED)), np.float32)

    def _grow(self) -> None:
        """Double the capacity for kept poses, and rehash their cells."""
        table = self._table
        kept, cells, following = (
            np.concatenate([array, np.empty_like(array)]) for array in (table.kept, table.cells, table.following)
        )
        heads = np.full(4 * len(kept), -1, np.int64)
        self._table = table._replace(kept=kept, cells=cells, following=following, heads=heads)
        _list_cells(cells, following, heads, self.count)


def thin_poses(directions: F32, bone_lengths: F64, distance: float = DISTANCE_M) -> ThinnedPoses:
    """Drop every pose that is near a pose kept before it (thesis, Section 8.3.3).

    Two poses are near if the root mean square distance of the `COMPARED` joints, on the same bones, is at most
    `distance`; Eq. 8.1 prints 1/J instead of 1/√J. Every pose that is dropped is near a kept pose.

    Parameters
    ----------
    directions : float32 array (T, 24, 3)
        Unit directions of bones in order of take name and frame.
    bone_lengths : float64 array (24,)
        The archive's mean bone lengths in metres.
    distance : float
        The largest distance of near poses in metres.

    Returns
    -------
    ThinnedPoses
        The kept rows, and for every pose the row of a kept pose that represents it.

    Raises
    ------
    ParameterError
        The distance is not positive, or an argument is invalid for `place_directions`.
    """
    numbers = PoseThinning(bone_lengths, distance).add(directions)
    _, rows = np.unique(numbers, return_index=True)
    return ThinnedPoses(rows, rows[numbers])


def _cell_axes() -> F32:
    """Return orthonormal axes (5, 60): the mean height and depth of each arm, and the difference of the legs' depths.

    Poses vary much along these axes.
    """
    compared = [JOINTS[j] for j in _ORDERED]
    arm, leg = ("elbow", "wrist", "fingers"), ("knee", "ankle", "toes")
    groups: list[list[tuple[str, int, float]]] = [
        *([(side + name, axis, 1.0) for name in arm] for side in "lr" for axis in (1, 2)),
        [(side + name, 2, sign) for side, sign in (("l", 1.0), ("r", -1.0)) for name in leg],
    ]
    axes: F32 = np.zeros((len(groups), 3 * len(compared)), np.float32)
    for row, group in zip(axes, groups, strict=True):
        for name, axis, sign in group:
            row[3 * compared.index(name) + axis] = sign / np.sqrt(len(group))
    return axes


@nb.njit(cache=True, nogil=True)
def _slot(cell: I64, slots: int) -> int:
    """Return the hash slot of a cell."""
    value = np.uint64(14695981039346656037)
    for number in cell:
        value = (value ^ np.uint64(number)) * np.uint64(1099511628211)
    return int((value >> np.uint64(20)) & np.uint64(slots - 1))


@nb.njit(cache=True, nogil=True)
def _list_cells(cells: I64, following: I64, heads: I64, count: int) -> None:
    for row in range(count):
        slot = _slot(cells[row], len(heads))
        following[row] = heads[slot]
        heads[slot] = row


@nb.njit(cache=True, nogil=True)
def _project(pose: F32, axes: F32, width: float, place: F64, cell: I64) -> None:
    """Write the coordinates of a pose along the axes in units of the cell width, and its cell."""
    for a in range(len(axes)):
        total = 0.0
        for k in range(len(pose)):
            total += float(axes[a, k]) * float(pose[k])
        place[a] = total / width
        cell[a] = np.int64(np.floor(place[a]))


@nb.njit(cache=True, nogil=True)
def _near(pose: F32, place: F64, cell: I64, table: CellTable, other: I64) -> int:
    """Return the index of a kept pose that is near, −1 if none is; within a cell the newest is compared first."""
    _, steps, reach, kept, cells, following, heads = table
    most = reach * reach
    for step in steps:
        gap = 0.0
        for a in range(len(cell)):
            other[a] = cell[a] + step[a]
            if step[a] != 0:
                off = other[a] - place[a] if step[a] > 0 else place[a] - other[a] - 1.0
                gap += off * off
        if gap > 1.0:
            continue
        row = heads[_slot(other, len(heads))]
        while row >= 0:
            same = True
            for a in range(len(other)):
                same &= cells[row, a] == other[a]
            if same:
                total = 0.0
                k = 0
                while k < len(pose) and total <= most:
                    off = float(pose[k]) - float(kept[row, k])
                    total += off * off
                    k += 1
                if total <= most:
                    return row
            row = following[row]
    return -1


@nb.njit(cache=True, nogil=True)
def _find(poses: F32, table: CellTable, count: int, near: I64) -> None:
    axes, reach = table.axes, table.reach
    place, cell, other = np.empty(len(axes)), np.empty(len(axes), np.int64), np.empty(len(axes), np.int64)
    width = reach * (1.0 + 1e-6)
    for t in range(len(poses)):
        _project(poses[t], axes, width, place, cell)
        near[t] = _near(poses[t], place, cell, table, other) if count else -1


@nb.njit(cache=True, nogil=True)
def _add(poses: F32, table: CellTable, always: bool, count: int, near: I64) -> int:
    """Add poses to the kept ones, write the representative of each, and return the new number of kept poses."""
    axes, _, reach, kept, cells, following, heads = table
    place, cell, other = np.empty(len(axes)), np.empty(len(axes), np.int64), np.empty(len(axes), np.int64)
    width = reach * (1.0 + 1e-6)
    for t in range(len(poses)):
        _project(poses[t], axes, width, place, cell)
        row = -1
        if not always:
            row = _near(poses[t], place, cell, table, other)
        if row < 0:
            row = count
            copy_row(kept[row], poses[t])
            copy_row(cells[row], cell)
            slot = _slot(cell, len(heads))
            following[row] = heads[slot]
            heads[slot] = row
            count += 1
        near[t] = row
    return count
