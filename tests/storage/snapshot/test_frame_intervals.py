"""Intervals of takes are read from the row groups that hold them, whatever the size of a group, and are the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.storage.snapshot import parts
from kinedex.storage.snapshot.frames import footer_of, read_intervals
from kinedex.storage.snapshot.parts import FramesWriter, joint_positions
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, arrays, take_row, takes_table

LENGTHS = {"a": 300, "b": 5, "c": 0, "d": 63, "e": 128, "f": 1, "gone": 40, "h": 200}
GROUPS = [32, 131_072]
"""Rows of a group: so few that takes extend over many, and as many as parts of earlier versions have."""


@pytest.fixture(scope="module", params=GROUPS)
def store(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Store:
    path: Path = tmp_path_factory.mktemp("intervals") / "store"
    with pytest.MonkeyPatch.context() as patch, StoreWriter.open(path, BODY) as writer:
        patch.setattr(parts, "ROW_GROUP", request.param)
        ids = writer.assign_take_ids(list(LENGTHS))
        written = []
        for names in (("a", "d", "f", "gone", "h"), ("b", "c", "e")):  # ids of the parts interleave
            with FramesWriter(path, BODY) as frames:
                for name in names:
                    frames.add(ids[name], *arrays(name, LENGTHS[name]))
                written.append(frames.close())
        writer.add_takes(takes_table([take_row(ids[name], name, LENGTHS[name]) for name in LENGTHS]), written)
        writer.commit()
        writer.drop_takes([ids["gone"]])
        writer.commit()
    return open_store(path)


def stored(name: str, start: int, stop: int) -> np.ndarray:
    return arrays(name, LENGTHS[name])[0][:, :, start:stop].astype(np.float32)


def test_no_interval_has_no_positions(store: Store) -> None:
    assert store.positions([]) == []


def test_every_interval_is_the_rows_of_its_take(store: Store) -> None:
    random = np.random.default_rng(1)
    names = [name for name in LENGTHS if LENGTHS[name] and name != "gone"]
    asked = [("a", 0, 300), ("a", 31, 33), ("a", 64, 96), ("a", 299, 300), ("f", 0, 1), ("h", 0, 200)]
    for name in random.choice(names, 80).tolist():
        start = int(random.integers(LENGTHS[name]))
        asked.append((name, start, int(random.integers(start, LENGTHS[name])) + 1))
    intervals = [(store.take_ids[name], start, stop) for name, start, stop in asked]
    found = dict(read_intervals(store.checked, store.manifest, intervals, BODY.joints))
    assert sorted(found) == list(range(len(asked)))
    for one, positions in zip(asked, store.positions(intervals), strict=True):
        np.testing.assert_array_equal(positions.transpose(1, 2, 0), stored(*one))
    for place, one in enumerate(asked):
        assert set(found[place].column_names) == {"take_id", *BODY.joints}
        np.testing.assert_array_equal(joint_positions(found[place], BODY.joints), stored(*one))
        np.testing.assert_array_equal(joint_positions(store.frames(*one), BODY.joints), stored(*one))


def test_an_empty_range_and_a_take_without_frames_have_no_rows_but_all_columns(store: Store) -> None:
    whole = store.frames("a")
    for name, start in (("c", 0), ("a", 0), ("a", 17), ("a", 300)):
        assert store.frames(name, start, start).schema == whole.schema
        assert store.frames(name, start, start).num_rows == 0
    assert (
        store.frames("a", 5, 5, ["root", "word"]).column_names == store.frames("a", 5, 9, ["root", "word"]).column_names
    )
    assert store.frames("a", 5, 9, ["frame", "word"]).column("frame").to_pylist() == [5, 6, 7, 8]


def test_no_row_group_is_read_that_lies_beside_the_interval(store: Store) -> None:
    take = store.take_ids["a"]
    (part,) = (part for part in store.manifest.frames if take in part.live)
    footer = footer_of(store.path / part.path)
    size = footer.metadata.row_group(0).num_rows
    first = int(np.flatnonzero(footer.takes[:, 1] >= take)[0])
    assert footer.groups(take, 0, 300) == footer.groups_between(take, take)
    if size == GROUPS[0]:
        assert footer.groups(take, 65, 66) == [first + 2]
        assert footer.groups(take, 31, 33) == [first, first + 1]
        assert footer.groups(take, 299, 300) == [first + 9]
    assert footer.groups(take, 5, 5) == []
