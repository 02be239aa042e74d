"""This module describes poses so that copies can be compared: around the root, turned to one direction, on one body."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cached_property, lru_cache

import numpy as np
from numba import njit

from kinedex.ops.arrays import F32, F64, I64
from kinedex.ops.body.joint_tree import JOINT_PARENTS

_LENGTHS_M = {
    "hip": 0.11, "knee": 0.41, "ankle": 0.40, "toes": 0.15, "belly": 0.12, "chest": 0.14, "neck": 0.20, "head": 0.10,
    "headtop": 0.12, "clavicle": 0.05, "shoulder": 0.15, "elbow": 0.28, "wrist": 0.25, "fingers": 0.10,
}  # fmt: skip
"""The lengths in metres of the bones of a body of ordinary size, by the joint at the end of each."""


_FRAMES = (("root", "lhip", "rhip"), ("neck", "lshoulder", "rshoulder"))
"""The joints that define position and direction of poses: those of the pelvis, or otherwise of the shoulders."""

BODIES_DIFFER_M = 0.005
"""Difference in metres of the length of a bone from which two takes show different bodies."""


_MEASURED = 64  # frames of a take in which bones are measured


class TakePoses:
    """The poses of a take, or of its mirror image, and the same poses on a body of ordinary size.

    Parameters
    ----------
    positions : float32 array (T, J, 3)
        Positions in metres, Y up; NaN if a joint is not known.
    joints : sequence of str
        The names of the joints.
    mirrored : bool, optional
        True for the mirror image, with left and right exchanged.

    Attributes
    ----------
    own : float32 array (T, J, 3)
        Positions relative to the root, see `local_poses`.
    """

    def __init__(self, positions: F32, joints: Sequence[str], mirrored: bool = False) -> None:
        root, left, right = next(_turned_by(joints, positions), [0, 0, 0])
        if mirrored:
            positions = positions[:, [joints.index(_other_side(joint, joints)) for joint in joints]]
        self._step = max(1, len(positions) // _MEASURED)
        self.own = local_poses(np.ascontiguousarray(positions), root, left, right, mirrored=mirrored)
        some = np.isfinite(self.own[:: self._step, :, 0])
        every = some if some.any(axis=0).all() else np.isfinite(self.own[:, :, 0])
        self._parents, self._lengths_m, self._order = _chain(tuple(joints), tuple(map(any, every.T.tolist())))
        self.nbytes = self.own.nbytes

    def part_on_ordinary_body(self, start: int, stop: int) -> F32:
        """Return the poses of the frames [start, stop) on a body of ordinary size."""
        return poses_on_body(self.own[start:stop], self._order, self._parents, self._lengths_m)

    @cached_property
    def on_ordinary_body(self) -> F32:
        """The poses with the same directions of bones on a body of ordinary size."""
        return self.part_on_ordinary_body(0, len(self.own))

    @cached_property
    def bone_lengths_m(self) -> F64:
        """The median length of the bone to each joint in metres (J,); NaN without a bone or known frames."""
        return bone_lengths(self.own[:: self._step], self._parents)

    def is_on_body_of(self, other: TakePoses) -> bool:
        """Return whether all bones that both takes have are about as long in both."""
        apart = np.abs(self.bone_lengths_m - other.bone_lengths_m)
        return not (apart > BODIES_DIFFER_M).any()


def _turned_by(joints: Sequence[str], positions: F32) -> Iterator[list[int]]:
    """Yield the indices of joints that define a direction in at least one frame, those of the pelvis first."""
    for names in _FRAMES:
        if all(name in joints for name in names):
            found = [joints.index(name) for name in names]
            if np.isfinite(positions[:1, found]).any() or np.isfinite(positions[:, found]).any():
                yield found


def _other_side(joint: str, joints: Sequence[str]) -> str:
    """Return the joint of the other side of the body; a joint in the middle is returned unchanged."""
    other = {"l": "r", "r": "l"}.get(joint[:1], "") + joint[1:]
    return other if other in joints else joint


@lru_cache(64)
def _chain(joints: tuple[str, ...], known: tuple[bool, ...]) -> tuple[I64, F64, I64]:
    """Return parents and lengths of bones, see `bones_of`, and the joints with parents before their children."""
    parents, lengths_m = bones_of(joints, known)
    return parents, lengths_m, np.array(sorted(range(len(joints)), key=lambda joint: _depth(parents, joint)))


def _depth(parents: I64, joint: int) -> int:
    """Return the number of bones between a joint and the joint at the root of its chain."""
    return 0 if parents[joint] < 0 else 1 + _depth(parents, parents[joint])


def local_poses(positions: F32, root: int, left: int, right: int, *, mirrored: bool = False) -> F32:
    """Return joint positions relative to the root, rotated so that the hips lie along the X axis.

    Parameters
    ----------
    positions : float32 array (T, J, 3)
        Positions in metres, Y up.
    root, left, right : int
        The joints of the root and of the left and right hip.
    mirrored : bool, optional
        True to mirror the poses; `left`, `right` and the order of the joints must then be those of the other side.

    Returns
    -------
    float32 array (T, J, 3)
        Positions that depend neither on the body's position nor on its facing direction; NaN if a joint is not known.
    """
    return _local(positions, root, left, right, -1.0 if mirrored else 1.0)


@njit(cache=True, nogil=True)
def _local(positions: F32, root: int, left: int, right: int, side: float) -> F32:
    turned = np.empty(positions.shape, np.float32)
    for t in range(len(positions)):
        x0, y0, z0 = (
            np.float64(positions[t, root, 0]),
            np.float64(positions[t, root, 1]),
            np.float64(positions[t, root, 2]),
        )
        across = side * (np.float64(positions[t, left, 0]) - positions[t, right, 0])
        along = np.float64(positions[t, left, 2]) - positions[t, right, 2]
        length = math.hypot(across, along)
        cosine, sine = (across / length, along / length) if length > 0 else (across, along)
        for j in range(positions.shape[1]):
            x, z = side * (np.float64(positions[t, j, 0]) - x0), np.float64(positions[t, j, 2]) - z0
            turned[t, j, 0] = cosine * x + sine * z
            turned[t, j, 1] = np.float64(positions[t, j, 1]) - y0
            turned[t, j, 2] = cosine * z - sine * x
    return turned


def _length_m(joint: str) -> float:
    """Return the length of the bone to a joint; 0 for the root and for joints that are no joints of a body."""
    return _LENGTHS_M.get(joint, _LENGTHS_M.get(joint[1:], 0.0))


def bones_of(joints: Sequence[str], known: Sequence[bool]) -> tuple[I64, F64]:
    """Return the parent of each joint among those that are known, and the length of the bone between them.

    Parameters
    ----------
    joints : sequence of str
        Names of joints.
    known : sequence of bool
        True for a joint that has a position in some frame; a child of another one hangs from the next known joint.

    Returns
    -------
    parents : int64 array (J,)
        The index of the parent; −1 without one.
    lengths_m : float64 array (J,)
        The length of each bone of a body of ordinary size, in metres.
    """
    parents, lengths = np.full(len(joints), -1, np.int64), np.zeros(len(joints))
    for j, name in enumerate(joints):
        parent, at = JOINT_PARENTS.get(name), name
        lengths[j] = _length_m(name)
        while parent is not None and not (parent in joints and known[joints.index(parent)]):
            at, parent = parent, JOINT_PARENTS[parent]
            lengths[j] += _length_m(at)
        parents[j] = -1 if parent is None else joints.index(parent)
    return parents, lengths


def bone_lengths(poses: F32, parents: I64) -> F64:
    """Return the median length of the bone to each joint in metres (J,); NaN without a bone or known frames."""
    bones = np.linalg.norm(poses - poses[:, np.maximum(parents, 0)], axis=2).astype(np.float64)
    measured = (parents >= 0) & np.isfinite(bones).any(axis=0)
    lengths = np.full(len(parents), np.nan)
    lengths[measured] = np.nanmedian(bones[:, measured], axis=0)
    return lengths


@njit(cache=True, nogil=True)
def poses_on_body(poses: F32, order: I64, parents: I64, lengths_m: F64) -> F32:
    """Return poses with the same directions of bones on a body with other lengths of bones.

    Parameters
    ----------
    poses : float32 array (T, J, 3)
        Poses of `local_poses`.
    order : int64 array (J,)
        The joints, parents before their children.
    parents : int64 array (J,)
        The parent of each joint; one without a parent (−1) stays where it is.
    lengths_m : float64 array (J,)
        The length of the bone from the parent to each joint, in metres.

    Returns
    -------
    float32 array (T, J, 3)
        The poses; a joint whose bone has no length lies at its parent.
    """
    found = np.empty(poses.shape, np.float32)
    for t in range(len(poses)):
        for j in order:
            parent = parents[j]
            if parent < 0:
                for x in range(3):
                    found[t, j, x] = 0.0 * poses[t, j, x]
                continue
            square = 0.0
            for x in range(3):
                square += (np.float64(poses[t, j, x]) - poses[t, parent, x]) ** 2
            factor = lengths_m[j] / math.sqrt(square) if square > 1e-12 else 0.0 * square
            for x in range(3):
                found[t, j, x] = found[t, parent, x] + factor * (poses[t, j, x] - poses[t, parent, x])
    return found
