"""Stage break_track: errors of a tracker are put into the limbs of takes, with labels and simulated annotators."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import ClassVar

import pyarrow as pa

from kinedex.catalog.limbs import chosen_limbs
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.console.wording import counted
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.inertial.broken_takes import LimbLabel, break_take, label_text
from kinedex.pipelines.inertial.limb_sources import reading_digest
from kinedex.pipelines.inertial.limb_tables import KIND, limb_table, stored_limbs
from kinedex.pipelines.inertial.parameters import BreakTrackParameters
from kinedex.storage.disk import whole_file
from kinedex.storage.store.store import Store

LABELS, TRUTH = "limb_labels.csv", "limb_truth.csv"
"""The files of the labels of simulated annotators and of the true errors, in the folder of reports."""


class BreakTrack(Stage[BreakTrackParameters]):
    """Errors of a tracker are put into the limbs of takes, with labels and simulated annotators (thesis, 7.6)."""

    name = "break_track"
    parameters = BreakTrackParameters
    inputs: ClassVar = {"limbs": Input("limb_orientations")}

    def reading(self, params: BreakTrackParameters, store: Store) -> Reading:
        """Return a digest of the takes that are broken."""
        takes = store.takes_table(params.where)["name"].to_pylist()
        return Reading(reading_digest(store, takes), counted(len(takes), "take"))

    def run(self, context: StageContext, params: BreakTrackParameters) -> dict[str, object]:
        """Break the limbs of the takes, and write labels of what was done."""
        store = context.open()
        names = store.takes_table(params.where)["name"].to_pylist()
        if not names:
            raise KinedexError(f"where: no take fits '{params.where}'; `--set {context.stage}.where=true` takes all")
        limbs, takes = chosen_limbs(params.limbs), list[str]()
        truth: list[LimbLabel] = []
        labels: list[LimbLabel] = []

        def tables() -> Iterator[pa.Table]:
            with context.progress("takes", len(names)) as bar:
                for one in stored_limbs(store, context.key(context.inputs["limbs"]), names):
                    broken = break_take(one, limbs, params.noise_deg, params.annotators, params.seed)
                    takes.append(one.take)
                    truth.extend(broken.truth)
                    labels.extend(broken.labels)
                    bar.advance(1)
                    yield limb_table(one.take_id, one.take, broken.limbs, context.run)

        with context.writer() as writer:
            writer.put_results(KIND, tables(), stage=context.key(), run=context.run)
            writer.commit()
        files = []
        for name, text in ((LABELS, label_text(takes, labels)), (TRUTH, label_text(takes, truth, with_kinds=True))):
            path = context.report_file(name)
            with whole_file(path) as temporary:
                temporary.write_bytes(text.encode())
            files.append(path.relative_to(context.store_path).as_posix())
        kinds = Counter(one.kind for one in truth)
        listed = ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items())) or "none"
        context.say(f"{counted(len(takes), 'take')}, wrong by 20 degrees and more: {listed}")
        context.say(
            f"{counted(len(labels), 'label')} of {counted(params.annotators, 'simulated annotator')}: "
            f"{context.report_file(LABELS).resolve()}"
        )
        return {"takes": len(takes), "errors": len(truth), "labels": len(labels), "files": files}
