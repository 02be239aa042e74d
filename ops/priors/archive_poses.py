"""This module computes the archive poses of a class: mean and spread of node rotations for each template column.

The example clips of the class are aligned with the template by classical dynamic time warping (DTW).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numba as nb
import numpy as np

from kinedex.ops.arrays import F64, I64, U64, Bool
from kinedex.ops.body.kinematic_chain import Poses, rotation_of, vector_of
from kinedex.ops.copies import copy_row
from kinedex.ops.errors import ParameterError
from kinedex.ops.priors.constraints import Mark
from kinedex.ops.templates.templates import QuantisedTemplate, Template
from kinedex.ops.templates.warping import align
from kinedex.ops.words import NO_WORD, bits

MIN_SEEN_S = 5 / 30
"""Minimum time in seconds for which a node must be seen in a hit to measure the actor's deviation."""

FULL_SEEN_S = 0.5
"""Time in seconds for which a node must be seen in a hit for the actor's deviation to have its full weight."""


class PoseTable(NamedTuple):
    """The rotations of nodes in the example clips of a class, for the N columns of its template.

    Attributes
    ----------
    means : float64 array (N, K, 3, 3)
        The mean rotation M of each node.
    spreads : float64 array (N, K, 3)
        Root mean square over the clips of log(MᵀR), where R is the rotation in a clip, about X, Y and Z of the node, in
        radians.
    tilts : float64 array (N, 3)
        The mean direction of the world's up axis in the frame of the first node.
    clips : int
        The number of clips.
    """

    means: F64
    spreads: F64
    tilts: F64
    clips: int


def pose_table(clips: Sequence[Poses], frames: Sequence[I64]) -> PoseTable:
    """Return the mean poses of clips that are aligned to a template, and their spread.

    Parameters
    ----------
    clips : sequence of Poses
        The fitted poses of each example clip.
    frames : sequence of int64 array (N,)
        For each clip, the frame that corresponds to each column, see `clip_frames`.

    Raises
    ------
    ParameterError
        If there is no clip.
    """
    if not clips:
        raise ParameterError("clips", "at least one clip with poses", 0)
    rotations = np.stack([clip.rotations[own] for clip, own in zip(clips, frames, strict=True)])
    means = nearest_rotations(rotations.mean(axis=0))
    spreads = np.sqrt((relative_rotations(means[None], rotations) ** 2).mean(axis=0))
    tilts = rotations[:, :, 0, 1, :].mean(axis=0)  # Rᵀe_y is the second row of R
    return PoseTable(means, spreads, tilts / np.linalg.norm(tilts, axis=1, keepdims=True), len(clips))


def nearest_rotations(matrices: F64) -> F64:
    """Return the rotations nearest to matrices (…, 3, 3), by singular value decomposition."""
    left, _, right = np.linalg.svd(matrices)
    signs = np.sign(np.linalg.det(left @ right))
    left[..., 2] *= signs[..., None]
    rotations: F64 = left @ right
    return rotations


