"""Ranking a store: by a learned template, by an example, within keyframe hits, with any number of threads."""

from __future__ import annotations

import csv
import io
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from kinedex import open_store as open_archive
from kinedex.catalog.queries.keyframe_query import Keyframe, KeyframeQuery
from kinedex.catalog.queries.query_reader import read_query_files
from kinedex.commands.cli import app
from kinedex.ops.errors import KinedexError
from kinedex.ops.intervals import Interval
from kinedex.ops.ranking.best_hits import rank
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import NO_WORD, TakeWords
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.evaluation.ground_truth import Manual
from kinedex.pipelines.stages import evaluate_ranking, vary_stiffness
from kinedex.pipelines.stages.evaluate_ranking import EvaluateRanking
from kinedex.pipelines.stages.rank import Rank
from kinedex.pipelines.templates import candidate_granules, ranking
from kinedex.pipelines.templates.ranked_hits import RankedTemplate, Ranking, ranking_table
from kinedex.pipelines.templates.ranking import mirrored_template, rank_both_sides, rank_takes
from kinedex.pipelines.templates.ranking_evaluation import (
    EVERYWHERE,
    WRITTEN,
    EvaluatedRanking,
    Trial,
    evaluate_clips,
    evaluate_hits,
    mean_average_precision,
    recall_at_tau,
)
from kinedex.pipelines.templates.store_ranking import RankingQuestion, rank_store
from kinedex.pipelines.templates.stored_templates import template_from_clip
from kinedex.storage.index.builder import build_index
from kinedex.storage.store.store import Store, open_store
from tests.pipelines.archives import write_archive
from tests.pipelines.labelled import write_store
from tests.storage.made_up import BODY


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    folder = tmp_path_factory.mktemp("ranking")
    archive = write_archive(folder / "archive", {f"x_{name}.amc": 240 + 40 * i for i, name in enumerate("abcdef")})
    run_pipeline("ingest", folder / "store", assignments={"source": str(archive)}, executor="serial")
    return open_store(folder / "store")


def example(store: Store, take: str, start: int, stop: int) -> QuantisedTemplate:
    words = store.words([store.take_id(take)]).take(0)[start:stop]
    return QuantisedTemplate(np.full(len(words), (1 << 40) - 1, np.uint64), words)


def rows(ranking: Ranking, *names: str) -> list[tuple[object, ...]]:
    """Return some columns of the hits of a ranking, a tuple for each hit."""
    return list(zip(*(ranking.hits.column(name).to_pylist() for name in names), strict=True))


def test_a_stretch_of_a_take_is_found_first_and_the_order_is_that_of_one_long_list(store: Store):
    template = example(store, "x_c", 10, 40)
    (found,) = rank_takes(store, [RankedTemplate("c", template)], 0.4, workers=1)
    # the last three frames are alike
    assert rows(found, "take", "start", "stop", "cost")[0] == ("x_c", 10, 38, 0.0)
    words = store.words()
    names = dict(store.takes().select("take_id", "name").iter_rows())
    whole = rank(template, words, 0.4)
    expected = [
        (names[words.take_ids[take]], start, stop)
        for take, start, stop in zip(whole.takes.tolist(), whole.starts.tolist(), whole.stops.tolist(), strict=True)
    ]
    assert rows(found, "take", "start", "stop") == expected
    assert found.frames == found.searched == len(words.words)


def test_threads_and_batches_change_nothing(store: Store, monkeypatch: pytest.MonkeyPatch):
    searched = [RankedTemplate("c", example(store, "x_c", 10, 40)), RankedTemplate("e", example(store, "x_e", 0, 25))]
    plain = ranking_table(rank_takes(store, searched, 0.4, workers=1))
    monkeypatch.setattr(ranking, "BATCH_FRAMES", 100)
    for workers in (1, 2, 3):
        assert ranking_table(rank_takes(store, searched, 0.4, workers=workers)) == plain
    few = rank_takes(store, searched, 0.4, top=2, workers=2)
    for one in few:
        all_hits = [row for row in plain.to_pylist() if row["template"] == one.name]
        assert one.hits.column("take").to_pylist() == [row["take"] for row in all_hits[:2]]
    for top in range(1, 12):  # whatever the last hit costs that is kept, equal costs included
        for one in rank_takes(store, searched, 0.4, top=top, workers=1):
            all_hits = [row for row in plain.to_pylist() if row["template"] == one.name]
            assert rows(one, "take", "start", "cost") == [
                (row["take"], row["start"], row["cost"]) for row in all_hits[:top]
            ]


