"""Stage observe: read and check recordings of calibrated cameras, and store them as observations."""

from __future__ import annotations

from kinedex.catalog.camera_recordings import load_recordings
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading, hash_of
from kinedex.pipelines.engine.stage import Stage
from kinedex.pipelines.tracking.observed_recordings import files_stamp
from kinedex.pipelines.tracking.parameters import ObserveParameters
from kinedex.pipelines.tracking.recording_runs import RunContext
from kinedex.pipelines.tracking.tracking_runs import observe
from kinedex.storage.store.store import Store


class Observe(Stage[ObserveParameters]):
    """Reads and checks recordings of calibrated cameras, and stores them as observations."""

    name = "observe"
    parameters = ObserveParameters

    def reading(self, params: ObserveParameters, store: Store) -> Reading:
        """Return an empty digest: recordings do not depend on the archive."""
        return Reading("no takes", "")

    def external_digest(self, params: ObserveParameters, store: Store | None) -> str:
        """Return a hash of the recordings' settings, and of their files by path, size and time."""
        file = load_recordings(params.recordings)
        return hash_of(*(files_stamp(file, name) for name in params.only or file.recordings))

    def run(self, context: StageContext, params: ObserveParameters) -> dict[str, object]:
        """Read the recordings that are new or changed, each committed whole."""
        place = RunContext.of(context)
        with context.writer() as writer:
            done = observe(writer, params, place)
        if done.unchanged:
            context.message(f"unchanged: {len(done.unchanged)} of {len(done.names)}")
        return {"recordings": done.names, "unchanged": len(done.unchanged)}
