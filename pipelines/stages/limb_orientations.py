"""Stage limb_orientations: the limbs of takes at the rate of their sources, from these sources."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import ClassVar

import pyarrow as pa

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.console.wording import counted
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.inertial.limb_sources import limb_tasks, read_limbs, reading_digest, with_stored_body
from kinedex.pipelines.inertial.limb_tables import KIND, limb_pieces
from kinedex.pipelines.inertial.parameters import LimbOrientationsParameters
from kinedex.storage.store.store import Store


class LimbOrientations(Stage[LimbOrientationsParameters]):
    """The limbs of takes at the rate of their sources, from these sources (thesis, Section 7.5)."""

    name = "limb_orientations"
    parameters = LimbOrientationsParameters
    inputs: ClassVar = {"takes": Input("ingest", optional=True)}

    def reading(self, params: LimbOrientationsParameters, store: Store) -> Reading:
        """Return a digest of the takes whose limbs are read."""
        takes = store.takes_table(params.where)["name"].to_pylist()
        return Reading(reading_digest(store, takes), counted(len(takes), "take"))

    def run(self, context: StageContext, params: LimbOrientationsParameters) -> dict[str, object]:
        """Read the limbs of the takes, and store them."""
        store = context.open()
        takes = store.takes_table(params.where)["name"].to_pylist()
        if not takes:
            raise KinedexError(
                f"where: no take fits '{params.where}'; `kinedex sql STORE 'FROM takes'` lists what there is, and "
                f"`--set {context.stage}.where=true` takes all"
            )
        tasks = limb_tasks(store, takes, params.chosen)
        bases: Counter[str] = Counter()
        lacking: Counter[str] = Counter()
        jumped, frames, remarks = 0, 0, 0
        results = context.executor.map(read_limbs, (with_stored_body(task, store) for task in tasks))

        def tables() -> Iterator[pa.Table]:
            nonlocal jumped, frames, remarks
            with context.progress("limbs", len(tasks)) as bar:
                for task, found in zip(tasks, results, strict=True):
                    bases.update(one.basis for one in found.limbs.values())
                    lacking.update(f"{limb} ({reason})" for limb, reason in found.lacking.items())
                    jumped += any(one.jump.any() for one in found.limbs.values())
                    frames += max((len(one.times) for one in found.limbs.values()), default=0)
                    remarks += len(found.remarks)
                    for remark in found.remarks:
                        context.say(f"{task.take}: {remark}")
                    bar.advance(1)
                    yield from limb_pieces(task.take_id, task.take, found.limbs, context.run)

        with context.writer() as writer:
            writer.put_results(KIND, tables(), stage=context.key(), run=context.run)
            writer.commit()
        shares = ", ".join(f"{count} {basis}" for basis, count in bases.most_common()) or "none"
        context.say(f"{counted(len(tasks), 'take')}, {counted(frames, 'source frame')}; bases of limbs: {shares}")
        for what, count in lacking.most_common():
            context.say(f"not known in {counted(count, 'take')}: {what}")
        if jumped:
            context.say(f"{counted(jumped, 'take')} with turns faster than 2,500 degrees a second, marked as jumps")
        return {"takes": len(tasks), "frames": frames, "limbs": dict(bases), "jumped": jumped, "remarks": remarks}
