"""Stage reconstruct: reconstruct takes from depth-camera recordings, with the archive's poses as prior knowledge."""

from __future__ import annotations

from typing import ClassVar

from kinedex.catalog.depth_recordings import load_depth_recordings
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading, hash_of
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.reconstruction.parameters import ReconstructParameters
from kinedex.pipelines.reconstruction.reconstruction_runs import (
    chosen_recordings,
    files_stamp,
    named_bodies,
    reconstruct,
    take_digest,
)
from kinedex.pipelines.tracking.recording_runs import RunContext, has_all_takes, rebuild_index
from kinedex.storage.store.store import Store


class Reconstruct(Stage[ReconstructParameters]):
    """Reconstructs takes from depth-camera recordings, with the archive's poses as prior (thesis, Section 8.4)."""

    name = "reconstruct"
    parameters = ReconstructParameters
    inputs: ClassVar = {"poses": Input("pose_database")}

    def reading(self, params: ReconstructParameters, store: Store) -> Reading:
        """Return a digest of the takes that provide bone lengths; the pose database covers those that provide poses."""
        return Reading(take_digest(store, list(named_bodies(params).values())), "")

    def external_digest(self, params: ReconstructParameters, store: Store | None) -> str:
        """Return a hash of the recordings' settings, and of their files by path, size and time."""
        file = load_depth_recordings(params.recordings)
        return hash_of(*(files_stamp(file, name) for name in chosen_recordings(params)))

    def is_current(self, store: Store) -> bool:
        """Return whether all reconstructed takes exist in the store."""
        return has_all_takes(store, "reconstructions", "reconstruct")

    def run(self, context: StageContext, params: ReconstructParameters) -> dict[str, object]:
        """Reconstruct the recordings that are new or changed, each committed whole."""
        place = RunContext.of(context)
        with context.writer() as writer:
            done = reconstruct(writer, params, context.key(context.inputs["poses"]), place)
        rebuild_index(context.store_path, context.wait)
        if done.unchanged:
            context.message(f"unchanged: {len(done.unchanged)} of {len(done.names)}")
        return {"takes": done.names, "unchanged": len(done.unchanged)}
