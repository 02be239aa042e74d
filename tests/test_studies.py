"""The studies of docs/studies.md: drawing examples, counting labels, explaining distances by features."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import yaml

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.queries.keyframe_query import SAME_FRAME, Gap, Keyframe, KeyframeQuery
from kinedex.catalog.queries.query_reader import parse_queries, read_queries
from kinedex.ops.annotation.segments import Segment
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.pipelines.engine.config import load_pipeline
from studies import corrections, cuts, few_clips, learned_queries, manual_queries, silhouettes, stiffness
from studies.bandai import NONE, confusions, draw, summary, winner
from studies.cross_studio import begin_of, contributions
from studies.long_archive import METHODS, stages
from tests.bodies import index, standing
from tests.oracles.paths import best_paths


def _takes(**counts: int) -> pl.DataFrame:
    rows = [{"name": f"{label}{index:02d}", "class": label} for label, n in counts.items() for index in range(n)]
    return pl.DataFrame(rows)


def test_examples_are_drawn_by_seed_and_are_no_takes_to_label() -> None:
    takes = _takes(walk=9, run=12, bow=7)
    drawn = draw(takes, 1, 5, 8)
    assert len(drawn.examples) == 10
    assert not set(drawn.examples) & set(drawn.rest["name"])
    assert sorted(drawn.rest["class"].unique()) == ["run", "walk"]  # bow has too few
    assert drawn.rest.height == 4 + 7
    assert draw(takes.sample(fraction=1, shuffle=True, seed=3), 1, 5, 8).examples == drawn.examples
    assert draw(takes, 2, 5, 8).examples != drawn.examples


def test_accuracy_is_averaged_over_draws() -> None:
    def row(seed: int, label: str, right: int, wrong: int) -> dict[str, object]:
        one = {"method": "thesis", "seed": seed, "content": "walk", "label": label}
        return {**one, "frames": 10, "right": right, "wrong": wrong}

    rows = pl.DataFrame([row(0, "walk", 10, 0), row(0, "run", 2, 8), row(1, "walk", 6, 0), row(1, "walk", 10, 0)])
    (found,) = summary(rows, "method").iter_rows(named=True)
    assert found["takes"] == 2
    assert found["accuracy"] == pytest.approx(75)
    assert found["sd"] == pytest.approx(np.std([50, 100], ddof=1))
    assert (found["frames"], found["wrong"], found["none"]) == pytest.approx((70, 20, 10))
    assert confusions(rows, "thesis", 5).rows() == [("walk", "run", 0.5, 2.0)]
    assert NONE not in confusions(rows, "thesis", 5)["label"].to_list()


def test_of_classes_that_label_as_many_frames_the_cheapest_wins() -> None:
    covered = np.array([[1, 1, 0, 0], [1, 1, 1, 0], [0, 1, 1, 1]], bool)
    assert winner(covered, np.array([0.0, 0.05, 0.02])) == 2
    assert winner(covered[:2], np.array([0.0, 0.05])) == 1
    assert winner(np.zeros((2, 4), bool), np.full(2, np.inf)) is None


@pytest.mark.parametrize("seed", range(20))
def test_what_features_add_is_the_distance(seed: int) -> None:
    generator = np.random.default_rng(seed)
    mask = generator.integers(0, 1 << 40, 9, dtype=np.uint64)
    mask[4] = 0  # a column of wildcards alone
    template = QuantisedTemplate(mask, generator.integers(0, 1 << 40, 9, dtype=np.uint64) & mask)
    words = generator.integers(0, 1 << 40, 40, dtype=np.uint64)
    ends = np.array([16, 25, 39])
    starts, distances = best_paths(template, words, ends)
    for start, end, distance in zip(starts, ends, distances, strict=True):
        assert contributions(template, words[start : end + 1], 40).sum() == pytest.approx(distance)
        begin = begin_of(template, words, int(end))
        assert begin >= start  # the last of the best paths
        assert contributions(template, words[begin : end + 1], 40).sum() == pytest.approx(distance)


def test_words_that_no_path_fits_are_refused() -> None:
    template = QuantisedTemplate(np.ones(3, np.uint64), np.ones(3, np.uint64))
    with pytest.raises(ValueError, match="no path leads"):
        contributions(template, np.ones(20, np.uint64), 40)


@pytest.mark.parametrize("method", [None, *METHODS])
def test_every_method_of_the_long_archive_is_a_pipeline(method: str | None, tmp_path: Path) -> None:
    file = tmp_path / "long.yaml"
    file.write_text(yaml.safe_dump(stages(tmp_path, method)), encoding="utf-8")
    names = [stage.name for stage in load_pipeline(file).stages]
    assert names[0] == "ingest"
    assert "learn_templates" in names
    assert ("learn_keyframes" in names) == (method is not None and "queries" in method)
    assert (names[-1] == "evaluate") == (method is not None)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_few_clips_are_of_two_people_where_the_class_has_two(count: int) -> None:
    people = {"walk": "aaaaaaab", "run": "aaaaaa", "bow": "ab"}
    rows = [
        {"name": f"{label}{index}", "class": label, "actor": actor}
        for label, actors in people.items()
        for index, actor in enumerate(actors)
    ]
    clips = pl.DataFrame(rows)
    for seed in range(20):
        names = few_clips.draw(clips, count, seed)
        chosen = clips.filter(pl.col("name").is_in(names))
        assert len(names) == len(set(names)) == chosen.height == 2 * count + 2
        of_class = {key[0]: group["actor"].n_unique() for key, group in chosen.group_by("class")}
        assert of_class == {"walk": 2, "run": 1, "bow": 2}
        assert few_clips.draw(clips, count, seed) == names
    assert sorted(few_clips.draw(clips, None, 0)) == sorted(clips["name"])
    assert len(few_clips.draw(clips, 1, 0)) == 3


def test_the_queries_of_table_3_3_are_joined_from_another_file(tmp_path: Path) -> None:
    features = load_feature_set()
    parts = sorted({part for names, _ in manual_queries.JOINED.values() for part in names})
    file = tmp_path / "parts.yaml"
    file.write_text("".join(f"{part}: {{keyframes: [{{on: [rknee_bent]}}]}}\n" for part in parts), encoding="utf-8")
    text = manual_queries.joined(file, read_queries(file, features))
    found = {query.name: len(query.keyframes) for query in parse_queries(text, features)}
    assert found == {name: len(names) for name, (names, _) in manual_queries.JOINED.items()}


def test_the_histogram_of_stiffness_counts_parts_of_one_keyframe_apart() -> None:
    gaps = (SAME_FRAME, Gap.of_distance(8, 0.5))
    query = KeyframeQuery("q", "q", tuple(Keyframe("lower", 1, 1) for _ in range(3)), gaps)
    assert stiffness.stiffness_values([query]) == [1.0, 0.5]
    assert stiffness.stiffness_values([query], same_frame=False) == [0.5]
    assert "| 0.5 | 1 | 50.0% |" in stiffness.histogram([1.0, 0.5])


def test_the_pages_name_variants_that_there_are() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in Path(__file__).parents[1].glob("docs/*.md"))
    named = {quoted or word for quoted, word in re.findall(r'--variant (?:"([^"]+)"|(\w+))', text)}
    assert named <= set(learned_queries.VARIANTS)
    assert named


def test_a_simulated_person_corrects_what_is_cut_badly_and_rejects_what_is_wrong() -> None:
    words = np.arange(100, dtype=np.uint64)
    motion = corrections.Motion("a", "ann", words, (("walk", 10, 30), ("kick", 50, 70)))
    person = corrections.Person({}, {"a": "ann"})
    person.look(motion, "walk", Segment(25, 40, 0, 0.1, 0))  # overlaps
    person.look(motion, "walk", Segment(51, 69, 0, 0.1, 0))  # it is a kick
    person.look(motion, "kick", Segment(80, 90, 0, 0.1, 0))  # it is nothing
    assert {one.subclass: one.names for one in person.clips()} == {"walk": ("a[10:30]",), "kick": ("a[50:70]",)}
    assert [one.of_takes for one in person.clips()] == [("a",), ("a",)]
    assert [(one.label, len(one.words)) for one in person.rejected] == [("walk", 18), ("kick", 10)]
    assert person.has_seen(motion, Segment(52, 70, 0, 0.1, 0))
    assert not person.has_seen(motion, Segment(10, 24, 0, 0.1, 0))


def test_words_that_differ_are_counted_by_their_distance_from_the_cut() -> None:
    differ = np.zeros(60, bool)
    differ[[0, 2, 59]] = True
    text = cuts.tables([cuts.Cut(0.0, differ), cuts.Cut(0.0, np.zeros(60, bool)), cuts.Cut(0.5, differ & False)])
    assert "| 0 | 50.0 % | 50.0 % |" in text
    assert "| 2 | 50.0 % | 0.0 % |" in text
    assert "| 0 s | 1 of 2 | 3 of 120 |" in text
    assert "| 0.5 s | 1 of 1 | 0 of 60 |" in text


def test_two_cameras_are_dark_for_a_while_in_every_second_and_a_half() -> None:
    dark = silhouettes.dark_cameras(450, 4, np.random.default_rng(3))
    for first in range(0, 450, 45):
        part = dark[first : first + 45]
        assert sorted(part.sum(axis=0) > 0) == [False, False, True, True]
        assert 11 <= part.any(axis=1).sum() <= 31


def test_joined_clips_go_on_where_the_one_before_ended() -> None:
    figure = np.stack([standing(30)[index(joint)] for joint in silhouettes.CHAIN.joints]).transpose(2, 0, 1)
    figure = figure + np.linspace(0, 0.3, 30)[:, None, None] * np.array([0, 0, 1])  # walks to the front
    away = figure @ np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]) + np.array([3.0, 0, 1])
    whole = silhouettes.join([figure, away], fade=5)
    assert whole.shape == (55, 24, 3)
    np.testing.assert_allclose(whole[:25], figure[:25])
    expected = figure + np.array([0, 0, 0.3 * 25 / 29])
    np.testing.assert_allclose(whole[25:], expected, atol=0.02)
