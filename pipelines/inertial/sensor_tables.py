"""Make tables of the results `sensor_sync` and `sensor_calibration`, and read clocks and calibrations from them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from kinedex.pipelines.inertial.sensor_fits import SensorFit
from kinedex.pipelines.inertial.synchronisation import RecordingClock
from kinedex.pipelines.inertial.worn_sensors import Clock
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import Store

F64 = npt.NDArray[np.float64]
Value = TypeVar("Value")

SYNC, CALIBRATION = "sensor_sync", "sensor_calibration"


def sync_row(take_id: int, take: str, recording: str, found: RecordingClock) -> dict[str, Any]:
    """Return a row with the clock offset and drift of one recording of a take."""
    clock = found.clock
    return {
        "take_id": take_id,
        "take": take,
        "recording": recording,
        "offset_s": None if clock is None else clock.offset_s,
        "ppm": None if clock is None else clock.ppm,
        "correlation": found.correlation,
        "next_best": found.next_best,
        "limbs": found.limbs,
        "refined": found.refined,
        "left_out": found.left_out or None,
    }


def calibration_row(one: SensorFit) -> dict[str, Any]:
    """Return the row of one sensor in one take."""
    fit = one.fit
    row: dict[str, Any] = {
        "take_id": one.take_id,
        "take": one.take,
        "recording": one.recording,
        "sensor": one.sensor,
        "limb": one.limb,
        "basis": one.basis or None,
        "direction": _struct(one.direction, "xyz"),
        "left_out": one.left_out or None,
    }
    found = not one.left_out
    row["q_global"] = _struct(one.q_global if found else None, "wxyz")
    if fit is not None:
        row |= {
            "q_mount": _struct(fit.q_mount if found else None, "wxyz"),
            "frames": fit.frames,
            "inliers": fit.inliers,
            "median_deg": None if math.isnan(fit.median_deg) else fit.median_deg,
            "observability": fit.observability,
            "tilt_deg": fit.tilt_deg,
            "drift": [
                {"t": t, "degrees": degrees}
                for t, degrees in zip(fit.drift.times.tolist(), fit.drift.degrees.tolist(), strict=True)
            ],
            "warning": fit.warning or None,
        }
    return row


def _struct(values: F64 | None, axes: str) -> dict[str, float] | None:
    return None if values is None else dict(zip(axes, values.tolist(), strict=True))


def result_table(kind: str, rows: Iterable[dict[str, Any]], run: str) -> pa.Table:
    """Return rows of a kind of results as a table; columns that a row lacks are null."""
    return pa.Table.from_pylist([{"run": run, **row} for row in rows], schema=result_schema(kind))


def take_tables(kind: str, rows: Iterable[dict[str, Any]], takes: Iterable[int], run: str) -> list[pa.Table]:
    """Return rows of a kind of results as one table for each take, in the order of takes.

    Parameters
    ----------
    kind : str
        The kind of results.
    rows : iterable of dict
        Rows with `take_id`; the order of rows within a take is kept.
    takes : iterable of int
        The ids of the takes.
    run : str
        Id of the run.
    """
    own: dict[int, list[dict[str, Any]]] = {take_id: [] for take_id in takes}
    for row in rows:
        own[row["take_id"]].append(row)
    return [result_table(kind, some, run) for some in own.values()]


def stored_clocks(store: Store, stage: str) -> dict[tuple[int, str], Clock]:
    """Return the clocks that a stage has found, by take_id and recording."""
    return {
        (row["take_id"], row["recording"]): Clock(row["offset_s"], row["ppm"])
        for row in store.result(SYNC, stage=stage).to_pylist()
        if row["offset_s"] is not None
    }


def stored_calibrations(store: Store, stage: str) -> dict[tuple[int, str, str], dict[str, Any]]:
    """Return the rows of calibrated sensors that a stage has stored, by take_id, recording and sensor."""
    columns = [name for name in result_schema(CALIBRATION).names if name not in ("run", "fingerprint")]
    return {
        (row["take_id"], row["recording"], row["sensor"]): row
        for row in store.result(CALIBRATION, stage=stage).select(columns).to_pylist()
        if row["left_out"] is None
    }


def by_take(found: Mapping[tuple[Any, ...], Value]) -> dict[int, list[tuple[tuple[Any, ...], Value]]]:
    """Return clocks or calibrations with their keys, grouped by take_id and sorted."""
    own: dict[int, list[tuple[tuple[Any, ...], Value]]] = {}
    for key in sorted(found):
        own.setdefault(key[0], []).append((key, found[key]))
    return own
