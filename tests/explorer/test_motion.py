"""Motions for the page: exact to a unit, gaps and all, at any place, and clear errors beyond the ends of a take."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from kinedex.explorer.motion import (
    BLOCK_FRAMES,
    FIRST_FRAMES,
    HEADER_BYTES,
    UNKNOWN,
    PositionCache,
    facing_viewer,
    figures,
    motion_blocks,
    packed_positions,
)
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.ops.intervals import Interval
from kinedex.storage.snapshot.parts import FramesWriter
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, arrays, take_row, takes_table

JOINTS = len(BODY.joints)


def run_of_kilometres(frames: int) -> np.ndarray:
    """A body that runs 9 m/s away from the origin, and whose right fingers are lost for a while."""
    random = np.random.default_rng(3)
    places = random.normal(0, 0.5, (frames, JOINTS, 3)) + np.array([0.3, 0.0, 0.0]) * np.arange(frames)[:, None, None]
    places[40:60, BODY.joints.index("rfingers")] = np.nan
    return places.astype(np.float32)


POSITIONS = {"far": run_of_kilometres(2000), "near": run_of_kilometres(90)}


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    path: Path = tmp_path_factory.mktemp("motion") / "store"
    with StoreWriter.open(path, BODY) as writer:
        ids = writer.assign_take_ids(list(POSITIONS))
        with FramesWriter(path, BODY) as frames:
            for name, positions in POSITIONS.items():
                _, orientation, words = arrays(name, len(positions))
                frames.add(ids[name], positions.transpose(1, 2, 0), orientation, words)
            part = frames.close()
        rows = [take_row(ids[name], name, len(positions)) for name, positions in POSITIONS.items()]
        writer.add_takes(takes_table(rows), part)
        writer.commit()
    return open_store(path)


def unpack(block: bytes) -> tuple[tuple[int, ...], np.ndarray, float]:
    """Return frames, joints, first and step, the positions in metres, and the unit."""
    magic, frames, joints, first, step, rate, unit, *origin = struct.unpack("<4s4I5f8x", block[:HEADER_BYTES])
    assert (magic, rate) == (b"KNX1", 30.0)
    numbers = np.frombuffer(block[HEADER_BYTES:], "<i2").reshape(frames, joints, 3)
    places = np.where(numbers == UNKNOWN, np.nan, numbers * np.float64(unit) + np.array(origin))
    return (frames, joints, first, step), places, unit


@pytest.mark.parametrize(("first", "stop", "step"), [(0, None, 1), (31, 1990, 7), (1999, 2000, 1)])
def test_a_take_comes_in_blocks_that_are_exact_to_a_millimetre_a_kilometre_away(
    store: Store, first: int, stop: int | None, step: int
) -> None:
    blocks = [unpack(one) for one in motion_blocks(PositionCache(), store, store.take_ids["far"], first, stop, step)]
    found = np.concatenate([places for _, places, _ in blocks])
    expected = POSITIONS["far"][first:stop:step]
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    for (frames, joints, begin, _), places, unit in blocks:
        true = POSITIONS["far"][begin : begin + frames * step : step]
        assert joints == JOINTS
        assert np.nanmax(np.abs(places - true)) <= unit / 2 * 1.01 + 1e-4  # float32 at 600 m is good to 0.03 mm
    assert blocks[0][0][2:] == (first, step)
    assert blocks[0][0][0] <= FIRST_FRAMES
    assert all(head[0] <= BLOCK_FRAMES for head, _, _ in blocks)
    assert max(unit for *_, unit in blocks) <= 0.001


def test_an_empty_range_is_one_block_without_frames(store: Store) -> None:
    (block,) = motion_blocks(PositionCache(), store, store.take_ids["near"], 90)
    assert unpack(block)[0] == (0, JOINTS, 90, 1)


@pytest.mark.parametrize(("first", "stop", "step"), [(-1, None, 1), (0, 91, 1), (50, 40, 1), (0, None, 0)])
def test_a_range_beyond_the_take_is_an_error_at_once(store: Store, first: int, stop: int | None, step: int) -> None:
    with pytest.raises(ParameterError, match=r"must be a range within \[0, 90\)|must be at least 1"):
        motion_blocks(PositionCache(), store, store.take_ids["near"], first, stop, step)
    with pytest.raises(KinedexError, match="no take has the id 99"):
        motion_blocks(PositionCache(), store, 99)


def test_a_motion_without_any_known_place_has_unknown_numbers_alone() -> None:
    shape, places, _ = unpack(packed_positions(np.full((2, 3, 3), np.nan), 30.0))
    assert shape == (2, 3, 0, 1)
    assert np.isnan(places).all()


def test_figures_have_the_order_of_the_question_and_begin_above_the_origin_facing_the_viewer(store: Store) -> None:
    asked = [Interval("far", 900, 1000), Interval("near", 0, 20), Interval("far", 3, 4)]
    answer = figures(PositionCache(), store, asked, 25)
    (count,) = struct.unpack_from("<I", answer)
    place, found = 4, []
    for _ in range(count):
        (length,) = struct.unpack_from("<I", answer, place)
        found.append(unpack(answer[place + 4 : place + 4 + length]))
        place += 4 + length
    assert place == len(answer)
    assert [shape for shape, _, _ in found] == [(25, JOINTS, 900, 4), (20, JOINTS, 0, 1), (1, JOINTS, 3, 1)]
    for _, places, unit in found:
        left, right = (places[0, BODY.joints.index(name)] for name in ("lhip", "rhip"))
        assert np.abs(places[0, 0, [0, 2]]).max() <= unit
        assert abs(left[2] - right[2]) <= 2 * unit
        assert left[0] > right[0]
    turned = facing_viewer(POSITIONS["near"][:20], BODY.joints)
    steps = [np.linalg.norm(np.diff(one, axis=0), axis=2) for one in (turned, POSITIONS["near"][:20])]
    np.testing.assert_allclose(*steps, atol=1e-5)


def test_figures_beyond_a_take_and_too_many_of_them_are_refused(store: Store) -> None:
    with pytest.raises(ParameterError, match=r"interval 2 must be 0 <= start < stop <= 90"):
        figures(PositionCache(), store, [Interval("near", 0, 9), Interval("near", 80, 91)], 25)
    with pytest.raises(ParameterError, match="at most 500"):
        figures(PositionCache(), store, [Interval("near", 0, 9)] * 501, 25)


def test_the_cache_keeps_what_fits(store: Store) -> None:
    cache = PositionCache(POSITIONS["near"].nbytes)
    near, far = store.take_ids["near"], store.take_ids["far"]
    first = cache.positions(store, near)
    assert cache.positions(store, near) is first
    assert cache.positions(store, far) is not cache.positions(store, far)
    assert cache.positions(store, near) is first
