"""A report of takes that nobody has labelled: what was found, what to look at first, and every segment."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa
import pytest

from kinedex.ops.intervals import TakeSegment
from kinedex.pipelines.labels.row_selection import RowSelection, selected_rows
from kinedex.reports.annotation_page import annotation_page, confirmations, hits_to_play
from kinedex.reports.archive_strip import BINS, archive_strip
from kinedex.reports.palette import CLASS_COLOURS
from kinedex.reports.report_data import ReportData, TakeRow
from kinedex.reports.report_overview import (
    LOOKS,
    MAX_ROWS,
    class_findings,
    csv_lines,
    group_findings,
    in_order,
    most_doubtful,
    surest,
    totals,
)
from kinedex.reports.take_selection import choose_takes, findings_of, take_groups
from tests.pipelines.study import FRAMES, Reading, study


def unlabelled() -> ReportData:
    """Return the study without ground truth, with a confidence of each segment and two groups of takes."""
    data = study()
    sure = (0.9, 0.1, 0.6)
    return replace(
        data,
        takes=tuple(replace(take, group=group) for take, group in zip(data.takes, ("angry", "sad"), strict=True)),
        grouped_by="style",
        automatic=tuple(replace(one, confidence=value) for one, value in zip(data.automatic, sure, strict=True)),
        manual=(),
        scores=(),
        evaluation=None,
        held_out=None,
    )


def test_what_was_found_comes_before_a_word_of_explanation() -> None:
    page = annotation_page(unlabelled())
    first, text = page[: page.index("<details>")], Reading(page).text
    for expected in ("Squats and kicks", "of 2 classes", 'class="whole"', "Surest", "Most doubtful", "confidence 0.10"):
        assert expected in first
    assert text.index("Surest") < text.index("motion template")
    assert [words for words in ("confirmed", "manual", "Agreement", "People") if words in text] == []
    assert "found, doubtful" in text


def test_totals_count_a_frame_with_two_labels_once() -> None:
    data = unlabelled()
    both = replace(data, automatic=(*data.automatic, TakeSegment("one", "kick", 30, 50, 0.1, "kick", 0.2)))
    found = totals(both)
    assert (found.segments, found.classes, found.takes) == (4, 2, 2)
    assert found.labelled == pytest.approx((30 + 13 + 45) / 30)
    kick = next(row for row in class_findings(both) if row.label == "kick")
    assert (kick.segments, kick.takes, kick.confidence, kick.least) == (2, 1, pytest.approx(0.15), 0.1)
    assert [(row.name, row.segments, row.common) for row in group_findings(both)] == [
        ("angry", 3, ("kick", "squat")),
        ("sad", 1, ("squat",)),
    ]


def test_the_surest_and_the_most_doubtful_are_of_different_classes_first() -> None:
    made = [("a", 0.9), ("a", 0.8), ("b", 0.7), ("c", 0.2), ("c", 0.1), ("a", None)]
    segments = [TakeSegment("t", label, i, i + 1, 0.1, label, sure) for i, (label, sure) in enumerate(made)]
    assert [one.start for one in surest(segments, 3)] == [0, 2, 3]
    assert [one.start for one in most_doubtful(segments, 3)] == [4, 2, 1]
    assert [one.start for one in surest(segments, 5)] == [0, 1, 2, 3, 4]


def test_the_least_confident_segments_come_first_and_the_file_has_all() -> None:
    data = unlabelled()
    assert [one.confidence for one in in_order(data.automatic)] == [0.1, 0.6, 0.9]
    evil = replace(data.automatic[0], take="one", label="=1+1", confidence=None)
    lines = list(csv_lines(replace(data, automatic=(*data.automatic, evil))))
    assert len(lines) == 5
    assert lines[1] == "one,squat,squat2Reps,20,41,0.6667,1.3667,0.02,0.9,\n"
    assert lines[-1].startswith("one,'=1+1,")
    assert in_order([evil, *data.automatic])[-1] is evil


def test_rows_of_the_file_choose_annotations(tmp_path: Path) -> None:
    evil = TakeSegment("=take", "=1+1", 3, 9, 0.1, "x", 0.5)
    data = replace(unlabelled(), takes=(TakeRow("=take", 30, 30.0),), automatic=(evil,))
    (tmp_path / "rows.csv").write_text("".join(csv_lines(data)))
    table = pa.table({"take": ["=take", "b"], "class": ["=1+1", "c"], "start": pa.array([3, 0], pa.int32()),
                      "stop": pa.array([9, 5], pa.int32())})  # fmt: skip
    assert selected_rows(table, RowSelection(rows=tmp_path / "rows.csv"), "annotation")["take"].to_list() == ["=take"]


def test_fifty_thousand_segments_leave_the_page_small_and_it_tells_where_the_others_are() -> None:
    generator = np.random.default_rng(1)
    takes = tuple(TakeRow(f"take_{i:05d}", 3000, 30.0) for i in range(500))
    segments = tuple(
        TakeSegment(take.name, f"class{i % 30:02d}", 30 * i, 30 * i + 25, 0.05, "sub", float(generator.random()))
        for take in takes
        for i in range(100)
    )
    data = replace(unlabelled(), takes=takes, automatic=segments, curves=(), curves_take=None, subclasses={})
    page = annotation_page(data)
    assert len(page.encode()) < 2_500_000
    assert f"The page has the {MAX_ROWS:,} least confident of 50,000 segments" in Reading(page).text
    rows = json.loads(re.search(r'id="rows">(.*?)</script>', page)[1])["rows"]  # type: ignore[index]
    assert len(rows) == MAX_ROWS
    assert rows[0][5] <= rows[-1][5]
    assert "460 takes not shown" in Reading(page).text


def test_takes_without_ground_truth_are_chosen_by_what_was_found() -> None:
    segments = [TakeSegment(f"t{i:02d}", "a", k, k + 1, 0.1, "a", 0.5) for i in range(20) for k in range(i)]
    segments += [TakeSegment("t03", "a", 50, 60, 0.1, "a", 0.01)]
    names = [f"t{i:02d}" for i in range(20)]
    choice = choose_takes(names, {}, findings=findings_of(segments), max_takes=8)
    assert choice.shown[:4] == ("t19", "t18", "t17", "t03")
    assert choice.look[0] == "t03"
    assert len(choice.shown) == 8
    assert "t00" in choice.left_out
    doubted = [replace(one, doubted="b") if one.take == "t05" else one for one in segments]
    disagreeing = choose_takes(names, {}, findings=findings_of(doubted), max_takes=8)
    assert disagreeing.look[0] == "t05"
    assert "another method disagrees" in disagreeing.reason
    assert choose_takes(["b", "a"], {}, findings=findings_of([TakeSegment("b", "x", 0, 1)])).shown == ("b", "a")


def test_takes_are_grouped_by_actor_then_by_the_pattern_then_by_folder() -> None:
    takes = pl.DataFrame(
        {
            "name": [f"t{i}" for i in range(6)],
            "source": [f"{'ab'[i % 2]}/t{i}.bvh" for i in range(6)],
            "actor": [None] * 6,
            "set": ["1"] * 6,
            "style": ["angry", "sad", "sad", "old", None, "old"],
            "clip": ["1", "2", "3", "1", "2", "3"],
        }
    )
    name, groups = take_groups(takes, ["set", "style", "clip"])
    assert name == "style"
    assert groups["t4"] == "other"
    assert take_groups(takes, ["set"])[0] == "folder"
    assert take_groups(takes.with_columns(actor=pl.Series(["x", "y"] * 3)), ["style"])[0] == "actor"
    assert take_groups(takes.with_columns(source=pl.lit("t.bvh")), []) == ("", {})


def test_the_archive_is_laid_out_in_columns_whose_heights_are_shares_of_time() -> None:
    takes = [TakeRow("a", 500, 30.0, group="x"), TakeRow("b", 500, 30.0, group="y")]
    segments = [TakeSegment("a", "walk", 0, 250), TakeSegment("b", "run", 0, 500), TakeSegment("a", "walk", 100, 250)]
    strip = archive_strip(takes, segments, {"run": 0, "walk": 1})
    assert [area.path for area in strip.lanes] == [
        f"M{BINS // 2} 10v-10h{BINS // 2}v10z",
        f"M0 10v-10h{BINS // 4}v10z",
    ]
    assert [(band.name, band.left, band.width) for band in strip.bands] == [("x", 0.0, 50.0), ("y", 50.0, 50.0)]
    assert strip.takes == (("a", 0.0, 50.0), ("b", 50.0, 50.0))
    sparse = archive_strip([TakeRow("a", 100_000, 30.0)], [TakeSegment("a", "walk", 0, 10)], {"walk": 0})
    assert sparse.lanes[0].path == "M0 10v-1h1v1z"
    assert archive_strip([], [], {}).strip == ()


def test_hits_are_confirmed_by_ground_truth_only() -> None:
    assert confirmations(unlabelled()) is None
    found = confirmations(study())
    assert found is not None
    assert [found[one.key] for one in study().automatic] == [True, False, True]
    assert "Confusion of classes" in Reading(annotation_page(study())).text
    assert len(hits_to_play(unlabelled())) <= 8 + LOOKS
    assert FRAMES == 90


def test_what_another_method_found_is_shown() -> None:
    data = unlabelled()
    doubted = replace(data.automatic[1], doubted="squat")
    text = Reading(annotation_page(replace(data, automatic=(doubted,), other_method="best"))).text
    assert "“Other method” is what best found there" in text
    assert "1 found by this method only" in text


@pytest.mark.parametrize("side", [0, 1])
def test_colours_of_up_to_twenty_classes_differ(side: int) -> None:
    colours = [oklab(pair[side]) for pair in CLASS_COLOURS]
    assert len(colours) == 20
    nearest = min(math.dist(one, other) for i, one in enumerate(colours) for other in colours[:i])
    assert nearest > 0.1  # an eye tells apart some 0.02


def oklab(colour: str) -> Sequence[float]:
    """Return lightness and the two axes of colour in OKLab (Ottosson 2020)."""
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = np.array([part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts])
    cones = np.array([[0.4122214708, 0.5363325363, 0.0514459929], [0.2119034982, 0.6806995451, 0.1073969566],
                      [0.0883024619, 0.2817188376, 0.6299787005]]) @ linear  # fmt: skip
    axes = np.array([[0.2104542553, 0.7936177850, -0.0040720468], [1.9779984951, -2.4285922050, 0.4505937099],
                     [0.0259040371, 0.7827717662, -0.8086757660]]) @ np.cbrt(cones)  # fmt: skip
    return [float(axis) for axis in axes]
