"""Lookup of poses by five ends: the tree beside a scan with early end, on 25,000 and on 1,000,000 distinct poses.

The poses are those of the synthetic archive, and of real clips where ../shared has them (their number is part of
the name), with every bone turned by some degrees, so that no two are equal. A frame asks for the ten nearest poses of
twelve labels. Both must give the same rows, or nothing is reported.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
from numba import njit

from benchmarks.harness import Figure, seconds, sized
from kinedex.library.new_takes import read
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.depth.pose_index import PoseIndex, pose_features
from kinedex.ops.depth.thinned_poses import bone_directions, bone_lengths_of, place_directions
from kinedex.ops.errors import ParameterError
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store
from tests.real_data import SHARED

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

SIZES = sized((25_000, 1_000_000), (1_000, 4_000))
LABELS, NEIGHBOURS, FRAMES = 12, 10, 20
TURN_RAD, NOISE_M = 0.15, 0.04
REAL_CLIPS = sized(40, 2)
_SHARED = SHARED / "data" / "hdm05" / "clips"


def figures(opened: Store) -> Iterator[Figure]:
    """Time frames of lookup by tree and by scan, and report the memory."""
    poses, real = archive_poses(opened)
    bones = bone_lengths_of(poses)
    directions = bone_directions(poses)
    every = distinct_directions(directions, max(SIZES))
    for size in SIZES:
        index = PoseIndex(place_directions(every[:size], bones))
        queries = frame_queries(directions, bones)
        rows, squares = index.nearest(queries, NEIGHBOURS), scan(queries, index.features)
        if not (
            np.array_equal(rows[0], squares[0]) and np.array_equal(rows[1], np.sqrt(squares[1].astype(np.float64)))
        ):
            raise ParameterError("the tree", "one with the answers of a scan", size)
        tree = seconds(lambda index=index, queries=queries: index.nearest(queries, NEIGHBOURS))  # type: ignore[misc]
        few = queries[: LABELS * (FRAMES if size == min(SIZES) else 2)]
        slow = seconds(lambda index=index, few=few: scan(few, index.features), 3) * len(queries) / len(few)  # type: ignore[misc]
        name = f"lookup of {LABELS} labels in {size:,} poses ({real:,} real ones)"
        yield Figure(name, FRAMES, "frames", tree, "scan with early end, same answers", slow)
        yield Figure(f"memory of {size:,} poses and their tree", index.nbytes / 1e6, "MB", None)


def archive_poses(opened: Store) -> tuple[F64, int]:
    """Return the whole poses (N, 24, 3) of the synthetic archive and of some real clips, and how many are real."""
    parts = [
        joint_positions(table, JOINTS).transpose(2, 0, 1).astype(np.float64)
        for _, table in opened.frames_of(sorted(opened.take_ids))
    ]
    files = sorted(_SHARED.glob("*/*.amc"))
    takes = [read(file) for file in files[:: max(1, len(files) // REAL_CLIPS)]]
    real = [take.positions[:, [take.joints.index(joint) for joint in JOINTS]].astype(np.float64) for take in takes]
    poses = np.concatenate([*parts, *real])
    return poses[np.isfinite(poses).all(axis=(1, 2))], sum(map(len, real))


def distinct_directions(directions: F32, count: int) -> F32:
    """Return directions of random poses, with every bone turned at random: no two are equal."""
    random = np.random.default_rng(1)
    parts: list[F32] = []
    for first in range(0, count, 50_000):
        some = directions[random.integers(0, len(directions), min(50_000, count - first))]
        turned = some + random.normal(0, TURN_RAD, some.shape).astype(np.float32) * (some != 0)
        lengths = np.linalg.norm(turned, axis=2, keepdims=True)
        parts.append(np.divide(turned, lengths, out=np.zeros_like(turned), where=lengths > 0))
    every = np.concatenate(parts)
    if len(np.unique(every.reshape(count, -1) @ random.normal(size=3 * len(JOINTS)))) < count:
        raise ParameterError("directions", "those of distinct poses", "equal ones")
    return every


def frame_queries(directions: F32, bones: F64) -> F32:
    """Return the ends of poses with noise, for the labels of `FRAMES` frames, most of them wrong."""
    random = np.random.default_rng(2)
    features = pose_features(place_directions(directions[random.integers(0, len(directions), FRAMES)], bones))
    ends = features.reshape(FRAMES, 5, 3) + random.normal(0, NOISE_M, (FRAMES, 5, 3)).astype(np.float32)
    labels = [np.arange(5), *(random.permutation(5) for _ in range(LABELS - 1))]
    return np.concatenate([own[label].reshape(1, 15) for own in ends for label in labels])


def scan(queries: F32, features: F32) -> tuple[I64, F32]:
    """Return the nearest rows and their squared distances by comparison with all."""
    rows = np.full((len(queries), NEIGHBOURS), -1, np.int64)
    squares = np.full((len(queries), NEIGHBOURS), np.inf, np.float32)
    _scan(queries, features, rows, squares)
    return rows, squares


@njit(nogil=True)
def _scan(queries: F32, features: F32, rows: I64, squares: F32) -> None:
    last = rows.shape[1] - 1
    for q in range(len(queries)):
        most = squares[q, last]
        for row in range(len(features)):
            total = np.float32(0.0)
            for k in range(0, 15, 3):
                a, b, c = (
                    queries[q, k] - features[row, k],
                    queries[q, k + 1] - features[row, k + 1],
                    queries[q, k + 2] - features[row, k + 2],
                )
                total += a * a + b * b + c * c
                if total >= most:
                    break
            if total < most:
                place = last
                while place > 0 and squares[q, place - 1] > total:
                    squares[q, place], rows[q, place] = squares[q, place - 1], rows[q, place - 1]
                    place -= 1
                squares[q, place], rows[q, place] = total, row
                most = squares[q, last]
