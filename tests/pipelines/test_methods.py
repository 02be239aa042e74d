"""Methods compared on splits of an archive: what is left out of which training, what is kept, and what is judged."""

from __future__ import annotations

import io
import json
import math
import re
from pathlib import Path
from typing import ClassVar

import pytest
from rich.console import Console

from kinedex.console.terminal import Terminal
from kinedex.ops.errors import KinedexError
from kinedex.ops.evaluation.metrics import Counts
from kinedex.ops.intervals import TakeSegment
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.evaluation import comparison_cells
from kinedex.pipelines.evaluation.comparison_parameters import METRICS, Method, Split
from kinedex.pipelines.evaluation.comparison_results import SplitResult, Study
from kinedex.pipelines.evaluation.folds import Fold, TestTake
from kinedex.pipelines.evaluation.method_scores import chosen_takes, joined_segments, score_method, segment_outcomes
from kinedex.pipelines.keyframes import learning_runs as keyframe_runs
from kinedex.pipelines.stages.compare_methods import CompareMethods
from kinedex.pipelines.stages.evaluate import Evaluate
from kinedex.pipelines.stages.learn_keyframes import LearnKeyframes
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.reports.comparison_tables import overview
from kinedex.storage.store.store import open_store
from tests.pipelines.labelled import Line, clip, long_take, motion, write_store
from tests.pipelines.study import Reading

THESIS = {"name": "thesis", "tau": 0.13}
BEST = {"name": "best", "method": "best"}
LEARNED = {**BEST, "name": "with keyframes", "queries": "learned"}
LEFT_OUT = {
    "name": "left out", "test": "class IS NOT NULL", "leave_out": "actor", "clips_as_takes": True,
    "clips_a_take": 3, "orders": 2, "most_clips": 2,
}  # fmt: skip
MOTIONS = ("walk", "kick", "wave")


class Comparing(Line):
    INPUTS: ClassVar[dict[str, dict[str, str]]] = {
        **Line.INPUTS,
        "learn_keyframes": {},
        "compare_methods": {"templates": "learn_templates", "keyframes": "learn_keyframes"},
    }

    def compare(self, methods: list[dict], splits: list[dict], **params: object) -> dict:
        self.run(CompareMethods, methods=methods, splits=splits, **params)
        return json.loads(self.file("json"))

    def file(self, ending: str) -> str:
        return (self.store / f"results/reports/test/methods.{ending}").read_text(encoding="utf-8")


def truth_file(folder: Path, takes: dict[str, tuple[str, ...]]) -> Path:
    """Ground truth of long takes of these motions in a row, in source frames (four to an analysis frame)."""
    lines = ["take,class,start,stop"]
    for take, motions in takes.items():
        at = 0
        for name in motions:
            stop = at + 4 * len(motion(name))
            lines += [f"{take},{name},{at},{stop}"] if name != "rest" else []
            at = stop
    path = folder / "ground_truth.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.fixture
def line(tmp_path: Path) -> Comparing:
    truth_file(tmp_path, {"eve_1": ("walk", "rest", "kick"), "eve_2": ("wave", "walk")})
    speeds = {"ann": 5, "bob": 6}
    clips = [clip(name, actor, n, speed) for actor, speed in speeds.items() for name in MOTIONS for n in (1, 2)]
    long = [long_take("eve_1", "eve", "walk", "rest", "kick"), long_take("eve_2", "eve", "wave", "walk")]
    store = write_store(tmp_path / "store", [*clips, *long], tmp_path)
    line = Comparing(store)
    line.run(LearnTemplates)
    line.params["learn_keyframes"] = LearnKeyframes.parameters(generations=5, population=10, runs=2)
    return line


