"""Remember failures of earlier runs in the store, so that a run reports only new ones."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.config import Pipeline
from kinedex.pipelines.labels.unmatched_labels import UnmatchedLabels
from kinedex.storage.formats.motion.packed_files import container_of
from kinedex.storage.formats.motion.sources import checksum
from kinedex.storage.formats.source_files import stamp_of
from kinedex.storage.lock import Wait
from kinedex.storage.snapshot.schemas import result_table
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter

KIND, STAGE = "known_failures", "known_failures"
"""The kind of results, and the last part of the name of the stage that they are stored under."""


@dataclass(frozen=True)
class FailedFile:
    """A file that could not be read, or whose labels match no take.

    Attributes
    ----------
    file : str
        The path of the file. If one person of a file with several persons failed, this is the path of the whole file.
    checksum : str
        Hash of what the failure depends on: the content of the file, and of other files or the names of takes that are
        involved; empty for a single file that cannot be read.
    error : str
        The kind of error.
    reason : str
        The message.
    """

    file: str
    checksum: str
    error: str
    reason: str

    @property
    def key(self) -> tuple[str, str, str]:
        """The file, its content and the kind of error, by which a failure is recognised in a later run."""
        return self.file, self.checksum, self.error


@dataclass(frozen=True)
class SourceFiles:
    """The changes of source files that a run of a pipeline has seen.

    Attributes
    ----------
    new, changed, gone : tuple of str
        Paths of files that are new since the run before, have other content, or no longer exist.
    failed : tuple of FailedFile
        The files that failed; where failures are remembered, those that did not fail in the same way before.
    accepted : tuple of FailedFile
        The files that still fail in the way that the store remembers.
    """

    new: tuple[str, ...] = ()
    changed: tuple[str, ...] = ()
    gone: tuple[str, ...] = ()
    failed: tuple[FailedFile, ...] = ()
    accepted: tuple[FailedFile, ...] = ()


def source_state(store: Store | None, pipeline: Pipeline) -> dict[str, str | None]:
    """Return the source files of a pipeline at its last ingest, with hashes of contents; None for rejected files."""
    if store is None:
        return {}
    seen: dict[str, str | None] = {}
    for stage in (one for one in pipeline.stages if one.uses == "ingest"):
        for row in store.result("source_files", stage=f"{pipeline.name}/{stage.name}").to_pylist():
            if row["outcome"] in ("in", "refused"):
                seen[f"{row['source_root']}/{row['source']}"] = None
    if seen:
        for row in store.take_columns("source_root", "source", "checksum").to_pylist():
            place = f"{row['source_root']}/{row['source']}"
            if place in seen:
                seen[place] = row["checksum"]
    return seen


def source_files(
    store_path: Path,
    pipeline: Pipeline,
    before: Mapping[str, str | None],
    unmatched: Iterable[UnmatchedLabels],
    *,
    remember: bool,
    run: str,
    wait: Wait,
) -> SourceFiles:
    """Compare source files and failures of a pipeline with the files before a run and with remembered failures.

    Parameters
    ----------
    store_path : Path
        The directory of the store, after the run.
    pipeline : Pipeline
        The pipeline.
    before : mapping of str to (str or None)
        The source files of the pipeline before the run, see `source_state`.
    unmatched : iterable of UnmatchedLabels
        The labels that match no take.
    remember : bool
        True to store the failures of this run in place of those of the run before.
    run : str
        Id of the pipeline run.
    wait : Wait
        The time to wait for another writer.
    """
    store = open_store(store_path, at="newest")
    stage, now = f"{pipeline.name}/{STAGE}", source_state(store, pipeline)
    labels = (FailedFile(one.file, _checksum(one.file, *one.takes), "UnmatchedLabels", str(one)) for one in unmatched)
    failures = tuple(dict.fromkeys([*_failed(store, pipeline), *labels]))
    remembered = store.result(KIND, stage=stage).to_pylist() if remember else ()
    known = {(row["file"], row["checksum"], row["error"]) for row in remembered}
    failed = tuple(one for one in failures if one.key not in known)
    if remember and (failed or len(known) > len(failures)):
        with StoreWriter.open(store_path, store.feature_set, store.rate_hz, wait) as writer:
            writer.put_results(KIND, result_table(KIND, map(asdict, failures), run), stage=stage, run=run)
            writer.commit()
    return SourceFiles(
        tuple(sorted(now.keys() - before.keys())),
        tuple(sorted(file for file in now.keys() & before.keys() if now[file] != before[file])),
        tuple(sorted(before.keys() - now.keys())),
        failed,
        tuple(one for one in failures if one.key in known),
    )


def _failed(store: Store, pipeline: Pipeline) -> Iterator[FailedFile]:
    """Yield the source files that the stages of a pipeline could not read."""
    for stage in pipeline.stages:
        root = getattr(stage.params, "root", None) if stage.uses == "ingest" else None
        for row in store.result("ingest_log", stage=f"{pipeline.name}/{stage.name}").to_pylist():
            file = f"{root}/{row['source']}" if root is not None else row["file"]
            yield FailedFile(file, _checksum(file, row["file"]), row["error"], row["message"])


def _checksum(file: str, *more: str) -> str:
    """Return the hash of a file, combined with that of further files or names if any are given."""
    parts = [_content(file), *(_content(one) or one for one in more if one != file)]
    return parts[0] if len(parts) == 1 else hashlib.sha256("\0".join(parts).encode()).hexdigest()


def _content(file: str) -> str:
    with suppress(KinedexError, ValueError):  # the file no longer exists, or its name is not a valid path
        return checksum(Path(file))
    container = container_of(Path(file))
    return "" if container is None else str(stamp_of(container))  # it cannot be unpacked
