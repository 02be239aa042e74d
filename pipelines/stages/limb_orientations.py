"""Stage limb_orientations: the limbs of takes at the rate of their sources, from these sources."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import pyarrow as pa

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.console.wording import counted
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.inertial.limb_motion import LimbMotion
from kinedex.pipelines.inertial.limb_sources import (
    limb_fingerprints,
    limb_tasks,
    read_limbs,
    reading_digest,
    with_stored_body,
)
from kinedex.pipelines.inertial.limb_tables import KIND, limb_pieces, limb_table, limbs_of_rows, stored_fingerprints
from kinedex.pipelines.inertial.parameters import LimbOrientationsParameters
from kinedex.storage.snapshot.row_groups import RowGroups
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
        ids = {row["name"]: row["take_id"] for row in store.take_rows.select(["name", "take_id"]).to_pylist()}
        prints = limb_fingerprints(store, takes, params.chosen, context.code)
        before = {} if context.anew or not context.code else stored_fingerprints(store, context.key())
        fresh = [take for take in takes if before.get(ids[take]) != prints[take]]
        tasks = limb_tasks(store, fresh, params.chosen)
        results = zip(
            tasks, context.executor.map(read_limbs, (with_stored_body(task, store) for task in tasks)), strict=True
        )
        counts = _Counts()

        def tables() -> Iterator[pa.Table]:
            stored = RowGroups(store, KIND, context.key(), "take_id")
            read = set(fresh)
            with context.progress("limbs", len(takes)) as bar:
                for take in takes:
                    if take in read:
                        task, found = next(results)
                        counts.add(found.limbs)
                        counts.lacking.update(f"{limb} ({reason})" for limb, reason in found.lacking.items())
                        counts.remarks += len(found.remarks)
                        for remark in found.remarks:
                            context.say(f"{take}: {remark}")
                        rows = limb_table(task.take_id, take, found.limbs, context.run, prints[take])
                    else:
                        rows = stored.rows(ids[take])
                        counts.add(limbs_of_rows(rows).limbs)
                        new_run = pa.repeat(pa.scalar(context.run), rows.num_rows)
                        rows = rows.set_column(0, rows.schema.field(0), new_run)
                    bar.advance(1)
                    yield from limb_pieces(rows)

        with context.writer() as writer:
            writer.put_results(KIND, tables(), stage=context.key(), run=context.run)
            writer.commit()
        counts.show(context, len(takes))
        if unchanged := len(takes) - len(fresh):
            context.say(f"unchanged: {counted(unchanged, 'take')}, not read again")
        return {
            "takes": len(takes), "unchanged": unchanged, "frames": counts.frames, "limbs": dict(counts.bases),
            "jumped": counts.jumped, "remarks": counts.remarks,
        }  # fmt: skip


@dataclass
class _Counts:
    """The figures of a run: limbs by basis, and source frames, takes with jumps, limbs that lack, and remarks."""

    bases: Counter[str] = field(default_factory=Counter)
    lacking: Counter[str] = field(default_factory=Counter)
    frames: int = 0
    jumped: int = 0
    remarks: int = 0

    def add(self, limbs: Mapping[str, LimbMotion]) -> None:
        """Count the limbs of a take."""
        self.bases.update(one.basis for one in limbs.values())
        self.jumped += any(one.jump.any() for one in limbs.values())
        self.frames += max((len(one.times) for one in limbs.values()), default=0)

    def show(self, context: StageContext, takes: int) -> None:
        """Show the figures."""
        shares = ", ".join(f"{count} {basis}" for basis, count in self.bases.most_common()) or "none"
        frames = counted(self.frames, "source frame")
        context.say(f"{counted(takes, 'take')}, {frames}; bases of limbs: {shares}")
        for what, count in self.lacking.most_common():
            context.say(f"not known in {counted(count, 'take')}: {what}")
        if self.jumped:
            what = "with turns faster than 2,500 degrees a second, marked as jumps"
            context.say(f"{counted(self.jumped, 'take')} {what}")
