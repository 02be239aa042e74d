"""The study of decisions in the explorer: a person of known truth, against a real server, and how F is counted."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

import pytest

from kinedex.explorer.application import BUILT
from kinedex.storage.index.builder import build_index
from kinedex.storage.store.store import open_store
from studies import explorer_decisions
from studies.explorer_decisions import Point, examples, judged, reached, report, run
from studies.explorer_person import Archive, alike, half, overlap
from tests.pipelines.labelled import long_take, motion, write_store

PEOPLE = ("ann", "bob", "cat", "dan")


def row(take: str, start: int, stop: int) -> dict[str, object]:
    return {"take": take, "start": start, "stop": stop}


def test_intervals_are_alike_if_they_share_half_of_the_shorter_one() -> None:
    assert overlap(row("a", 0, 10), row("a", 8, 30)) == 2
    assert alike(row("a", 0, 10), row("a", 5, 40))
    assert not alike(row("a", 0, 10), row("a", 6, 40))
    assert not alike(row("a", 0, 10), row("b", 0, 10))


def test_f_is_counted_by_takes_frames_and_segments() -> None:
    truth = {"a": [(0, 10)], "b": [(0, 10)]}
    takes, frames, segments = judged({"a": [(0, 5)], "b": [], "c": [(0, 5)]}, truth)
    assert takes == pytest.approx(0.5)  # one of two is right, one of two is found
    assert frames == pytest.approx(2 * 5 / (10 + 20))
    assert segments == pytest.approx(0.5)
    assert judged({"a": [(0, 10)], "b": [(0, 10)]}, truth) == (1, 1, 1)
    assert judged({"a": [], "b": []}, truth) == (0, 0, 0)


def test_names_are_halved_whatever_their_order() -> None:
    names = {f"style {number}" for number in range(9)}
    assert half(names) == half({f"style {number}" for number in reversed(range(9))})
    assert len(half(names)) == 5


def test_a_row_of_the_table_names_the_median_and_the_worst() -> None:
    def points(*values: float) -> list[Point]:
        return [Point(20 * (n + 1), n, n + 1.0, (one, 0, 0), (0, one, 0)) for n, one in enumerate(values)]

    archive = Archive("any", Path("any"), {}, frozenset(), by_take=True)
    runs = [points(0.5, 0.95), points(0.91), points(0.5, 0.6)]
    assert reached(runs[0], "decided", by_take=True) == runs[0][1]
    assert reached(runs[0], "held_out", by_take=True) is None
    line = report(archive, "kick", "top", runs)
    assert line.startswith("| kick | top | 40 (never) | 2 s (never) | 2 of 3 | never (never) |")


@pytest.mark.skipif(not (BUILT / "index.html").is_file(), reason="the page has not been built: run `make page`")
def test_a_person_finds_a_class_in_a_real_explorer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("rest", "walk", "rest", "kick", "rest")
    path = write_store(tmp_path / "store", [long_take(f"{one}_take", one, *names) for one in PEOPLE])
    build_index(open_store(path, at="newest"))
    edges = [sum(len(motion(name)) for name in names[:count]) for count in (3, 4)]
    truth = {"kick": {f"{one}_take": [(edges[0], edges[1])] for one in PEOPLE}}
    archive = Archive("made up", path, truth, half(set(PEOPLE)), by_take=False)
    monkeypatch.setattr(explorer_decisions, "BUILD", tmp_path)
    (example,) = examples(archive, "kick", 1)
    given = Namespace(each=3, most=10)
    (point,) = run(archive, "kick", "learn, doubtful first", example, given, 0)
    for takes, frames, segments in (point.decided, point.held_out):
        assert (takes, segments) == (1, 1)
        assert frames >= 0.9
    assert point.decisions <= 3
    assert point.waited > 0
