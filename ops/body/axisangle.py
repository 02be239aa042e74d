"""Joint angles as rotation vectors (axis times angle), and where they bring the joints of a body."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import ParameterError

F64 = npt.NDArray[np.float64]

_AT_ONCE = 4096  # frames: a few megabytes of matrices, whatever the take's length


def matrices(vectors: F64) -> F64:
    """Rotation vectors (T, 3) in radians as matrices (T, 3, 3).

    Rodrigues' formula: R = I + (sin θ / θ) K + ((1 − cos θ) / θ²) K², with K the cross product by the vector.
    """
    angle = np.sqrt(np.einsum("ta,ta->t", vectors, vectors))
    # 1 − cos θ as 2 sin² (θ/2), which keeps its digits where θ is small; sinc is sin(πx)/(πx), and 1 at 0.
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    turned: F64 = np.eye(3) + first[:, None, None] * cross + second[:, None, None] * (cross @ cross)
    return turned


def forward(rest: F64, parents: Sequence[int], turns: F64, places: F64) -> tuple[F64, F64]:
    """Where the joints of a body are, by the turns of each about its parent.

    The skeleton of SMPL (Loper et al. 2015, Eq. 4): a joint's offset from its parent in the rest pose turns with all
    the turns above it.

    Parameters
    ----------
    rest: float64 (J, 3), the joints in the rest pose. parents: the index of each joint's parent, smaller than its own;
    −1 for the first, the root. turns: float64 (T, J, 3), rotation vectors in radians. places: float64 (T, 3), how far
    the root is from its place at rest.

    Returns
    -------
    positions: float64 (J, 3, T). root: float64 (9, T), the root's matrices, row by row.

    Raises
    ------
    ParameterError: shapes that do not agree, or a parent that does not come before its child.
    """
    joints, frames = len(rest), len(turns)
    if rest.shape != (joints, 3) or turns.shape != (frames, joints, 3) or places.shape != (frames, 3):
        shapes = (rest.shape, turns.shape, places.shape)
        raise ParameterError("rest, turns and places", "of shapes (J, 3), (T, J, 3) and (T, 3)", shapes)
    if len(parents) != joints or parents[0] != -1 or any(not 0 <= parents[j] < j for j in range(1, joints)):
        raise ParameterError("parents", "indices of earlier joints, and -1 for the first", list(parents))
    positions = np.empty((joints, 3, frames))
    root = np.empty((9, frames))
    for start in range(0, frames, _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        whole: list[F64] = []
        at: list[F64] = []
        for j, parent in enumerate(parents):
            turned = matrices(turns[part, j])
            if parent < 0:
                whole.append(turned)
                at.append(rest[j] + places[part])
            else:
                whole.append(whole[parent] @ turned)
                at.append(at[parent] + whole[parent] @ (rest[j] - rest[parent]))
            positions[j, :, part] = at[j].T
        root[:, part] = whole[0].reshape(-1, 9).T
    return positions, root
