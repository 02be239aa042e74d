"""Check recordings of sensors: compare the rows of sensors with their samples."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from kinedex.storage.snapshot.part_records import ResultPart
from kinedex.storage.snapshot.snapshot import Snapshot

_UNIT = 1e-6


def imu_problems(store: Snapshot) -> Iterator[tuple[str, str]]:
    """Yield the part and the problem of each inconsistency in recordings of sensors.

    The samples of a sensor must be 0, 1, …, as many as its row in `imu_recordings` counts, at ascending times; their
    orientations must have length 1. A sensor with samples must have a row with a limb, and the other way round.

    Parameters
    ----------
    store : Snapshot
        A version whose part files are undamaged.
    """
    results = store.manifest.results
    kinds = ("imu_recordings", "imu_samples")
    for stage in sorted({part.stage for kind in kinds for part in results.get(kind, ())}):
        sensors, samples = ([part for part in results.get(kind, ()) if part.stage == stage] for kind in kinds)
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
    for part in samples:
        for piece in store.result_pieces("imu_samples", [part]):
            problem = _piece_problem(piece, found, last)
            if problem is not None:
                yield part.path, problem
                return
    for key in sorted(expected.keys() | found.keys()):
        if expected.get(key, 0) != found[key]:
            path = (samples or sensors)[0].path
            yield path, f"recording {key[0]}, sensor {key[1]} has {found[key]} samples, expected {expected.get(key, 0)}"
            return


def _piece_problem(
    piece: pa.Table, found: dict[tuple[str, str], int], last: dict[tuple[str, str], float]
) -> str | None:
    """Return the problem of a piece of samples, None if there is none, and count its samples in `found`."""
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
    return None
