"""The real archives against what an independent implementation computed on them: every word, every joint."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store, open_store
from tests.pipelines.archives import context

pytestmark = [pytest.mark.shared, pytest.mark.slow]

SOURCES = ["hdm05", "cmu/01", "cmu/02", "cmu/03"]


@pytest.fixture(scope="module")
def store(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Store:
    path = tmp_path_factory.mktemp("real") / "store"
    for source in SOURCES:
        summary = Ingest().run(context(path), Ingest.parameters(source=str(shared / "data" / source)))
        assert summary["left_out"] == 0
    return open_store(path)


def by_take(table: pa.Table) -> dict[str, pa.Table]:
    names = table.column("take").cast(pa.string()).to_numpy(zero_copy_only=False)
    return {name: table.filter(pa.array(names == name)) for name in np.unique(names)}


def test_every_bit_of_every_word_is_that_of_the_reference(store: Store, shared: Path) -> None:
    reference = by_take(pq.read_table(shared / "reference" / "feature_words.parquet"))
    ids = dict(store.takes().select("name", "take_id").rows())
    assert set(reference) == set(ids)
    words = store.words()
    place = {int(take): i for i, take in enumerate(words.take_ids)}
    bits = frames = 0
    for name, rows in reference.items():
        expected = rows.column("word").to_numpy()[rows.column("source_frame").to_numpy() % 4 == 0]
        found = words.take(place[ids[name]])
        assert len(found) == len(expected)
        bits += int(np.bitwise_count(found ^ expected).sum())
        frames += len(found)
    assert frames > 20_000
    assert bits == 0


def test_joints_are_within_a_tenth_of_a_millimetre_of_the_reference(store: Store, shared: Path) -> None:
    reference = by_take(pq.read_table(shared / "reference" / "joint_positions.parquet"))
    joints = store.feature_set.joints
    worst = 0.0
    for name, rows in reference.items():
        found = joint_positions(store.frames(name), joints)
        at = rows.column("source_frame").to_numpy() // 4
        for joint, track in zip(joints, found, strict=True):
            points = rows.column(joint).combine_chunks()
            expected = np.stack([points.field(axis).to_numpy() for axis in "xyz"])
            worst = max(worst, float(np.abs(track[:, at] - expected).max()))
    assert worst < 1e-4
