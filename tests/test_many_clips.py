"""The study of very large classes: copies of clips, and its tables on a made-up archive."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from kinedex.pipelines.templates.template_learning import TrainingClips, training_clips
from kinedex.storage.store.store import open_store
from studies import many_clips
from tests.pipelines.labelled import clip, write_store

ACTORS = ("ann", "bob", "cid", "dan")


def archive(path: Path) -> Path:
    """Write four actors' clips of three classes, each slower than the one before."""
    shown = (("walk", 3), ("kick", 2), ("wave", 1))
    takes = [clip(label, who, n, 4 + n) for label, count in shown for who in ACTORS for n in range(count)]
    return write_store(path, takes)


def test_the_largest_class_has_as_many_clips_as_asked_for_and_the_others_their_share(tmp_path: Path) -> None:
    store = open_store(archive(tmp_path / "store"))
    clips = training_clips(store, store.takes("class IS NOT NULL"))
    assert {one.subclass: Counter(one.of_actors) for one in clips}["walk"] == dict.fromkeys(ACTORS, 3)
    larger = many_clips.enlarged(clips, 30)
    assert {one.subclass: len(one.words) for one in larger} == {"kick": 20, "walk": 30, "wave": 10}
    for one, own in zip(larger, clips, strict=True):
        assert len(set(one.names)) == len(one.names) == len(one.of_takes) == len(one.of_actors)
        assert all(np.array_equal(a, b) for a, b in zip(one.words, own.words, strict=False))  # the first are themselves
        assert set(np.concatenate(one.words).tolist()) <= set(np.concatenate(own.words).tolist())
    again = many_clips.enlarged(clips, 30)
    assert all(
        np.array_equal(a, b)
        for one, other in zip(larger, again, strict=True)
        for a, b in zip(one.words, other.words, strict=True)
    )
    assert [len(one.words) for one in many_clips.enlarged(clips, 1)] == [8, 12, 4]


def test_a_class_keeps_its_actors_without_some_takes_and_in_the_mirror() -> None:
    words = tuple(np.ones(3, np.uint64) for _ in range(3))
    clips = TrainingClips("walk", ("a", "b", "c"), words, actors=("ann", "bob", "cid"))
    assert clips.without({"b"}).of_actors == ("ann", "cid")
    assert TrainingClips("walk", ("a", "b"), words[:2]).of_actors == ("", "")


def test_the_study_prints_its_tables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = archive(tmp_path / "store")
    options = ["--largest", "90", "--judged", "1", "90", "--bounds", "10", "--whole"]
    monkeypatch.setattr(sys, "argv", ["many_clips", str(path), *options])
    many_clips.main()
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("180 clips of 3 classes, 90 in the largest")
    assert [line.split(":")[0] for line in lines[1:3]] == ["averaged from 80", "averaged from all"]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines[6:]]
    assert [row[:3] for row in rows] == [
        ["6", "12", "10"], ["6", "12", "all"], ["90", "180", "10"], ["90", "180", "all"]
    ]  # fmt: skip
    assert all(float(row[4]) == 1.0 for row in rows)  # every class ranks its own clips first
