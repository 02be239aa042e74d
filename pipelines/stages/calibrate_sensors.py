"""Stage calibrate_sensors: estimate how sensors are mounted on limbs, and how their world frame is rotated."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, ClassVar

from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading, hash_of
from kinedex.pipelines.engine.display import ResultTable
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.inertial.parameters import CalibrateParameters, CalibrationSettings
from kinedex.pipelines.inertial.sensor_fits import (
    CALIBRATION,
    calibration_row,
    fit_fingerprints,
    fit_groups,
    fit_tasks,
    fit_together,
)
from kinedex.pipelines.inertial.worn_sensors import ReusedTakes, WornTakes, by_take, stored_clocks, take_tables
from kinedex.storage.store.store import Store


class CalibrateSensors(Stage[CalibrationSettings]):
    """Estimates the mounts of sensors on limbs, and the rotation between sensor and take worlds (thesis, 7.5)."""

    name = "calibrate_sensors"
    parameters = CalibrateParameters
    inputs: ClassVar = {
        "sensors": Input("read_imu"),
        "limbs": Input("limb_orientations"),
        "broken": Input("break_track", optional=True),
        "clocks": Input("synchronise"),
    }

    def reading(self, params: CalibrationSettings, store: Store) -> Reading:
        """Return a digest of the columns that tell during which takes the sensors were not moved on the body."""
        return Reading(hash_of(sorted(_wear_periods(store, params.wearing).items(), key=lambda item: item[0])), "")

    def run(self, context: StageContext, params: CalibrationSettings) -> dict[str, object]:
        """Calibrate the sensors of every synchronised recording, and store the results."""
        store = context.open()
        takes = WornTakes.of(context, store)
        clocks = stored_clocks(store, context.key(context.inputs["clocks"]))
        wearing = _wear_periods(store, params.wearing)
        groups = fit_groups(takes, wearing, params)
        own_clocks = by_take(clocks)
        brought = takes.fingerprints(context.code, params.model_dump(), of=own_clocks.get)
        prints = fit_fingerprints(groups, wearing, brought)
        reuse = ReusedTakes(context, store, prints, CALIBRATION)
        rows: list[dict[str, Any]] = []
        tasks = fit_tasks(takes, groups, set(reuse.fresh), clocks, wearing, params)
        with context.progress("calibrations", len(reuse.fresh)) as bar:
            for fits in context.executor.map(fit_together, tasks):
                rows += [calibration_row(one) | {"fingerprint": prints[one.take_id]} for one in fits]
                bar.advance(len({one.take_id for one in fits}))
        reuse.put(CALIBRATION, take_tables(CALIBRATION, rows, reuse.fresh, context.run))
        context.message(*_remarks(rows))
        every = context.open().result(CALIBRATION, stage=context.key()).to_pylist()
        found = [row for row in every if not row["left_out"]]
        if found:
            context.terminal.show(_table(found))
        sensors, recordings = (len({row[name] for row in found}) for name in ("sensor", "recording"))
        context.message(
            f"{counted(len(found), 'calibration')}: {counted(sensors, 'sensor')} in "
            f"{counted(recordings, 'recording')}; {len(every) - len(found)} left out"
        )
        reuse.report("not calibrated")
        return {"calibrated": len(found), "without_mount": len(every) - len(found), "unchanged": reuse.unchanged}


def _remarks(rows: list[dict[str, Any]]) -> list[str]:
    """Return lines about excluded sensors and warnings; sensors of one recording with the same reason share a line."""
    found: dict[tuple[str, str, str, str], list[str]] = {}
    for row in rows:
        for what, text in (("left out", row["left_out"]), ("warning", row.get("warning"))):
            if text:
                found.setdefault((row["take"], row["recording"], what, str(text)), []).append(str(row["sensor"]))
    lines = []
    for (take, recording, what, text), sensors in found.items():
        own = "" if text.startswith(f"{sensors[0]}: ") else f"{sensors[0]}: "  # a sensor may have the name of its limb
        who = own if len(sensors) == 1 else f"{counted(len(sensors), 'sensor')}: "
        lines.append(f"{take}, {recording}: {who}{what}: {text}")
    return lines


def _wear_periods(store: Store, columns: list[str]) -> dict[int, Hashable]:
    """Return a key for each take_id, equal for takes with the same mounts: column values, or the name of the take."""
    rows = store.take_rows.to_pylist()
    known = list(rows[0]) if rows else []
    for column in columns:
        if known and column not in known:
            raise KinedexError(f"wearing: takes have no column '{column}'{did_you_mean(column, known)}")
    found: dict[int, Hashable] = {}
    for row in rows:
        values = tuple(row[column] for column in columns)
        own = all(value is None for value in values)
        found[row["take_id"]] = ("take", row["name"]) if own else ("columns", *map(str, values))
    return found


def _table(rows: list[dict[str, Any]]) -> ResultTable:
    """Return a table with a row for each limb: the number of takes, and medians of the measures of quality."""
    table = ResultTable(("limb", "takes", "below 15°", "median of these", "observability"))
    for limb in sorted({row["limb"] for row in rows}):
        own = [row for row in rows if row["limb"] == limb]
        numbers = [
            sorted(row[name] for row in own if row.get(name) is not None)
            for name in ("inliers", "median_deg", "observability")
        ]
        middle = [values[len(values) // 2] if values else None for values in numbers]
        texts = (
            "–" if value is None else form.format(value)
            for value, form in zip(middle, ("{:.0%}", "{:.1f}°", "{:.3f}"), strict=True)
        )
        table.add(limb, str(len({row["take_id"] for row in own})), *texts)
    return table
