"""Motions in a report: packed small, and read back as the player does."""

from __future__ import annotations

import base64
import json
import re
import zlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.errors import KinedexError
from kinedex.ops.intervals import TakeSegment
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.templates.stored_clips import nearest_examples
from kinedex.reports import embedded_motions
from kinedex.reports.annotation_page import annotation_page
from kinedex.reports.embedded_motions import FINEST_M, UNSEEN, EmbeddedMotion, embed, motions_json, pack
from kinedex.reports.example_motions import with_hits
from kinedex.reports.report_data import Template
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store, open_store
from tests.pipelines.archives import human_amc, human_asf
from tests.pipelines.counted_bars import CountedBars
from tests.pipelines.study import study


def unpacked(motion: EmbeddedMotion) -> np.ndarray:
    """Decode a motion as the player does: (J, 3, T), NaN where no position is known."""
    steps = np.frombuffer(zlib.decompress(base64.b64decode(motion.data)), "<i2")
    rows = np.cumsum(steps.reshape(72, -1), axis=1, dtype=np.int16)
    return np.where(rows == UNSEEN, np.nan, rows * motion.unit_m).reshape(24, 3, -1)


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 40), st.sampled_from([0.5, 20.0, 500.0]), st.integers(0, 2**32 - 1))
def test_a_motion_comes_back_to_half_a_unit(frames: int, reach: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    positions = random.uniform(-reach, reach, (24, 3, frames)).astype(np.float32)
    positions[random.integers(24), :, random.integers(frames)] = np.nan
    motion = pack("take", positions, 30.0)
    assert motion.unit_m == pytest.approx(max(FINEST_M, np.nanmax(np.abs(positions[:, :, ::2])) / 32_000))
    np.testing.assert_allclose(unpacked(motion), positions[:, :, ::2], atol=0.51 * motion.unit_m)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    folder = tmp_path_factory.mktemp("motions")
    (folder / "source").mkdir()
    (folder / "source" / "xx.asf").write_text(human_asf())
    for number in range(4):
        (folder / "source" / f"xx_{number}.amc").write_text(human_amc(60 + 8 * number, number))
    run_pipeline("ingest", folder / "store", assignments={"source": str(folder / "source")})
    return open_store(folder / "store")


def test_as_many_takes_are_carried_as_fit_and_the_rest_is_named(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    names = store.takes()["name"].to_list()[:4]
    bars = CountedBars()
    all_of_them = embed(store, names, progress=bars)
    assert bars.seen == [("motions", 4, 4)]
    assert [motion.take for motion in all_of_them.motions] == names
    assert "for every take" in all_of_them.remark
    positions = joint_positions(store.frames(names[0]), all_of_them.joints)
    np.testing.assert_allclose(unpacked(all_of_them.motions[0]), positions[:, :, ::2], atol=0.51 * FINEST_M)
    room = sum(len(motion.data) for motion in all_of_them.motions[:2])
    monkeypatch.setattr(embedded_motions, "MAX_BYTES", room)
    some = embed(store, names)
    assert [motion.take for motion in some.motions] == names[:2]
    assert f"2 of the 4 takes with a timeline ({names[0]}, {names[1]})" in some.remark
    assert len(embed(store, names, "all").motions) == 4
    assert not embed(store, names, "none").motions
    assert [motion.take for motion in embed(store, names, [names[3]]).motions] == [names[3]]


def test_takes_laid_end_to_end_move_one_after_the_other(store: Store) -> None:
    one, two = store.takes()["name"].to_list()[:2]
    (laid_out,) = embed(store, {"both": (one, two)}, stage="compare_methods").motions
    found = unpacked(laid_out)
    parts = np.concatenate(
        [joint_positions(store.frames(name), embed(store, [one]).joints) for name in (one, two)], axis=2
    )
    assert (laid_out.take, laid_out.frames) == ("both", parts.shape[2])
    np.testing.assert_allclose(found, parts[:, :, ::2], atol=0.51 * FINEST_M)
    assert "--set compare_methods.embed=all" in embed(store, {"both": (one,)}, "none", "compare_methods").remark


def test_intervals_of_other_takes_are_carried_as_pieces_as_far_as_there_is_room(store: Store) -> None:
    one, two, three = store.takes()["name"].to_list()[:3]
    intervals = [(two, 8, 12), (one, 0, 5), (three, 0, 9)]
    found = embed(store, [one]).with_pieces(store, intervals, margin=2)
    whole, piece, last = found.motions
    assert (piece.take, piece.first, piece.frames, piece.total) == (two, 6, 8, store.takes()["frames"][1])
    positions = joint_positions(store.frames(two, 6, 14), found.joints)
    np.testing.assert_allclose(unpacked(piece), positions[:, :, ::2], atol=0.51 * FINEST_M)
    assert found.has(two, 6, 14)
    assert not found.has(two, 5, 14)
    room = len(whole.data) + len(piece.data)
    assert len(embed(store, [one]).with_pieces(store, intervals, margin=2, most=room).motions) == 2
    assert (last.take, last.first) == (three, 0)


def test_the_nearest_example_of_a_hit_is_the_clip_that_it_repeats(store: Store) -> None:
    names = store.takes()["name"].to_list()[:3]
    clips = (names[0], f"{names[1]}[2:14]", "gone")
    template = Template("walk", "walk", "soft", np.zeros((2, 40)), clips, 1)
    hits = [TakeSegment(names[1], "walk", 1, 16, 0.1, "walk", 0.5), TakeSegment(names[2], "run", 0, 9, 0.1, "run")]
    bars = CountedBars()
    motions, near = with_hits(store, embed(store, [names[1]]), hits, [], [template], bars)
    assert bars.seen == [("nearest examples", 1, 1)]
    assert list(near) == [hits[0].key]  # no example shows how to run
    place, steps = motions.near[0]
    frames = np.cumsum(steps)
    assert motions.motions[place].take == names[1]
    assert frames[0] == 2
    assert frames[1:7].tolist() == list(range(3, 15, 2))
    mirrored = replace(template, clips=clips[:2], origin="learned, 2 of 2 clips are those of x in the mirror")
    assert nearest_examples(store, {hit.key: hit.subclass for hit in hits}, [mirrored]) == {}


def test_a_take_without_a_timeline_cannot_be_asked_for(store: Store) -> None:
    with pytest.raises(KinedexError, match="embed: no take with a timeline is named 'nobody'"):
        embed(store, ["somebody"], ["nobody"])


def test_nothing_in_the_page_ends_the_script_that_holds_the_motions() -> None:
    carried = embedded_motions.EmbeddedMotions(
        (EmbeddedMotion("</script><b>", 0, 1, 1, 2, 15.0, 0.001, ""),), ("root",), (-1,), ""
    )
    text = str(motions_json(carried))
    assert "<" not in text
    assert json.loads(text)["motions"][0]["take"] == "</script><b>"
    assert not re.search(r"[\u2028\u2029]", text)


def test_a_page_has_a_player_where_it_carries_motions_and_its_segments_say_their_frames() -> None:
    data = study()
    take = data.takes[0].name
    carried = embedded_motions.EmbeddedMotions(
        (pack(take, np.zeros((24, 3, 8)), 30.0),), ("root",), (-1,), "Click a segment."
    )
    page = annotation_page(data, motions=carried)
    assert 'id="player"' in page
    assert f'data-take="{take}"' in page
    starts = {int(start) for start in re.findall(r'data-start="(\d+)"', page)}
    assert starts == {segment.start for segment in (*data.automatic, *data.manual)}
    assert 'id="player"' not in annotation_page(data)
