"""Check limb errors: frames in order, errors in range, runs within the frames, counts that agree."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from kinedex.storage.snapshot.snapshot import Snapshot

F64 = npt.NDArray[np.float64]

_ANGLES = ("degrees", "swing_deg", "twist_deg", "tau_deg")
_SHARES = ("p1", "r1", "f1", "p2", "r2", "f2")
_KINDS = ("distance", "jump")


def limb_error_problems(store: Snapshot) -> Iterator[tuple[str, str]]:
    """Yield the part and the problem of each inconsistency in limb errors, their runs and metrics.

    The frames of a limb must be 0, 1, …; angles must be between 0 and 180 degrees, and present in each frame that is
    judged. Runs must be within the frames of their limb, and the peak of runs of wrong frames must exceed the threshold
    τ. Labels must end after their start. In metrics, no count may exceed its total, and measures must be between 0 and
    1.

    Parameters
    ----------
    store : Snapshot
        A version whose part files are undamaged.
    """
    results = store.manifest.results
    frames: dict[tuple[str, int, str], int] = {}
    for part in results.get("limb_errors", ()):
        for piece in store.result_pieces("limb_errors", [part]):
            problem = _error_problem(part.stage, piece, frames)
            if problem:
                yield part.path, problem
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
    """Return the problem of rows of errors; count frames in `frames`, since a limb may continue in the next rows."""
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
