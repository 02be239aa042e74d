"""The nearest seconds of different takes of a store, found by the places of joints alone, without words.

They say which takes of a collection may be copies of one another, and how near two performances come. Poses count
around the mean of the joints, turned by hips and shoulders.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np
import numpy.typing as npt

from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store

F32 = npt.NDArray[np.float32]

MOMENTS = 6
"""Moments of a second at which poses are compared."""

STEP_S = 1 / 3
"""Seconds between the begins of the seconds that are compared with all others."""

NEAR_M = 0.010
"""Root mean square distance of joints in metres from which a pair is not counted."""

SHOWN = 5
_BLOCK = 256


def nearest_seconds(store: Store, known: Collection[frozenset[str]]) -> Iterator[str]:
    """Yield lines that say how near the takes of a store come to one another, without pairs that are known copies."""
    joints = list(store.feature_set.joints)
    names, windows, places = [], [], []
    second = round(store.rate_hz)
    at = np.linspace(0, second - 1, MOMENTS).round().astype(np.int64)
    for name, table in store.frames_of(store.take_ids):
        poses = _poses(np.ascontiguousarray(joint_positions(table, joints).transpose(2, 0, 1)), joints)
        begins = np.arange(max(0, len(poses) - second + 1))
        windows.append(poses[begins[:, None] + at].reshape(len(begins), MOMENTS * len(joints) * 3))
        places += [(len(names), frame) for frame in begins.tolist()]
        names.append(name)
    every, where = np.concatenate(windows), np.array(places)
    nearest: dict[frozenset[str], tuple[float, str]] = {}
    asked = np.flatnonzero(where[:, 1] % max(1, round(STEP_S * store.rate_hz)) == 0)
    squares = np.square(every).sum(axis=1)
    for first in range(0, len(asked), _BLOCK):
        rows = asked[first : first + _BLOCK]
        apart = squares[rows][:, None] + squares - 2 * every[rows] @ every.T
        apart = np.sqrt(np.maximum(apart, 0) / (MOMENTS * len(joints)))
        for one, other in np.argwhere(apart < NEAR_M).tolist():
            (take, frame), (take2, frame2) = where[rows[one]].tolist(), where[other].tolist()
            pair, far = frozenset((names[take], names[take2])), float(apart[one, other])
            if len(pair) == 2 and pair not in known and far < nearest.get(pair, (np.inf, ""))[0]:
                moves = np.linalg.norm(np.diff(every[rows[one]].reshape(MOMENTS, -1, 3), axis=0), axis=2).mean()
                text = f"{names[take]} at {frame / second:.1f} s and {names[take2]} at {frame2 / second:.1f} s"
                nearest[pair] = far, f"{text}, joints move by {moves * (MOMENTS - 1):.2f} m"
    yield (
        f"{len(names)} takes, {len(known)} known pairs, "
        f"{len(nearest)} other pairs with a second nearer than {1000 * NEAR_M:.0f} mm"
    )
    for far, text in sorted(nearest.values())[:SHOWN]:
        yield f"  {1000 * far:.1f} mm: {text}"


def _poses(positions: F32, joints: list[str]) -> F32:
    """Return joint positions around their mean, with the body turned to one direction."""
    left, right, left2, right2 = (joints.index(name) for name in ("lhip", "rhip", "lshoulder", "rshoulder"))
    across = positions[:, left] - positions[:, right] + positions[:, left2] - positions[:, right2]
    angle = np.arctan2(across[:, 2], across[:, 0])
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    around = positions - positions.mean(axis=1, keepdims=True)
    x, z = around[..., 0], around[..., 2]
    turned: F32 = np.stack([cosine * x + sine * z, around[..., 1], cosine * z - sine * x], axis=-1).astype(np.float32)
    return turned
