"""A keyframe search gives the same hits for an index of one shard and of many."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.catalog.queries.query_reader import parse_queries
from kinedex.pipelines.keyframes.store_search import search_store
from kinedex.storage.index.builder import build_index
from kinedex.storage.index.generations import read_generation
from kinedex.storage.snapshot.parts import FramesWriter
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, take_row, takes_table

QUERIES: tuple[KeyframeQuery, ...] = parse_queries(
    """
step:
  keyframes: [{on: [rfoot_behind]}, {on: [lfoot_behind], off: [rfoot_behind]}]
  gaps: [{range: [1, 9]}]
wave:
  keyframes: [{on: [rhand_above_neck]}, {off: [rhand_above_neck]}, {on: [rhand_above_neck, relbow_bent]}]
  gaps: [{range: [1, 20]}, {range: [0, 20]}]
""",
    BODY,
)


def takes_of_part(store: Path, part: int) -> None:
    """Three takes whose ids lie between those of other parts, once some of them are replaced."""
    rng = np.random.default_rng(part)
    with StoreWriter.open(store, BODY) as writer:
        names = [f"{i}_{part % 3}" for i in range(3)]
        ids = writer.assign_take_ids(names)
        with FramesWriter(store, BODY) as frames:
            for name in sorted(names, key=ids.__getitem__):
                few = rng.integers(0, 2**40, 6, dtype=np.uint64)
                words = np.repeat(rng.choice(few, 40), 3)
                nowhere = np.zeros((len(BODY.joints), 3, len(words)))
                frames.add(ids[name], nowhere, np.zeros((4, len(words))), words)
            done = frames.close()
        writer.add_takes(takes_table([take_row(ids[name], name, 120) for name in names]), done)
        writer.commit()


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    path = tmp_path_factory.mktemp("shards") / "store"
    for part in range(5):
        takes_of_part(path, part)
    return open_store(path, at="newest")


def test_hits_do_not_depend_on_the_number_of_shards(store: Store) -> None:
    found = []
    for shard_frames in (10**9, 1):
        generation = build_index(store, threads=1, shard_frames=shard_frames)
        described = read_generation(generation)
        assert described is not None
        found.append((len(described.shards), search_store(open_store(store.path, at="newest"), QUERIES)))
        (generation / "generation.json").unlink()
    (one, whole), (many, divided) = found
    assert (one, many) == (1, 3)
    assert whole.num_rows > 20
    assert divided.equals(whole)
