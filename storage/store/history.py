"""Keep the history of a store: a file for each pipeline run, which remains after the run's results are removed.

`history/<run>.json` has the record of a pipeline run and a checksum. `history/files/<sha256>` has the content of a
user's file that the parameters of a run name, such as a class file. Garbage collection keeps both kinds of files.
Manifests do not grow with the number of runs. Runs from before the history existed are read from the remaining
manifests.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from pydantic import TypeAdapter, ValidationError

from kinedex.ops.errors import StoreError
from kinedex.storage.durable_files import names_in, replace_file, sync_folder, write_errors, write_flushed, xxh3_of
from kinedex.storage.remedies import repair
from kinedex.storage.snapshot.manifest import Manifest, PipelineRecord, StageRecord
from kinedex.storage.snapshot.manifest_files import json_checksum, read_newest, read_version, versions

SUMS = "file_sums"
"""The field of a record's summary that is a dict from file path, relative to the store, to the XXH3 of the file."""


def file_sums(store: Path, files: Iterable[str]) -> dict[str, str]:
    """Return the checksums of files that a stage has written; their paths are relative to the store."""
    return {name: xxh3_of(store / name)[0] for name in files}


def wrong_files(store: Path, records: Iterable[StageRecord]) -> Iterator[tuple[str, str]]:
    """Yield path and problem of each file that a stage has recorded and that is missing or has changed."""
    for record in records:
        sums = record.summary.get(SUMS, {})
        for name in record.summary.get("files", ()):
            try:
                if name in sums and xxh3_of(store / name)[0] != sums[name]:
                    yield name, "its content does not fit its checksum"
            except FileNotFoundError:
                yield name, "is missing"
            except OSError as fault:
                yield name, f"cannot be read: {fault.strerror}"


def refuse_damaged_report(file: Path) -> None:
    """Raise a StoreError if a file is a report of a store and was changed since its stage wrote it."""
    places = file.resolve().parents
    if len(places) < 4 or places[1].name != "reports" or not versions(places[3]):
        return
    store, name = places[3], file.resolve().relative_to(places[3]).as_posix()
    for found, problem in wrong_files(store, read_newest(store).stages.values()):
        if found == name:
            raise StoreError(f"{file}: the report is damaged: {problem}", remedy=repair(store))


FOLDER = "history"
FILES = f"{FOLDER}/files"

_NAME = re.compile(r"^([0-9]{8}-[0-9]{6}-[0-9a-f]{4,6})\.json$")
_SHA256 = re.compile(r"^[0-9a-f]{64}$")

State = Literal["running", "finished", "failed", "interrupted"]
StageState = Literal["ran", "up to date", "running", "failed", "not reached"]

OWN_FIELDS = ("uses", "params", "given", "inputs", "fingerprint_parts", SUMS)
"""The fields that the runner adds to the summary of a stage record."""


@dataclass(frozen=True)
class StageRun:
    """A stage in a pipeline run.

    Attributes
    ----------
    stage : str
        Its name in the pipeline.
    uses : str
        The kind of stage.
    inputs : dict of str to str
        Name of an input → the stage that provides it.
    given : dict of str to object
        The parameters set by the user, as JSON values; paths are absolute.
    params : dict of str to object
        All of its parameters, including defaults.
    state : {"ran", "up to date", "running", "failed", "not reached"}
        Its state.
    reason : str
        The reason why it ran; empty if it did not.
    run : str
        Id of the run of the stage that made its results, which is an earlier one if the stage was up to date.
    fingerprint : str
        Hash of everything on which its results depend.
    fingerprint_parts : dict of str to str
        The hashes of which the fingerprint is composed.
    finished : str
        Time of its end, ISO 8601 in UTC.
    seconds : float
        Its duration.
    summary : dict of str to object
        Facts about its results, as JSON values.
    """

    stage: str
    uses: str
    inputs: dict[str, str] = field(default_factory=dict)
    given: dict[str, Any] = field(default_factory=dict)
    params: dict[str, Any] = field(default_factory=dict)
    state: StageState = "not reached"
    reason: str = ""
    run: str = ""
    fingerprint: str = ""
    fingerprint_parts: dict[str, str] = field(default_factory=dict)
    finished: str = ""
    seconds: float = 0.0
    summary: dict[str, Any] = field(default_factory=dict)

    def recorded(self, record: StageRecord, state: StageState) -> StageRun:
        """Return the stage with the facts of its record in the store."""
        return replace(
            self,
            state=state,
            run=record.run,
            fingerprint=record.fingerprint,
            fingerprint_parts=record.summary.get("fingerprint_parts", {}),
            finished=record.finished,
            seconds=record.seconds,
            summary={key: value for key, value in record.summary.items() if key not in OWN_FIELDS},
        )