def test_every_method_is_judged_in_every_split(line: Comparing) -> None:
    found = line.compare([THESIS, BEST], [{"name": "eve"}, LEFT_OUT], taus=[0.05, 0.1])
    eve, left_out = found["splits"]
    assert set(eve["methods"]) == {"thesis", "best"}
    assert eve["methods"]["best"]["pooled"]["f1"] == pytest.approx(1.0)
    assert eve["methods"]["best"]["map"]["0.7"] == pytest.approx(1.0)
    assert eve["methods"]["best"]["boundaries"]["start"]["median"] == 0.0
    assert [point["tau"] for point in eve["sweep"]] == [0.05, 0.1]
    assert [fold["name"] for fold in left_out["folds"]] == ["ann", "bob"]
    assert set(left_out["methods"]["best"]["groups"]) == {"ann", "bob"}
    assert left_out["methods"]["best"]["pooled"]["f1"] == pytest.approx(1.0)
    metrics = open_store(line.store).result("metrics").to_pylist()
    scopes = {row["scope"]: row["name"] for row in metrics if row["evaluation"] == "left out: best"}
    assert (set(scopes), scopes["group"]) == ({"pooled", "fold", "group", "class", "take"}, "bob")
    assert {row["evaluation"] for row in metrics} >= {"eve: best", "left out: thesis"}


def test_what_is_annotated_is_never_learned_from(line: Comparing) -> None:
    by_take = {**LEFT_OUT, "name": "by take", "leave_out": None, "folds": 3, "seed": 4}
    found = line.compare([BEST], [LEFT_OUT, by_take])
    left_out, folds = found["splits"]
    assert [fold["clips"] for fold in left_out["folds"]] == [6, 6]
    assert [fold["clips"] for fold in folds["folds"]] == [8, 8, 8]
    rows = open_store(line.store).takes("class IS NOT NULL")
    assert rows.height == 12


def test_clips_laid_end_to_end_are_annotated_as_one_take(line: Comparing) -> None:
    found = line.compare([BEST], [LEFT_OUT])["splits"][0]
    shown = found["shown"]["best"]
    assert shown["frames"] == sum(stop - start for _, start, stop in shown["manual"])
    assert [(one["label"], one["start"], one["stop"]) for one in shown["automatic"]["best"]] == [
        tuple(one) for one in shown["manual"]
    ]
    assert "takes share clips" in " ".join(found["remarks"])


def test_a_fixed_split_refuses_to_annotate_what_it_learned_from(line: Comparing) -> None:
    with pytest.raises(KinedexError, match=r"split 'x': takes to annotate are learned from as well: ann_kick_001"):
        line.compare([BEST], [{"name": "x", "test": "class IS NOT NULL", "clips_as_takes": True}])


def test_finished_cells_are_kept_and_not_done_again(line: Comparing, monkeypatch: pytest.MonkeyPatch) -> None:
    first = line.compare([THESIS], [{"name": "eve"}, LEFT_OUT])
    done: list[str] = []
    real = comparison_cells.annotate_task
    monkeypatch.setattr(
        comparison_cells, "annotate_task", lambda task: done.append(task.test_takes[0].name) or real(task)
    )
    assert line.compare([THESIS], [{"name": "eve"}, LEFT_OUT])["splits"] == first["splits"]
    assert done == []
    line.compare([THESIS, BEST], [{"name": "eve"}, LEFT_OUT])
    assert done == ["eve_1", "ann: order 1, take 1", "bob: order 1, take 1"]


def test_what_was_finished_before_it_broke_off_is_kept(line: Comparing, monkeypatch: pytest.MonkeyPatch) -> None:
    real = comparison_cells.annotate_task

    def breaks(task: comparison_cells.Task) -> comparison_cells.SegmentsByTake:
        if task.test_takes[0].name.startswith("bob"):
            raise KinedexError("pulled the plug")
        return real(task)

    monkeypatch.setattr(comparison_cells, "annotate_task", breaks)
    monkeypatch.setattr(comparison_cells, "SAVE_SECONDS", 0.0)
    with pytest.raises(KinedexError, match="pulled the plug"):
        line.compare([BEST], [LEFT_OUT])
    assert set(open_store(line.store).result("method_cells")["fold"].to_pylist()) == {"ann"}
    monkeypatch.setattr(comparison_cells, "annotate_task", real)
    assert len(line.compare([BEST], [LEFT_OUT])["splits"][0]["folds"]) == 2


