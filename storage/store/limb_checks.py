"""Check limbs, and the clocks and mounts of sensors on them: find rows that contradict each other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from kinedex.storage.snapshot.part_records import ResultPart
from kinedex.storage.snapshot.snapshot import Snapshot

_OFF_LENGTH = 1e-3
"""The largest deviation of the length of quaternions and directions from 1."""


def limb_problems(store: Snapshot) -> Iterator[tuple[str, str]]:
    """Yield the part and the problem of each inconsistency in results about limbs, clocks and mounts.

    The frames of a limb must be consecutive; a valid frame must have an orientation or a direction; quaternions must
    have length 1. A clock and a mount must exist, or the reason why they do not.

    Parameters
    ----------
    store : Snapshot
        A version whose part files are undamaged.
    """
    results = store.manifest.results
    for kind, check in (("sensor_sync", _clock_problem), ("sensor_calibration", _mount_problem)):
        for part in results.get(kind, ()):
            rows = [row for piece in store.result_pieces(kind, [part]) for row in piece.to_pylist()]
            problem = next((text for text in map(check, rows) if text), "")
            if problem:
                yield part.path, problem
    for stage in sorted({part.stage for part in results.get("limb_orientations", ())}):
        yield from _limb_problems(store, [part for part in results["limb_orientations"] if part.stage == stage])


def _clock_problem(row: dict[str, Any]) -> str:
    name = f"take {row['take']}, recording {row['recording']}"
    if (row["offset_s"] is None) == (row["left_out"] is None):
        return f"{name} has neither a clock nor the reason for which there is none, or both"
    correlations = [row[key] for key in ("correlation", "next_best") if row[key] is not None]
    if not all(-1.001 <= value <= 1.001 for value in correlations):
        return f"{name} has a correlation beyond -1 and 1"
    return ""


def _mount_problem(row: dict[str, Any]) -> str:
    name = f"take {row['take']}, sensor {row['sensor']}"
    mounts = [row[key] for key in ("q_mount", "direction") if row[key] is not None]
    found = row["q_global"] is not None and len(mounts) == 1
    if found == (row["left_out"] is not None) or (not found and mounts):
        return f"{name} has neither a mount nor the reason for which there is none, or both"
    turns = [one for one in (row["q_global"], *mounts) if one is not None]
    if any(abs(sum(value**2 for value in one.values()) - 1.0) > _OFF_LENGTH for one in turns):
        return f"{name} has a rotation or a direction that is not of length 1"
    shares = [row[key] for key in ("inliers", "observability") if row[key] is not None]
    return "" if all(0.0 <= value <= 1.0 for value in shares) else f"{name} has a share beyond 0 and 1"


def _limb_problems(store: Snapshot, parts: Sequence[ResultPart]) -> Iterator[tuple[str, str]]:
    """Yield the first problem of the limbs of one stage."""
    counts: Counter[tuple[str, str]] = Counter()
    for part in parts:
        for piece in store.result_pieces("limb_orientations", [part]):
            problem = _order_problem(piece, counts) or _turn_problem(piece)
            if problem:
                yield part.path, problem
                return


def _order_problem(piece: pa.Table, counts: Counter[tuple[str, str]]) -> str:
    """Return the problem of the first frame that does not follow the limb's frame before; count each limb's frames."""
    takes, limbs = (piece.column(name).to_numpy(zero_copy_only=False) for name in ("take", "limb"))
    frames = piece.column("source_frame").to_numpy()
    breaks = np.flatnonzero((takes[1:] != takes[:-1]) | (limbs[1:] != limbs[:-1])) + 1
    edges = [0, *breaks.tolist(), len(frames)] if len(frames) else []
    for start, stop in pairwise(edges):
        limb = (str(takes[start]), str(limbs[start]))
        wrong = np.flatnonzero(frames[start:stop] != counts[limb] + np.arange(stop - start))
        if len(wrong):
            return f"{_named(piece, start + int(wrong[0]))} is there twice, or the one before it is missing"
        counts[limb] += stop - start
    return ""


def _turn_problem(piece: pa.Table) -> str:
    """Return the problem of the first frame with an invalid rotation, or that is valid without a rotation."""
    squares = _squares(piece.column("orientation"), "wxyz")
    wrong = np.flatnonzero(np.abs(squares - 1.0) > _OFF_LENGTH)  # NaN, which stands for unknown, compares as False
    if len(wrong):
        return f"{_named(piece, int(wrong[0]))} has an orientation that is not of length 1"
    needed = np.where(pc.equal(piece.column("basis"), "none").to_numpy(), "direction", "orientation")
    known = {name: pc.is_valid(piece.column(name)).to_numpy() for name in ("direction", "orientation")}
    has = np.where(needed == "direction", known["direction"], known["orientation"])
    wrong = np.flatnonzero(piece.column("valid").to_numpy().astype(np.bool_) & ~has)
    return f"{_named(piece, int(wrong[0]))} is valid without its {needed[wrong[0]]}" if len(wrong) else ""


def _squares(column: pa.ChunkedArray, axes: str) -> npt.NDArray[np.float64]:
    """Return the squared lengths of STRUCT vectors; NaN for nulls."""
    parts = [pc.struct_field(column.combine_chunks(), axis).to_numpy(zero_copy_only=False) for axis in axes]
    return np.asarray(np.sum([np.square(part.astype(np.float64)) for part in parts], axis=0))


def _named(piece: pa.Table, row: int) -> str:
    take, limb, frame = (piece.column(name)[row].as_py() for name in ("take", "limb", "source_frame"))
    return f"take {take}, {limb}, frame {frame}"
