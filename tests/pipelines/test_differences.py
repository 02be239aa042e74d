"""Two evaluations compared: what got better and what got worse, and what can be compared with what."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from kinedex.commands.cli import app
from kinedex.ops.errors import KinedexError
from kinedex.ops.evaluation.detection import bootstrap
from kinedex.ops.evaluation.metrics import Counts
from kinedex.pipelines.evaluation.annotation_scores import Evaluation, Row, write_metrics
from kinedex.pipelines.evaluation.differences import (
    _difference_of,
    compare_evaluations,
    comparisons_json,
    without_repeats,
)
from kinedex.pipelines.evaluation.written_evaluations import MethodEvaluation, paired_evaluations, read_evaluations
from kinedex.reports.difference_tables import markdown
from kinedex.reports.methods_page import comparison_page
from kinedex.storage.snapshot.manifest import StageRecord
from kinedex.storage.store.writer import StoreWriter
from tests.pipelines.study import Reading
from tests.storage.made_up import BODY, make_store


def counts(right: int, of: int = 10) -> Counts:
    """Frames and segments of which so many are right."""
    return Counts(right, of, of, right, of, right, of)


def scored(method: str = "m", **takes: int) -> MethodEvaluation:
    by_take = {name: counts(right) for name, right in takes.items()}
    whole = sum(by_take.values(), Counts())
    return MethodEvaluation("split", method, whole, {"walk": whole}, by_take)


def study_file(path: Path, **methods: dict[str, int]) -> Path:
    """A file as the stage compare_methods writes it."""
    found = {
        name: {
            "pooled": asdict(one.pooled),
            "classes": {label: asdict(own) for label, own in one.classes.items()},
            "takes": {take: asdict(own) for take, own in one.takes.items()},
        }
        for name, one in ((name, scored(name, **takes)) for name, takes in methods.items())
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"format": "kinedex evaluation 1", "splits": [{"name": "split", "methods": found}]})
    path.write_text(text, encoding="utf-8")
    return path


def test_takes_are_sorted_into_better_worse_and_same() -> None:
    one = compare_evaluations(scored(x=5, y=5, z=5), scored(x=9, y=4, z=5), ("A", "B"))
    assert {change.name: change.verdict for change in one.takes} == {"x": "better", "y": "worse", "z": "same"}
    assert one.overall.by == pytest.approx((0.1, 0.1))
    assert [change.name for change in one.changed(one.takes, "better")] == ["x"]
    assert one.classes[0].verdict == "better"


def test_only_takes_that_both_have_count() -> None:
    one = compare_evaluations(scored(x=5, y=0), scored(x=7, z=10), ("A", "B"))
    assert one.overall.by == pytest.approx((0.2, 0.2))
    assert (one.only_a.takes, one.only_b.takes, one.common) == (("y",), ("z",), 1)
    assert "takes of A alone, excluded: y" in markdown([one])


def test_labels_in_vain_are_worse_than_none() -> None:
    silent, vain = Counts(), Counts(0, 30, 0, 0, 3, 0, 0)
    a = MethodEvaluation("e", "", counts(5) + silent, {"walk": counts(5), "hop": silent}, {"x": counts(5), "y": silent})
    b = MethodEvaluation("e", "", counts(5) + vain, {"walk": counts(5), "hop": vain}, {"x": counts(5), "y": vain})
    one = compare_evaluations(a, b, ("A", "B"))
    assert {change.name: change.verdict for change in one.takes} == {"x": "same", "y": "worse"}
    assert {change.name: change.verdict for change in one.classes} == {"walk": "same", "hop": "worse"}
    assert one.takes[1].by == (None, None)
    assert {change.name: change.verdict for change in compare_evaluations(b, a, ("B", "A")).takes}["y"] == "better"
    for text in (markdown([one]), Reading(comparison_page([one])).text):
        assert "Worse: 1 of 2 takes" in text
    alone = compare_evaluations(
        *(MethodEvaluation("e", "", each, {}, {"y": each}) for each in (silent, vain)), ("A", "B")
    )
    assert alone.verdict.startswith(
        "F (frames) is worse: B labels what is not there, the other one nothing; F (segments) is worse"
    )
    assert json.loads(json.dumps(comparisons_json([alone]), allow_nan=False))["comparisons"][0]["overall"]["by"] == [
        None,
        None,
    ]


def test_runs_without_a_common_take_are_not_compared() -> None:
    one = compare_evaluations(scored(x=5, y=4), scored(z=9), ("A", "B"))
    assert one.verdict == "no take in common, so neither is better or worse"
    assert (one.classes, one.takes, one.only_a.takes, one.only_b.takes) == ((), (), ("x", "y"), ("z",))
    for text in (markdown([one]), Reading(comparison_page([one])).text):
        assert "no take in common" in text
        assert "ach over its own takes" in text
        assert "better:" not in text.lower()
    assert comparisons_json([one])["comparisons"][0]["common_takes"] == 0


def test_other_ground_truth_is_noticed() -> None:
    a, b = scored(x=5, y=5), scored(x=5, y=5)
    more = b.takes["y"] + Counts(0, 0, 4, 0, 0, 0, 1)
    b = replace(b, takes={**b.takes, "y": more}, classes={"walk": b.classes["walk"] + Counts(0, 0, 4, 0, 0, 0, 1)})
    one = compare_evaluations(a, b, ("A", "B"))
    assert (one.other_truth.takes, one.other_truth.classes) == (("y",), ("walk",))
    assert one.verdict.endswith("but A and B were judged against different ground truth")
    assert "takes whose manual labels are not the same in A and B: y" in markdown([one])
    assert compare_evaluations(a, a, ("A", "A")).other_truth.takes == ()


def test_what_is_to_be_found_on_one_side_only_cannot_be_compared() -> None:
    one = compare_evaluations(
        *(MethodEvaluation("e", "", each, {}, {"x": each}) for each in (Counts(), counts(5))), ("A", "B")
    )
    assert one.takes[0].verdict == "incomparable"
    assert one.verdict.startswith("F (frames) is undefined in A; F (segments) is undefined in A; but A and B")
    assert "Incomparable: 1 of 1 takes" in markdown([one])


def test_what_is_better_on_every_take_is_no_chance() -> None:
    sure = compare_evaluations(scored(a=5, b=5, c=6, d=5), scored(a=8, b=9, c=9, d=8), ("A", "B"))
    assert sure.intervals["f1"][0] > 0
    assert "chance" not in sure.verdict
    unsure = compare_evaluations(scored(a=5, b=5, c=6, d=5), scored(a=9, b=2, c=9, d=4), ("A", "B"))
    assert unsure.verdict.startswith("F (frames) is better by 0.075")
    assert "which may be chance" in unsure.verdict


def test_settings_that_differ_are_said() -> None:
    ours, theirs = (
        replace(scored(x=5), settings={"name": name, "method": name, "tau": 0.13, "queries": queries})
        for name, queries in (("thesis", None), ("best", ["mine.yaml"]))
    )
    one = compare_evaluations(ours, theirs, ("A", "B"))
    assert one.settings == (("method", "thesis", "best"), ("queries", None, ["mine.yaml"]))
    assert "- method: thesis in A, best in B" in markdown([one])
    assert 'queries: not set in A, ["mine.yaml"] in B' in Reading(comparison_page([one])).text
    assert 'queries: not set in A, \\["mine.yaml"\\] in B' in markdown([one])


def test_thresholds_that_do_not_matter_are_not_said() -> None:
    ours, theirs = (
        replace(scored(x=5), settings={"method": "best", "tau": tau, "tau_by_class": {}, "delta": tau})
        for tau in (0.13, 0.06)
    )
    assert compare_evaluations(ours, theirs, ("A", "B")).settings == (("delta", 0.13, 0.06),)


def test_the_same_comparison_is_shown_once() -> None:
    one = compare_evaluations(scored(x=5), scored(x=7), ("plain (a)", "plain (b)"))
    again = replace(one, a="held out (a)", b="held out (b)")
    other = compare_evaluations(scored(x=5), scored(x=8), ("plain (a)", "plain (b)"))
    found = without_repeats([one, again, other])
    assert [(found.a, found.overall) for found in found] == [
        ("plain (a); held out (a)", one.overall),
        ("plain (a)", other.overall),
    ]


def test_the_interval_of_no_difference_is_nothing() -> None:
    same = [counts(3), counts(7)]
    assert bootstrap(_difference_of("f1"), same, same) == (0.0, 0.0)
    assert all(math.isnan(end) for end in bootstrap(_difference_of("f1"), [], []))
    assert all(math.isnan(end) for end in bootstrap(_difference_of("f1"), [Counts()], [Counts()]))


def test_a_class_that_goes_up_in_frames_and_down_in_segments_is_mixed() -> None:
    a = MethodEvaluation("e", "", Counts(), {"walk": Counts(5, 10, 10, 9, 10, 9, 10)}, {})
    b = MethodEvaluation(
        "e", "", Counts(), {"walk": Counts(7, 10, 10, 6, 10, 6, 10), "jump": Counts(1, 1, 1, 1, 1, 1, 1)}, {}
    )
    one = compare_evaluations(a, b, ("A", "B"))
    assert [(change.name, change.verdict) for change in one.classes] == [("walk", "mixed")]
    assert one.overall.f1 == (None, None)
    assert one.only_b.classes == ("jump",)
    assert "classes of B alone, not compared: jump" in markdown([one])
    assert json.loads(json.dumps(comparisons_json([one]), allow_nan=False))["comparisons"][0]["intervals"]["f1"] == [
        None,
        None,
    ]


def test_the_same_method_of_two_stores_is_compared(tmp_path: Path) -> None:
    study_file(tmp_path / "a/results/reports/p/methods.json", thesis={"x": 5}, best={"x": 8})
    study_file(tmp_path / "b/results/reports/p/methods.json", thesis={"x": 6}, other={"x": 9})
    found = paired_evaluations(read_evaluations(str(tmp_path / "a")), read_evaluations(str(tmp_path / "b")))
    assert [(one.name, other.name) for one, other in found] == [("split: thesis", "split: thesis")]


def test_two_methods_of_one_store_are_compared(tmp_path: Path) -> None:
    file = study_file(tmp_path / "methods.json", thesis={"x": 5}, best={"x": 8})
    ((one, other),) = paired_evaluations(read_evaluations(f"{file}::thesis"), read_evaluations(f"{file}::best"))
    assert (one.method, other.method) == ("thesis", "best")


def test_metrics_of_the_stage_evaluate_are_read(tmp_path: Path) -> None:
    rows = (Row("pooled", "all", counts(5)), Row("take", "x", counts(5)), Row("class", "walk", counts(5)))
    write_metrics(tmp_path / "metrics.json", Evaluation("annotate", rows), "run")
    (found,) = read_evaluations(str(tmp_path)).found
    assert found == MethodEvaluation("annotate", "", counts(5), {"walk": counts(5)}, {"x": counts(5)})


@pytest.mark.parametrize(
    ("a", "b", "split", "message"),
    [
        ("one", "none", None, "there is no such store, folder or file"),
        ("one", "empty", None, "holds no evaluation"),
        ("one::bets", "one", None, "no method or pipeline 'bets'; did you mean 'best'"),
        ("one", "one", "spilt", "no evaluation 'spilt'; did you mean 'split'"),
        ("one", "two", None, r"nothing to compare: .*'split: best', 'split: thesis'.* --split|nothing to compare"),
        ("broken.json", "one", None, "is no JSON file"),
        ("other.json", "one", None, "is no evaluation"),
    ],
)
def test_what_cannot_be_compared_is_said(tmp_path: Path, a: str, b: str, split: str | None, message: str) -> None:
    study_file(tmp_path / "one/methods.json", best={"x": 8}, thesis={"x": 5})
    study_file(tmp_path / "two/methods.json", mine={"x": 8}, yours={"x": 5})
    (tmp_path / "empty").mkdir()
    (tmp_path / "broken.json").write_text("{", encoding="utf-8")
    (tmp_path / "other.json").write_text("[1]", encoding="utf-8")
    with pytest.raises(KinedexError, match=message):
        paired_evaluations(read_evaluations(str(tmp_path / a)), read_evaluations(str(tmp_path / b)), split)


def test_of_a_store_with_reports_of_two_pipelines_the_current_one_is_meant(tmp_path: Path) -> None:
    store = make_store(tmp_path / "store", {"a": 9})
    for name, count in (("p", 8), ("q", 7)):
        study_file(store / f"results/reports/{name}/methods.json", best={"x": count}, q={"x": 1})
    with StoreWriter.open(store, BODY) as writer:
        for name in ("p", "q"):
            summary = {"uses": "annotate"}
            writer.record_stage(StageRecord(f"{name}/annotate", "", "r", "2026-01-01T00:00:00Z", 1.0, summary))
            writer.record_run(name)
        writer.commit()

    def read(names: str) -> set[str]:
        return {f"{one.method} {one.pooled.frames_both}" for one in read_evaluations(f"{store}{names}").found}

    assert read("") == {"best 7", "q 1"}
    assert "pipeline q; `" in str(read_evaluations(str(store)).remark)
    assert (read("::p"), read("::p::best"), read("::best"), read("::q")) == (
        {"best 8", "q 1"}, {"best 8"}, {"best 7"}, {"q 1"},
    )  # fmt: skip
    assert read_evaluations(f"{store}::p").remark is None
    with pytest.raises(KinedexError, match="no method or pipeline 'pp'; did you mean 'p'"):
        read("::pp")


def test_the_command_shows_and_writes_what_changed(tmp_path: Path) -> None:
    file = study_file(tmp_path / "methods.json", thesis={"x": 5, "y": 5}, best={"x": 8, "y": 4})
    arguments = ["report", "compare", f"{file}::thesis", f"{file}::best"]
    shown = CliRunner().invoke(app, arguments)
    assert shown.exit_code == 0
    assert "better: 1 of 2 takes" in shown.output
    assert "worse: 1 of 2 takes" in shown.output
    for ending in ("md", "html", "json"):
        written = CliRunner().invoke(app, [*arguments, "--output", str(tmp_path / f"out.{ending}")])
        assert written.exit_code == 0
    assert "split: best against split: thesis" in (tmp_path / "out.md").read_text(encoding="utf-8")
    assert json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))["comparisons"][0]["b"] == "split: best"
    refused = CliRunner().invoke(app, [*arguments, "--output", "out.txt"])
    assert refused.exit_code == 1
    assert "must end in .md, .html, .json" in refused.output


def test_the_page_stands_alone() -> None:
    text = comparison_page([compare_evaluations(scored(x=5), scored(x=9), ("<A>", "B"))])
    reading = Reading(text)
    assert reading.references == []
    assert "B against <A>" in reading.text
