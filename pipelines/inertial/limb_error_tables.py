"""Make tables of the results `limb_errors` and `limb_error_runs`, and read curves of limbs from their rows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
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


def error_table(take_id: int, take: str, found: TakeErrors, run: str, fingerprint: str | None) -> pa.Table:
    """Return the rows of a take's errors, sorted by limb and frame."""
    schema = result_schema(ERRORS)
    shared = {"run": run, "take_id": take_id, "take": take, "tau_deg": found.tau_deg, "fingerprint": fingerprint}
    tables = [_rows(one, shared, schema) for one in found.curves]
    return pa.concat_tables(tables) if tables else schema.empty_table()


def _rows(one: LimbCurve, shared: Mapping[str, object], schema: pa.Schema) -> pa.Table:
    frames = len(one.times)
    constants = {**shared, "limb": one.limb}
    columns = {name: pa.repeat(pa.scalar(value, schema.field(name).type), frames) for name, value in constants.items()}
    columns["recording"], columns["sensor"] = pa.array(one.recording.tolist()), pa.array(one.sensor.tolist())
    columns["source_frame"] = pa.array(np.arange(frames, dtype=np.int32))
    columns["t"], columns["valid"] = pa.array(one.times), pa.array(one.valid)
    for name, values in (("degrees", one.degrees), ("swing_deg", one.swing), ("twist_deg", one.twist)):
        columns[name] = pa.array(values, mask=~np.isfinite(values))
    return pa.table([columns[name] for name in schema.names], schema=schema)


def run_rows(take_id: int, take: str, found: TakeErrors) -> Iterator[dict[str, Any]]:
    """Yield the rows of a take's runs, limb by limb: first runs of wrong frames, then jumps."""
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


@dataclass
class ErrorFigures:
    """Sums over the evaluated frames of a limb.

    Attributes
    ----------
    frames, wrong : int
        The numbers of all frames, and of frames above τ.
    total, squares : float
        The sums of errors (degrees) and of their squares.
    """

    frames: int = 0
    wrong: int = 0
    total: float = 0.0
    squares: float = 0.0

    def add(self, error: F64, tau_deg: F64) -> None:
        """Add frames by their errors in degrees, with the τ of each frame."""
        self.frames += len(error)
        self.wrong += int(np.count_nonzero(error > tau_deg))
        self.total += float(error.sum())
        self.squares += float(error @ error)

    def texts(self) -> tuple[str, str, str]:
        """Return mean, standard deviation, and the fraction of wrong frames, as text."""
        if not self.frames:
            return "–", "–", "–"
        mean = self.total / self.frames
        deviation = math.sqrt(max(self.squares / self.frames - mean**2, 0.0))
        return f"{mean:.1f}°", f"{deviation:.1f}°", f"{self.wrong / self.frames:.1%}"


@dataclass(frozen=True)
class StoredFigures:
    """The error statistics that a stage has stored: those of each limb, and the τ of each take."""

    limbs: dict[str, ErrorFigures]
    taus: dict[int, float]


def error_figures(store: Store, stage: str) -> StoredFigures:
    """Return the error statistics of all takes that a stage has stored."""
    found = StoredFigures({}, {})
    parts = [part for part in store.manifest.results.get(ERRORS, ()) if part.stage == stage]
    for rows in store.result_pieces(ERRORS, parts, ["take_id", "limb", "degrees", "swing_deg", "valid", "tau_deg"]):
        for limb in pc.unique(rows.column("limb")).to_pylist():
            own = rows.filter(pc.equal(rows.column("limb"), limb))
            valid = own.filter(own.column("valid"))
            error = pc.coalesce(valid.column("degrees"), valid.column("swing_deg")).to_numpy()
            found.limbs.setdefault(limb, ErrorFigures()).add(error, valid.column("tau_deg").to_numpy())
        taus = rows.group_by(["take_id"]).aggregate([("tau_deg", "min")])
        found.taus.update(zip(*(taus.column(name).to_pylist() for name in ("take_id", "tau_deg_min")), strict=True))
    return found


@dataclass(frozen=True, eq=False)
class JudgedLimb:
    """The stored errors of a limb of a take.

    Attributes
    ----------
    take_id : int
        Id of the take.
    take, limb : str
        Names.
    error : float64 array (T,)
        The whole error angle in degrees, or the swing if only that is known; NaN if neither is.
    valid : bool array (T,)
        The frames that are evaluated.
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
    """Yield the limbs of each take whose errors a stage has stored, one take at a time."""
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