def test_the_result_does_not_depend_on_the_executor(line: Comparing, tmp_path: Path) -> None:
    serial = line.compare([THESIS, BEST], [LEFT_OUT])
    other = Comparing(line.store, "processes")
    other.params = dict(line.params)
    with_workers = other.compare([THESIS, BEST], [LEFT_OUT])
    other.executor.close()
    for scope in ("pooled", "takes", "confusion"):
        assert with_workers["splits"][0]["methods"]["best"][scope] == serial["splits"][0]["methods"]["best"][scope]


def test_learned_queries_are_learned_in_each_fold_from_its_own_clips(line: Comparing) -> None:
    found = line.compare([BEST, LEARNED], [LEFT_OUT])["splits"][0]
    assert found["methods"]["with keyframes"]["pooled"]["f1"] > 0.8
    runs = open_store(line.store).result("keyframe_runs").to_pylist()
    assert len({row["key"] for row in runs}) == 2 * len(MOTIONS)  # each class once without ann, once without bob


def _runs(line: Comparing) -> set[tuple[str, int]]:
    rows = open_store(line.store).result("keyframe_runs").to_pylist()
    return {(row["key"], row["number"]) for row in rows}


def _done(monkeypatch: pytest.MonkeyPatch, most: float = math.inf) -> list[tuple[str, int]]:
    """The runs that are done from now on; after so many, the power goes."""
    done: list[tuple[str, int]] = []
    original = keyframe_runs.learn_runs

    def counted(task: keyframe_runs.RunTask) -> list:
        if len(done) >= most:
            raise KinedexError("out of power")
        done.extend((task.training.subclass, number) for number in task.numbers)
        return original(task)

    monkeypatch.setattr(keyframe_runs, "learn_runs", counted)
    return done


def test_runs_of_folds_with_other_settings_are_kept(line: Comparing, monkeypatch: pytest.MonkeyPatch) -> None:
    line.compare([LEARNED], [LEFT_OUT])
    first = _runs(line)
    params = line.params["learn_keyframes"]
    line.params["learn_keyframes"] = params.model_copy(update={"seed": 7})
    line.compare([LEARNED], [LEFT_OUT])
    both = _runs(line)
    assert len(both) == 2 * len(first)
    assert both > first
    line.params["learn_keyframes"] = params
    done = _done(monkeypatch)
    line.compare([LEARNED], [LEFT_OUT])
    assert not done
    assert _runs(line) == both
    # clips that are not learned from any more: nothing could use these runs
    line.compare([LEARNED], [{**LEFT_OUT, "train": "class IN ('walk', 'kick')", "test": "class IN ('walk', 'kick')"}])
    assert not _runs(line) & both


def test_an_interruption_in_the_first_fold_loses_no_run_of_the_others(
    line: Comparing, monkeypatch: pytest.MonkeyPatch
) -> None:
    line.compare([LEARNED], [LEFT_OUT])
    first = _runs(line)
    line.params["learn_keyframes"] = line.params["learn_keyframes"].model_copy(update={"runs": 4, "settled": 0.0})
    _done(monkeypatch, most=2)
    with pytest.raises(KinedexError, match="out of power"):
        line.compare([LEARNED], [LEFT_OUT])
    assert _runs(line) > first


def test_the_same_method_twice_is_compared_once(line: Comparing) -> None:
    found = line.compare([BEST, {**BEST, "name": "again", "queries": []}], [{"name": "eve"}])
    assert list(found["splits"][0]["methods"]) == ["best"]
    assert found["remarks"] == ["the same as an earlier method, excluded: again"]


