"""A search by example: words find candidates, and numbers order them by their similarity."""

from __future__ import annotations

import itertools
from pathlib import Path

import polars as pl
import pytest

import kinedex
from kinedex.ops.errors import KinedexError, ParameterError

SQUAT = "squat1Reps"


@pytest.fixture
def squats(store: kinedex.Store) -> list[str]:
    """The names of the clips of a squat."""
    return sorted(store.takes(f"class = '{SQUAT}'")["name"].to_list())


def test_hits_are_the_candidates_of_the_ranking_in_another_order(store: kinedex.Store, squats: list[str]) -> None:
    found = store.similar(squats[0], top=None, tau=0.3)
    ranked = store.rank(kinedex.Template.from_clip(store[squats[0]]), None, tau=0.3)
    place = ["take", "start", "stop", "cost"]
    assert found.select(place).sort(place).equals(ranked.select(place).sort(place))
    assert found["rank"].to_list() == list(range(1, found.height + 1))
    similarity = found["similarity"].to_list()
    assert similarity == sorted(similarity, reverse=True)
    assert (found["take"][0], found["similarity"][0]) == (squats[0], pytest.approx(1))
    probable = found["probable"].to_list()
    assert probable == sorted(probable, reverse=True)


def test_the_clips_of_the_same_motion_come_first(store: kinedex.Store, squats: list[str]) -> None:
    clips = store.takes("class IS NOT NULL")
    class_of = dict(zip(clips["name"].to_list(), clips["class"].to_list(), strict=True))
    found = store.similar(squats[0], where="class IS NOT NULL", top=None)
    takes = [take for take, _ in itertools.groupby(found["take"].to_list())]
    assert [class_of[take] for take in takes[: len(squats)]] == [SQUAT] * len(squats)


def test_a_take_that_is_not_in_the_store_is_an_example(store: kinedex.Store, motion_file: Path) -> None:
    inside, found = store.similar(motion_file.stem, top=5), store.similar(kinedex.read(motion_file), top=5)
    assert found.drop("template").equals(inside.drop("template"))


def test_several_examples_and_rejected_intervals(store: kinedex.Store, squats: list[str]) -> None:
    clips = [f"{name}[0:{len(store[name])}]" for name in squats[:2]]
    of_clips = "class IS NOT NULL"
    several = store.similar(clips, top=None, where=of_clips)
    assert set(several["take"][:2]) == set(squats[:2])
    rejected = next(name for name in several["take"] if name not in squats)
    without = store.similar(clips, top=None, rejected=[rejected], where=of_clips)
    assert not without.filter(pl.col("take") == rejected)["probable"].any()
    assert without.filter(pl.col("take") == rejected)["similarity"].max() < 0
    mirrored = store.similar([f"mirror of {clips[0]}"], top=1, mirror=True)
    assert (mirrored["take"][0], mirrored["mirrored"][0]) == (squats[0], True)


def test_bad_examples_are_named(store: kinedex.Store, squats: list[str]) -> None:
    with pytest.raises(KinedexError, match="no take"):
        store.similar(["nobody[0:3]"])
    with pytest.raises(KinedexError, match="100000"):
        store.similar([f"{squats[0]}[0:100000]"])
    with pytest.raises(ParameterError, match="start and stop"):
        store.similar([squats[0]], 3, 9)
    with pytest.raises(KinedexError, match="example"):
        store.similar([])


def test_a_take_of_few_joints_is_compared_by_these(store: kinedex.Store, squats: list[str]) -> None:
    take = store[squats[0]]
    positions = take.positions.copy()
    positions[:, take.joints.index("head")] = float("nan")
    partial = kinedex.Take.from_positions(positions, take.rate_hz, joints=take.joints, name="without a head")
    found = store.similar(partial, top=3)
    assert found["take"][0] == squats[0]
    assert found["similarity"][0] > 0.9
    positions[:, [take.joints.index(one) for one in ("lknee", "rknee")]] = float("nan")
    legless = kinedex.Take.from_positions(positions, take.rate_hz, joints=take.joints, name="without knees")
    with pytest.warns(UserWarning, match="no example has a pair of hips or shoulders and a whole leg"):
        store.similar(legless, top=3)
