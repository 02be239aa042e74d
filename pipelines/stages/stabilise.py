"""Stage stabilise: stabilise takes that were tracked badly in parts, by priors from the archive."""

from __future__ import annotations

from typing import ClassVar

from kinedex.catalog.classes import class_files
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading, files_digest, hash_of
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.templates.template_learning import read_templates
from kinedex.pipelines.templates.training import TemplateParameters, training_material
from kinedex.pipelines.tracking.parameters import StabiliseParameters, TrackParameters
from kinedex.pipelines.tracking.recording_runs import RunContext, earlier_rows, has_all_takes, rebuild_index
from kinedex.pipelines.tracking.tracked_takes import STABILISED
from kinedex.pipelines.tracking.tracking_runs import Archive, stabilise
from kinedex.storage.store.store import Store


class Stabilise(Stage[StabiliseParameters]):
    """Stabilises takes that were tracked badly in parts, by priors from the archive (thesis, Sections 6.3 and 6.4)."""

    name = "stabilise"
    parameters = StabiliseParameters
    inputs: ClassVar = {
        "takes": Input("ingest", optional=True),
        "templates": Input("learn_templates"),
        "tracks": Input("track"),
    }

    def external_digest(self, params: StabiliseParameters, store: Store | None) -> str:
        """Return a hash of the class file."""
        return files_digest(class_files(params.classes))

    def reading(self, params: StabiliseParameters, store: Store) -> Reading:
        """Return a digest of all takes except the stabilised ones."""
        rows = (row for row in store.take_rows.to_pylist() if not row["name"].endswith(STABILISED))
        return Reading(hash_of(sorted((row["name"], row["checksum"], row["recipe"], row["class"]) for row in rows)), "")

    def is_current(self, store: Store) -> bool:
        """Return whether all stabilised takes exist in the store."""
        return has_all_takes(store, "tracks", "stabilise")

    def run(self, context: StageContext, params: StabiliseParameters) -> dict[str, object]:
        """Stabilise the takes that are new or changed, each committed whole."""
        place = RunContext.of(context)
        tracks = context.key(context.inputs["tracks"])
        with context.writer() as writer:
            store = writer.store
            learned = read_templates(store, context.key(context.inputs["templates"]), params.templates)
            material = training_material(store, context.params_of("templates", TemplateParameters))
            takes = params.takes or [str(row["take"]) for row in earlier_rows(store, "tracks", tracks)]
            tracker = context.params_of("tracks", TrackParameters)
            done = stabilise(writer, params, tracker, takes, Archive(learned, material.clips), place)
        rebuild_index(context.store_path, context.wait)
        if done.unchanged:
            context.message(f"unchanged: {len(done.unchanged)} of {len(done.names)}")
        return {"takes": done.names, "unchanged": len(done.unchanged), "remarks": done.remarks}
