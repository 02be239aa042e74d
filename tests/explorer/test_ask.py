"""Asking the explorer's server: by example, by keyframes and by SQL, with the hits of the same calls in Python."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import kinedex
from kinedex.catalog.template_files import read_templates
from kinedex.explorer.keyframes import QueryEntry, model_of, read_text, written
from kinedex.ops.intervals import Hit, Interval
from kinedex.ops.templates.templates import quantise
from kinedex.pipelines.templates.chosen_intervals import template_of_chosen
from kinedex.storage.index.builder import build_index
from kinedex.storage.store.store import Store, open_store
from tests.explorer.conftest import Connect
from tests.pipelines.labelled import POSES, long_take, write_store
from tests.storage.made_up import BODY

Ask = Callable[..., Any]

FEATURE = [feature.name for feature in BODY.features]


def noisy(take: dict[str, object], seed: int) -> dict[str, object]:
    """Change a bit in some frames, so that hits differ in their costs."""
    rng = np.random.default_rng(seed)
    words = np.array(take["words"], np.uint64)
    flipped = np.flatnonzero(rng.random(len(words)) < 0.2)
    words[flipped] ^= np.uint64(1) << rng.integers(0, 40, len(flipped)).astype(np.uint64)
    return take | {"words": words}


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    order = ("walk", "rest", "kick", "wave", "rest", "kick", "walk")
    takes = [
        noisy(long_take(f"take_{i}", "ann" if i % 2 else "bob", *order[i:], *order[:i]), i) for i in range(len(order))
    ]
    mirrored = long_take("mirror", "bob", "rest", "kick", "rest")
    mirrored["words"] = BODY.mirrored(np.asarray(mirrored["words"], np.uint64))
    made = write_store(tmp_path_factory.mktemp("ask") / "a store", [*takes, mirrored])
    build_index(open_store(made, at="newest"), threads=1)
    return made


@pytest.fixture(scope="module")
def opened(path: Path) -> Store:
    return open_store(path)


@pytest.fixture(scope="module")
def ask(path: Path, connect: Connect) -> Ask:
    client = connect(path)

    def asked(what: str, status: int = 200, **body: Any) -> Any:
        answer = client.post(f"/api/ask/{what}", json=body)
        assert answer.status_code == status, answer.text
        return answer.json()

    return asked


def interval(opened: Store, take: str, start: int, stop: int, **more: bool) -> dict[str, Any]:
    return {"take_id": opened.take_ids[take], "start": start, "stop": stop, **more}


def kick_of(take: int) -> tuple[int, int]:
    """Return where the first kick of a take begins and ends."""
    order = ("walk", "rest", "kick", "wave", "rest", "kick", "walk")
    turned = (*order[take:], *order[:take])
    lengths = np.cumsum([0, *(5 * len(POSES[name]) for name in turned)])
    place = turned.index("kick")
    return int(lengths[place]), int(lengths[place + 1])


def rows(hits: list[dict[str, Any]]) -> list[tuple[Any, ...]]:
    return [(one["take"], one["start"], one["stop"], one["cost"], one["mirrored"]) for one in hits]


KEYS = ("take", "start", "stop", "cost", "mirrored")


def test_an_example_has_the_hits_of_python_with_its_mirror_image(path: Path, opened: Store, ask: Ask) -> None:
    start, stop = kick_of(0)
    found = ask("examples", positives=[interval(opened, "take_0", start, stop)], tau=0.3, top=40)
    python = kinedex.open_store(path)
    example = kinedex.Template.from_clip(python["take_0"], start, stop, name="example")
    expected = python.rank(example, 40, tau=0.3, mirror=True)
    assert rows(found["hits"]) == expected.select(KEYS).rows()
    assert found["total"] == expected.height > 10
    assert ("mirror", True) in {(one["take"], one["mirrored"]) for one in found["hits"]}
    alone = ask("examples", positives=[interval(opened, "take_0", start, stop)], tau=0.3, top=40, mirror=False)
    assert rows(alone["hits"]) == [(*row, False) for row in python.similar("take_0", start, stop, 40, tau=0.3)
                                   .select(KEYS[:4]).rows()]  # fmt: skip
    scope: dict[str, Any] = {}
    exec("\n".join([*found["python"].splitlines()[:-1], f"hits = {found['python'].splitlines()[-1]}"]), scope)
    assert rows(found["hits"]) == scope["hits"].select(KEYS).rows()
    assert f"--take take_0 --start {start} --stop {stop} --mirror" in found["command"]


def test_filters_and_the_number_of_hits_limit_a_search(opened: Store, ask: Ask) -> None:
    start, stop = kick_of(1)
    asked = {"positives": [interval(opened, "take_1", start, stop)], "tau": 0.3, "where": "actor = 'ann'"}
    found = ask("examples", **asked, top=3, filters=[{"column": "name", "values": ["take_1", "take_2", "take_3"]}])
    assert {one["take"] for one in found["hits"]} <= {"take_1", "take_3"}
    assert (found["total"], found["more"]) == (3, True)
    assert "no take to rank" in ask("examples", 400, **(asked | {"where": "actor = 'eve'"}))["error"]["message"]
    assert "actr" in ask("examples", 400, **(asked | {"where": "actr = 'eve'"}))["error"]["message"]
    wrong = ask("examples", 422, positives=[interval(opened, "take_1", start, 9999)])
    assert "0 <= start < stop" in wrong["error"]["message"]
    ask("examples", 422, positives=[])


def test_a_condition_over_another_view_chooses_its_takes_for_a_search(path: Path, opened: Store, ask: Ask) -> None:
    start, stop = kick_of(1)
    asked = {"positives": [interval(opened, "take_1", start, stop)], "tau": 0.3, "top": 40}
    plain = ask("examples", **asked, where="take_id IN (1, 3)")
    found = ask("examples", **asked, where="take_id IN (SELECT take_id FROM vocabulary, takes WHERE take_id IN (1, 3))")
    assert rows(found["hits"]) == rows(plain["hits"]) != []
    assert "--where 'take_id IN (1, 3)'" in found["command"]
    none = ask("examples", 400, **asked, where="take_id IN (SELECT -1 FROM vocabulary)")
    assert none["error"]["message"] == "no take fits the condition take_id IN (SELECT -1 FROM vocabulary)"
    wrong = ask("examples", 400, **asked, where="take_id IN (SELECT take_id FROM vocbulary)")
    assert wrong["error"]["message"] == "no view or macro is named 'vocbulary'; did you mean 'vocabulary'?"


def test_several_examples_are_learned_as_a_template_is(path: Path, opened: Store, ask: Ask) -> None:
    clips = [(f"take_{i}", *kick_of(i)) for i in range(3)]
    found = ask("examples", positives=[interval(opened, *clip) for clip in clips], tau=0.3, top=40)
    python = kinedex.open_store(path)
    learned = kinedex.Template.learn([python[take][start:stop] for take, start, stop in clips], name="example")
    assert rows(found["hits"]) == python.rank(learned, 40, tau=0.3, mirror=True).select(KEYS).rows()
    assert found["template"]["clips"] == [f"{take}[{start}:{stop}]" for take, start, stop in clips]


def test_a_mirrored_hit_is_an_example_by_what_its_mirror_image_shows(opened: Store) -> None:
    made = template_of_chosen(opened, "kick", [Hit(Interval("mirror", 5, 30), mirrored=True)])
    assert quantise(made.named.template, 0.1).value.tolist() == np.repeat(POSES["kick"], 5).tolist()
    assert made.clips == ("mirror of mirror[5:30]",)


def test_what_is_rejected_becomes_dearer_and_what_overlaps_an_example_does_not_count(opened: Store, ask: Ask) -> None:
    start, stop = kick_of(0)
    accepted = [interval(opened, "take_0", start, stop)]
    plain = ask("examples", positives=accepted, tau=0.9, top=60)
    rejected = [one for one in plain["hits"] if one["cost"] > 0.2][:4]
    assert rejected
    negatives = [{key: one[key] for key in ("take_id", "start", "stop", "mirrored")} for one in rejected]
    found = ask("examples", positives=accepted, negatives=negatives, tau=0.9, top=60)
    assert found["template"]["weights"]
    assert min(found["template"]["weights"].values()) > 1
    before, after = ({(one["take_id"], one["stop"]): one["cost"] for one in each["hits"]} for each in (plain, found))
    same = [(one["take_id"], one["stop"]) for one in rejected if (one["take_id"], one["stop"]) in after]
    assert all(after[place] > before[place] for place in same)
    badly_cut = interval(opened, "take_0", start + 3, stop - 3)
    ignored = ask("examples", positives=accepted, negatives=[badly_cut], tau=0.9, top=60)
    assert (ignored["template"]["weights"], rows(ignored["hits"])) == ({}, rows(plain["hits"]))
    assert "overlap" in ignored["remarks"][0]


def test_the_template_of_a_search_is_a_file_that_ranks_alike(
    opened: Store, ask: Ask, tmp_path: Path, path: Path
) -> None:
    positives = [interval(opened, "take_0", *kick_of(0)), interval(opened, "take_1", *kick_of(1))]
    asked = {"positives": positives, "negatives": [interval(opened, "take_2", 0, 20)], "name": "kick"}
    file = tmp_path / "kick.yaml"
    file.write_text(ask("template", **asked)["text"], encoding="utf-8")
    (read,) = read_templates(file, BODY)
    assert (read.name, read.template.feature_weights is not None) == ("kick", True)
    found = ask("examples", **asked, tau=0.3)
    python = kinedex.open_store(path)
    hits = python.rank(kinedex.Template.load(file), tau=0.3, mirror=True)
    assert rows(found["hits"]) == hits.select(KEYS).rows()


def test_a_hit_has_its_curve_its_path_and_what_it_contradicts(opened: Store, ask: Ask) -> None:
    asked = {"positives": [interval(opened, "take_0", *kick_of(0))], "tau": 0.3}
    for one in ask("examples", **asked, top=12)["hits"]:
        hit = {key: one[key] for key in ("take_id", "start", "stop", "mirrored")}
        shown = ask("hit", **asked, hit=hit)
        assert shown["cost"] == pytest.approx(one["cost"])
        assert shown["curve"][one["stop"] - 1 - shown["first"]] == pytest.approx(one["cost"], abs=1e-5)
        assert (shown["start"], len(shown["columns"])) == (one["start"], one["stop"] - one["start"])
        assert bool(shown["contradicted"]) == (one["cost"] > 0)


# ---- keyframes -------------------------------------------------------------------------------------------


def test_poses_and_text_are_the_same_query_with_the_hits_of_python(path: Path, ask: Ask, tmp_path: Path) -> None:
    poses = [{"on": BODY.named(int(POSES["kick"][i]))[:6], "off": []} for i in (0, 2)]
    model = {"name": "two poses", "poses": poses, "gaps": [{"low": 0.1, "high": 1.0}]}
    found = ask("keyframes", query=model)
    assert found["total"] > 0
    assert ask("keyframes", text=found["text"])["hits"] == found["hits"]
    assert found["query"] == model
    file = tmp_path / "two poses.yaml"
    file.write_text(found["text"], encoding="utf-8")
    expected = kinedex.open_store(path).search(file).select("take", "start", "stop").rows()
    assert [(hit["take"], hit["start"], hit["stop"]) for hit in found["hits"]] == expected
    some = ask("keyframes", query=model, where="actor = 'ann'", limit=1)
    assert len(some["hits"]) == 1
    assert some["total"] < found["total"]


def test_an_open_pose_and_an_open_gap_are_written_and_read(opened: Store) -> None:
    entry = QueryEntry.model_validate_json(f'{{"poses": [{{"on": ["{FEATURE[0]}"]}}, {{}}], "gaps": [{{"low": 0.5}}]}}')
    read = model_of(read_text(written(entry, opened), opened), opened)
    assert read is not None
    assert (read["poses"][1], read["gaps"]) == ({"on": [], "off": []}, [{"low": 0.5, "high": None}])


def test_a_text_that_is_wrong_is_answered_with_its_line(ask: Ask, tmp_path: Path) -> None:
    wrong = ask("keyframes", text=f"kick:\n  keyframes:\n    - {{on: [{FEATURE[0]}x]}}\n")
    assert (wrong["fault"]["line"], wrong["total"], wrong["hits"]) == (3, 0, [])
    assert FEATURE[0] in wrong["fault"]["message"]
    broken = ask("keyframes", text="kick:\n  keyframes: [")
    assert broken["fault"]["line"]
    for file in (tmp_path / "other.yaml", "../secret.yaml", "secret.yaml"):
        refused = ask("keyframes", text=f"q:\n  any_of:\n    - {{file: {file}, query: kick}}\n")
        assert "shipped" in refused["fault"]["message"]
    assert ask("keyframes", text="{}")["fault"]["message"]
    both = ask("keyframes", text="a: {any_of: [{keyframes: [{on: [1]}]}, {keyframes: [{on: [2]}]}]}")
    assert (both["fault"], both["query"]) == (None, None)
    ask("keyframes", 422, text="{}", query={"poses": [{}]})
    ask("keyframes", 400, query={"poses": [{"on": ["no such"]}]})


def test_keyframes_are_proposed_from_an_example_and_find_it(opened: Store, ask: Ask) -> None:
    start, stop = kick_of(3)
    made = ask("propose", take_id=opened.take_ids["take_3"], start=start, stop=stop, keyframes=2)
    assert len(made["query"]["poses"]) <= 2
    hits = ask("keyframes", query=made["query"])["hits"]
    assert any(one["take"] == "take_3" and start <= one["start"] < one["stop"] <= stop for one in hits)


# ---- SQL -------------------------------------------------------------------------------------------------


def test_a_result_of_sql_comes_in_blocks_and_as_hits(ask: Ask) -> None:
    text = "SELECT name AS take, 0::INTEGER AS start, 10::INTEGER AS stop, i FROM takes, range(100) r(i) ORDER BY ALL"
    first = ask("sql", text=text, limit=30)
    assert (first["total"], first["kept"], first["counted"], len(first["rows"])) == (800, 800, True, 30)
    assert [one["name"] for one in first["columns"]] == ["take", "start", "stop", "i"]
    assert len(first["hits"]) == 500
    last = ask("sql", text=text, offset=790, limit=100)
    assert (len(last["rows"]), last["hits"]) == (10, None)
    outside = ask("sql", text="SELECT 'take_0' AS take, 5 AS start, 99999 AS stop UNION ALL SELECT 'no', 1, 2")
    assert outside["hits"] == []
    assert ask("sql", text="SELECT 1")["hits"] is None
    many = ask("sql", text="SELECT i FROM range(150000) r(i)")
    assert (many["total"], many["kept"]) == (150_000, 100_000)


def test_sql_only_reads_and_its_views_are_listed(path: Path, ask: Ask, connect: Connect) -> None:
    for text in ("DROP TABLE takes", "COPY takes TO 'x.csv'", "SELECT * FROM read_text('/etc/hostname')", "SELEC 1"):
        assert ask("sql", 400, text=text)["error"]["message"]
    views = connect(path).get("/api/ask/views").json()["views"]
    takes = next(one for one in views if one["name"] == "takes")
    assert "actor" in [one["name"] for one in takes["columns"]]


# ---- labels ----------------------------------------------------------------------------------------------


def test_verdicts_become_labels_of_a_class_once(path: Path, opened: Store, ask: Ask, connect: Connect) -> None:
    asked = {
        "class": "kick",
        "positives": [interval(opened, "take_0", *kick_of(0))],
        "negatives": [interval(opened, "take_2", 0, 9)],
    }
    refused = connect(path, read_only=True).post("/api/ask/labels", json=asked)
    assert (refused.status_code, refused.json()["error"]["type"]) == (403, "ReadOnlyError")
    assert (ask("labels", **asked)["recorded"], ask("labels", **asked)["known"]) == (2, 2)
    labels = open_store(path).labels().to_pylist()
    assert [(one["take"], one["class"], one["verdict"]) for one in labels] == [
        ("take_0", "kick", "positive"),
        ("take_2", "kick", "negative"),
    ]


@given(
    hits=st.lists(st.tuples(st.sampled_from(["take_0", "take_1"]), st.integers(0, 30), st.integers(1, 30)), max_size=6),
)
@settings(max_examples=25, deadline=None)
def test_hits_have_the_labels_of_their_places(
    labelled: tuple[Ask, list[dict[str, Any]]], hits: list[tuple[str, int, int]]
) -> None:
    ask, labels = labelled
    places = [{"take": take, "start": start, "stop": start + length} for take, start, length in hits]
    found = ask("labelled", hits=places)["labels"]
    for place, those in zip(places, found, strict=True):
        frames = set(range(place["start"], place["stop"]))
        expected = set()
        for one in labels:
            own = set(range(one["start"], one["stop"]))
            if one["take"] == place["take"] and 2 * len(frames & own) >= min(len(frames), len(own)):
                expected.add((one["class"], one["verdict"]))
        assert {(one["class"], one["verdict"]) for one in those} == expected
        assert [one["share"] for one in those] == sorted((one["share"] for one in those), reverse=True)


@pytest.fixture(scope="module")
def labelled(tmp_path_factory: pytest.TempPathFactory, connect: Connect) -> tuple[Ask, list[dict[str, Any]]]:
    """Return the questions to a store with labels of two takes, and the labels."""
    takes = [long_take(f"take_{i}", "ann", "walk", "rest", "kick", "wave", "rest", "kick") for i in range(2)]
    client = connect(write_store(tmp_path_factory.mktemp("labelled") / "store", takes))
    rng = np.random.default_rng(3)
    labels = []
    for side, verdict in (("positives", "positive"), ("negatives", "negative")):
        starts = rng.integers(0, 40, 4).tolist()
        own = [{"take": f"take_{i % 2}", "start": at, "stop": at + 3 + 4 * i} for i, at in enumerate(starts)]
        name = "kick" if verdict == "positive" else "wave"
        assert client.post("/api/ask/labels", json={"class": name, side: own}).status_code == 200
        labels += [{**one, "class": name, "verdict": verdict} for one in own]

    def asked(what: str, **body: Any) -> Any:
        answer = client.post(f"/api/ask/{what}", json=body)
        assert answer.status_code == 200, answer.text
        return answer.json()

    return asked, labels
