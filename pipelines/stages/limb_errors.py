"""Stage limb_errors: compute the angles between limbs of takes and of sensors, and the runs of frames above τ."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import pyarrow as pa

from kinedex.ops.wording import counted
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading, hash_of
from kinedex.pipelines.engine.display import ResultTable
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.inertial.limb_error_curves import (
    ERRORS,
    RUNS,
    ErrorStatistics,
    error_statistics,
    error_table,
    run_rows,
    take_errors,
)
from kinedex.pipelines.inertial.parameters import LimbErrorsParameters
from kinedex.pipelines.inertial.sensor_fits import stored_calibrations
from kinedex.pipelines.inertial.worn_sensors import ReusedTakes, WornTakes, by_take, stored_clocks, take_tables
from kinedex.storage.store.store import Store


class LimbErrors(Stage[LimbErrorsParameters]):
    """Computes the angles between limbs of takes and of sensors, and the runs of frames above τ (thesis, 7.6)."""

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
        """Return an empty digest: limbs, samples, clocks and mounts are results of other stages."""
        return Reading(hash_of(), "")

    def run(self, context: StageContext, params: LimbErrorsParameters) -> dict[str, object]:
        """Compare every limb that has a calibrated sensor, and store its errors and runs."""
        store = context.open()
        takes = WornTakes.of(context, store)
        clocks = stored_clocks(store, context.key(context.inputs["clocks"]))
        mounts = stored_calibrations(store, context.key(context.inputs["mounts"]))
        of_clocks, of_mounts = by_take(clocks), by_take(mounts)
        prints = takes.fingerprints(
            context.code, params.model_dump(), of=lambda take_id: (of_clocks.get(take_id), of_mounts.get(take_id))
        )
        reuse = ReusedTakes(context, store, prints, ERRORS, RUNS)
        runs: list[dict[str, Any]] = []

        def tables() -> Iterator[pa.Table]:
            with context.progress("errors", len(reuse.fresh)) as bar:
                for take in map(takes.take, reuse.fresh):
                    found = take_errors(take, clocks, mounts, params)
                    for text in found.left_out:
                        context.message(f"{take.take}: left out: {text}")
                    runs.extend(run_rows(take.take_id, take.take, found))
                    bar.advance(1)
                    yield error_table(take.take_id, take.take, found, context.run, prints[take.take_id])

        with context.writer() as writer:
            key, run = context.key(), context.run
            writer.put_results(ERRORS, reuse.rows(ERRORS, tables()), stage=key, run=run)
            run_tables = take_tables(RUNS, runs, reuse.fresh, run)
            writer.put_results(RUNS, reuse.rows(RUNS, run_tables), stage=key, run=run)
            writer.commit()
        statistics = _report(context)
        reuse.report("not compared")
        return statistics | {"unchanged": reuse.unchanged}


def _report(context: StageContext) -> dict[str, object]:
    """Show the error statistics of all stored takes, and return those for the record of the stage."""
    store, stage = context.open(), context.key()
    found = error_statistics(store, stage)
    if found.limbs:
        context.terminal.show(_table(found.limbs))
    kinds = Counter(row["kind"] for row in store.result(RUNS, stage=stage).select(["kind"]).to_pylist())
    wrong, jumps = kinds["distance"], kinds["jump"]
    frames, taus = sum(one.frames for one in found.limbs.values()), {round(tau, 3) for tau in found.taus.values()}
    counts = (counted(len(found.taus), "take"), f"{counted(frames, 'frame')} of limbs", counted(wrong, "wrong run"))
    limits = " to ".join(f"{tau:g}°" for tau in sorted({min(taus), max(taus)})) if taus else "–"
    context.message(f"{', '.join(counts)}, {counted(jumps, 'jump')}; τ {limits}")
    return {"takes": len(found.taus), "frames": frames, "runs": wrong, "jumps": jumps}


def _table(statistics: Mapping[str, ErrorStatistics]) -> ResultTable:
    """Return a table with a row for each limb: its number of frames, errors, and the fraction of frames above τ."""
    table = ResultTable(("limb", "frames", "mean", "sd", "above τ"))
    for limb in sorted(statistics):
        table.add(limb, f"{statistics[limb].frames:,}", *statistics[limb].texts())
    return table
