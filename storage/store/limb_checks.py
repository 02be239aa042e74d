"""Check recordings of sensors, and limbs and limb errors computed from them, for rows that contradict each other."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from kinedex.storage.snapshot.manifest import ResultPart
from kinedex.storage.snapshot.snapshot import Snapshot

_UNIT = 1e-6


def imu_problems(store: Snapshot) -> Iterator[tuple[str, str]]:
    """Yield the part and the problem of each inconsistency in recordings of sensors.

    The samples of a sensor must be numbered 0, 1, …, at ascending times, and there must be as many as the sensor's row
    in `imu_recordings` states; their orientations must have length 1. A sensor with samples must have a row with a
    limb, and a sensor whose row has a limb must have samples.

    Parameters
    ----------
    store : Snapshot
        A version whose part files are undamaged.
    """
    for sensors, samples in store.manifest.parts_by_stage("imu_recordings", "imu_samples"):
        yield from _stage_problems(store, sensors, samples)


def _stage_problems(store: Snapshot, sensors: list[ResultPart], samples: list[ResultPart]) -> Iterator[tuple[str, str]]:
    expected: dict[tuple[str, str], int] = {}
    for part in sensors:
        for rows in store.result_pieces("imu_recordings", [part]):
            for row in rows.select(["recording", "sensor", "limb", "samples"]).to_pylist():
                key = (row["recording"], row["sensor"])
                if key in expected:
                    yield part.path, f"recording {key[0]}, sensor {key[1]} stands twice"
                expected[key] = row["samples"] if row["limb"] is not None else 0
    found: dict[tuple[str, str], int] = defaultdict(int)
    last: dict[tuple[str, str], float] = {}
    wrong = _first_problem(store, "imu_samples", samples, lambda _, piece: _piece_problem(piece, found, last))
    if wrong:
        yield from wrong
        return
    for key in sorted(expected.keys() | found.keys()):
        if expected.get(key, 0) != found[key]:
            path = (samples or sensors)[0].path
            yield path, f"recording {key[0]}, sensor {key[1]} has {found[key]} samples, expected {expected.get(key, 0)}"
            return


def _first_problem(
    store: Snapshot, kind: str, parts: Sequence[ResultPart], check: Callable[[ResultPart, pa.Table], str]
) -> list[tuple[str, str]]:
    """Return the first part with a problem in one of its pieces, and the problem; empty if there is none."""
    for part in parts:
        for piece in store.result_pieces(kind, [part]):
            if problem := check(part, piece):
                return [(part.path, problem)]
    return []


def _piece_problem(piece: pa.Table, found: dict[tuple[str, str], int], last: dict[tuple[str, str], float]) -> str:
    """Return the problem of a piece of samples, and count its samples in `found`."""
    names, sensors = (piece.column(name).to_numpy(zero_copy_only=False) for name in ("recording", "sensor"))
    numbers, times = piece.column("sample").to_numpy(), piece.column("t").to_numpy()
    squares = [pc.struct_field(piece.column("orientation"), axis).to_numpy() ** 2 for axis in "wxyz"]
    lengths = np.sqrt(np.sum(squares, axis=0))
    changes = (names[1:] != names[:-1]) | (sensors[1:] != sensors[:-1])
    starts: list[int] = [0, *(np.flatnonzero(changes) + 1).tolist()] if len(names) else []
    for start, stop in zip(starts, [*starts[1:], len(names)], strict=True):
        key = (str(names[start]), str(sensors[start]))
        where = f"recording {key[0]}, sensor {key[1]}"
        own = np.r_[last.get(key, -np.inf), times[start:stop]]
        if not (numbers[start:stop] == found[key] + np.arange(stop - start)).all():
            return f"{where}: samples must be numbered 0, 1, …"
        if not (np.diff(own) > 0).all():
            return f"{where}: times must ascend"
        if (np.abs(lengths[start:stop] - 1) > _UNIT).any():
            return f"{where}: an orientation must have the length 1"
        found[key] += stop - start
        last[key] = float(times[stop - 1])
    return ""


_LENGTH_TOLERANCE = 1e-3
"""The largest deviation from 1 of the squared length of quaternions and directions."""


def limb_problems(store: Snapshot) -> Iterator[tuple[str, str]]:
    """Yield the part and the problem of each inconsistency in results about limbs, clocks and mounts.

    The frames of a limb must be consecutive; a valid frame must have an orientation or a direction; quaternions must
    have length 1. The row of a clock or a mount must have its values, or else the reason why they are missing.

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
    for (parts,) in store.manifest.parts_by_stage("limb_orientations"):
        counts = Counter[tuple[str, str]]()
        yield from _first_problem(store, "limb_orientations", parts, partial(_frames_problem, counts))


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
    rotations = [one for one in (row["q_global"], *mounts) if one is not None]
    if any(abs(sum(value**2 for value in one.values()) - 1.0) > _LENGTH_TOLERANCE for one in rotations):
        return f"{name} has a rotation or a direction that is not of length 1"
    shares = [row[key] for key in ("inliers", "observability") if row[key] is not None]
    return "" if all(0.0 <= value <= 1.0 for value in shares) else f"{name} has a share beyond 0 and 1"


