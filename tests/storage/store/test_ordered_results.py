"""Results of takes in their order: new rows go to their place, and the other parts stay as files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from kinedex.storage.snapshot import parts
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store import reused_results
from kinedex.storage.store.reused_results import ReusedParts, reused_parts, rows_in_order, stored_fingerprints
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, make_store

KIND, STAGE = "sensor_sync", "p/synchronise"


def table(take: int, version: int) -> pa.Table:
    """Return the rows of a take: as many as its version states, none for some takes."""
    rows = [
        {
            "run": "r",
            "take_id": take,
            "recording": f"{take}.{row}",
            "limbs": version,
            "left_out": "still",
            "fingerprint": str(version),
        }
        for row in range((take + version) % 4)
    ]
    return pa.Table.from_pylist(rows, schema=result_schema(KIND))


def put(writer: StoreWriter, versions: dict[int, int], fresh: set[int]) -> list[str]:
    """Put the rows of takes, of which some are new, and return the paths of the parts."""
    takes = list(versions)
    tables = [table(take, versions[take]) for take in takes if take in fresh]
    rows = rows_in_order(writer.store, KIND, STAGE, takes, fresh, tables, run="r")
    writer.put_results(KIND, rows, stage=STAGE, run="r")
    writer.commit()
    found = writer.store.result(KIND, stage=STAGE)
    assert found.equals(pa.concat_tables([table(take, version) for take, version in versions.items()]))
    return [part.path for part in writer.manifest.results[KIND]]


@pytest.mark.parametrize("full", [1, 3500, 10_000_000])
def test_the_rows_are_those_of_a_run_over_all_takes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, full: int) -> None:
    make_store(tmp_path, {"a": 5})
    for module in (parts, reused_results):
        monkeypatch.setattr(module, "FULL_BYTES", full)
    monkeypatch.setattr(reused_results, "MIN_ROWS", 2)
    random = np.random.default_rng(full)
    order = random.permutation(40).tolist()
    versions: dict[int, int] = {}
    with StoreWriter.open(tmp_path, BODY) as writer:
        for _ in range(25):
            now = {take: versions.get(take, 0) for take in order if random.random() < 0.9}
            fresh = {take for take in now if take not in versions or random.random() < 0.1}
            versions = {take: version + (take in fresh) for take, version in now.items()}
            put(writer, versions, fresh)
    assert verify(open_store(tmp_path)) == []


def test_parts_that_new_rows_do_not_fall_into_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_store(tmp_path, {"a": 5})
    for module in (parts, reused_results):
        monkeypatch.setattr(module, "FULL_BYTES", 1)
    monkeypatch.setattr(reused_results, "MIN_ROWS", 2)
    versions = dict.fromkeys((1, 2, 3, 5, 6, 9, 10), 1)
    with StoreWriter.open(tmp_path, BODY) as writer:
        before = put(writer, versions, set(versions))
        assert len(before) == 6
        after = put(writer, dict(sorted({**versions, 13: 1, 4: 2}.items())), {4, 13})
        assert [path for path in after if path in before] == before
        assert put(writer, {take: 1 for take in versions if take != 1}, set())[0] != before[0]
        for module in (parts, reused_results):
            monkeypatch.setattr(module, "FULL_BYTES", 10_000_000)
        last = put(writer, {**{take: 1 for take in versions if take != 1}, 14: 1}, {14})
        assert len(last) == 1, "small parts join the new rows"
        assert stored_fingerprints(writer.store, KIND, STAGE) == dict.fromkeys((2, 5, 6, 9, 10, 14), "1")


def test_parts_that_share_a_take_are_written_again_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_store(tmp_path, {"a": 5})
    monkeypatch.setattr(parts, "FULL_BYTES", 1)
    both = table(2, 1)
    pieces = [pa.concat_tables([table(1, 1), both.slice(0, 1)]), pa.concat_tables([both.slice(1), table(6, 1)])]
    with StoreWriter.open(tmp_path, BODY) as writer:
        writer.put_results(KIND, pieces, stage=STAGE, run="r")
        writer.commit()
        first, second = writer.manifest.results[KIND]
        assert reused_parts(writer.store, KIND, STAGE, {2, 6}) == ReusedParts((), (first, second))
        assert reused_parts(writer.store, KIND, STAGE, {1, 2, 6}) == ReusedParts((first, second), ())
        assert put(writer, {1: 2, 2: 1, 6: 1}, {1})
