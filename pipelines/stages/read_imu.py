"""Stage read_imu: read recordings of inertial sensors, and assign them to takes and limbs, with orientations."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, ClassVar

from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading, hash_of
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.inertial.parameters import ReadImuParameters
from kinedex.pipelines.inertial.sensor_recordings import (
    ReadRows,
    ReadTask,
    file_stamps,
    find_recordings,
    read_rows,
    sensor_files,
    sensor_set_of,
    source_root,
)
from kinedex.pipelines.ingestion.file_failures import Failure, failure_messages, log_table
from kinedex.pipelines.tracking.recording_runs import earlier_rows, put_for_takes
from kinedex.storage.store.store import Store
from kinedex.storage.store.writer import StoreWriter

KINDS = ("imu_recordings", "imu_samples")
"""The kinds of results of the stage; both have a column `recording`."""

_SOURCES = {
    "file": "of the files",
    "9D": "estimated with magnetometer (9D)",
    "6D": "estimated without magnetometer (6D: each heading is arbitrary)",
}

_MAX_WARNINGS = 10

BLOCK_SAMPLES = 2_000_000
"""The number of samples per commit."""


class ReadImu(Stage[ReadImuParameters]):
    """Reads recordings of inertial sensors, and assigns them to takes and limbs (thesis, Section 7.4)."""

    name = "read_imu"
    parameters = ReadImuParameters
    inputs: ClassVar = {"takes": Input("ingest", optional=True)}

    def reading(self, params: ReadImuParameters, store: Store) -> Reading:
        """Return a digest of the names of the takes to which recordings can be assigned."""
        made = made_takes(store)
        takes = hash_of(sorted(take_ids(store).items()), *((sorted(made.items()),) if made else ()))
        return Reading(takes, "names of takes")

    def external_digest(self, params: ReadImuParameters, store: Store | None) -> str:
        """Return a hash of the recordings by path, size and time, and of the file that describes the sensors."""
        sensors = sensor_set_of(params.sensors).entries.model_dump()
        return hash_of(file_stamps(sensor_files(source_root(params.source))), sensors)

    def run(self, context: StageContext, params: ReadImuParameters) -> dict[str, object]:
        """Read the recordings that are new or changed; each is committed whole."""
        store = context.open()
        sensor_set = sensor_set_of(params.sensors)
        found = find_recordings(params, take_ids(store), sensor_set, made_takes(store))
        sensors = sensor_set.entries.model_dump()
        chosen = params.model_dump(exclude={"source", "sensors", "match"})
        tasks = []
        for recording in found.recordings:
            files = file_stamps([*recording.files, *recording.beside])
            fingerprint = hash_of(context.code, chosen, sensors, files, recording.name, recording.take_id)
            tasks.append(
                ReadTask(
                    found.root, recording, params.sensors, params.orientation, params.rate_hz, fingerprint, context.run
                )
            )
        before = {} if context.anew or not context.code else _fingerprints(store, context.key())
        fresh = [task for task in tasks if before.get(task.recording.name) != task.fingerprint]
        failures = list(found.failures)
        unchanged = {task.recording.name for task in tasks} - {task.recording.name for task in fresh}
        failures.extend(_earlier_failures(store, context.key(), unchanged))
        done = self._read(context, fresh, unchanged, failures)
        if found.passed_over:
            few = ", ".join(found.passed_over[:3])
            context.message(
                f"passed over, without columns of a sensor that are known: {counted(len(found.passed_over), 'file')}: "
                f"{few}; `columns:` of a file of sensors names others"
            )
        failures = list(dict.fromkeys(failures))  # one file may belong to the recordings of several takes
        context.message(*failure_messages(failures))
        if not done and not unchanged:
            raise KinedexError("no recording could be read; the reasons are above (table ingest_log)")
        _show(context, len(unchanged))
        return {"recordings": done + len(unchanged), "unchanged": len(unchanged), "left_out": len(failures)}

    def _read(
        self, context: StageContext, tasks: Sequence[ReadTask], unchanged: set[str], failures: list[Failure]
    ) -> int:
        """Read recordings and store their rows, remove those that no longer exist, and return the number read."""
        with context.writer() as writer, context.progress("recordings", len(tasks)) as bar:
            gone = set(_fingerprints(writer.store, context.key())) - unchanged
            waiting: list[ReadRows] = []
            samples = done = 0
            for read in context.executor.map(read_rows, list(tasks)):
                bar.advance()
                failures.extend(read.failures)
                if read.tables:
                    waiting.append(read)
                    samples, done = samples + read.tables["imu_samples"].num_rows, done + 1
                if samples > BLOCK_SAMPLES:
                    _put(context, writer, waiting, gone)
                    waiting, samples = [], 0
            _put(context, writer, waiting, gone)
            log = log_table(list(dict.fromkeys(failures)), context.run, self.name)
            writer.put_results("ingest_log", log, stage=context.key(), run=context.run)
            writer.commit()
        return done


def _show(context: StageContext, unchanged: int) -> None:
    """Show warnings of sensors, the numbers of stored recordings and sensors, and the sources of orientations."""
    stored: list[dict[str, Any]] = earlier_rows(context.open(), "imu_recordings", context.key())
    rows = [row for row in stored if row["limb"] is not None]
    warnings = [f"{row['file']}: warning: {row['sensor']}: {text}" for row in rows for text in row["warnings"]]
    context.message(*warnings[:_MAX_WARNINGS])
    if len(warnings) > _MAX_WARNINGS:
        context.message(
            f"and {counted(len(warnings) - _MAX_WARNINGS, 'warning')} more (column warnings of imu_recordings)"
        )
    sources = Counter(_SOURCES[row["orientation"]] for row in rows)
    takes, recordings = (len({row[column] for row in rows}) for column in ("take_id", "recording"))
    same = f" ({unchanged:,} unchanged, not read again)" if unchanged else ""
    context.message(
        f"{counted(recordings, 'recording')} of {counted(takes, 'take')}{same}: {counted(len(rows), 'sensor')}, "
        f"{sum(row['samples'] for row in rows):,} samples; orientations {', '.join(sources)}"
    )


def _put(context: StageContext, writer: StoreWriter, read: Sequence[ReadRows], gone: set[str]) -> None:
    """Commit the rows of recordings, and remove their earlier rows and those of recordings that no longer exist."""
    going = sorted(gone | {one.recording.name for one in read})
    for kind in KINDS:
        tables = [one.tables[kind] for one in read]
        put_for_takes(writer, kind, tables, stage=context.key(), run=context.run, column="recording", gone=going)
    writer.commit()


def take_ids(store: Store) -> dict[str, int]:
    """Return a dict from name to id of the takes of a store."""
    rows = store.take_rows
    return dict(zip(rows.column("name").to_pylist(), rows.column("take_id").to_pylist(), strict=True))


def made_takes(store: Store) -> dict[str, list[str]]:
    """Return a dict from camera recording to names of takes made from it (tracked, stabilised, reconstructed)."""
    found: dict[str, list[str]] = {}
    if "recording" in store.take_rows.column_names:
        for row in store.take_rows.select(["name", "recording"]).to_pylist():
            if row["recording"] is not None:
                found.setdefault(row["recording"], []).append(row["name"])
    return found


def _fingerprints(store: Store, stage: str) -> dict[str, str]:
    """Return a dict from recording to fingerprint for the recordings that a stage has stored."""
    return {str(row["recording"]): str(row["fingerprint"]) for row in earlier_rows(store, "imu_recordings", stage)}


def _earlier_failures(store: Store, stage: str, unchanged: set[str]) -> list[Failure]:
    """Return the logged failures of sensors that are assigned to no limb, in recordings that are unchanged."""
    rows = earlier_rows(store, "imu_recordings", stage)
    files = {str(row["file"]) for row in rows if row["recording"] in unchanged and row["limb"] is None}
    return [
        Failure(str(row["source"]), str(row["error"]), str(row["message"]), str(row["file"]), None)
        for row in earlier_rows(store, "ingest_log", stage)
        if row["source"] in files
    ]