def test_what_a_method_found_stands_under_its_own_name(line: Comparing) -> None:
    line.compare([{**THESIS, "name": "mine"}, BEST], [{"name": "eve"}, {"name": "again"}], taus=[0.05, 0.13])
    rows = open_store(line.store).result("method_cells").to_pylist()
    mine = [row for row in rows if row["method"] == "mine"]
    assert [(row["split"], row["take"]) for row in mine] == [
        (split, take) for split in ("eve", "again") for take in ("eve_1", "eve_2")
    ]
    swept = [row for row in rows if row["method"].endswith("τ = 0.13")]
    assert [row["starts"] for row in swept] == [row["starts"] for row in mine]


def test_what_is_to_be_known_of_thresholds_is_told_once(line: Comparing) -> None:
    training = "class IS NOT NULL AND (actor = 'ann' OR class = 'walk')"
    method = {**THESIS, "name": "calibrated", "tau": "calibrated"}
    found = line.compare([method, BEST], [{"name": "eve", "train": training}])["splits"][0]
    (output,) = [one for one in found["remarks"] if "τ of all classes together" in one]
    assert output.endswith("their clips are of one actor: kick, wave (calibrated)")
    for text in (line.file("html"), line.file("md"), line.printed.getvalue()):
        assert "their clips are of one actor: kick, wave" in text


def test_thresholds_make_no_other_method_of_one_without(line: Comparing) -> None:
    methods = [{**BEST, "name": "own τ", "tau_by_class": {"walk": 0.1}}, {**BEST, "tau": "calibrated"}]
    found = line.compare(methods, [{"name": "eve"}])
    assert list(found["splits"][0]["methods"]) == ["own τ"]
    assert found["remarks"] == [
        "the same as an earlier method, excluded: best",
        "own τ: `tau_by_class` has no effect with `method: best`, which uses no thresholds",
    ]


def test_labels_without_a_template_are_told(line: Comparing, tmp_path: Path) -> None:
    with open(tmp_path / "ground_truth.csv", "a", encoding="utf-8") as file:
        file.write("eve_1,dance,20,40\n")
    found = line.compare([BEST], [{"name": "eve"}], unknown_labels="miss")["splits"][0]
    (missed,) = [one for one in found["segments"] if not one["overlaps"]["best"]]
    assert (missed["take"], missed["label"], found["never_found"]) == ("eve_1", "dance", 1)
    assert "without a template, so their segments cannot be found: dance" in found["remarks"]
    assert found["methods"]["best"]["classes"]["dance"]["r2"] == 0.0


def test_the_page_stands_alone_and_says_the_same_as_the_summary(line: Comparing) -> None:
    line.compare([THESIS, BEST], [{"name": "eve"}, LEFT_OUT], taus=[0.05, 0.1], title="Walks & kicks")
    page = line.file("html")
    reading = Reading(page)
    assert all(one.startswith("#") for one in reading.references)
    assert "Walks & kicks" in reading.text
    assert "Table 5.2" in reading.text
    assert "Figure 5.6" in reading.text
    others = 1 + 2 + 4  # the splits, their legends, the player with its time, speed and button
    assert page.count('role="img"') == page.count("aria-label") - page.count('role="group"') - others
    summary = line.file("md")
    assert "| best | 1.00 |" in summary
    assert "### Found by no method: 0" in summary
    for text in (reading.text, summary):
        assert "repetitions in a row as one segment" in text
        assert "where touching segments of one class are one" in text
    left_out = json.loads(line.file("json"))["splits"][1]["methods"]["best"]
    assert left_out["joined"]["map"]["0.7"] == pytest.approx(1.0)
    assert left_out["joined"]["boundaries"]["start"]["median_size"] == 0.0


