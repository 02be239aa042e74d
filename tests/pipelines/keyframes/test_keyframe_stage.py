"""Keyframe queries learned in a store: what they find, that they are the same however learned, that runs are kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pyarrow as pa
import pytest
from pydantic import ValidationError
from typer.testing import CliRunner

from kinedex.catalog.classes import load_classes
from kinedex.catalog.queries.query_reader import parse_queries
from kinedex.catalog.queries.query_writer import write_queries
from kinedex.commands.cli import app
from kinedex.ops.errors import KinedexError
from kinedex.ops.keyframes.genetic_algorithm import BETA
from kinedex.ops.keyframes.margins import hit_ranges
from kinedex.ops.keyframes.training_task import OFFSPRING, PARENTS
from kinedex.ops.words import NO_WORD, TakeWords
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.keyframes import learning_runs as keyframe_runs
from kinedex.pipelines.keyframes import parameters as keyframe_parameters
from kinedex.pipelines.keyframes import query_learning
from kinedex.pipelines.keyframes.learning_runs import known_runs, outcomes_of
from kinedex.pipelines.keyframes.parameters import KeyframeParameters
from kinedex.pipelines.keyframes.preselected_frames import preselect, template_window
from kinedex.pipelines.keyframes.query_learning import allowed_features, every_query, keyframe_queries, training_sets
from kinedex.pipelines.stages.annotate import Annotate
from kinedex.pipelines.stages.learn_keyframes import LearnKeyframes
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.pipelines.templates.template_learning import training_clips
from kinedex.storage.store.result_changes import record_labels
from kinedex.storage.store.store import open_store
from tests.pipelines.labelled import BODY, POSES, Line, clip, long_take, write_store

QUICK = {"generations": 15, "population": 20, "runs": 6}


@pytest.fixture(autouse=True)
def small_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounds of two runs."""
    monkeypatch.setattr(keyframe_parameters, "GROUP", 2)


def never_settled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(keyframe_parameters, "PATIENCE", 5)
    monkeypatch.setattr(keyframe_parameters, "SETTLED", 0.0)


class Learning(Line):
    INPUTS: ClassVar[dict[str, dict[str, str]]] = {
        **Line.INPUTS,
        "learn_keyframes": {},
        "annotate": {"templates": "learn_templates", "keyframes": "learn_keyframes"},
    }

    def outcomes(self) -> list:
        return outcomes_of(open_store(self.store).result("queries"))

    def runs(self) -> list:
        return known_runs(open_store(self.store).result("keyframe_runs"))


@pytest.fixture
def store(tmp_path: Path) -> Path:
    clips = [
        clip(subclass, actor, number, frames)
        for subclass in POSES
        for actor, number, frames in (("al", 1, 5), ("al", 2, 6), ("bo", 3, 4))
    ]
    return write_store(tmp_path / "store", [*clips, long_take("long", "cy", "walk", "kick", "wave", "walk")])


def test_every_class_gets_queries_that_find_its_clips_and_no_others(store: Path) -> None:
    line = Learning(store)
    summary = line.run(LearnKeyframes, **QUICK, alternatives=2)
    assert (summary["subclasses"], summary["clips"], summary["recall"], summary["precision"]) == (4, 12, 1.0, 1.0)
    opened = open_store(store)
    clips = opened.takes("class IS NOT NULL").sort("take_id")
    words = opened.words(clips["take_id"].to_list())
    for outcome in line.outcomes():
        queries = keyframe_queries(outcome, BODY)
        assert 1 <= len(queries) <= 2
        for query in queries:
            found = preselect(words, BODY, [query])[query]
            hit = (np.diff(found.offsets) > 0).tolist()
            assert hit == [name == outcome.subclass for name in clips["class"]]