def _frames_problem(counts: Counter[tuple[str, str]], _: ResultPart, piece: pa.Table) -> str:
    return _order_problem(piece, counts) or _rotation_problem(piece)


def _order_problem(piece: pa.Table, counts: Counter[tuple[str, str]]) -> str:
    """Return the problem of the first frame that does not follow the previous one of its limb; count frames by limb."""
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


def _rotation_problem(piece: pa.Table) -> str:
    """Return the problem of the first frame with an invalid rotation, or marked as valid without a rotation."""
    rotations = piece.column("orientation").combine_chunks()
    axes = [pc.struct_field(rotations, axis).to_numpy(zero_copy_only=False) for axis in "wxyz"]
    squares = np.asarray(np.sum([np.square(axis.astype(np.float64)) for axis in axes], axis=0))
    wrong = np.flatnonzero(np.abs(squares - 1.0) > _LENGTH_TOLERANCE)  # False for NaN, which stands for unknown
    if len(wrong):
        return f"{_named(piece, int(wrong[0]))} has an orientation that is not of length 1"
    needed = np.where(pc.equal(piece.column("basis"), "none").to_numpy(), "direction", "orientation")
    known = {name: pc.is_valid(piece.column(name)).to_numpy() for name in ("direction", "orientation")}
    has = np.where(needed == "direction", known["direction"], known["orientation"])
    wrong = np.flatnonzero(piece.column("valid").to_numpy().astype(np.bool_) & ~has)
    return f"{_named(piece, int(wrong[0]))} is valid without its {needed[wrong[0]]}" if len(wrong) else ""


def _named(piece: pa.Table, row: int) -> str:
    take, limb, frame = (piece.column(name)[row].as_py() for name in ("take", "limb", "source_frame"))
    return f"take {take}, {limb}, frame {frame}"


F64 = npt.NDArray[np.float64]

_ANGLES = ("degrees", "swing_deg", "twist_deg", "tau_deg")
_SHARES = ("p1", "r1", "f1", "p2", "r2", "f2")
_KINDS = ("distance", "jump")


def limb_error_problems(store: Snapshot) -> Iterator[tuple[str, str]]:
    """Yield the part and the problem of each inconsistency in limb errors, their runs and metrics.

    The frames of a limb must be numbered 0, 1, …; angles must be between 0 and 180 degrees, and every frame with a
    verdict must have an angle. Runs of frames must be within the frames of their limb, and the peak of a run of wrong
    frames must exceed the threshold τ. Labels must end after their start. In metrics, no count may exceed its total,
    and measures must be between 0 and 1.

    Parameters
    ----------
    store : Snapshot
        A version whose part files are undamaged.
    """
    results = store.manifest.results
    frames: dict[tuple[str, int, str], int] = {}
    errors = results.get("limb_errors", ())
    wrong = _first_problem(store, "limb_errors", errors, lambda part, rows: _error_problem(part.stage, rows, frames))
    if wrong:
        yield from wrong
        return
    checks = {
        "limb_error_runs": _run_problem,
        "limb_labels": _label_problem,
        "limb_error_metrics": _metric_problem,
    }
    for kind, check in checks.items():
        for part in results.get(kind, ()):
            rows = pa.concat_tables(store.result_pieces(kind, [part]))
            problem = check(part.stage, rows, frames)
            if problem:
                yield part.path, problem