def test_the_best_hits_are_the_head_of_more_where_costs_tie(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    archive = tmp_path / "archive"
    names = ["m", "c", "x", "a", "k", "b"]  # ingested one by one: other names than numbers come first
    for name in names:
        write_archive(archive, {f"x_{name}.amc": 120}, first_seed=5)
        run_pipeline("ingest", tmp_path / "store", assignments={"source": str(archive)}, executor="serial")
    store = open_store(tmp_path / "store")
    assert store.takes().sort("take_id")["name"].to_list() == [f"x_{name}" for name in names]
    searched = [
        RankedTemplate("one", example(store, "x_m", 5, 20)),
        RankedTemplate("other", example(store, "x_a", 2, 25)),
    ]
    for chosen in (searched, searched[:1]):
        whole = rank_takes(store, chosen, 0.3, workers=1)
        assert whole[0].hits.column("take").to_pylist()[:6] == [f"x_{name}" for name in sorted(names)]
        for frames in (1, 60, 90, 200_000):
            monkeypatch.setattr(ranking, "BATCH_FRAMES", frames)
            for top in (1, 2, 3, 4, 5, 10):
                for workers in (1, 2):
                    few = rank_takes(store, chosen, 0.3, top=top, workers=workers)
                    assert [one.hits for one in few] == [one.hits.slice(0, top) for one in whole]


def test_the_seconds_of_reading_and_of_ranking_are_apart_and_what_was_not_tried_is_no_number(store: Store):
    one, other = RankedTemplate("c", example(store, "x_c", 10, 40)), RankedTemplate("e", example(store, "x_e", 0, 25))
    both = rank_takes(store, [one, other], 0.1, workers=1)
    assert both[0].reading == both[1].reading > 0
    assert both[0].ranking / 30 == pytest.approx(both[1].ranking / 25)
    assert both[0].skipped is not None
    (alone,) = rank_takes(store, [one], 0.1, workers=1)  # too few columns for a bound that pays
    assert alone.skipped is None
    assert alone.ranking > 0


def test_a_filter_that_selects_nothing_is_said(store: Store):
    with pytest.raises(KinedexError, match="selects none"):
        rank_takes(store, [RankedTemplate("c", example(store, "x_c", 10, 40))], 0.1, where="name = 'zzz'")


def test_an_example_finds_itself_and_equals_the_ranking_by_its_template(store: Store):
    asked = RankingQuestion(tau=0.4, top=None)
    found = rank_store(store, [template_from_clip(store, "x_c", 10, 40)], asked)
    assert rows(found.rankings[0], "take", "cost")[0] == ("x_c", 0.0)
    made = template_from_clip(store, "x_c", "10", "40", "mine")
    by_template = rank_store(store, [made], asked)
    assert by_template.table().drop_columns(["template"]) == found.table().drop_columns(["template"])
    assert found.table().num_rows == len(found.rankings[0])
    anything = replace(made.template, values=np.full_like(made.template.values, 0.5))
    with pytest.raises(KinedexError, match="the template 'mine' is wildcards alone"):
        rank_store(store, [replace(made, template=anything)])


def test_query_by_example_on_the_command_line(store: Store):
    answer = CliRunner().invoke(
        app,
        ["rank", str(store.path), "--take", "x_c", "--start", "10", "--stop", "40", "--top", "3", "--format", "csv"],
    )
    assert answer.exit_code == 0, answer.output
    lines = answer.output.splitlines()
    assert lines[0].split(",")[1:8] == ["template", "rank", "take_id", "take", "start", "stop", "start_seconds"]
    assert lines[1].split(",")[4:7] == ["x_c", "10", "38"]
    neither = CliRunner().invoke(app, ["rank", str(store.path)])
    assert neither.exit_code == 1


def test_a_template_file_ranks_like_the_example_that_it_was_made_of(store: Store, tmp_path: Path):
    file = tmp_path / "mine.yaml"
    stretch = ["x_c", "10", "40"]
    made = CliRunner().invoke(
        app, ["template", "from-clip", str(store.path), *stretch, "--name", "mine", "-o", str(file)]
    )
    assert made.exit_code == 0, made.output
    by_file = CliRunner().invoke(app, ["rank", str(store.path), str(file), "--tau", "0.5", "--format", "csv"])
    by_take = CliRunner().invoke(
        app, ["rank", str(store.path), "--take", "x_c", "--start", "10", "--stop", "40", "--format", "csv"]
    )
    assert by_file.exit_code == 0, by_file.output
    hits = [
        sorted((row["take"], row["start"], row["stop"], row["cost"]) for row in csv.DictReader(io.StringIO(text)))
        for text in (by_file.output, by_take.output)
    ]
    assert hits[0] == hits[1]  # an example orders them by their similarity
    file.write_text(file.read_text() + file.read_text().replace("mine:", "other:"))
    several = CliRunner().invoke(app, ["rank", str(store.path), str(file)])
    assert several.exit_code == 1
    assert "2 templates; leave one in it: mine, other" in several.stderr


def test_several_templates_rank_as_each_does_alone(store: Store, tmp_path: Path):
    runner = CliRunner()
    for name, take, start in (("first", "x_c", "10"), ("second", "x_e", "0")):
        stretch, file = [str(store.path), take, start, "40"], str(tmp_path / f"{name}.yaml")
        made = runner.invoke(app, ["template", "from-clip", *stretch, "--name", name, "-o", file])
        assert made.exit_code == 0, made.output
    files = [str(tmp_path / "first.yaml"), str(tmp_path / "second.yaml")]
    options = ["--tau", "0.4", "--top", "5", "--format", "csv"]
    together = runner.invoke(app, ["rank", str(store.path), *files, *options])
    assert together.exit_code == 0, together.output
    alone = [runner.invoke(app, ["rank", str(store.path), file, *options]).output.splitlines() for file in files]
    assert together.output.splitlines() == alone[0] + alone[1][1:]
    shown = runner.invoke(app, ["rank", str(store.path), *files, "--tau", "0.4"])
    assert "hits below 0.4 by 2 templates" in shown.output
    assert "template" in shown.output
    no_templates = runner.invoke(app, ["rank", str(store.path), "--all"])
    assert no_templates.exit_code == 1
    assert "has no templates yet" in no_templates.stderr
    both = runner.invoke(app, ["rank", str(store.path), files[0], "--all"])
    assert both.exit_code == 1


def test_weights_in_a_template_file_change_the_costs_of_hits(store: Store, tmp_path: Path):
    runner = CliRunner()
    file = tmp_path / "mine.yaml"
    made = runner.invoke(
        app, ["template", "from-clip", str(store.path), "x_c", "10", "40", "--name", "mine", "-o", str(file)]
    )
    assert made.exit_code == 0, made.output
    plain = file.read_text()

    def costs(text: str) -> list[float]:
        file.write_text(text)
        answer = runner.invoke(app, ["rank", str(store.path), str(file), "--tau", "0.5", "--format", "csv"])
        assert answer.exit_code == 0, answer.output
        return [float(line.split(",")[-1]) for line in answer.output.splitlines()[1:]]

    first = store.feature_set.features[0].name
    unweighted = costs(plain)
    assert costs(plain.replace("mine:", f"mine:\n  weights: {{{first}: 1}}")) == unweighted
    assert costs(plain.replace("mine:", f"mine:\n  weights: {{{first}: 50}}")) != unweighted


def manual(take: str, label: str, start: int, stop: int) -> Manual:
    return Manual(0, take, label, start, stop, start, stop, "test")


def test_a_segment_is_found_once_and_a_second_hit_on_it_is_wrong():
    truth = [manual("a", "kick", 0, 30), manual("a", "punch", 40, 70), manual("b", "kick", 0, 30)]
    hits = [("a", 2, 28, 0.01), ("a", 5, 31, 0.02), ("a", 38, 66, 0.03), ("b", 0, 20, 0.2)]
    names = ("take", "start", "stop", "cost")
    table = pa.Table.from_pylist([dict(zip(names, hit, strict=True)) | {"template": "kick"} for hit in hits])
    judged = evaluate_hits("kick", table, truth, 0.1)
    assert judged.relevant == (True, False, False, True)
    assert judged.average_precision == (1 + 2 / 4) / 2
    assert judged.recall == 0.5
    assert dict(judged.confused) == {"kick": 1, "punch": 1}


def test_clips_are_judged_by_their_least_distance():
    costs = np.array([0.05, 0.01, 0.2, np.inf])
    judged = evaluate_clips("bk", "kick", costs, ["punch", "kick", "kick", "punch"], ["p", "k1", "k2", "q"], 0.1)
    assert judged.relevant == (True, False, True, False)
    assert judged.recall == 0.5
    assert judged.confused == (("punch", 1),)
    assert mean_average_precision([judged]) == (1 + 2 / 3) / 2
    assert recall_at_tau([judged]) == 0.5


@pytest.mark.slow
@pytest.mark.shared
def test_retrieval_of_hdm05_reaches_what_was_asked(shared: Path, tmp_path: Path):
    outcome = run_pipeline("retrieval", tmp_path / "store", assignments={"source": str(shared / "data" / "hdm05")})
    assert outcome.ran
    summary = open_store(tmp_path / "store").manifest.stages["retrieval/evaluate_ranking"].summary
    assert summary["takes_map"] >= 0.9
    assert summary["clips_map"] >= 0.9
    assert summary["takes_recall"] >= 0.95
    assert summary["clips_recall"] >= 0.95


def test_takes_without_frames_rank_nothing():
    empty = TakeWords(np.array([1]), np.array([0, 0]), np.empty(0, np.uint64))
    template = QuantisedTemplate(np.ones(3, np.uint64), np.ones(3, np.uint64))
    assert len(rank(template, empty, 0.1)) == 0


def test_classes_without_a_query_are_ranked_in_all_frames_and_that_is_said(store: Store, tmp_path: Path):
    runner = CliRunner()
    files = []
    for name in ("asked", "free"):
        files.append(str(tmp_path / f"{name}.yaml"))
        made = runner.invoke(
            app, ["template", "from-clip", str(store.path), "x_c", "10", "40", "--name", name, "-o", files[-1]]
        )
        assert made.exit_code == 0, made.output
    written = runner.invoke(app, ["query", "from-clip", str(store.path), "x_c", "10", "40", "--name", "asked"])
    assert written.exit_code == 0, written.output
    queries = tmp_path / "queries.yaml"
    queries.write_text(written.stdout)
    options = ["--queries", str(queries), "--format", "csv"]
    found = runner.invoke(app, ["rank", str(store.path), *files, *options])
    assert found.exit_code == 0, found.output
    assert "ranked in all frames: free" in found.stderr
    assert ",free,1," in found.stdout
    none = runner.invoke(app, ["rank", str(store.path), files[1], *options])
    assert none.exit_code == 1
    assert "no query is for free; the queries are for: asked" in none.stderr


def test_options_that_exclude_each_other_are_named_and_an_output_file_is_written(store: Store, tmp_path: Path):
    runner = CliRunner()
    both = runner.invoke(app, ["rank", str(store.path), "kick", "--take", "x_c"])
    assert both.exit_code == 1
    assert "TEMPLATE and --take exclude each other" in both.stderr
    file = tmp_path / "hits.csv"
    stretch = ["--take", "x_c", "--start", "10", "--stop", "40"]
    written = runner.invoke(app, ["rank", str(store.path), *stretch, "-o", str(file)])
    assert written.exit_code == 0, written.output
    assert written.stdout.strip() == str(file)
    assert file.read_text().count("x_c") > 1


def test_a_threshold_too_small_to_count_in_is_refused_by_the_stage():
    with pytest.raises(ValueError, match=r"0\.000001"):
        Rank.parameters(tau=1e-300)


def test_a_misspelt_column_is_answered_by_the_right_one(store: Store):
    with pytest.raises(KinedexError, match="no column 'actr'; did you mean 'actor'"):
        evaluate_ranking._folds(store, EvaluateRanking.parameters(clips="true", leave_out="actr"))


def test_all_rows_of_the_stiffness_table_are_about_the_same_classes():
    def trial(variant: str, label: str, relevant: tuple[bool, ...]) -> Trial:
        return Trial(variant, None, EvaluatedRanking("takes", "", label, relevant, len(relevant), 0), 1.0)

    trials = [trial(EVERYWHERE, "kick", (True,)), trial(EVERYWHERE, "walk", (False, False)), trial(WRITTEN, "kick", ())]
    assert [row.cells[1] for row in vary_stiffness._shown(trials).rows] == ["1", "1"]
    assert [row.cells[1] for row in vary_stiffness._shown(trials[:2]).rows] == ["2"]


def test_two_queries_of_one_name_both_say_where_to_look(store: Store, tmp_path: Path):
    """Of two files, a query each: the hits of either count."""
    word_set, count = next((name, one.count) for name, one in store.feature_set.sets.items())
    anywhere = KeyframeQuery("c", "c", (Keyframe(word_set, 0, 0),), ())
    first = int(store.words([store.take_id("x_c")]).words[10]) & 1
    some = replace(anywhere, keyframes=(Keyframe(word_set, 1, first),))
    template = example(store, "x_c", 10, 40)
    for queries in ((anywhere, some), (some, anywhere)):
        (found,) = rank_takes(store, [RankedTemplate("c", template, queries)], 0.4, workers=1)
        assert found.kept == 1
    files = [tmp_path / "one.yaml", tmp_path / "two.yaml"]
    for file in files:
        file.write_text(f'c: {{keyframes: [{{set: {word_set}, pattern: "{"*" * count}"}}]}}\n')
    with pytest.raises(KinedexError, match=r"two .* named 'c' \(the second one in .*two.yaml\); give one.*`class: c`"):
        read_query_files(files, store.feature_set)


def test_a_mirrored_template_finds_the_other_side(store: Store):
    words = store.words([store.take_id("x_c")]).take(0)[10:40]
    image = store.feature_set.mirrored(words)
    every = np.full(len(words), (1 << 40) - 1, np.uint64)
    one = RankedTemplate("c", QuantisedTemplate(every, image))
    assert mirrored_template(mirrored_template(one, store.feature_set), store.feature_set).template.value.tolist() == (
        image.tolist()
    )
    (whole,) = rank_both_sides(store, [one], 0.4, workers=1)
    assert rows(whole, "take", "start", "mirrored", "cost")[0] == ("x_c", 10, True, 0)
    assert set(whole.hits.column("mirrored").to_pylist()) == {True, False}
    for top in (1, 2, 5, len(whole), len(whole) + 3):
        assert rank_both_sides(store, [one], 0.4, top, workers=1)[0].hits == whole.hits.slice(0, top)
    image_alone = mirrored_template(one, store.feature_set)
    sides = [*rank_takes(store, [one], 0.4, workers=1), *rank_takes(store, [image_alone], 0.4, workers=1)]
    places = {hit for side in sides for hit in rows(side, "take", "start", "stop", "cost")}
    assert set(rows(whole, "take", "start", "stop", "cost")) <= places
    hits = [Interval(*hit) for hit in rows(whole, "take", "start", "stop")]
    assert not any(hit.overlaps(other) for i, hit in enumerate(hits) for other in hits[:i])


def test_without_a_hit_the_nearest_places_are_shown(store: Store, tmp_path: Path):
    body = "".join(f"    {number}: '{'01' * 8}'\n" for number in range(1, 21))
    (tmp_path / "odd.yaml").write_text(f"odd:\n  rows:\n{body}")
    asked = ["rank", str(store.path), str(tmp_path / "odd.yaml"), "--tau", "0.001", "--mirror"]
    found = CliRunner().invoke(app, asked)
    assert found.exit_code == 0, found.output
    miss = r"no hit of 'odd' below 0.001; the nearest place costs .*; --tau ([\d.]+) makes it a hit"
    tau = re.search(miss, found.stderr)
    assert tau is not None
    assert "No hit below 0.001; the nearest places, which are none:" in found.output
    assert "0 hits below 0.001" in found.output
    again = CliRunner().invoke(app, [*asked[:4], tau[1], "--json"])
    document = json.loads(again.stdout)
    assert document["hits"]
    assert document["nearest"] == []
    limited = CliRunner().invoke(app, [*asked[:4], tau[1], "--top", "1"])
    assert f"1 best hit below {float(tau[1]):g}, as --top 1 asks for; " in limited.output
    with pytest.warns(UserWarning, match=r"no hit of 'odd' below 0.001; the nearest place .*; tau=[\d.]+ makes it a"):
        assert open_archive(store.path).rank(str(tmp_path / "odd.yaml"), tau=0.001).height == 0
    document = json.loads(CliRunner().invoke(app, [*asked, "--json"]).stdout)
    assert document["hits"] == []
    assert len(document["nearest"]) == 5
    assert {"mirrored", "cost"} <= document["nearest"][0].keys()


# ---- what the index excludes -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def repeated(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Takes in which two motions and their mirror images come again and again, hardly changed; one lacks features."""
    rng = np.random.default_rng(7)
    motions = [np.repeat(rng.integers(0, 1 << 40, 9, dtype=np.uint64), 4) for _ in range(2)]
    motions += [BODY.mirrored(one) for one in motions]
    takes = []
    for number in range(9):
        parts = [motions[int(rng.integers(4))][: int(rng.integers(20, 37))] for _ in range(int(rng.integers(1, 9)))]
        words = np.concatenate(parts)
        spoiled = np.flatnonzero(rng.random(len(words)) < 0.05 * (number % 4))
        words[spoiled] ^= np.uint64(1) << rng.integers(0, 40, len(spoiled)).astype(np.uint64)
        words[rng.random(len(words)) < 0.01] = NO_WORD
        take: dict[str, object] = {"name": f"take_{8 - number}", "actor": "ann", "class": None, "words": words}
        if number == 3:
            known = BODY.every_bit & ~0b1110
            take |= {"known": known, "words": np.where(words == NO_WORD, NO_WORD, words & np.uint64(known))}
        takes.append(take)
    path = write_store(tmp_path_factory.mktemp("repeated") / "store", takes)
    build_index(open_store(path, at="newest"), threads=1)
    return open_store(path)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.integers(0, 8), st.integers(0, 200), st.integers(2, 60), st.sampled_from([1, 2, 5, 30, None]),
    st.sampled_from([0.02, 0.1, 0.3, 1.0]), st.booleans(),
)  # fmt: skip
def test_hits_are_the_same_with_and_without_what_the_index_excludes(
    repeated: Store, monkeypatch: pytest.MonkeyPatch, take: int, start: int, length: int, top: int | None, tau: float,
    both: bool,
) -> None:  # fmt: skip
    words = repeated.words([repeated.take_id(f"take_{take}")]).take(0)
    clip = words[min(start, max(0, len(words) - length)) :][:length]
    mask = np.full(len(clip), BODY.every_bit, np.uint64)
    asked = [RankedTemplate("clip", QuantisedTemplate(mask, clip & mask))]
    ranked = rank_both_sides if both else rank_takes
    with monkeypatch.context() as patch:
        for module in (ranking, candidate_granules):
            patch.setattr(module, "sound_index", lambda _: None)
        (plain,) = ranked(repeated, asked, tau, top)
    with monkeypatch.context() as patch:
        patch.setattr(candidate_granules, "WORTH_FRAMES", 0)
        patch.setattr(ranking, "MAX_PROMISING", 1.0)
        patch.setattr(ranking, "BATCH_FRAMES", 150)
        (found,) = ranked(repeated, asked, tau, top)
    assert found.hits == plain.hits
    assert (found.frames, found.searched) == (plain.frames, plain.searched)