def test_margins_cover_every_training_clip_whole(store: Path) -> None:
    line = Learning(store)
    line.run(LearnKeyframes, **QUICK)
    opened = open_store(store)
    for outcome in line.outcomes():
        (query,) = keyframe_queries(outcome, BODY)
        assert query.margins is not None
        own = opened.takes(f"class = '{outcome.subclass}'").sort("take_id")
        words = opened.words(own["take_id"].to_list())
        _, ranges = hit_ranges(words, outcome.chosen[0].query, 40)
        assert (ranges[:, 0] - query.margins[0] <= 0).all()
        assert (ranges[:, 1] + query.margins[1] >= words.frames).all()
        assert template_window(query, np.full((outcome.columns, 40), 0.5), BODY) == query.margins


def test_learned_queries_are_written_as_people_write_them_and_read_back(store: Path) -> None:
    line = Learning(store)
    line.run(LearnKeyframes, **QUICK, alternatives=2)
    queries = [query for outcome in line.outcomes() for query in keyframe_queries(outcome, BODY)]
    text = write_queries(queries, BODY)
    assert "keyframes:" in text
    assert "margins: [" in text
    assert list(parse_queries(text, BODY)) == queries


def test_the_same_is_learned_by_any_number_of_workers(store: Path) -> None:
    alone = Learning(store)
    alone.run(LearnKeyframes, **QUICK)
    expected, runs = alone.outcomes(), alone.runs()
    write_store_again = store.parent / "again"
    opened = open_store(store)
    takes = [
        {**row, "words": opened.words([row["take_id"]]).words}
        for row in opened.takes().select("name", "actor", "class", "take_id").iter_rows(named=True)
    ]
    write_store(write_store_again, [{k: v for k, v in take.items() if k != "take_id"} for take in takes])
    several = Learning(write_store_again, "processes")
    several.run(LearnKeyframes, **QUICK)
    several.executor.close()
    assert [one.consensus.query.key() for one in several.outcomes()] == [one.consensus.query.key() for one in expected]
    assert [(one.key, one.number) for one in several.runs()] == [(one.key, one.number) for one in runs]


