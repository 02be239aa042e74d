"""Upgrade a store to the current format, by a new version with the same takes and results; the old one is kept."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from kinedex.ops.errors import StoreError
from kinedex.storage.durable_files import TEMPORARY, FileSums, sync_file, write_errors
from kinedex.storage.index.builder import build_index
from kinedex.storage.index.generations import current_generation, generations
from kinedex.storage.lock import NO_WAIT, Lock, Wait
from kinedex.storage.remedies import upgrade_with_damage
from kinedex.storage.snapshot.manifest import (
    AnyPart,
    Manifest,
    Part,
    PipelineRecord,
    Source,
    StageRecord,
    kinedex_version,
    now,
    running_command,
)
from kinedex.storage.snapshot.manifest_files import FOLDER, publish, read_newest
from kinedex.storage.snapshot.parts import column_count, read_errors, write_part
from kinedex.storage.snapshot.schemas import (
    FORMAT_VERSION,
    GROUP_COLUMN,
    TakeColumn,
    column_problem,
    takes_schema,
    with_columns,
)
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.store.garbage_collection import shown_bytes
from kinedex.storage.store.writer import FOLDERS

PROGRESS = f"{TEMPORARY}upgrade.jsonl"
"""The file in the folder of manifests with the checksums that a killed upgrade has computed."""

_THREADS = min(4, os.cpu_count() or 1)


@dataclass(frozen=True)
class Upgrade:
    """The result of an upgrade, or its plan in a dry run.

    Attributes
    ----------
    before : int
        Format of the store.
    version : int
        Number of the new version; in a dry run, or if the store has the current format, that of the newest version.
    parts : int
        Number of parts that are checked.
    bytes : int
        Size of these parts.
    takes_parts : int
        Number of parts of takes that are rewritten; frames and results are not.
    columns : tuple of str
        New columns of takes, from the named groups of source patterns.
    damaged : tuple of str
        Damaged or missing parts that are left unchanged.
    index_built : bool
        True if an index of an older kinedex was rebuilt.
    """

    before: int
    version: int
    parts: int = 0
    bytes: int = 0
    takes_parts: int = 0
    columns: tuple[str, ...] = ()
    damaged: tuple[str, ...] = ()
    index_built: bool = False


def upgrade(
    store: str | Path,
    *,
    keep_damaged: bool = False,
    dry_run: bool = False,
    wait: Wait = NO_WAIT,
    progress: Callable[[int], object] = lambda _: None,
) -> Upgrade:
    """Convert a store to the current format.

    Every part is compared with its SHA-256 checksum, and its XXH3 checksum is recorded. If source patterns have named
    groups, parts of takes are rewritten with these groups as columns. Takes, their ids, results and records of stages
    stay valid, so that no stage has to run again. The result becomes visible in one step, as a new version. A killed
    upgrade continues where it stopped when it is run again. The index is kept, unless its file format has changed; then
    it is rebuilt before the new version is published.

    Parameters
    ----------
    store : str or Path
        The store's directory.
    keep_damaged : bool, optional
        Convert the store even if parts are damaged or missing; these are left for `kinedex repair`.
    dry_run : bool, optional
        Change nothing, and do not compute checksums.
    wait : Wait, optional
        Time to wait for another writer to finish.
    progress : callable, optional
        Called with the size in bytes of each checked part.

    Raises
    ------
    StoreError
        A part is damaged or missing, another process writes the store, or the disk is full; nothing is changed.
    """
    root = Path(store)
    manifest = read_newest(root)
    if manifest.format_version == FORMAT_VERSION:
        return Upgrade(FORMAT_VERSION, manifest.version)
    if dry_run:
        columns, again = _group_columns(root, manifest, ())
        return _summary(manifest, manifest.version, columns, again, ())
    with Lock(root / "lock", "the upgrade", wait):
        manifest = read_newest(root)
        if manifest.format_version == FORMAT_VERSION:
            return Upgrade(FORMAT_VERSION, manifest.version)
        with write_errors(root):
            for folder in FOLDERS:
                (root / folder).mkdir(exist_ok=True)
        sums = _checked_sums(root, manifest.parts, progress)
        damaged = tuple(part.path for part in manifest.parts if part.path not in sums)
        if damaged and not keep_damaged:
            shown = ", ".join(damaged[:3]) + (f" and {len(damaged) - 3} more" if len(damaged) > 3 else "")
            raise StoreError(
                f"{root}: {len(damaged)} of {len(manifest.parts)} parts are damaged or missing: {shown}; nothing was "
                "changed; bring the files back from a copy of the store, or accept the damage",
                remedy=upgrade_with_damage(root),
            )
        columns, again = _group_columns(root, manifest, damaged)
        made = _upgraded(root, manifest, sums, columns, again)
        # built before the version exists, so that no reader finds it without its index, even after a kill
        built = not damaged and bool(generations(root)) and current_generation(root, made) is None
        if built:
            build_index(Snapshot(root, made), wait=wait)
        publish(root, made)
        (root / FOLDER / PROGRESS).unlink(missing_ok=True)
    return replace(_summary(manifest, made.version, columns, again, damaged), index_built=built)


def summary(store: str | Path, done: Upgrade, *, dry_run: bool = False) -> list[str]:
    """Describe an upgrade in lines of text."""
    if done.before == FORMAT_VERSION:
        return [f"{store} has format {FORMAT_VERSION} already: nothing to do"]
    columns = f"; takes get the columns {', '.join(done.columns)}" if done.columns else ""
    parts = f"{done.parts} parts of {shown_bytes(done.bytes)}"
    if dry_run:
        again = f"{done.takes_parts} parts of takes would be written again"
        return [f"would convert {store} from format {done.before} to {FORMAT_VERSION}: check {parts}; {again}{columns}"]
    lines = [
        f"converted {store} from format {done.before} to {FORMAT_VERSION}: {parts} checked, {done.takes_parts} parts "
        f"of takes written again{columns}; version {done.version}"
    ]
    lines += ["the index was built again"] if done.index_built else []
    lines += [f"✗ {path}: is damaged or missing, and was kept" for path in done.damaged]
    lines.append(
        f"`kinedex repair {store}` repairs what is damaged"
        if done.damaged
        else f"version {done.version - 1} stays as it was; `kinedex gc {store}` removes old versions"
    )
    return lines


def _summary(
    manifest: Manifest, version: int, columns: Iterable[str], again: Iterable[Part], damaged: tuple[str, ...]
) -> Upgrade:
    size = sum(part.bytes for part in manifest.parts)
    count = len(list(again))
    return Upgrade(manifest.format_version, version, len(manifest.parts), size, count, tuple(columns), damaged)


def _checked_sums(root: Path, parts: Iterable[AnyPart], progress: Callable[[int], object]) -> dict[str, str]:
    """Return a dict from path to XXH3 for undamaged parts; checksums that a killed upgrade has computed are reused."""
    known = _known_sums(root)
    found: dict[str, str] = {}

    def check(part: AnyPart) -> tuple[AnyPart, dict[str, Any] | None]:
        try:
            state = os.stat(root / part.path)
            record = known.get(part.path)
            if record is not None and (record["bytes"], record["mtime_ns"]) == (state.st_size, state.st_mtime_ns):
                sums = FileSums(record["bytes"], record["sha256"], record["xxh3"])
            else:
                sums = sync_file(root / part.path)
        except OSError:
            return part, None
        return part, {"path": part.path, "mtime_ns": state.st_mtime_ns, **sums._asdict()}

    with write_errors(root / FOLDER), open(root / FOLDER / PROGRESS, "a", encoding="utf-8") as written:
        # end a line that a killed upgrade left incomplete
        written.write("\n")
        with ThreadPoolExecutor(_THREADS) as pool:
            for part, record in pool.map(check, parts):
                if record is not None and (record["bytes"], record["sha256"]) == (part.bytes, part.sha256):
                    found[part.path] = record["xxh3"]
                    written.write(json.dumps(record) + "\n")
                    written.flush()
                progress(part.bytes)
    return found


def _known_sums(root: Path) -> dict[str, dict[str, Any]]:
    """Return the records of a killed upgrade by path; incomplete lines are ignored."""
    known = {}
    try:
        lines = (root / FOLDER / PROGRESS).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return {}
    for line in lines:
        try:
            record = json.loads(line)
            FileSums(record["bytes"], record["sha256"], record["xxh3"])
            known[record["path"]] = record | {"mtime_ns": record["mtime_ns"]}
        except (ValueError, KeyError, TypeError):
            continue
    return known


def _groups(root: Path, part: Part) -> Iterator[tuple[dict[str, Any], bool]]:
    """Yield for each row of a part of takes what named groups of its path pattern matched, and True if it is live."""
    file = root / part.path
    with read_errors(file):
        table = pq.read_table(file, columns=["take_id", "groups"])
    gone = set(part.dropped)
    for take, text in zip(*(column.to_pylist() for column in table.columns), strict=True):
        groups = json.loads(text or "{}")
        yield groups if isinstance(groups, dict) else {}, take not in gone


def _group_columns(
    root: Path, manifest: Manifest, damaged: tuple[str, ...]
) -> tuple[dict[str, TakeColumn], tuple[Part, ...]]:
    """Return columns for the named groups of path patterns, which old rows hold as JSON, and the parts of such rows."""
    columns: dict[str, TakeColumn] = {}
    again = []
    for part in manifest.takes:
        if part.path in damaged:
            continue
        names = dict.fromkeys(name for groups, counts in _groups(root, part) if counts for name in groups)
        for name in names:
            if column_problem(name, GROUP_COLUMN, columns) is None:
                columns[name] = GROUP_COLUMN
        if not columns.keys().isdisjoint(names):
            again.append(part)
    return columns, tuple(again)


def _upgraded(
    root: Path, manifest: Manifest, sums: dict[str, str], columns: dict[str, TakeColumn], again: tuple[Part, ...]
) -> Manifest:
    """Write the new parts of takes, and return the manifest of the new version."""
    new = {part.path: _with_groups(root, part, columns) for part in again}
    takes = tuple(new.get(part.path, replace(part, xxh3=sums.get(part.path, ""))) for part in manifest.takes)
    results = {
        kind: tuple(
            replace(part, xxh3=sums[part.path], columns=column_count(root / part.path)) if part.path in sums else part
            for part in parts
        )
        for kind, parts in manifest.results.items()
    }
    return replace(
        manifest,
        format_version=FORMAT_VERSION,
        version=manifest.version + 1,
        created=now(),
        frames=tuple(replace(part, xxh3=sums.get(part.path, "")) for part in manifest.frames),
        takes=takes,
        results=results,
        kinedex=kinedex_version(),
        command=running_command(),
        changes={"upgraded_from": manifest.format_version} | ({"columns": list(columns)} if columns else {}),
        columns=columns,
        sources=_sources(root, takes, manifest.stages, sums),
        pipelines=_pipelines(manifest.stages),
    )


def _with_groups(root: Path, part: Part, columns: dict[str, TakeColumn]) -> Part:
    """Write the live rows of a part as a new part, with the named groups as columns."""
    schema = takes_schema(columns)
    rows = []
    with read_errors(root / part.path):
        table = with_columns(pq.read_table(root / part.path), takes_schema())
    for row, (groups, counts) in zip(table.to_pylist(), _groups(root, part), strict=True):
        if counts:
            rows.append({name: groups.get(name) for name in columns} | row)
    return write_part(root, "takes", pa.Table.from_pylist(rows, schema=schema), part.live)


def _sources(
    root: Path, takes: Iterable[Part], stages: dict[str, StageRecord], sums: dict[str, str]
) -> dict[str, Source]:
    """Return a dict from source folder to settings, from the records of stages that ingest."""
    roots: set[str] = set()
    for part in takes:
        if part.path in sums or part.xxh3:
            with read_errors(root / part.path):
                roots.update(pq.read_table(root / part.path, columns=["source_root"]).column(0).to_pylist())
    sources = {}
    for key, record in sorted(stages.items(), key=lambda item: item[1].finished):
        params = record.summary.get("params", {})
        if record.summary.get("uses") == "ingest" and params.get("source"):
            folder = os.path.realpath(Path(params["source"]).expanduser())
            if folder in roots:
                sources[folder] = Source(key, params | {"source": folder}, record.finished)
    return sources


def _pipelines(stages: dict[str, StageRecord]) -> dict[str, PipelineRecord]:
    """Return records of pipelines, with pipeline files composed from the records of their stages."""
    pipelines: dict[str, list[StageRecord]] = {}
    for key, record in stages.items():
        pipelines.setdefault(key.partition("/")[0], []).append(record)
    return {name: _pipeline(name, records) for name, records in pipelines.items()}


def _pipeline(name: str, records: list[StageRecord]) -> PipelineRecord:
    last = max(records, key=lambda record: record.finished)
    stages = {
        record.stage.partition("/")[2]: {
            key: record.summary[key] for key in ("uses", "inputs", "params") if key in record.summary
        }
        for record in records
    }
    content = {"name": name, "description": "made of the records of its stages by `kinedex upgrade`", "stages": stages}
    sources = sorted({record.summary.get("params", {}).get("source") or "" for record in records} - {""})
    return PipelineRecord(
        yaml=yaml.safe_dump(content, sort_keys=False, allow_unicode=True),
        path="",
        settings={},
        sources=tuple(os.path.realpath(Path(source).expanduser()) for source in sources),
        command="",
        kinedex="",
        run=last.run,
        recorded=last.finished,
    )
