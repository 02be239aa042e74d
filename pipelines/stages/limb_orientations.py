"""Stage limb_orientations: read the limbs of takes from their source files, at the rate of these files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import ClassVar

import pyarrow as pa

from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.inertial.limb_motion import KIND, LimbStatistics, limb_pieces, limb_statistics, limb_table
from kinedex.pipelines.inertial.parameters import LimbOrientationsParameters
from kinedex.pipelines.inertial.source_limbs import (
    limb_fingerprints,
    limb_tasks,
    read_limbs,
    reading_digest,
    with_stored_body,
)
from kinedex.pipelines.inertial.worn_sensors import ReusedTakes
from kinedex.storage.store.store import Store


class LimbOrientations(Stage[LimbOrientationsParameters]):
    """Reads the limbs of takes from their source files, at the rate of these files (thesis, Section 7.5)."""

    name = "limb_orientations"
    parameters = LimbOrientationsParameters
    inputs: ClassVar = {"takes": Input("ingest", optional=True), "sensors": Input("read_imu", optional=True)}

    def reading(self, params: LimbOrientationsParameters, store: Store) -> Reading:
        """Return a digest of the takes whose limbs are read."""
        takes = store.takes_table(params.where)["name"].to_pylist()
        what = counted(len(takes), "take")
        return Reading(reading_digest(store, takes), what if params.where is not None else f"up to {what}")

    def run(self, context: StageContext, params: LimbOrientationsParameters) -> dict[str, object]:
        """Read the limbs of the takes, and store them."""
        store = context.open()
        takes = _takes(context, store, params.where)
        if not takes:
            raise KinedexError(
                f"where: no take fits '{params.where or 'takes that wear sensors'}'; `kinedex sql STORE 'FROM takes'` "
                f"lists what there is, and `--set {context.stage}.where=true` takes all"
            )
        prints = limb_fingerprints(store, takes, params.chosen, context.code)
        reuse = ReusedTakes(context, store, prints, KIND)
        lacking, remarks = Counter[str](), 0

        def tables() -> Iterator[pa.Table]:
            nonlocal remarks
            names = {take_id: take for take, take_id in store.take_ids.items()}
            tasks = limb_tasks(store, [names[take_id] for take_id in reuse.fresh], params.chosen)
            results = context.executor.map(read_limbs, (with_stored_body(task, store) for task in tasks))
            with context.progress("limbs", len(tasks)) as bar:
                for task, found in zip(tasks, results, strict=True):
                    lacking.update(f"{limb} ({reason})" for limb, reason in found.lacking.items())
                    remarks += len(found.remarks)
                    for remark in found.remarks:
                        context.message(f"{task.take}: {remark}")
                    bar.advance(1)
                    yield limb_table(task.take_id, task.take, found.limbs, context.run, prints[task.take_id])

        reuse.put(KIND, tables(), limb_pieces)
        statistics = limb_statistics(context.open(), context.key())
        _show(context, len(takes), statistics, lacking)
        reuse.report("not read")
        return {
            "takes": len(takes), "unchanged": reuse.unchanged, "frames": statistics.frames,
            "limbs": dict(statistics.bases), "jumped": statistics.jumped, "remarks": remarks,
        }  # fmt: skip


def _takes(context: StageContext, store: Store, where: str | None) -> list[str]:
    """Return the takes that a filter selects.

    Without a filter, these are the takes with a sensor that is assigned to a limb, or all takes if the stage has no
    input `sensors`.
    """
    takes: list[str] = store.takes_table(where)["name"].to_pylist()
    if where is not None or "sensors" not in context.inputs:
        return takes
    rows = store.result("imu_recordings", stage=context.key(context.inputs["sensors"])).select(["take", "limb"])
    worn = {row["take"] for row in rows.to_pylist() if row["limb"] is not None}
    return [take for take in takes if take in worn]


def _show(context: StageContext, takes: int, statistics: LimbStatistics, lacking: Counter[str]) -> None:
    """Show statistics of all limbs, and the limbs that are missing in the takes that were read."""
    shares = ", ".join(f"{count} {basis}" for basis, count in statistics.bases.most_common()) or "none"
    context.message(f"{counted(takes, 'take')}, {counted(statistics.frames, 'source frame')}; bases of limbs: {shares}")
    for what, count in lacking.most_common():
        context.message(f"not known in {counted(count, 'take')}: {what}")
    if statistics.jumped:
        what = "with turns faster than 2,500 degrees a second, marked as jumps"
        context.message(f"{counted(statistics.jumped, 'take')} {what}")
