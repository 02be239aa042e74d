"""A query proposed from an example finds the example, and reads back as it was written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.queries.query_reader import parse_queries
from kinedex.commands.cli import app
from kinedex.ops.errors import KinedexError, ParameterError, StoreError
from kinedex.ops.search.query_proposal import SetCounts, propose_poses
from kinedex.ops.words import NO_WORD, U64, cut
from kinedex.pipelines.keyframes.proposed_query import propose_query
from kinedex.pipelines.keyframes.store_search import search_store
from kinedex.storage.store.store import Store, open_store
from tests.pipelines.keyframes.test_store_search import make_store, motion, real_words

BODY = load_feature_set("body40")


def counts_of(words: U64) -> list[SetCounts]:
    counts = []
    for one in BODY.sets.values():
        found, frames = np.unique(cut(words, one.first, one.count), return_counts=True)
        counts.append(SetCounts(one.first, one.count, found, frames.astype(np.int64)))
    return counts


@given(st.data())
def test_the_example_meets_its_poses_in_order(data: st.DataObject) -> None:
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    words = rng.integers(0, 2**40, 8).astype(np.uint64)[np.sort(rng.integers(0, 8, 60))]
    counts = counts_of(words)
    clip = words[data.draw(st.integers(0, 20)) : data.draw(st.integers(21, 60))].copy()
    clip[rng.random(len(clip)) < 0.1] = NO_WORD
    if (clip == NO_WORD).all():
        return
    most = data.draw(st.integers(1, 6))
    poses = propose_poses(clip, counts, most)
    assert 1 <= len(poses) <= most
    frames = [pose.frame for pose in poses]
    assert frames == sorted(set(frames))
    for pose in poses:
        assert clip[pose.frame] != NO_WORD
        assert int(clip[pose.frame]) & pose.mask == pose.value
        assert 0 <= pose.share <= 1


def test_a_pose_fixes_what_is_rare_and_leaves_the_rest_open() -> None:
    words = motion(rknee_bent="." * 90 + "x" * 10, rhand_fast="x." * 50, body_low="." * 100)
    (pose,) = propose_poses(words[90:], counts_of(words), 1)
    assert pose.mask == pose.value == 1 << (BODY.feature("rknee_bent").number - 1)
    assert pose.share == 0.1


def test_an_example_of_invalid_frames_has_no_poses() -> None:
    with pytest.raises(ParameterError, match="at least one valid frame"):
        propose_poses(np.full(5, NO_WORD), counts_of(np.zeros(3, np.uint64)), 2)
    with pytest.raises(ParameterError, match="at least 1"):
        propose_poses(np.zeros(3, np.uint64), counts_of(np.zeros(3, np.uint64)), 0)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    dull = motion(rknee_bent="." * 200, rhand_fast="..x." * 50)
    squat = motion(rknee_bent="." * 60 + "x" * 12 + "." * 28, body_low="." * 64 + "x" * 5 + "." * 31)
    return make_store(tmp_path_factory.mktemp("proposing") / "store", {"dull": dull, 'it\'s a "squat"': squat})


def test_a_proposal_finds_its_example_and_little_else(store: Store) -> None:
    text = propose_query(store, 'it\'s a "squat"', 55, 75, name="down and up")
    (query,) = parse_queries(text, BODY)
    assert query.name == "down and up"
    hits = search_store(store, [query]).to_pylist()
    assert [hit["take"] for hit in hits] == ['it\'s a "squat"']
    assert hits[0]["start"] < 72
    assert hits[0]["stop"] > 60
    assert "finds 1 range in 1 take" in text
    assert "body_low" in text


def test_an_example_that_is_not_there_is_told(store: Store) -> None:
    with pytest.raises(StoreError, match="did you mean 'dull'"):
        propose_query(store, "dul", 0, 9)
    for start, stop in ((0, 201), (5, 5), (-1, 3)):
        with pytest.raises(KinedexError, match=r"within \[0, 200\)"):
            propose_query(store, "dull", start, stop)


def test_the_command_writes_a_file_that_search_reads(store: Store, tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    made = CliRunner().invoke(
        app, ["query", "from-clip", str(store.path), "dull", "3", "30", "--keyframes", "2", "-o", str(file)]
    )
    assert made.exit_code == 0, made.output
    found = CliRunner().invoke(app, ["search", str(store.path), str(file), "--save", "mine"])
    assert found.exit_code == 0, found.output
    kept = open_store(store.path).sql("SELECT DISTINCT query, take FROM hits").to_pylist()
    assert {"query": "proposed", "take": "dull"} in kept
    shown = CliRunner().invoke(app, ["search", str(store.path), str(file)])
    assert "intervals in" in shown.output.splitlines()[-1]
    nothing = CliRunner().invoke(app, ["search", str(store.path), str(file), "--where", "name = 'x'"])
    assert "0 intervals in 0 takes; --explain" in nothing.output
    refused = CliRunner().invoke(app, ["search", str(store.path), str(file), "--save", "x", "--explain"])
    assert refused.exit_code == 1


def test_the_example_can_be_said_in_seconds_or_be_the_whole_take(store: Store) -> None:
    def proposed(*place: str) -> str:
        made = CliRunner().invoke(app, ["query", "from-clip", str(store.path), "dull", *place])
        assert made.exit_code == 0, made.output
        return made.output

    assert proposed("0.1s", "1s") == proposed("3", "30")
    assert proposed() == proposed("0", "200")
    refused = CliRunner().invoke(app, ["query", "from-clip", str(store.path), "dull", "0", "201"])
    assert refused.exit_code == 1
    assert "expected 0 <= START < STOP <= 200" in refused.stderr


@pytest.mark.shared
def test_a_proposal_from_real_motion_finds_its_example_and_keeps_few_frames(shared: Path) -> None:
    names, words = real_words(shared)
    counts = counts_of(words.words)
    kept = []
    for index in range(0, len(names), 12):
        clip = words.take(index)
        poses = propose_poses(clip, counts, 3)
        for pose in poses:
            assert int(clip[pose.frame]) & pose.mask == pose.value
        rare = np.prod([pose.share for pose in poses])
        kept.append(float(rare))
    assert np.median(kept) < 0.001