def test_no_value_is_cut_on_a_narrow_terminal(line: Comparing) -> None:
    line.compare([{**BEST, "name": "best of all, with a long name"}, THESIS], [{"name": "eve"}])
    output = line.printed.getvalue()
    assert "2 takes with 4 manual segments" in output
    result = line.compare([{**BEST, "name": "best of all, with a long name"}, THESIS], [{"name": "eve"}], metrics=[])
    assert set(result["splits"][0]["methods"]) == {"best of all, with a long name", "thesis"}
    study = Study("", "", "", "", "", "", 30.0, ("a",), {}, "actor", METRICS, (), (small_split(),))
    narrow = Console(file=io.StringIO(), width=80)
    Terminal(narrow).show(*overview(study))
    assert isinstance(narrow.file, io.StringIO)
    assert "…" not in narrow.file.getvalue()
    assert narrow.file.getvalue().count("0.86–0.86") == 2
    assert "repetitions in a row" in narrow.file.getvalue()


def small_split() -> SplitResult:
    take = a_test_take(("a", 0, 4))
    found = {"t": (a_segment("a", 0, 3, 1.0),)}
    judged = {
        name: score_method(found, [take], ["a"], draws=5) for name in ("thesis, τ = 0.13, learned queries", "best")
    }
    return SplitResult(Split(name="x"), (Fold("x", "all", (), (take,)),), {}, judged, (), ())


def test_names_with_signs_stand_in_the_summary_as_they_are(line: Comparing) -> None:
    line.compare(
        [{**BEST, "name": "<i>x</i> | *y*"}], [{"name": "eve & `co`"}], title="Walks <i>& kicks", metrics=["frames"]
    )
    summary = line.file("md")
    assert summary.startswith("# Walks \\<i\\>\\& kicks\n")
    assert "## eve \\& \\`co\\`\n" in summary
    assert "| \\<i\\>x\\</i\\> \\| \\*y\\* | 1.00 |" in summary
    assert "eve_1" in summary


def test_a_click_on_a_segment_of_the_page_shows_the_motion(line: Comparing) -> None:
    elsewhere = {**LEFT_OUT, "name": "elsewhere", "seed": 5}
    found = line.compare([BEST], [{"name": "eve"}, LEFT_OUT, elsewhere])
    page = line.file("html")
    carried = json.loads(re.search(r'id="motions">(.*?)</script>', page).group(1))
    lengths = {motion["take"]: motion["frames"] for motion in carried["motions"]}
    shown = [(split["name"], one) for split in found["splits"] for one in split["shown"].values()]
    for split, one in shown:
        title = one["take"] if one["take"] in lengths else f"{split}: {one['take']}"
        assert lengths[title] == one["frames"]
        assert f'data-take="{title}"' in page
    assert "elsewhere: ann: order 1, take 1" in lengths or "left out: ann: order 1, take 1" in lengths
    assert re.search(r'data-start="0" data-stop="20" data-what="best: w[a-z]+" data-near="\d+"', page)
    assert all(carried["motions"][place]["take"] for place, _ in carried["near"])
    line.compare([BEST], [{"name": "eve"}], embed="none")
    assert 'id="motions"' not in line.file("html")
    assert "--set compare_methods.embed=all" in line.file("html")
    line.compare([BEST], [{"name": "eve"}], embed=["eve_2"])
    assert "1 of the 2 takes with a timeline (eve_2), as requested" in Reading(line.file("html")).text


@pytest.mark.parametrize(
    ("split", "message"),
    [
        ({"name": "x", "test": "actor = 'nobody'"}, "no take to annotate"),
        ({"name": "x", "leave_out": "actress"}, "takes have no column 'actress'; did you mean 'actor'"),
        ({"name": "x", "test": "class IS NULL", "clips_as_takes": True}, "none of the 2 takes"),
        ({"name": "x", "folds": 5}, "5 folds of 2 takes"),
    ],
)
def test_a_split_that_cannot_be_is_refused(line: Comparing, split: dict, message: str) -> None:
    with pytest.raises(KinedexError, match=message):
        line.compare([BEST], [split])


