"""Stage index: build the index of word runs, feature runs and vocabulary of all takes, as a DuckDB file."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.file_parameters import StageParameters
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.storage.index.builder import build_index
from kinedex.storage.index.generations import current_generation, read_generation
from kinedex.storage.store.store import Store


class Params(StageParameters):
    """The parameters of the stage `index`."""

    threads: int | None = Field(None, ge=1, description="threads to use; one for every core unless given")
    memory_mb: int | None = Field(
        None, ge=64, description="memory that DuckDB may use, in MB; 80 % of the machine's unless given"
    )


class Index(Stage[Params]):
    """Builds the index of word runs, feature runs and vocabulary of all takes."""

    name = "index"
    parameters = Params
    inputs: ClassVar = {"takes": Input("ingest")}

    def is_current(self, store: Store) -> bool:
        """Return whether the index of the store's current takes exists."""
        return current_generation(store.path, store.manifest) is not None

    def run(self, context: StageContext, params: Params) -> dict[str, object]:
        """Build the index of the store's takes, unless it is up to date."""
        store = context.open()
        before = current_generation(store.path, store.manifest)
        generation = build_index(store, params.threads, params.memory_mb, wait=context.wait, progress=context.progress)
        record = read_generation(generation)
        assert record is not None
        built = 0 if generation == before else record.built_frames
        context.message(
            f"{record.rows['word_runs']:,} word runs of {record.rows['vocabulary']:,} words, "
            f"{record.rows['feature_runs']:,} feature runs in {generation.name}, "
            f"for which {built:,} of {record.frames:,} frames were indexed anew"
        )
        return {
            "generation": generation.name,
            "bytes": record.bytes,
            "shards": len(record.shards),
            "built_frames": built,
            **record.rows,
        }
