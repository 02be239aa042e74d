"""Check reports: a stage's record has the XXH3 of every file that the stage wrote beside its results."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from kinedex.ops.errors import StoreError
from kinedex.storage.disk import xxh3_of
from kinedex.storage.remedies import repair
from kinedex.storage.snapshot.manifest import StageRecord
from kinedex.storage.snapshot.manifest_files import read_newest, versions

SUMS = "file_sums"
"""The field of a record's summary that is a dict from file path, relative to the store, to the XXH3 of the file."""


def file_sums(store: Path, files: Iterable[str]) -> dict[str, str]:
    """Return the checksums of files that a stage has written; their paths are relative to the store."""
    return {name: xxh3_of(store / name)[0] for name in files}


def wrong_files(store: Path, records: Iterable[StageRecord]) -> Iterator[tuple[str, str]]:
    """Yield path and problem of each file of stages of the newest version that is missing or has changed."""
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