@dataclass(frozen=True)
class KeptText:
    """A user's file that the parameters of a run name, with its copy in the history.

    Attributes
    ----------
    path : str
        Its absolute path.
    sha256 : str
        Checksum of its content, and name of the copy in `FILES`.
    """

    path: str
    sha256: str


@dataclass(frozen=True)
class PipelineRun:
    """One run of a pipeline.

    Attributes
    ----------
    run : str
        Its id.
    pipeline : str
        Name of the pipeline.
    state : {"running", "finished", "failed", "interrupted"}
        Its state; a run whose process was killed stays "running".
    begun, finished : str
        Times of its start and of the end of the last stage that has ended, ISO 8601 in UTC.
    seconds : float
        Duration of the stages that ran.
    kinedex : str
        Version of kinedex.
    command : str
        Command line of the process.
    description : str
        Description of the pipeline.
    path : str
        Path of the pipeline's file.
    yaml : str
        Text of that file.
    settings : dict of str to object
        The settings that replaced those of the file.
    sources : tuple of str
        The absolute paths of the folders from which its stages read motion files.
    other_sources : dict of str to dict
        Source folder → settings of its ingest, for sources ingested by earlier runs, oldest first.
    mappings : dict of str to str
        Name → text of the skeleton mappings in the store.
    files : tuple of KeptText
        The user's files that parameters name.
    takes : int
        Number of the store's takes after the run.
    labels : int
        Number of rows of labels in the store.
    version : int
        The newest version that the run made.
    problem : str
        The reason why it failed.
    stages : tuple of StageRun
        Its stages, in their order.
    """

    run: str
    pipeline: str
    state: State = "running"
    begun: str = ""
    finished: str = ""
    seconds: float = 0.0
    kinedex: str = ""
    command: str = ""
    description: str = ""
    path: str = ""
    yaml: str = ""
    settings: dict[str, Any] = field(default_factory=dict)
    sources: tuple[str, ...] = ()
    other_sources: dict[str, dict[str, Any]] = field(default_factory=dict)
    mappings: dict[str, str] = field(default_factory=dict)
    files: tuple[KeptText, ...] = ()
    takes: int = 0
    labels: int = 0
    version: int = 0
    problem: str = ""
    stages: tuple[StageRun, ...] = ()

    @property
    def ran(self) -> tuple[StageRun, ...]:
        """The stages that ran."""
        return tuple(stage for stage in self.stages if stage.state == "ran")


_ADAPTER: TypeAdapter[PipelineRun] = TypeAdapter(PipelineRun)


def write_run(store: Path, run: PipelineRun) -> None:
    """Write a pipeline run into the history, replacing an earlier state of it.

    Raises
    ------
    StoreError
        The disk is full or cannot be written; the file is unchanged.
    """
    content = asdict(run)
    text = json.dumps(content | {"checksum": json_checksum(json.loads(json.dumps(content)))}, indent=1)
    _write(store / FOLDER / f"{run.run}.json", text.encode() + b"\n")


def keep_file(store: Path, path: Path) -> KeptText:
    """Copy a file into the history, unless the history has a file with this content.

    Raises
    ------
    OSError
        The file cannot be read.
    StoreError
        The copy cannot be written.
    """
    content = path.read_bytes()
    sha256 = hashlib.sha256(content).hexdigest()
    if not (store / FILES / sha256).is_file():
        _write(store / FILES / sha256, content)
    return KeptText(os.path.abspath(path), sha256)


def kept_content(store: Path, kept: KeptText) -> bytes:
    """Return the content of a file that the history keeps.

    Raises
    ------
    StoreError
        The copy is missing or damaged.
    """
    name = f"{FILES}/{kept.sha256}"
    try:
        content = (store / name).read_bytes() if _SHA256.match(kept.sha256) else b""
    except OSError as fault:
        raise StoreError(f"{store / name}: the copy of {kept.path} cannot be read: {fault.strerror}") from None
    if hashlib.sha256(content).hexdigest() != kept.sha256:
        raise StoreError(
            f"{store / name}: the copy of {kept.path} is damaged: its content does not fit its checksum",
            remedy=repair(store),
        )
    return content


def list_runs(store: Path) -> list[PipelineRun]:
    """Return the pipeline runs of a store, oldest first.

    Runs whose file is damaged are excluded; `history_problems` names them.

    Raises
    ------
    StoreError
        There is no store.
    """
    read_newest(store)
    found = {run.run: run for run in map(partial(_read_sound, store), _files(store)) if run is not None}
    for run in _runs_of_manifests(store):
        found.setdefault(run.run, run)
    return sorted(found.values(), key=lambda run: (run.begun or run.finished, run.run))