def relative_rotations(means: F64, rotations: F64) -> F64:
    """Return log(MᵀR), the rotation vectors (…, 3) from means M to rotations R (…, 3, 3), in the means' frame."""
    means, rotations = np.broadcast_arrays(means, rotations)
    vectors = np.empty((means.size // 9, 3))
    _relative(np.ascontiguousarray(means).reshape(-1, 3, 3), np.ascontiguousarray(rotations).reshape(-1, 3, 3), vectors)
    return vectors.reshape(means.shape[:-1])


@nb.njit(cache=True, nogil=True)
def _relative(means: F64, rotations: F64, vectors: F64) -> None:
    product = np.empty((3, 3))
    for place in range(len(means)):
        for i in range(3):
            for j in range(3):
                product[i, j] = (
                    means[place, 0, i] * rotations[place, 0, j]
                    + means[place, 1, i] * rotations[place, 1, j]
                    + means[place, 2, i] * rotations[place, 2, j]
                )
        copy_row(vectors[place], vector_of(product))


class ActorDeviation(NamedTuple):
    """The deviation of an actor's rotations from the archive's in a hit, measured where the cameras agree.

    Attributes
    ----------
    rotations : float64 array (K, 3, 3)
        The rotation to apply after the archive's mean; the identity if the node is hardly seen.
    residuals : float64 array (K, 3)
        Root mean square of the remaining log(MᵀR) over the frames in which the node is seen, in radians; NaN if the
        node is hardly seen.
    seen_s : float64 array (K,)
        The time for which each node is seen, in seconds.
    """

    rotations: F64
    residuals: F64
    seen_s: F64


def actor_deviation(means: F64, rotations: F64, seen: Bool, rate_hz: float) -> ActorDeviation:
    """Measure how an actor's rotations deviate from the archive in the frames of a hit.

    Parameters
    ----------
    means : float64 array (E, K, 3, 3)
        The archive's rotation of each node in the frames of the hit.
    rotations : float64 array (E, K, 3, 3)
        The track's rotation of each node.
    seen : bool array (E, K)
        The nodes whose keypoints the cameras agree on.
    rate_hz : float
        Frames per second.

    Returns
    -------
    ActorDeviation
        The rotation of each node is exp(v), where v is the mean of log(MᵀR) over the N frames in which the node is
        seen, times min(1, N / rate_hz / `FULL_SEEN_S`). It is the identity if the node is seen for less than
        `MIN_SEEN_S`.
    """
    counts = seen.sum(axis=0)
    enough = counts >= MIN_SEEN_S * rate_hz - 1e-9
    vectors = relative_rotations(means, rotations)
    shares = np.minimum(1.0, counts / (FULL_SEEN_S * rate_hz)) * enough
    total = np.where(seen[:, :, None], vectors, 0.0).sum(axis=0)
    offsets = total / np.maximum(counts, 1)[:, None] * shares[:, None]
    own = np.stack([rotation_of(vector) for vector in offsets]) if len(offsets) else np.zeros((0, 3, 3))
    left = relative_rotations(means @ own, rotations)
    squares = np.where(seen[:, :, None], left**2, 0.0).sum(axis=0) / np.maximum(counts, 1)[:, None]
    return ActorDeviation(own, np.where(enough[:, None], np.sqrt(squares), np.nan), counts / rate_hz)


def clip_frames(template: Template, words: U64) -> I64:
    """Return the frame of a clip that corresponds to each column of a template.

    The clip is aligned by classical DTW. The local cost is the mean over features of |x − y|, weighted if the template
    has feature weights. Of equally cheap steps, read from the end, (1,1) is preferred to a step in which only the
    template advances, and this is preferred to a step in which only the clip advances.

    Parameters
    ----------
    template : Template
        The soft template of the clip's class, of N columns.
    words : uint64 array (L,)
        The words of the clip.

    Returns
    -------
    int64 array (N,)
        For each column the mean of the frames that the path assigns to it, rounded to the nearest frame, halves to the
        even frame.

    Raises
    ------
    ParameterError
        If the clip is empty or has invalid frames.
    """
    if not len(words) or np.any(words == NO_WORD):
        raise ParameterError("words", "those of a clip of at least one frame, all valid", len(words))
    features = template.values.shape[1]
    weights = np.ones(features) if template.feature_weights is None else template.feature_weights
    shown = bits(words, features).astype(np.float64)
    # Σ w |x − y| = Σ w (x + y − 2 x y) for y in {0, 1}
    costs = (template.values @ weights)[:, None] + (shown @ weights)[None, :]
    costs -= 2.0 * (template.values * weights) @ shown.T
    path = align(np.maximum(costs / weights.sum(), 0.0), np.ones(len(template)), np.ones(len(words))).path
    counts = np.bincount(path[:, 0], minlength=len(template))
    totals = np.bincount(path[:, 0], weights=path[:, 1].astype(np.float64), minlength=len(template))
    return np.rint(totals / counts).astype(np.int64)


@dataclass(frozen=True, eq=False)
class PriorMotion:
    """A class of motions with its template, its poses and its marked regions.

    Attributes
    ----------
    name : str
        The name of the class.
    template : QuantisedTemplate
        The quantised template of the class.
    poses : PoseTable, optional
        The poses of the class's example clips; None if the archive has only templates.
    marks : tuple of Mark
        The marked regions of the template.
    """

    name: str
    template: QuantisedTemplate
    poses: PoseTable | None = None
    marks: tuple[Mark, ...] = ()
