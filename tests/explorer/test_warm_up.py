"""Preparation asks a first question of each kind, whatever the store has or lacks."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from kinedex.explorer.open_archive import Archive
from kinedex.explorer.warm_up import prepare
from kinedex.storage.index.builder import build_index
from kinedex.storage.store.store import open_store
from kinedex.storage.store.writer import StoreWriter
from tests.pipelines.labelled import long_take, write_store
from tests.storage.made_up import BODY

STEPS = ["open_sql", "ask_by_example", "check_frames", "ask_for_more", "ask_by_keyframes", "ask_for_doubtful"]


def prepared(path: Path, caplog: pytest.LogCaptureFixture) -> dict[str, str]:
    """Return what the preparation of a store logs about each step."""
    with caplog.at_level(logging.INFO, "kinedex.explorer"):
        prepare(Archive(path))
    return dict(record.message.lstrip("_").split(": ", 1) for record in caplog.records)


@pytest.mark.parametrize("takes", [1, 2, 4])
def test_all_questions_are_answered(tmp_path: Path, caplog: pytest.LogCaptureFixture, takes: int) -> None:
    path = write_store(tmp_path / "store", [long_take(f"t{number}", "al", "walk", "kick") for number in range(takes)])
    build_index(open_store(path, at="newest"), threads=1)
    found = prepared(path, caplog)
    assert list(found) == STEPS
    assert all(said.endswith(" s") for said in found.values()), found


def test_a_store_without_takes_has_nothing_to_ask_for(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with StoreWriter.open(tmp_path / "store", BODY) as writer:
        writer.commit()
    assert list(prepared(tmp_path / "store", caplog)) == STEPS
