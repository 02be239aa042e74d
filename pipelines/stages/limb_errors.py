"""Stage limb_errors: the angle between what a take and what sensors report of its limbs, and the runs above τ."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from rich import box
from rich.table import Table

from kinedex.pipelines.console.tables import plain_text
from kinedex.pipelines.console.wording import counted
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading, hash_of
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.inertial.error_parameters import LimbErrorsParameters
from kinedex.pipelines.inertial.limb_error_curves import take_errors
from kinedex.pipelines.inertial.limb_error_tables import ERRORS, RUNS, error_table, run_rows
from kinedex.pipelines.inertial.sensor_tables import result_table, stored_calibrations, stored_clocks
from kinedex.pipelines.inertial.worn_sensors import WornTakes
from kinedex.storage.store.store import Store

F64 = npt.NDArray[np.float64]


class LimbErrors(Stage[LimbErrorsParameters]):
    """The angle between what takes and what sensors report of limbs, and the runs above τ (thesis, Section 7.6)."""

    name = "limb_errors"
    parameters = LimbErrorsParameters
    inputs: ClassVar = {
        "sensors": Input("read_imu"),
        "limbs": Input("limb_orientations"),
        "broken": Input("break_track", optional=True),
        "clocks": Input("synchronise"),
        "mounts": Input("calibrate_sensors"),
    }

    def reading(self, params: LimbErrorsParameters, store: Store) -> Reading:
        """Return a digest of nothing: limbs, samples, clocks and mounts are results of other stages."""
        return Reading(hash_of(), "")

    def run(self, context: StageContext, params: LimbErrorsParameters) -> dict[str, object]:
        """Compare every limb that has a calibrated sensor, and store its errors and runs."""
        store = context.open()
        limbs = context.key(context.inputs.get("broken", context.inputs["limbs"]))
        takes = WornTakes(store, limbs, context.key(context.inputs["sensors"]))
        clocks = stored_clocks(store, context.key(context.inputs["clocks"]))
        mounts = stored_calibrations(store, context.key(context.inputs["mounts"]))
        rows: list[dict[str, Any]] = []
        figures: dict[str, _Figures] = {}
        taus: set[float] = set()
        judged = 0

        def tables() -> Iterator[pa.Table]:
            nonlocal judged
            with context.progress("errors", len(takes)) as bar:
                for take in takes:
                    found = take_errors(take, clocks, mounts, params)
                    for text in found.left_out:
                        context.say(f"{take.take}: left out: {text}")
                    for curve in found.curves:
                        figures.setdefault(curve.limb, _Figures()).add(curve.error[curve.valid], found.tau_deg)
                    if found.curves:
                        judged += 1
                        taus.add(round(found.tau_deg, 3))
                    rows.extend(run_rows(take.take_id, take.take, found))
                    bar.advance(1)
                    yield error_table(take.take_id, take.take, found, context.run)

        with context.writer() as writer:
            writer.put_results(ERRORS, tables(), stage=context.key(), run=context.run)
            writer.put_results(RUNS, result_table(RUNS, rows, context.run), stage=context.key(), run=context.run)
            writer.commit()
        if figures:
            context.terminal.show(_table(figures))
        frames, wrong = sum(one.frames for one in figures.values()), sum(row["kind"] == "distance" for row in rows)
        counts = (counted(judged, "take"), f"{counted(frames, 'frame')} of limbs", counted(wrong, "wrong run"))
        limits = " to ".join(f"{tau:g}°" for tau in sorted({min(taus), max(taus)})) if taus else "–"
        context.say(f"{', '.join(counts)}, {counted(len(rows) - wrong, 'jump')}; τ {limits}")
        return {"takes": judged, "frames": frames, "runs": wrong, "jumps": len(rows) - wrong}


@dataclass
class _Figures:
    """Sums over the frames of a limb that count."""

    frames: int = 0
    wrong: int = 0
    total: float = 0.0
    squares: float = 0.0

    def add(self, error: F64, tau_deg: float) -> None:
        self.frames += len(error)
        self.wrong += int(np.count_nonzero(error > tau_deg))
        self.total += float(error.sum())
        self.squares += float(error @ error)

    def texts(self) -> tuple[str, str, str]:
        """Return mean, standard deviation, and the share of wrong frames."""
        if not self.frames:
            return "–", "–", "–"
        mean = self.total / self.frames
        deviation = math.sqrt(max(self.squares / self.frames - mean**2, 0.0))
        return f"{mean:.1f}°", f"{deviation:.1f}°", f"{self.wrong / self.frames:.1%}"


def _table(figures: dict[str, _Figures]) -> Table:
    """Return a row for each limb: its frames, their errors, and the share of those above τ."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in ("limb", "frames", "mean", "sd", "above τ"):
        table.add_column(column, justify="left" if column == "limb" else "right")
    for limb in sorted(figures):
        table.add_row(plain_text(limb), f"{figures[limb].frames:,}", *figures[limb].texts())
    return table
