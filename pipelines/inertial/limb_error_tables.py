"""Tables of the results `limb_errors` and `limb_error_runs`, and the curves of takes from their rows."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from kinedex.ops.inertial.disagreement import Run
from kinedex.pipelines.inertial.limb_error_curves import LimbCurve, TakeErrors
from kinedex.storage.snapshot.row_groups import RowGroups
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import Store

F64 = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

ERRORS, RUNS = "limb_errors", "limb_error_runs"


def error_table(take_id: int, take: str, found: TakeErrors, run: str) -> pa.Table:
    """Return the rows of a take's errors, limb by limb, in the order of frames."""
    schema = result_schema(ERRORS)
    tables = [_rows(take_id, take, one, found.tau_deg, run, schema) for one in found.curves]
    return pa.concat_tables(tables) if tables else schema.empty_table()


def _rows(take_id: int, take: str, one: LimbCurve, tau_deg: float, run: str, schema: pa.Schema) -> pa.Table:
    frames = len(one.times)
    constants = {
        "run": run,
        "take_id": take_id,
        "take": take,
        "limb": one.limb,
        "tau_deg": tau_deg,
    }
    columns = {name: pa.repeat(pa.scalar(value, schema.field(name).type), frames) for name, value in constants.items()}
    columns["recording"], columns["sensor"] = pa.array(one.recording.tolist()), pa.array(one.sensor.tolist())
    columns["source_frame"] = pa.array(np.arange(frames, dtype=np.int32))
    columns["t"], columns["valid"] = pa.array(one.times), pa.array(one.valid)
    for name, values in (("degrees", one.degrees), ("swing_deg", one.swing), ("twist_deg", one.twist)):
        columns[name] = pa.array(values, mask=~np.isfinite(values))
    return pa.table([columns[name] for name in schema.names], schema=schema)


def run_rows(take_id: int, take: str, found: TakeErrors) -> Iterator[dict[str, Any]]:
    """Yield the rows of a take's runs, limb by limb: wrong frames, then jumps."""
    for curve in found.curves:
        for kind, own in zip(("distance", "jump"), found.runs[curve.limb], strict=True):
            for one in own:
                yield {
                    "take_id": take_id,
                    "take": take,
                    "limb": curve.limb,
                    "kind": kind,
                    "tau_deg": found.tau_deg,
                    **_range(one, curve),
                }


def _range(one: Run, curve: LimbCurve) -> dict[str, Any]:
    step = 1.0 / curve.rate_hz
    first = float(curve.times[one.start])
    known = not math.isnan(one.peak_deg)
    return {
        "start": one.start,
        "stop": one.stop,
        "start_seconds": first,
        "stop_seconds": first + (one.stop - one.start) * step,
        "seconds": (one.stop - one.start) * step,
        "peak_deg": one.peak_deg if known else None,
        "mean_deg": one.mean_deg if known else None,
    }


@dataclass(frozen=True, eq=False)
class JudgedLimb:
    """The errors of a limb of a take, as the store has them.

    Attributes
    ----------
    take_id : int
        Id of the take.
    take, limb : str
        Names.
    error : float64 array (T,)
        Degrees: the whole angle, or the swing where only that is known; NaN where neither is.
    valid : bool array (T,)
        The frames that count.
    rate_hz : float
        Frames per second.
    """

    take_id: int
    take: str
    limb: str
    error: F64
    valid: Flags
    rate_hz: float


def judged_limbs(store: Store, stage: str) -> Iterator[list[JudgedLimb]]:
    """Yield the limbs of takes whose errors a stage has stored, one take at a time."""
    groups = RowGroups(store, ERRORS, stage, "take_id")
    for take_id in groups.values:
        rows = groups.rows(take_id)
        limbs = pc.unique(rows.column("limb")).to_pylist()
        yield [_judged(rows.filter(pc.equal(rows.column("limb"), limb))) for limb in limbs]


def _judged(rows: pa.Table) -> JudgedLimb:
    error = pc.coalesce(rows.column("degrees"), rows.column("swing_deg"))
    times = rows.column("t").to_numpy()
    seconds = float(times[-1] - times[0])
    return JudgedLimb(
        rows.column("take_id")[0].as_py(),
        rows.column("take")[0].as_py(),
        rows.column("limb")[0].as_py(),
        error.to_numpy(),
        rows.column("valid").to_numpy().astype(np.bool_),
        (len(times) - 1) / seconds if seconds > 0 else 1.0,
    )
