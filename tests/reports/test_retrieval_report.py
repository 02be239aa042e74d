"""The stiffness experiment, and the page about ranking that shows it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from kinedex.catalog.queries.keyframe_query import SAME_FRAME, Gap, Keyframe, KeyframeQuery
from kinedex.ops.search.gaps import UNBOUNDED
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.templates.ranking_evaluation import (
    EVERYWHERE,
    WRITTEN,
    EvaluatedRanking,
    Trial,
    mean_stiffness,
    stiffened,
    trial_rows,
)
from kinedex.reports.retrieval_page import SIZE, diagrams, mean_of, qualities, retrieval_page, variants
from kinedex.storage.store.store import open_store
from tests.pipelines.study import Reading


def query(*gaps: Gap) -> KeyframeQuery:
    return KeyframeQuery("q", "kick", (Keyframe("lower", 1, 1),) * (len(gaps) + 1), gaps)


def test_rigid_gaps_admit_the_written_distance_and_loose_ones_any_longer_one() -> None:
    written = query(Gap.of_distance(8, 0.5), Gap(4, 16), SAME_FRAME, Gap(3, UNBOUNDED))
    rigid = stiffened(written, 1.0)
    assert rigid.bounds == [(8, 8), (8, 8), (0, 0), (3, UNBOUNDED)]
    assert stiffened(written, 0.0).bounds[:2] == [(0, UNBOUNDED), (0, UNBOUNDED)]
    assert stiffened(written, 0.5).bounds[:2] == [(4, 16), (4, 16)]
    with_other = KeyframeQuery("q", "kick", written.keyframes, written.gaps, alternatives=(written,))
    assert stiffened(with_other, 1.0).alternatives == (rigid,)
    assert mean_stiffness([query(Gap.of_distance(8, 0.5), SAME_FRAME, Gap.of_distance(2, 1.0))]) == 0.75
    assert mean_stiffness([query()]) is None


def trials() -> list[dict[str, Any]]:
    def judged(*relevant: bool) -> EvaluatedRanking:
        return EvaluatedRanking("takes", "", "kick", relevant, 2, sum(relevant))

    found = [
        Trial(EVERYWHERE, None, judged(True, False, True, False), 1.0),
        Trial(WRITTEN, None, judged(True, True), 0.2),
        Trial("1", 1.0, judged(True), 0.05),
        Trial("0.5", 0.5, judged(False, True, True), 0.25),
    ]
    return trial_rows(found, "run").to_pylist()


def test_precision_is_drawn_over_recall_up_to_the_last_right_rank() -> None:
    (diagram,) = diagrams(trials(), (EVERYWHERE, WRITTEN))
    everywhere, written = diagram.lines
    assert everywhere.path == f"M{SIZE / 2:.1f} 0.0L{SIZE / 2:.1f} {SIZE / 2:.1f}L{SIZE:.1f} {SIZE / 3:.1f}"
    assert written.dot == (SIZE, 0)
    assert "as written: AP 1.00, 2 of 2 found below τ and 2 at any rank, 20% kept" in diagram.description


def test_variants_are_counted_over_classes_with_queries() -> None:
    lone = trial_rows(
        [Trial(EVERYWHERE, None, EvaluatedRanking("takes", "", "walk", (), 5, 0), 1.0)], "run"
    ).to_pylist()
    by_name = {one.name: one for one in variants(trials() + lone)}
    assert by_name["1"].recall == 0.5
    assert by_name[EVERYWHERE].to_find == 2
    assert by_name["0.5"].average_precision == pytest.approx((1 / 2 + 2 / 3) / 2)


def quality_rows() -> list[dict[str, Any]]:
    def row(kind: str, label: str, total: int, found: int, average: float | None) -> dict[str, Any]:
        return {"evaluation": kind, "class": label, "relevant": total, "found": found, "average_precision": average,
                "confused_with": ["punch & co 3"]}  # fmt: skip

    return [row("takes", "kick", 2, 2, 0.75), row("clips", "kick", 4, 4, 1.0), row("clips", "kick", 4, 2, 0.5),
            row("clips", "hop", 0, 0, None)]  # fmt: skip


def test_folds_are_pooled_and_nothing_to_find_counts_nowhere() -> None:
    hop, kick = qualities(quality_rows())
    assert (hop.clips, hop.takes) == ((0, None, None), None)
    assert kick.clips == (8, 0.75, 0.75)
    assert kick.confused == "punch & co (9)"
    assert mean_of(quality_rows(), "clips") == (0.75, 0.75)
    assert mean_of([], "clips") is None


def summary(lists: bool) -> dict[str, Any]:
    found = {"keyframes": 3, "stiffness": 0.6, "segments": 1234, "seconds": 0.02, "lists_seconds": 0.001}
    return {
        "frames": 5000, "tau": 0.1, "delta": 0.1, "columns": {"kick": 20}, "skipped": {"kick": 0.5},
        "kept": {"kick": 0.2}, "reading": {"kick": 0.004}, "seconds": {"kick": 0.03},
        "lists": {"kick": found} if lists else {},
    }  # fmt: skip


def test_the_page_shows_both_stages_and_needs_nothing_from_outside() -> None:
    hits = [{"template": "kick", "cost": 0.03}, {"template": "kick", "cost": 0.02}]
    page = retrieval_page("Kicks <ranked>", summary(True), hits, quality_rows(), trials())
    reading = Reading(page)
    for text in ("Kicks <ranked>", "1,234", "20.0 %", "0.020", "σ ≡ 0.5", "punch & co (9)", "Rigid queries"):
        assert text in reading.text, text
    assert all(reference.startswith(("data:", "#")) for reference in reading.references)
    assert page.count("<svg") == page.count('role="img"') + page.count('<svg aria-hidden="true"')
    assert page == retrieval_page("Kicks <ranked>", summary(True), hits, quality_rows(), trials())


def test_reading_and_ranking_stand_apart_and_a_bound_that_was_not_tried_is_said() -> None:
    tried = retrieval_page("Kicks", summary(True), [], quality_rows(), trials())
    assert "<td>4.0</td><td>30.0</td><td>50 %</td>" in tried
    untried = summary(True) | {"skipped": {"kick": None}}
    assert "no bound" in retrieval_page("Kicks", untried, [], quality_rows(), trials())
    earlier = {name: value for name, value in summary(True).items() if name != "reading"}
    assert "<td>–</td><td>30.0</td>" in retrieval_page("Kicks", earlier, [], quality_rows(), trials())


def test_missing_parts_are_reported_in_sentences() -> None:
    reading = Reading(retrieval_page("Kicks", summary(False), [], [], []))
    for text in (
        "No keyframe queries were given",
        "No evaluation is stored",
        "has no segment of these classes",
    ):
        assert text in reading.text, text


@pytest.mark.slow
@pytest.mark.shared
def test_rigid_queries_of_the_papers_lose_what_the_written_ones_find(shared: Path, tmp_path: Path) -> None:
    queries = shared / "reference" / "keyframe_queries.json"
    settings = {"source": str(shared / "data" / "hdm05"), "queries": f"[{queries}]"}
    assert run_pipeline("retrieval", tmp_path / "store", assignments=settings).ran
    store = open_store(tmp_path / "store")
    by_name = {one.name: one for one in variants(store.result("precision_recall").to_pylist())}
    assert by_name["1"].ranked < by_name[WRITTEN].ranked <= by_name[EVERYWHERE].ranked
    assert by_name["1"].kept < by_name["0.6"].kept < by_name["0"].kept < 1
    page = (store.path / "results" / "reports" / "retrieval" / "retrieval.html").read_text(encoding="utf-8")
    assert "squat1Reps" in Reading(page).text