def test_runs_that_were_finished_are_not_done_again(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    never_settled(monkeypatch)
    line = Learning(store)
    done: list[tuple[str, int]] = []
    original = keyframe_runs.learn_runs

    def failing(task: keyframe_runs.RunTask) -> list:
        if len(done) >= 9:
            raise KinedexError("out of power")
        done.extend((task.training.subclass, number) for number in task.numbers)
        return original(task)

    monkeypatch.setattr(keyframe_runs, "learn_runs", failing)
    with pytest.raises(KinedexError, match="out of power"):
        line.run(LearnKeyframes, **QUICK)
    assert len(line.runs()) == len(done)
    before = list(done)
    monkeypatch.setattr(keyframe_runs, "learn_runs", lambda task: done.extend(
        (task.training.subclass, number) for number in task.numbers) or original(task))  # fmt: skip
    line.run(LearnKeyframes, **QUICK)
    assert len(done) == len(set(done)) == 24
    assert done[: len(before)] == before


def test_a_class_settles_when_its_outcome_no_longer_moves(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    line = Learning(store)
    monkeypatch.setattr(keyframe_parameters, "PATIENCE", 1)
    monkeypatch.setattr(keyframe_parameters, "SETTLED", 0.01)
    summary = line.run(LearnKeyframes, **{**QUICK, "runs": 40})
    assert summary["settled"] == 4
    assert int(str(summary["runs"])) < 4 * 40
    message = line.printed.getvalue().splitlines()
    assert message[0].strip() == "4 subclasses with 12 clips, in rounds of 2 runs each"
    reports = [text.strip() for text in message if "of at most 40 runs each" in text]
    assert reports[0] == "2 of at most 40 runs each: 0 of 4 subclasses settled"
    assert reports[-1] == f"{2 * len(reports)} of at most 40 runs each: 4 of 4 subclasses settled"


def test_the_outcome_is_that_of_the_best_round(store: Path) -> None:
    line = Learning(store)
    line.run(LearnKeyframes, **QUICK)
    first, *_ = line.outcomes()
    ranked = [
        replace(first, runs=runs, consensus=replace(first.consensus, rank=rank))
        for runs, rank in ((2, 0.5), (4, 0.9), (6, 0.9), (8, 0.7))
    ]
    course = keyframe_runs.ClassRuns(query_learning.TrainingSet("walk", (), (), ()), "key", {}, ranked)
    assert course.outcome.runs == 6


def test_a_wrong_value_that_is_set_is_told_as_such() -> None:
    for assignment, text in ((("tempo", ".inf"), "finite"), (("runs", "0"), "greater than or equal to 1, got 0")):
        with pytest.raises(KinedexError) as caught:
            load_pipeline("keyframes", {f"learn_keyframes.{assignment[0]}": assignment[1]})
        assert str(caught.value).startswith(f"--set learn_keyframes.{assignment[0]}=")
        assert text in str(caught.value)
        assert ".yaml" not in str(caught.value)


def test_keyframes_keep_to_the_feature_sets_allowed(store: Path) -> None:
    line = Learning(store)
    line.run(LearnKeyframes, **QUICK, sets=["lower"])
    allowed = allowed_features(BODY, ["lower"])
    for outcome in line.outcomes():
        assert not (outcome.consensus.query.masks & ~np.uint64(allowed)).any()
        assert {keyframe.set for query in keyframe_queries(outcome, BODY) for keyframe in query.keyframes} == {"lower"}


def test_subclasses_of_one_class_are_no_negatives_of_each_other(store: Path, tmp_path: Path) -> None:
    classes = tmp_path / "classes.yaml"
    classes.write_text("moving: {subclasses: [walk, kick]}\nother: {subclasses: [wave, rest]}\n")
    line = Learning(store)
    line.run(LearnKeyframes, **QUICK, classes=str(classes))
    opened = open_store(store)
    clips = training_clips(opened, opened.takes("class IS NOT NULL"))
    lessons = training_sets(clips, load_classes(classes, POSES))
    assert {one.subclass: len(one.negatives) for one in lessons} == dict.fromkeys(POSES, 6)


def test_the_simpler_learners_learn_too(store: Path) -> None:
    for learner in ("random", "greedy"):
        summary = Learning(store).run(LearnKeyframes, **QUICK, learner=learner)
        assert summary["recall"] == 1.0
        page = (store / str(summary["files"][0])).read_text()  # type: ignore[index]
        assert "generations." not in page.replace("had no generations.", "")
        assert "0.000 at the end" not in page


def test_what_cannot_be_learned_is_said(store: Path) -> None:
    line = Learning(store)
    with pytest.raises(KinedexError, match="those of walk only"):
        line.run(LearnKeyframes, **QUICK, where="class = 'walk'")
    with pytest.raises(KinedexError, match="no feature set 'lowr'"):
        line.run(LearnKeyframes, **QUICK, sets=["lowr"])


@pytest.mark.parametrize("key", ["delta", "tempo", "parsimony", "gap_cost", "outside_cost"])
@pytest.mark.parametrize("value", [float("inf"), float("nan")])
def test_numbers_are_finite(key: str, value: float) -> None:
    with pytest.raises(ValidationError):
        KeyframeParameters(**{key: value})


def test_clips_that_are_left_out_or_cut_are_said(tmp_path: Path) -> None:
    clips = [clip(subclass, "al", number) for subclass in ("walk", "kick") for number in (1, 2, 3)]
    for place, frame in ((0, 0), (4, 7)):
        words = np.array(clips[place]["words"])
        words[frame] = NO_WORD
        clips[place]["words"] = words
    line = Learning(write_store(tmp_path / "store", clips))
    summary = line.run(LearnKeyframes, **QUICK)
    assert summary["clips"] == 5
    page = (line.store / str(summary["files"][0])).read_text()  # type: ignore[index]
    for text in (
        "walk: clips with invalid frames at an end, which are cut off: al_walk_001",
        "kick: clips with invalid frames in the middle, excluded: al_kick_002",
    ):
        assert text in line.printed.getvalue()
        assert text in page
    assert "from 5 clips" in line.printed.getvalue()
    assert "2 classes, 5 clips" in page


def test_every_default_is_a_number_of_the_thesis() -> None:
    params = KeyframeParameters()  # type: ignore[call-arg]
    numbers = params.evolution()
    assert (numbers.population, PARENTS, numbers.generations, BETA) == (50, 5, 100, 2.0)
    assert (OFFSPRING, params.delta) == (10, 0.0)
    assert 100 <= params.runs <= 500
    assert (params.steady, params.joins, params.tempo, params.parsimony, params.gap_cost) == (0, 0, 0.0, 0.0, 0.0)


def test_learn_show_and_export_on_the_command_line(store: Path, tmp_path: Path) -> None:
    runner = CliRunner()
    missing = runner.invoke(app, ["keyframes", "show", str(store)])
    assert missing.exit_code == 1
    sets = [f"learn_keyframes.{key}={value}" for key, value in {**QUICK, "joins": 1}.items()]
    options = [part for one in sets for part in ("--set", one)]
    learned = runner.invoke(app, ["keyframes", "learn", str(store), "--executor", "serial", *options])
    assert learned.exit_code == 0, learned.output
    shown = runner.invoke(app, ["keyframes", "show", str(store), "--format", "csv"])
    assert shown.output.splitlines()[0].startswith("query,origin,runs,precision")
    assert len([line for line in shown.output.splitlines() if line.startswith(tuple(POSES))]) == 8
    people = runner.invoke(app, ["keyframes", "show", str(store)]).output.splitlines()
    assert max(map(len, people)) <= 160
    assert any("→11–56→: the next keyframe follows 11 to 56 frames later" in line for line in people)
    assert not any(" – " in line for line in people)
    path = tmp_path / "learned.yaml"
    assert runner.invoke(app, ["keyframes", "export", str(store), "-c", "kick", "-o", str(path)]).exit_code == 0
    assert {query.target for query in parse_queries(path.read_text(), BODY)} == {"kick"}
    twice = runner.invoke(app, ["keyframes", "export", str(store), "-c", "kick", "-c", "kick", "-o", str(path)])
    assert twice.exit_code == 0
    assert {query.target for query in parse_queries(path.read_text(), BODY)} == {"kick"}
    wrong = runner.invoke(app, ["keyframes", "export", str(store), "-c", "kik"])
    assert wrong.exit_code == 1
    assert "did you mean 'kick'" in wrong.output
    for target, reason in ((tmp_path / "x.txt", "ends in .yaml"), (tmp_path / "no" / "x.yaml", "create it")):
        refused = runner.invoke(app, ["keyframes", "export", str(store), "-o", str(target)])
        assert refused.exit_code == 1
        assert reason in refused.output


def test_queries_of_several_pipelines_are_kept_apart(store: Path) -> None:
    Learning(store).run(LearnKeyframes, **QUICK)
    other = Learning(store)
    other.PIPELINE = "other"
    other.run(LearnKeyframes, **QUICK, alternatives=2, where="class IN ('walk', 'kick')")
    runner = CliRunner()
    newest = runner.invoke(app, ["keyframes", "show", str(store), "--format", "csv"])
    assert sorted(line.split(",")[0] for line in newest.stdout.splitlines()[1:]) == ["kick", "kick 2", "walk", "walk 2"]
    assert "queries of other/learn_keyframes" in newest.stderr
    named = runner.invoke(app, ["keyframes", "export", str(store), "--pipeline", "test"])
    assert [query.name for query in parse_queries(named.stdout, BODY)] == sorted(POSES)
    unknown = runner.invoke(app, ["keyframes", "show", str(store), "--pipeline", "keyframe"])
    assert unknown.exit_code == 1
    assert "test, other" in unknown.stderr


def test_own_queries_preselect_besides_learned_ones_of_the_same_name(store: Path, tmp_path: Path) -> None:
    line = Learning(store)
    line.run(LearnTemplates, methods=["soft"])
    line.run(LearnKeyframes, **QUICK)

    def searched(**params: object) -> dict[str, float]:
        line.run(Annotate, **params)
        curves = open_store(store).result("distance_curves")
        return dict(zip(curves.column("subclass").to_pylist(), curves.column("preselected").to_pylist(), strict=True))

    learned = searched()
    assert max(learned.values()) < 1
    assert "queries of files and learned ones" not in line.printed.getvalue()
    own = tmp_path / "own.yaml"
    own.write_text('kick: {keyframes: [{set: upper, pattern: "**************"}]}\n')  # any pose
    assert searched(queries=str(own)) == {**learned, "kick": 1.0}
    assert "with queries of files and learned ones, matched within the hits of either: kick" in (
        line.printed.getvalue()
    )


def test_no_query_is_named_as_another_class(store: Path) -> None:
    line = Learning(store)
    line.run(LearnKeyframes, **QUICK, alternatives=2)
    kick, walk = (next(one for one in line.outcomes() if one.subclass == name) for name in ("kick", "walk"))
    queries = every_query([kick, replace(walk, subclass="kick 2")], BODY)
    assert [query.name for query in queries] == ["kick", "kick 3", "kick 2", "kick 2 2"]
    assert list(parse_queries(write_queries(queries, BODY), BODY)) == queries


def test_runs_of_other_settings_and_beyond_those_asked_for_are_kept(
    store: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    line = Learning(store)
    never_settled(monkeypatch)
    more = dict(QUICK)
    line.run(LearnKeyframes, **more)
    everything = {(one.key, one.number) for one in line.runs()}
    assert len(everything) == 24
    summary = line.run(LearnKeyframes, **{**more, "runs": 4})
    assert summary["runs"] == 16
    assert {(one.key, one.number) for one in line.runs()} == everything
    assert "16 of them known" in line.printed.getvalue()
    line.run(LearnKeyframes, **more, seed=1)
    assert "known" not in line.printed.getvalue().rsplit("subclasses from", 1)[1]
    assert {(one.key, one.number) for one in line.runs()} > everything
    assert len(line.runs()) == 48
    line.run(LearnKeyframes, **more)
    assert "24 of them known" in line.printed.getvalue()
    # other clips: nothing could use these runs
    line.run(LearnKeyframes, **more, where="class IN ('walk', 'kick')")
    assert len(line.runs()) == 12


def test_runs_of_other_code_do_not_count(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    line = Learning(store)
    line.run(LearnKeyframes, **QUICK)
    monkeypatch.setattr(query_learning, "_code", lambda: "other")
    line.run(LearnKeyframes, **QUICK)
    assert "known" not in line.printed.getvalue()


def test_a_rejected_interval_teaches_the_query_of_its_class_and_no_other(store: Path) -> None:
    line = Learning(store)
    line.run(LearnKeyframes, **QUICK, examples=["clips", "labels"])
    before = {(one.subclass, one.number): one.key for one in line.runs()}
    row = {"take": "long", "class": "walk", "start": 20, "stop": 45, "verdict": "negative", "origin": "accepted"}
    record_labels(store, pa.Table.from_pylist([row]))
    summary = line.run(LearnKeyframes, **QUICK, examples=["clips", "labels"])
    assert (summary["clips"], summary["precision"], summary["recall"]) == (12, 1.0, 1.0)
    assert "12 clips and 1 rejected interval" in line.printed.getvalue()
    after = {(one.subclass, one.number): one.key for one in line.runs()}
    changed = {subclass for (subclass, number), key in after.items() if before.get((subclass, number)) != key}
    assert changed == {"walk"}
    words = open_store(store).words([open_store(store).take_id("long")]).take(0)[20:45]
    (query,) = (one for one in every_query(line.outcomes(), BODY) if one.target == "walk")
    assert not preselect(TakeWords(np.array([0]), np.array([0, len(words)]), words), BODY, [query])[query].offsets[-1]
