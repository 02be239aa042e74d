"""Check pose databases: compare the poses and takes of each stage."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pyarrow as pa

from kinedex.ops.body.joint_tree import JOINTS
from kinedex.storage.snapshot.part_records import ResultPart
from kinedex.storage.snapshot.snapshot import Snapshot

_UNIT = 1e-4  # directions are float32: the tolerance of their lengths


def pose_problems(store: Snapshot) -> Iterator[tuple[str, str]]:
    """Yield the part and the problem of each inconsistency in the pose databases of a store.

    The numbers of poses must be 0, 1, …; directions must have length 1 or 0; the number and order of poses must agree
    with the rows of their takes; and every frame that a pose represents must name an existing pose, which is the frame
    itself if it is a pose.

    Parameters
    ----------
    store : Snapshot
        A version whose part files are undamaged.
    """
    takes = store.manifest.results.get("pose_takes", ())
    poses = store.manifest.results.get("poses", ())
    for stage in sorted({part.stage for part in (*takes, *poses)}):
        own = [part for part in takes if part.stage == stage]
        of_stage = [part for part in poses if part.stage == stage]
        if not own:
            yield of_stage[0].path, f"holds poses of {stage}, which has no rows of their takes"
        else:
            yield from _stage_problems(store, of_stage, own)


def _stage_problems(
    store: Snapshot, poses: Sequence[ResultPart], takes: Sequence[ResultPart]
) -> Iterator[tuple[str, str]]:
    rows = pa.concat_tables(store.result_pieces("pose_takes", takes))
    counts = rows.column("poses").to_numpy()
    starts = np.concatenate([[0], np.cumsum(counts)])
    names, frames = rows.column("take").to_pylist(), rows.column("stands_for")
    lengths = rows.column("frames").to_numpy()
    seen = 0
    for part in poses:
        for piece in store.result_pieces("poses", [part]):
            problem = _piece_problem(piece, seen)
            if problem is None:
                at = np.arange(seen, seen + piece.num_rows)
                place = np.searchsorted(starts, at, side="right") - 1
                expected = [names[k] if k < len(names) else None for k in place.tolist()]
                if piece.column("take").to_pylist() != expected:
                    problem = "its poses are not those that the rows of their takes count"
            if problem is not None:
                yield part.path, problem
                return
            seen += piece.num_rows
    if seen != starts[-1]:
        yield takes[0].path, f"counts {starts[-1]} poses, and there are {seen}"
        return
    kept = np.concatenate([np.empty(0, np.int64), *_columns(store, poses, "frame")])
    for k, name in enumerate(names):
        stands_for = frames[k].values.fill_null(-1).to_numpy(zero_copy_only=False)
        own = np.arange(starts[k], starts[k + 1])
        at = kept[starts[k] : starts[k + 1]]
        if len(stands_for) != lengths[k] or np.any(stands_for >= seen) or np.any(at >= lengths[k]):
            yield takes[0].path, f"take {name} names frames or poses that do not exist"
        elif np.any(at < 0) or not np.array_equal(stands_for[at], own):
            yield takes[0].path, f"take {name} has frames that are poses, and others stand for them"


def _columns(store: Snapshot, parts: Sequence[ResultPart], column: str) -> Iterator[np.ndarray]:
    for piece in store.result_pieces("poses", parts):
        yield piece.column(column).to_numpy().astype(np.int64)


def _piece_problem(piece: pa.Table, first: int) -> str | None:
    """Return the problem of poses whose first number must be `first`; None if there is none."""
    if any(piece.column(name).null_count for name in ("pose", "take", "frame", "directions")):
        return "lacks values"
    if not np.array_equal(piece.column("pose").to_numpy(), np.arange(first, first + piece.num_rows)):
        return f"its poses are not numbered from {first} on"
    column = piece.column("directions").combine_chunks()
    if np.any(column.value_lengths().to_numpy(zero_copy_only=False) != 3 * len(JOINTS)):
        return f"has directions that are not {3 * len(JOINTS)} numbers"
    lengths = np.linalg.norm(column.flatten().to_numpy(zero_copy_only=False).reshape(-1, len(JOINTS), 3), axis=2)
    if not np.all((np.abs(lengths - 1.0) < _UNIT) | (lengths == 0.0)):
        return "has directions whose length is neither 1 nor 0"
    return None