def _error_problem(stage: str, rows: pa.Table, frames: dict[tuple[str, int, str], int]) -> str:
    """Return the problem of some rows of errors; empty if there is none.

    The frames of each limb are counted in `frames`, because the rows of a limb may continue in the next call.
    """
    for name in _ANGLES:
        values = pc.drop_null(rows.column(name)).to_numpy()
        if not ((values >= 0.0) & (values <= 180.0 + 1e-6)).all():
            return f"{name} is not within 0 and 180 degrees"
    angle = pc.is_valid(pc.coalesce(rows.column("degrees"), rows.column("swing_deg")))
    if pc.any(pc.and_not(rows.column("valid"), angle)).as_py():
        return "a frame counts without an error"
    limbs = rows.column("limb").combine_chunks().dictionary_encode()
    ids, codes = rows.column("take_id").to_numpy(), limbs.indices.to_numpy()
    at = rows.column("source_frame").to_numpy()
    edges = np.flatnonzero((np.diff(ids) != 0) | (np.diff(codes) != 0)) + 1
    for start, stop in zip([0, *edges], [*edges, len(ids)], strict=True):
        if start == stop:
            continue
        key = (stage, int(ids[start]), str(limbs.dictionary[int(codes[start])]))
        first = frames.get(key, 0)
        if not np.array_equal(at[start:stop], np.arange(first, first + stop - start)):
            return f"the frames of {key[2]} of take {key[1]} are not 0, 1, …"
        frames[key] = first + int(stop - start)
    return ""


def _run_problem(stage: str, rows: pa.Table, frames: dict[tuple[str, int, str], int]) -> str:
    for row in rows.to_pylist():
        name = f"{row['take']}, {row['limb']}, frames {row['start']} to {row['stop']}"
        if row["kind"] not in _KINDS:
            return f"{name}: no such kind of run"
        if not 0 <= row["start"] < row["stop"] <= frames.get((stage, row["take_id"], row["limb"]), 0):
            return f"{name}: is not within the frames of the limb"
        if row["kind"] == "distance" and not (row["peak_deg"] or 0.0) > row["tau_deg"]:
            return f"{name}: its error is not above {row['tau_deg']:g} degrees"
    return ""


def _label_problem(stage: str, rows: pa.Table, frames: dict[tuple[str, int, str], int]) -> str:
    for row in rows.to_pylist():
        if not 0 <= row["start"] < row["stop"]:
            return f"{row['take']}, {row['limb']}: start {row['start']} is not before stop {row['stop']}"
    return ""


def _metric_problem(stage: str, rows: pa.Table, frames: dict[tuple[str, int, str], int]) -> str:
    wholes = (
        ("frames_both", "frames_automatic"),
        ("frames_both", "frames_manual"),
        ("frames_automatic", "frames"),
        ("frames_manual", "frames"),
        ("segments_automatic_hit", "segments_automatic"),
        ("segments_manual_hit", "segments_manual"),
    )
    for row in rows.to_pylist():
        for part, whole in wholes:
            if not 0 <= row[part] <= row[whole]:
                return f"{row['name']}, {row['annotator']}: {part} {row[part]} is not within 0 and {whole} {row[whole]}"
        for name in _SHARES:
            if row[name] is not None and not 0.0 <= row[name] <= 1.0:
                return f"{row['name']}, {row['annotator']}: {name} is not within 0 and 1"
    return ""
