"""Stage track: track camera recordings with a kinematic chain and without priors, and store them as takes."""

from __future__ import annotations

from typing import ClassVar

from kinedex.catalog.camera_recordings import load_recordings
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading, hash_of
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.tracking.parameters import ObserveParameters, TrackParameters
from kinedex.pipelines.tracking.recording_runs import RunContext, has_all_takes, rebuild_index
from kinedex.pipelines.tracking.tracking_runs import track
from kinedex.pipelines.tracking.tracking_tasks import archive_body
from kinedex.storage.snapshot.schemas import RECORDED_FORMATS
from kinedex.storage.store.store import Store


class Track(Stage[TrackParameters]):
    """Tracks camera recordings with a kinematic chain, without priors, and stores them as takes (thesis, 6.2)."""

    name = "track"
    parameters = TrackParameters
    inputs: ClassVar = {"takes": Input("ingest", optional=True), "recordings": Input("observe")}

    def reading(self, params: TrackParameters, store: Store) -> Reading:
        """Return a digest of the archive's bodies, from which bone lengths are taken that no camera shows."""
        takes = [row for row in store.take_rows.to_pylist() if row["format"] not in RECORDED_FORMATS]
        known = sorted((row["name"], row["checksum"], row["recipe"]) for row in takes)
        return Reading(hash_of(known, archive_body(store).offsets), "")

    def is_current(self, store: Store) -> bool:
        """Return whether all tracked takes exist in the store."""
        return has_all_takes(store, "tracks", "track")

    def run(self, context: StageContext, params: TrackParameters) -> dict[str, object]:
        """Track the recordings that are new or changed, each committed whole."""
        place = RunContext.of(context)
        observed = context.params_of("recordings", ObserveParameters)
        names = observed.only or list(load_recordings(observed.recordings).recordings)
        with context.writer() as writer:
            done = track(writer, params, names, context.key(context.inputs["recordings"]), place)
        rebuild_index(context.store_path, context.wait)
        if done.unchanged:
            context.message(f"unchanged: {len(done.unchanged)} of {len(done.names)}")
        return {"takes": done.names, "unchanged": len(done.unchanged)}