def test_a_split_is_of_one_kind() -> None:
    with pytest.raises(ValueError, match="exclude each other"):
        Split(name="x", leave_out="actor", folds=3)


def test_methods_take_what_the_stage_annotate_takes(line: Comparing) -> None:
    long = {**BEST, "name": "long", "min_seconds": 5}
    strict = {**THESIS, "name": "strict", "tau_by_class": {"walk": 1e-9}}
    found = line.compare([THESIS, BEST, long, strict], [LEFT_OUT])["splits"][0]["methods"]
    assert found["best"]["pooled"]["segments_automatic"] > found["long"]["pooled"]["segments_automatic"] == 0
    assert found["strict"]["classes"]["walk"] != found["thesis"]["classes"]["walk"]
    with pytest.raises(KinedexError, match="no class is named 'wlak'; did you mean 'walk'"):
        line.compare([{**BEST, "tau_by_class": {"wlak": 0.1}}], [LEFT_OUT])


def test_thresholds_are_calibrated_on_the_clips_of_the_fold(line: Comparing) -> None:
    method = {**THESIS, "name": "calibrated", "tau": "calibrated"}
    found = line.compare([method], [{"name": "eve"}])["splits"][0]["methods"]["calibrated"]
    assert found["pooled"]["r2"] == 1.0
    with pytest.raises(KinedexError, match="all training clips are of bob"):
        line.compare([method], [LEFT_OUT])


def test_actors_of_clips_that_the_stage_does_not_learn_from_are_known(line: Comparing) -> None:
    line.run(LearnTemplates, where="class IS NOT NULL AND actor = 'ann'")
    method = {**THESIS, "name": "calibrated", "tau": "calibrated"}
    with pytest.raises(KinedexError, match="all training clips are of bob"):
        line.compare([method], [{"name": "eve", "train": "class IS NOT NULL AND actor = 'bob'"}])


def test_methods_and_splits_have_names_of_their_own(line: Comparing) -> None:
    with pytest.raises(ValueError, match="methods: two are named 'best'"):
        line.compare([BEST, BEST], [{"name": "eve"}])


