"""Figures: trees of named nodes in a scene, with their rest poses and their transforms over time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.transforms import global_transforms, without_scale


class Poses(Protocol):
    """The motion of a figure: positions of its nodes and rotations of some of them, in metres with Y up."""

    def at(self, frames: I64, oriented: Sequence[int]) -> tuple[F64, F64]:
        """Return the positions (N, 3, K) in K frames, and the rotations (M, 9, K) of M nodes from their rest pose."""
        ...


@dataclass(frozen=True)
class ScenePoses:
    """The poses of a figure whose nodes have transforms relative to their parents.

    Attributes
    ----------
    parents : tuple of int
        Index of the parent of each of M nodes: the figure's nodes and all their ancestors.
    shown : tuple of int
        Indices of the figure's N nodes among these.
    local : callable
        Returns rotation with scale (M, K, 3, 3), and positions (M, K, 3), of all M nodes relative to their parents at K
        times in seconds.
    start : float
        Time of the first frame in seconds.
    rate_hz : float
        Frames per second.
    axes : float64 array (3, 3)
        The matrix from the scene's axes and unit to metres with Y up.
    rest : float64 array (N, 3, 3)
        The rotations of the nodes in the rest pose, in the scene's axes.
    """

    parents: tuple[int, ...]
    shown: tuple[int, ...]
    local: Callable[[F64], tuple[F64, F64]]
    start: float
    rate_hz: float
    axes: F64
    rest: F64

    def at(self, frames: I64, oriented: Sequence[int]) -> tuple[F64, F64]:
        """Return the positions of the nodes (N, 3, K), and the rotations (M, 9, K) of some from their rest pose."""
        with np.errstate(over="ignore", invalid="ignore"):  # joints with such numbers are refused later as too far away
            whole, positions = global_transforms(self.parents, *self.local(self.start + frames / self.rate_hz))
            shown = positions[list(self.shown)] @ self.axes.T
        nodes = list(oriented)
        turned = without_scale(whole[[self.shown[node] for node in nodes]])
        turned = turned @ self.rest[nodes].transpose(0, 2, 1)[:, None]
        axes = self.axes / np.cbrt(abs(np.linalg.det(self.axes)))  # the axes may be a reflection
        rows = (axes @ turned @ axes.T).reshape(*turned.shape[:2], 9).transpose(0, 2, 1)
        return np.ascontiguousarray(shown.transpose(0, 2, 1)), rows


@dataclass(frozen=True)
class Figure:
    """A tree of named nodes with its motion.

    Attributes
    ----------
    names : tuple of str
        Names of N nodes, all different.
    parents : tuple of int
        Index of each node's parent, which precedes it; −1 for a root.
    rest : float64 array (N, 3)
        Positions of the nodes in the rest pose, in metres, Y up.
    poses : Poses
        The motion.
    frames : int
        The number of frames.
    rate_hz : float
        Frames per second that the file states or that its times suggest.
    evidence : tuple of str
        Sentences on how the file was read, for `kinedex inspect`.
    warnings : tuple of str
        Warnings about the file.
    upright : bool
        True if, by the format's definition, all nodes are unrotated when the body stands upright and faces forward.
    turns : float64 array (N, 3, 3), optional
        The rotations of the nodes in the rest pose; None if they are not rotated.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    rest: F64
    poses: Poses
    frames: int
    rate_hz: float
    evidence: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    upright: bool = False
    turns: F64 | None = None
