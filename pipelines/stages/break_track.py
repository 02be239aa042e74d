"""Stage break_track: put a tracker's errors into the limbs of takes, and write labels of simulated annotators."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import ClassVar

import pyarrow as pa

from kinedex.catalog.limbs import chosen_limbs
from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading, hash_of
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.inertial.limb_motion import KIND, limb_pieces, limb_table, limbs_of_rows
from kinedex.pipelines.inertial.parameters import BreakTrackParameters
from kinedex.pipelines.inertial.simulated_errors import SimulatedLabels, inject_errors
from kinedex.pipelines.inertial.source_limbs import reading_digest
from kinedex.pipelines.inertial.worn_sensors import ReusedTakes
from kinedex.storage.snapshot.row_groups import RowGroups
from kinedex.storage.store.reused_results import stored_fingerprints
from kinedex.storage.store.store import Store

LABELS, TRUTH = "limb_labels.csv", "limb_truth.csv"
"""Names of the files with labels of simulated annotators and with the true errors, in the folder of reports."""


class BreakTrack(Stage[BreakTrackParameters]):
    """Puts a tracker's errors into the limbs of takes, and writes labels of simulated annotators (thesis, 7.6)."""

    name = "break_track"
    parameters = BreakTrackParameters
    inputs: ClassVar = {"limbs": Input("limb_orientations")}

    def reading(self, params: BreakTrackParameters, store: Store) -> Reading:
        """Return a digest of the takes that get errors."""
        takes = store.takes_table(params.where)["name"].to_pylist()
        return Reading(reading_digest(store, takes), counted(len(takes), "take"))

    def run(self, context: StageContext, params: BreakTrackParameters) -> dict[str, object]:
        """Put errors into the limbs of the takes, and write labels of these errors."""
        store = context.open()
        names = set(store.takes_table(params.where)["name"].to_pylist())
        if not names:
            raise KinedexError(f"where: no take fits '{params.where}'; `--set {context.stage}.where=true` takes all")
        stage = context.key(context.inputs["limbs"])
        groups = RowGroups(store, KIND, stage, "take_id")
        takes = {take_id: name for name, take_id in store.take_ids.items() if name in names and take_id in groups}
        marks = SimulatedLabels(context.report_file(LABELS), context.report_file(TRUTH))
        limbs, chosen = stored_fingerprints(store, KIND, stage), params.model_dump(exclude={"where"})

        def fingerprint(take_id: int) -> str | None:
            """Return the fingerprint of a take with errors, from inputs and labels; None without labels or limbs."""
            found = marks.digest(takes[take_id])
            return f"{hash_of(context.code, chosen, limbs[take_id])} {found}" if found and take_id in limbs else None

        reuse = ReusedTakes(context, store, {take_id: fingerprint(take_id) for take_id in takes}, KIND)

        def tables() -> Iterator[pa.Table]:
            wanted = chosen_limbs(params.limbs)
            with context.progress("takes", len(reuse.fresh)) as bar:
                for take_id in reuse.fresh:
                    one = limbs_of_rows(groups.rows(take_id))
                    broken = inject_errors(one, wanted, params.noise_deg, params.annotators, params.seed)
                    marks.put(one.take, broken.labels, broken.truth)
                    bar.advance(1)
                    yield limb_table(take_id, one.take, broken.limbs, context.run, fingerprint(take_id))

        reuse.put(KIND, tables(), limb_pieces)
        marks.write(list(takes.values()))
        labels, truth = marks.of(takes.values())
        kinds = Counter(one.kind for one in truth)
        listed = ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items())) or "none"
        context.message(f"{counted(len(takes), 'take')}, wrong by 20 degrees and more: {listed}")
        context.message(
            f"{counted(len(labels), 'label')} of {counted(params.annotators, 'simulated annotator')}: "
            f"{context.report_file(LABELS).resolve()}"
        )
        reuse.report("not broken")
        files = [path.relative_to(context.store_path).as_posix() for path in marks.files]
        return {
            "takes": len(takes), "unchanged": reuse.unchanged, "errors": len(truth), "labels": len(labels),
            "files": files,
        }  # fmt: skip