def test_queries_that_are_to_be_learned_need_the_stage(line: Comparing, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(Comparing.INPUTS, "compare_methods", {"templates": "learn_templates"})
    with pytest.raises(KinedexError, match="needs a stage 'learn_keyframes'"):
        line.compare([{**BEST, "queries": "learned"}], [{"name": "eve"}])


def a_test_take(*truth: tuple[str, int, int], frames: int = 10) -> TestTake:
    return TestTake("t", "g", (1,), frames, tuple(TakeSegment("t", *one) for one in truth))


def a_segment(label: str, start: int, stop: int, confidence: float = 1.0) -> TakeSegment:
    return TakeSegment("t", label, start, stop, confidence=confidence)


def test_a_segment_that_one_method_finds_is_found() -> None:
    truth = a_test_take(("a", 0, 4), ("b", 5, 9))
    found, missed = segment_outcomes({"one": {"t": (a_segment("a", 3, 6, 1.0),)}, "two": {"t": ()}}, [truth])
    assert (found.label, found.overlaps, found.missed) == ("a", {"one": pytest.approx(1 / 6), "two": 0.0}, False)
    assert (missed.label, missed.labels, missed.missed) == ("b", {"one": ("a",), "two": ()}, True)


def test_touching_segments_of_one_class_are_one_where_they_are_joined() -> None:
    truth = a_test_take(("a", 0, 6), ("a", 8, 10), ("b", 2, 4))
    spans = (("a", 3, 6, 0.2), ("b", 2, 4, 1.0), ("a", 0, 3, 0.8), ("a", 7, 10, 0.5))
    found = {"t": tuple(a_segment(*one) for one in spans)}
    mine, (one,) = joined_segments(found, [truth])
    assert [(each.label, each.start, each.stop, each.confidence) for each in mine["t"]] == [
        ("a", 0, 6, pytest.approx(0.5)), ("b", 2, 4, 1.0), ("a", 7, 10, 0.5),
    ]  # fmt: skip
    assert {each.key for each in one.truth} == {each.key for each in truth.truth}
    touching = a_test_take(("a", 0, 3), ("a", 3, 6), ("a", 4, 5))
    assert joined_segments({"t": ()}, [touching])[1][0].truth == (TakeSegment("t", "a", 0, 6),)
    result = score_method(found, [truth], ["a", "b"], draws=10)
    assert result.precision[0.7] < result.joined_precision[0.6] == 1.0
    assert result.boundaries.tolist() == [[3, 0], [-1, 0], [0, 0]]
    assert result.joined_boundaries.tolist() == [[0, 0], [-1, 0], [0, 0]]


def test_the_takes_shown_are_the_best_the_middle_and_the_worst() -> None:
    def counts(right: int) -> Counts:
        return Counts(right, 10, 10, 0, 0, 0, 0)

    assert chosen_takes({"x": counts(3), "y": counts(9), "z": counts(1), "w": Counts()}) == {
        "best": "y", "median": "x", "worst": "z",
    }  # fmt: skip
    assert chosen_takes({"x": counts(3)}) == {"best": "x"}
    assert chosen_takes({"x": Counts()}) == {}


def test_nothing_found_and_nothing_to_find_is_judged() -> None:
    result = score_method({"t": ()}, [a_test_take()], ["a"], draws=10)
    assert math.isnan(result.pooled.f1)
    assert math.isnan(result.precision[0.5])
    assert result.boundaries.shape == (0, 2)
    assert result.confusion.frames.sum() == 10


def test_the_same_method_at_another_threshold_is_on_the_same_curve() -> None:
    method = Method(name="mine", tau=0.13)
    assert method.at(0.06).curve_name == method.curve_name
    assert method.at(0.06).tau == 0.06
    assert Method(name="x", queries="learned").curve_name != method.curve_name


def test_the_shipped_pipeline_compares_methods() -> None:
    pipeline = load_pipeline("hdm05", {"source": "/data"})
    stage = pipeline.stage("compare_methods")
    assert isinstance(stage.params, CompareMethods.parameters)
    assert [method.name for method in stage.params.distinct][-1] == "best, learned queries"
    assert stage.inputs == {"templates": "learn_templates", "keyframes": "learn_keyframes"}
    assert stage.params.ground_truth == Evaluate.parameters().ground_truth


@pytest.mark.slow
@pytest.mark.shared
def test_hdm05_an_actor_never_seen_and_one_left_out(shared: Path, tmp_path: Path) -> None:
    settings = {"source": str(shared / "data" / "hdm05"), "compare_methods.taus": "[]"}
    methods = "[{name: thesis, tau: 0.06}, {name: best, method: best}]"
    assignments = {
        **settings,
        "compare_methods.methods": methods,
        "learn_keyframes.runs": "1",
        "learn_keyframes.generations": "0",
    }
    run_pipeline("hdm05", tmp_path / "store", assignments=assignments, terminal=Terminal(Console(file=io.StringIO())))
    text = (tmp_path / "store/results/reports/hdm05/methods.json").read_text(encoding="utf-8")
    unseen, left_out = json.loads(text)["splits"]
    assert unseen["methods"]["best"]["pooled"]["f1"] >= 0.91
    assert unseen["methods"]["best"]["pooled"]["f2"] >= 0.96
    assert unseen["methods"]["thesis"]["pooled"]["f1"] >= 0.83
    assert left_out["methods"]["best"]["pooled"]["f1"] >= 0.95
    assert left_out["methods"]["best"]["pooled"]["f2"] >= 0.99
    assert {fold["name"]: fold["clips"] < 188 for fold in left_out["folds"]} == {"bd": True, "bk": True, "dg": True}
