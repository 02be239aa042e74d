"""Of a damaged part of frames those takes are kept whose rows are provably right, and no others."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from kinedex.storage.repair.restored_rows import LARGEST, sound_takes, without_flip
from kinedex.storage.snapshot import parts
from kinedex.storage.snapshot.schemas import frames_schema
from tests.storage.made_up import BODY, write_frames

TAKES = {"a": (1, 300), "b": (2, 250), "c": (3, 280), "d": (4, 400)}
FRAMES = dict(TAKES.values())


@pytest.fixture
def part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A part of several row groups."""
    monkeypatch.setattr(parts, "ROW_GROUP", 256)
    (tmp_path / "frames").mkdir()
    path = tmp_path / write_frames(tmp_path, TAKES).path
    assert pq.read_metadata(path).num_row_groups > 2
    return path


def test_a_flipped_bit_costs_only_the_takes_of_its_row_group(part: Path) -> None:
    schema, whole = frames_schema(BODY, 30.0), part.read_bytes()
    expected = {take: rows.to_pylist() for take, rows in sound_takes(part, schema, FRAMES, FRAMES).items()}
    assert list(expected) == list(FRAMES)
    random, kept = np.random.default_rng(5), 0
    for _ in range(25):
        at, bit = int(random.integers(len(whole))), int(random.integers(8))
        part.write_bytes(whole[:at] + bytes([whole[at] ^ 1 << bit]) + whole[at + 1 :])
        found = sound_takes(part, schema, FRAMES, FRAMES)
        kept += len(found)
        assert {take: rows.to_pylist() for take, rows in found.items()}.items() <= expected.items()
    assert kept > 25


def test_a_part_that_was_cut_off_or_has_other_columns_gives_nothing(part: Path) -> None:
    whole = part.read_bytes()
    part.write_bytes(whole[: len(whole) // 2])
    assert sound_takes(part, frames_schema(BODY, 30.0), FRAMES, FRAMES) == {}
    part.write_bytes(whole)
    assert sound_takes(part, frames_schema(BODY, 25.0), FRAMES, FRAMES) == {}


def test_a_flipped_bit_is_found_and_other_damage_is_not() -> None:
    content = np.random.default_rng(1).bytes(2000)
    sha256 = hashlib.sha256(content).hexdigest()
    for at in (0, 999, 1999):
        flipped = content[:at] + bytes([content[at] ^ 64]) + content[at + 1 :]
        assert without_flip(flipped, sha256) == content
        assert without_flip(flipped[:-1] + bytes([flipped[-1] ^ 3]), sha256) is None
    assert without_flip(bytes(LARGEST + 1), sha256) is None
