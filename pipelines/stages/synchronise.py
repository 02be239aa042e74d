"""Stage synchronise: estimate offset and drift of the clocks of sensor recordings against takes."""

from __future__ import annotations

from functools import partial
from typing import Any, ClassVar

import pyarrow.compute as pc

from kinedex.ops.wording import counted, name_list
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading, hash_of
from kinedex.pipelines.engine.display import ResultTable
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.inertial.parameters import SynchroniseParameters
from kinedex.pipelines.inertial.synchronisation import MIN_DRIFT_S, sync_row, synchronise
from kinedex.pipelines.inertial.worn_sensors import SYNC, ReusedTakes, WornTake, WornTakes, take_tables
from kinedex.storage.store.store import Store


class Synchronise(Stage[SynchroniseParameters]):
    """Estimates offset and drift of the clocks of sensor recordings against takes (thesis, Section 7.6.1)."""

    name = "synchronise"
    parameters = SynchroniseParameters
    inputs: ClassVar = {
        "sensors": Input("read_imu"),
        "limbs": Input("limb_orientations"),
        "broken": Input("break_track", optional=True),
    }

    def reading(self, params: SynchroniseParameters, store: Store) -> Reading:
        """Return an empty digest: limbs and samples are results of other stages."""
        return Reading(hash_of(), "")

    def run(self, context: StageContext, params: SynchroniseParameters) -> dict[str, object]:
        """Estimate the clock of every recording of a take, or give the reason why that is impossible."""
        store = context.open()
        takes = WornTakes.of(context, store)
        prints = takes.fingerprints(context.code, params.model_dump())
        reuse = ReusedTakes(context, store, prints, SYNC)
        rows: list[dict[str, Any]] = []
        with context.progress("clocks", len(reuse.fresh)) as bar:
            for own in context.executor.map(partial(_rows, params=params), map(takes.take, reuse.fresh)):
                rows += [row | {"fingerprint": prints[row["take_id"]]} for row in own]
                bar.advance(1)
        reuse.put(SYNC, take_tables(SYNC, rows, reuse.fresh, context.run))
        for name in takes.without_limbs:
            context.message(f"{name}: left out: its limbs were not read; `limb_orientations.where` selects takes")
        for row in rows:
            if row["left_out"]:
                context.message(f"{row['take']}, {row['recording']}: left out: {row['left_out']}")
        _show_constant(context, rows, params)
        shown = [row for row in rows if not row["left_out"]]
        if shown:
            context.terminal.show(_table(shown))
        every = context.open().result(SYNC, stage=context.key())
        found = every.num_rows - pc.count(every.column("left_out")).as_py()
        context.message(f"{counted(found, 'recording')} synchronised, {every.num_rows - found} left out")
        reuse.report("not synchronised")
        return {"synchronised": found, "without_clock": every.num_rows - found, "unchanged": reuse.unchanged}


def _rows(take: WornTake, params: SynchroniseParameters) -> list[dict[str, Any]]:
    return [sync_row(take.take_id, take.take, one, synchronise(take, one, params)) for one in take.recordings]


def _show_constant(context: StageContext, rows: list[dict[str, Any]], params: SynchroniseParameters) -> None:
    """Show the recordings for which no clock drift could be estimated although the parameters ask for it."""
    constant = [str(row["recording"]) for row in rows if not row["left_out"] and row["ppm"] == 0.0]
    if params.clock == "drift" and constant:
        context.message(
            f"clock: drift: constant in {counted(len(constant), 'recording')}, since a drift shows only where take and "
            f"calibrated sensors share {MIN_DRIFT_S / 60:.0f} minutes, and `offset_s` is not given: "
            f"{name_list(constant)}"
        )


def _fixed(value: float, digits: int) -> str:
    """Format a number with a fixed number of decimals, and without a sign where it rounds to 0."""
    return f"{round(value, digits) + 0.0:.{digits}f}"


def _table(rows: list[dict[str, Any]]) -> ResultTable:
    """Return a table with a row for each recording: the offset, and correlations that show how certain it is."""
    columns = ("take", "recording", "offset s", "ppm", "correlation", "next best")
    table = ResultTable(columns, texts=frozenset({0, 1}))
    for row in rows[:_SHOWN]:
        numbers = ("–" if row[name] is None else f"{row[name]:.2f}" for name in ("correlation", "next_best"))
        offset = (_fixed(row["offset_s"], 4), _fixed(row["ppm"], 0))
        table.add(row["take"], row["recording"], *offset, *numbers)
    if len(rows) > _SHOWN:
        table.caption = f"and {len(rows) - _SHOWN} more in the view {SYNC}"
    return table


_SHOWN = 20
