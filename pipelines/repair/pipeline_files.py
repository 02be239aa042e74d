"""Reconstruct pipeline files from the records of stages in a store."""

from __future__ import annotations

import json
from pathlib import Path

from kinedex.ops.errors import StoreError
from kinedex.pipelines.ingestion.parameters import IngestParameters
from kinedex.storage.snapshot.manifest import Manifest, StageRecord
from kinedex.storage.snapshot.manifest_files import read_version, versions


def known_stages(store: Path) -> dict[str, StageRecord]:
    """Return a dict from "<pipeline>/<stage>" to the last record of the stage, for all stages of a pipeline.

    A stage whose record was removed so that it runs again has none in the newest version, so older versions are read as
    well.
    """
    found: dict[str, StageRecord] = {}
    for version in reversed(versions(store)):
        try:
            records = read_version(store, version).stages
        except StoreError:
            continue
        found = {name: record for name, record in records.items() if "uses" in record.summary} | found
    return found


def pipeline_text(records: dict[str, StageRecord], pipeline: str) -> str:
    """Return the text of a pipeline file with the stages of a pipeline and the parameters that they were given."""
    stages = {
        key.partition("/")[2]: {name: record.summary[name] for name in ("uses", "inputs")}
        # records of format 3 do not tell given parameters from defaults
        | {"params": record.summary.get("given", record.summary["params"])}
        for key, record in records.items()
        if key.partition("/")[0] == pipeline
    }
    # JSON is valid YAML
    document = {"name": pipeline, "description": "the stages as the store records them", "stages": stages}
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def ingest_settings(manifest: Manifest, records: dict[str, StageRecord]) -> list[IngestParameters]:
    """Return the parameters with which sources were ingested, the most recent first.

    Parameters
    ----------
    manifest : Manifest
        The manifest of the store, which has the parameters of each source.
    records : dict of str to StageRecord
        The result of `known_stages`; stores upgraded from format 3 have the parameters only there.
    """
    sources = sorted(manifest.sources.values(), key=lambda source: source.recorded, reverse=True)
    ingests = [record for record in records.values() if record.summary["uses"] == "ingest"]
    ingests.sort(key=lambda record: record.finished, reverse=True)
    known = [*(source.settings for source in sources), *(record.summary["params"] for record in ingests)]
    return [IngestParameters.model_validate(params) for params in known]