def last_run(store: Path, pipeline: str) -> PipelineRun | None:
    """Return the latest run of a pipeline, which may be running; None if the history has none."""
    runs = map(partial(_read_sound, store), reversed(_files(store)))
    return next((run for run in runs if run is not None and run.pipeline == pipeline), None)


def history_problems(store: Path) -> Iterator[tuple[str, str]]:
    """Yield path, relative to the store, and problem of each damaged file of the history."""
    for name in _files(store):
        try:
            _read(store, name)
        except StoreError as fault:
            yield f"{FOLDER}/{name}", str(fault).partition(": ")[2].partition(";")[0]
    folder = store / FILES
    for name in names_in(folder):
        if _SHA256.match(name) and hashlib.sha256((folder / name).read_bytes()).hexdigest() != name:
            yield f"{FILES}/{name}", "its content does not fit its checksum"


def _files(store: Path) -> list[str]:
    return [name for name in names_in(store / FOLDER) if _NAME.match(name)]


def _read(store: Path, name: str) -> PipelineRun:
    path = store / FOLDER / name
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        checksum = content.pop("checksum")
        if checksum != json_checksum(content):
            raise StoreError(f"{path}: its content does not fit its checksum", remedy=repair(store))
        run = _ADAPTER.validate_python(content)
    except OSError as fault:
        raise StoreError(f"{path}: cannot be read: {fault.strerror}") from fault
    except (ValueError, ValidationError, AttributeError, KeyError, TypeError) as fault:
        raise StoreError(f"{path}: it is no pipeline run ({type(fault).__name__})", remedy=repair(store)) from None
    if f"{run.run}.json" != name:
        raise StoreError(f"{path}: it names another run", remedy=repair(store))
    return run


def _read_sound(store: Path, name: str) -> PipelineRun | None:
    """Return a run of the history; None if its file is damaged."""
    with suppress(StoreError):
        return _read(store, name)
    return None


def _write(path: Path, content: bytes) -> None:
    with write_errors(path):
        if not path.parent.is_dir():
            path.parent.mkdir(parents=True, exist_ok=True)
            sync_folder(path.parent.parent)
        replace_file(path, lambda unfinished: write_flushed(unfinished, content))
        sync_folder(path.parent)


def _runs_of_manifests(store: Path) -> Iterator[PipelineRun]:
    """Yield the last runs of pipelines that the existing versions name, newer versions first."""
    seen: set[str] = set()
    for version in reversed(versions(store)):
        try:
            manifest = read_version(store, version)
        except StoreError:
            continue
        of_stages = {name: one for name, one in _records_of_stages(manifest).items() if name not in seen}
        for name, record in {**of_stages, **manifest.pipelines}.items():
            seen.add(name)
            yield _run_of_record(manifest, name, record)


def _records_of_stages(manifest: Manifest) -> dict[str, PipelineRecord]:
    """Return records of the pipelines of a version of format 3, which has only the records of their stages."""
    found: dict[str, PipelineRecord] = {}
    for key, stage in sorted(manifest.stages.items(), key=lambda item: item[1].finished):
        sources = {stage.summary.get("params", {}).get("source") or ""} - {""}
        name = key.partition("/")[0]
        before = found[name].sources if name in found else ()
        roots = dict.fromkeys([*before, *(os.path.realpath(Path(one).expanduser()) for one in sources)])
        found[name] = PipelineRecord("", "", {}, tuple(roots), "", "", stage.run, stage.finished)
    return found


def _run_of_record(manifest: Manifest, name: str, record: PipelineRecord) -> PipelineRun:
    """Return a run, as far as its record in a manifest and the records of its stages describe it."""
    stages = [one for key, one in manifest.stages.items() if key.partition("/")[0] == name and "uses" in one.summary]
    known = tuple(
        StageRun(
            one.stage.partition("/")[2],
            one.summary["uses"],
            dict(one.summary.get("inputs", {})),
            # records of format 3 do not store separately the parameters set by the user
            dict(one.summary.get("given", one.summary.get("params", {}))),
            dict(one.summary.get("params", {})),
        ).recorded(one, "ran")
        for one in stages
    )
    others = {
        root: source.settings
        for root, source in sorted(manifest.sources.items(), key=lambda item: item[1].recorded)
        if root not in record.sources
    }
    return PipelineRun(
        run=record.run,
        pipeline=name,
        state="finished",
        finished=record.recorded,
        seconds=round(sum(one.seconds for one in known), 3),
        kinedex=record.kinedex,
        command=record.command,
        path=record.path,
        yaml=record.yaml,
        settings=record.settings,
        sources=record.sources,
        other_sources=others,
        mappings=dict(manifest.mappings),
        takes=len(manifest.live_takes),
        labels=sum(part.rows for part in manifest.labels),
        version=manifest.version,
        stages=known,
    )
