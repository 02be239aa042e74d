"""The server side of the Templates page: templates with their clips, two compared, edits on held-out takes, queries."""

from __future__ import annotations

import base64
import io
import json
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from starlette.testclient import TestClient

from kinedex.catalog.queries.keyframe_query import WordPattern
from kinedex.console.terminal import Terminal
from kinedex.explorer import held_out_truth
from kinedex.explorer.keyframes import frames_of_poses, model_of, read_text
from kinedex.ops.templates.derived_templates import adjusted
from kinedex.ops.templates.templates import Template
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.storage.store.store import open_store
from tests.explorer.conftest import Connect
from tests.pipelines.labelled import CLIPS, TAKES, TRUTH, clip, motion, write_store

PIPELINE = """
name: {name}
stages:
  learn_templates: {{params: {learn}}}
  {more}
  annotate: {{params: {annotate}}}
  evaluate: {{params: {evaluate}}}
"""
LEARNED = "{where: class IS NOT NULL}"
TAU = 0.42
"""So large that the class finds too much, and edits have an effect."""

EDITS: list[dict[str, Any]] = [
    {},
    {"tau": 0.3},
    {"weights": {"rhand_fast": 0, "lknee_bent": 3.5}, "tau": 0.35},
    {"first": 4, "stop": 15},
    {"weights": {"rhand_above_neck": 0.25}, "first": 6, "tau": 0.37},
]


KEYFRAMES = (
    "learn_keyframes: {params: {where: class IS NOT NULL AND class <> 'wave', runs: 1, population: 12, generations: 8}}"
)
METHODS = {
    "own": (f"tau: {TAU}", ""),
    "keyed": (f"tau: {TAU}", KEYFRAMES),
    "rows": ("method: best", ""),
    "single": ("method: best, each_example: true", ""),
}
"""Pipelines, by the parameters of their annotation and a further stage."""


def run(folder: Path, name: str, learn: str, annotate: str, evaluate: str = "{}", more: str = "") -> None:
    """Run a pipeline on the store of a folder."""
    text = PIPELINE.format(name=name, learn=learn, annotate=annotate, evaluate=evaluate, more=more)
    (folder / f"{name}.yaml").write_text(text)
    run_pipeline(folder / f"{name}.yaml", folder / "store", terminal=Terminal(Console(file=io.StringIO())))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a store of clips and takes with ground truth, whose templates were learned and annotate."""
    path = tmp_path_factory.mktemp("templates")
    (path / "archive").mkdir()
    (path / "archive" / "ground_truth.csv").write_text(TRUTH)
    odd = {**clip("kick", "ann", 9), "words": np.concatenate([motion("kick")[:10], motion("wave")])}
    more = [clip("kick", "bob", 7, 4), clip("kick", "bob", 8, 7), odd]
    write_store(path / "store", [*CLIPS, *more, *TAKES], path / "archive")
    run(path, "own", LEARNED, f"{{where: class IS NULL, tau: {TAU}}}")
    return path


@pytest.fixture(scope="module")
def client(connect: Connect, folder: Path) -> TestClient:
    return connect(folder / "store")


STAGE = "own/learn_templates"
KICK = {"stage": STAGE, "kind": "soft", "template": "kick"}


def test_the_list_has_every_template_with_its_picture(client: TestClient) -> None:
    found = client.get("/api/templates").json()
    assert (found["stages"], found["kind"], found["kinds"]) == ([STAGE], "soft", ["soft", "hard"])
    assert [(one["name"], one["class"], one["clips"], one["tau"]) for one in found["templates"]] == [
        ("kick", "kick", 6, TAU), ("walk", "walk", 3, TAU), ("wave", "wave", 3, TAU)
    ]  # fmt: skip
    for row in found["templates"]:
        one = client.get("/api/templates/one", params={**KICK, "template": row["name"]}).json()
        picture = np.frombuffer(base64.b64decode(row["picture"]), np.uint8).reshape(40, row["columns"])
        np.testing.assert_allclose(picture / 200, one["values"], atol=0.003)
    assert client.get("/api/templates", params={"stage": "own/index"}).status_code == 404
    assert client.get("/api/templates/one", params={"template": "kik"}).status_code == 404
    assert client.get("/api/templates", params={"kind": "warm"}).status_code == 422


def test_clips_have_their_costs_and_the_one_that_is_unlike_stands_out(client: TestClient, folder: Path) -> None:
    one = client.get("/api/templates/one", params=KICK).json()
    rows = one["clips"]
    costs = [row["to_others"] for row in rows]
    assert costs == sorted(costs, reverse=True)
    median = float(np.median(costs))
    spread = float(np.median([abs(cost - median) for cost in costs]))
    limit = max(1.5 * median, median + 5 * spread, median + 0.05)
    assert one["far"] == pytest.approx({"limit": limit, "median": median, "spread": spread})
    assert [row["name"] for row in rows if row["far"]] == ["ann_kick_009"]
    for row in rows:
        curve = client.get(f"/api/takes/{row['take_id']}/curve", params={"template": "kick", "delta": 0.05}).content
        least = float(np.frombuffer(curve, "<f4").min())
        assert row["to_template"] is None if np.isinf(least) else row["to_template"] == pytest.approx(least)
        frames = row["frames"]
        assert len(frames) == one["columns"]
        assert frames == sorted(frames)
        assert row["start"] <= frames[0]
        assert frames[-1] < row["stop"]
    assert open_store(folder / "store").take_ids[rows[one["poses"]]["take"]] != rows[0]["take_id"]


def naive_cost(one: np.ndarray, other: np.ndarray) -> float:
    """Return the cost of the cheapest warping path by the recurrence as it stands in textbooks."""
    costs = np.abs(one[:, None, :] - other[None, :, :]).mean(axis=2)
    total = np.full((len(one) + 1, len(other) + 1), np.inf)
    total[0, 0] = 0
    for k, column in product(range(len(one)), range(len(other))):
        total[k + 1, column + 1] = costs[k, column] + min(total[k, column], total[k, column + 1], total[k + 1, column])
    return float(total[-1, -1])


def test_two_templates_differ_along_the_cheapest_path(client: TestClient) -> None:
    values = {
        name: np.array(client.get("/api/templates/one", params={**KICK, "template": name}).json()["values"]).T
        for name in ("kick", "walk")
    }
    found = client.get("/api/templates/difference", params={**KICK, "other": "walk"}).json()
    path = np.array(found["columns"])
    assert path[0].tolist() == [0, 0]
    assert path[-1].tolist() == [len(values["kick"]) - 1, len(values["walk"]) - 1]
    assert {tuple(step) for step in np.diff(path, axis=0).tolist()} <= {(1, 1), (1, 0), (0, 1)}
    differences = values["kick"][path[:, 0]] - values["walk"][path[:, 1]]
    np.testing.assert_allclose(np.array(found["values"]).T, differences, atol=0.002)
    assert np.abs(differences).mean(axis=1).sum() == pytest.approx(naive_cost(*values.values()), abs=0.02)
    means = np.abs(differences).mean(axis=0)
    assert [one["difference"] for one in found["features"]] == pytest.approx(sorted(means, reverse=True), abs=0.002)
    fixed = {name: np.where(own <= 0.05, 0, np.where(own >= 0.95, 1, 0.5)) for name, own in values.items()}
    first, second = fixed["kick"][path[:, 0]], fixed["walk"][path[:, 1]]
    compared = (first != 0.5) & (second != 0.5)
    assert found["share"] == pytest.approx(np.sum(compared & (first != second)) / np.sum(compared))
    assert "on in kick and off in walk in" in " ".join(one["words"] for one in found["features"])
    alike = client.get("/api/templates/difference", params={**KICK, "other": "kick", "other_stage": STAGE}).json()
    assert (alike["share"], max(one["difference"] for one in alike["features"])) == (0, 0)


@pytest.fixture(scope="module")
def with_methods(folder: Path) -> Path:
    """The folder, once templates were also learned and annotated with by other methods."""
    for name, (annotate, more) in METHODS.items():
        if name != "own":
            run(folder, name, LEARNED, f"{{where: class IS NULL, {annotate}}}", more=more)
    (folder / "kick-alone.yaml").write_text("kick: [kick]\n")
    return folder


@pytest.mark.parametrize("compete", [False, True])
@pytest.mark.parametrize(
    ("method", "number"),
    [(name, number) for name in METHODS for number in range(len(EDITS)) if name == "own" or number in (0, 3, 4)],
)
def test_an_edit_has_the_effect_that_the_stages_then_have(
    client: TestClient, with_methods: Path, method: str, number: int, compete: bool
) -> None:
    folder, edit = with_methods, EDITS[number]
    asked = {**KICK, **edit, "stage": f"{method}/learn_templates"}
    answer = client.post("/api/templates/effect", json={**asked, "compete": compete}).json()
    is_edited = bool({"weights", "first", "stop"} & edit.keys())
    file = folder / f"kick{number}.yaml"
    file.write_text(client.post("/api/templates/file", json=asked).json()["text"])
    files = f", template_files: [{file}]" if is_edited else ""
    params, more = METHODS[method]
    tau = f", tau_by_class: {{kick: {edit['tau']}}}" if "tau" in edit and answer["uses_tau"] else ""
    classes = "own" if compete else str(folder / "kick-alone.yaml")
    annotate = f"{{where: class IS NULL, classes: {classes}, {params}{tau}}}"
    name = f"{method}{number}{'all' if compete else 'alone'}"
    run(folder, name, f"{LEARNED[:-1]}{files}}}", annotate, "{unknown_labels: ignore}", more)
    store = open_store(folder / "store")
    rows = store.result("metrics", pipeline=name).to_pylist()
    (twin,) = [row for row in rows if (row["scope"], row["name"]) == ("class", "kick")]
    wanted = "used" if is_edited or ("tau" in edit and answer["uses_tau"]) else "pipeline"
    shown = next(row for row in answer["rows"] if row["threshold"] == wanted)
    for measure in ("p1", "r1", "f1", "p2", "r2", "f2", "frames_both", "frames_automatic", "segments_automatic"):
        assert shown[measure] == twin[measure], measure
    assert 0 < shown["f1"] <= 1
    assert (shown["f1"] < 1) or method != "own"
    assert answer["uses_tau"] == (shown["tau"] is not None) == (method in ("own", "keyed"))
    listed = client.get("/api/templates", params={"stage": asked["stage"]}).json()["templates"]
    assert all((one["tau"] is not None) == answer["uses_tau"] for one in listed)
    truth = [row for row in store.result("ground_truth", pipeline=name).to_pylist() if row["class"] == "kick"]
    found = [row for row in store.result("annotations", pipeline=name).to_pylist() if row["class"] == "kick"]
    meet = {
        (one["take"], one["start"]) for one, other in product(found, truth)
        if one["take"] == other["take"] and one["start"] < other["stop"] and other["start"] < one["stop"]
    }  # fmt: skip
    wrong = {(one["take"], one["start"], one["cost"]) for one in found if (one["take"], one["start"]) not in meet}
    assert {(one["take"], one["start"], one["cost"]) for one in answer["wrong"]["segments"]} == wrong
    assert answer["wrong"]["total"] == len(wrong)


def test_many_takes_are_judged_by_some_unless_all_are_asked_for(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = client.post("/api/templates/effect", json=KICK).json()
    monkeypatch.setattr(held_out_truth, "MAX_SECONDS", 0.1)
    asked = {**KICK, "truth": "evaluation"}
    some = client.post("/api/templates/effect", json=asked).json()
    assert (some["truth"]["takes"], some["truth"]["all_takes"]) == (1, 2)
    every = client.post("/api/templates/effect", json={**asked, "everything": True}).json()
    assert every["truth"] == whole["truth"]
    assert every["rows"] == whole["rows"] != some["rows"]


def test_the_best_threshold_is_that_of_all_thresholds(client: TestClient) -> None:
    """No threshold between two costs of the training clips gives a higher F."""
    edit = {"weights": {"rhand_fast": 0}, "first": 3}
    best = client.post("/api/templates/effect", json={**KICK, **edit}).json()["training"]["edited"]
    file = client.post("/api/templates/file", json={**KICK, **edit}).json()["text"]
    assert "columns 4 to" in file
    assert "rhand_fast × 0" in file
    assert 0 < best["tau"] <= 1
    least = {}
    for name in ("kick", "walk", "wave"):
        clips = client.get("/api/templates/one", params={**KICK, "template": name}).json()["clips"]
        for take in (row["take_id"] for row in clips):
            curve = client.get(f"/api/takes/{take}/curve", params={"template": "kick", "delta": 0.05}).content
            least[take] = (name == "kick", float(np.frombuffer(curve, "<f4").min()))
    scores = []
    for tau in (cost + 1e-6 for _, cost in least.values() if np.isfinite(cost)):
        hits = sum(own for own, cost in least.values() if cost < tau)
        false = sum(not own for own, cost in least.values() if cost < tau)
        scores.append(2 * hits / (hits + false + sum(own for own, _ in least.values())))
    learned = client.post("/api/templates/effect", json=KICK).json()["training"]["learned"]
    assert learned["f"] == pytest.approx(max(scores))
    assert max(learned["scores"]) == pytest.approx(learned["f"])


def test_who_accepts_lines_gets_the_progress_first(client: TestClient) -> None:
    asked = {**KICK, "tau": 0.123}
    answer = client.post("/api/templates/effect", json=asked, headers={"accept": "application/x-ndjson"})
    *steps, last = [json.loads(line) for line in answer.text.splitlines()]
    assert all(0 <= step["done"] <= step["total"] for step in steps)
    assert last["answer"]["rows"] == client.post("/api/templates/effect", json=asked).json()["rows"]
    headers = {"accept": "application/x-ndjson"}
    fault = client.post("/api/templates/effect", json={**KICK, "template": "nobody"}, headers=headers)
    last = json.loads(fault.text.splitlines()[-1])
    plain = client.post("/api/templates/effect", json={**KICK, "template": "nobody"})
    assert (last["status"], last["error"]) == (plain.status_code, plain.json()["error"])


def test_faults_of_edits_name_what_is_wrong(client: TestClient) -> None:
    for edit, status, text in (
        ({"weights": {"rhand_fats": 0}}, 400, "rhand_fast"),
        ({"first": 10, "stop": 10}, 422, "first and stop"),
        ({"stop": 4000}, 422, "first and stop"),
        ({"weights": {"rhand_fast": -1}}, 422, "greater than or equal to 0"),
        ({"template": "kik"}, 404, "kik"),
        ({"tau": 1.5}, 422, "less than or equal to 1"),
    ):
        answer = client.post("/api/templates/effect", json={**KICK, **edit})
        assert answer.status_code == status, edit
        assert text in answer.json()["error"]["message"]
    features = {one["name"]: 0 for one in client.get("/api/store").json()["features"]}
    nothing = client.post("/api/templates/effect", json={**KICK, "weights": features}).json()
    assert "at least one feature must count" in nothing["error"]["message"]


def label(client: TestClient, take: str, start: int, stop: int) -> None:
    """Label a kick."""
    client.post("/api/ask/labels", json={"class": "kick", "positives": [{"take": take, "start": start, "stop": stop}]})


def test_labels_are_a_ground_truth_where_nothing_was_evaluated(connect: Connect, tmp_path: Path) -> None:
    path = write_store(tmp_path / "store", [*CLIPS, *TAKES])
    (tmp_path / "own.yaml").write_text(f"name: own\nstages:\n  learn_templates: {{params: {LEARNED}}}\n")
    run_pipeline(tmp_path / "own.yaml", path, terminal=Terminal(Console(file=io.StringIO())))
    client = connect(path)
    without = client.post("/api/templates/effect", json=KICK).json()
    assert without["rows"] == []
    assert "Label some takes" in without["missing"]
    client.post(
        "/api/ask/labels", json={"class": "kick", "positives": [{"take": "ann_kick_001", "start": 0, "stop": 20}]}
    )
    among = client.post("/api/templates/effect", json=KICK).json()
    assert among["truth"]["among_examples"] == 1
    assert "among the examples of kick" in among["missing"]
    client.post(
        "/api/ask/labels", json={"class": "kick", "positives": [{"take": "cat_take01", "start": 30, "stop": 55}]}
    )
    effect = client.post("/api/templates/effect", json=KICK).json()
    assert effect["truth"] == {
        "source": "labels", "stage": None, "takes": 1, "seconds": pytest.approx(60 / 30, abs=1), "segments": 1,
        "all_takes": 1, "all_seconds": pytest.approx(60 / 30, abs=1), "among_examples": 1, "sources": ["labels"],
    }  # fmt: skip
    assert effect["rows"][0]["r1"] == 1
    assert effect["rows"][0]["tau"] == 0.13
    assert any("labels are taken as complete" in one for one in effect["remarks"])
    assert "annotate.tau_by_class" not in effect["pipeline"]
    empty = connect(write_store(tmp_path / "empty", [CLIPS[0]]))
    assert empty.get("/api/templates").json()["stages"] == empty.get("/api/queries").json()["stages"] == []


def test_learned_queries_have_poses_and_frames_that_show_them(connect: Connect, folder: Path) -> None:
    params = "{where: class IS NOT NULL, runs: 2, population: 20, generations: 15}"
    (folder / "keys.yaml").write_text(f"name: keys\nstages:\n  learn_keyframes: {{params: {params}}}\n")
    run_pipeline(folder / "keys.yaml", folder / "store", terminal=Terminal(Console(file=io.StringIO())))
    client, store = connect(folder / "store"), open_store(folder / "store")
    found = client.get("/api/queries", params={"stage": "keys/learn_keyframes"}).json()
    assert {one["class"] for one in found["queries"]} == {"kick", "walk", "wave"}
    features = {feature.name: feature.number - 1 for feature in store.feature_set.features}
    for one in found["queries"]:
        assert model_of(read_text(one["text"], store), store) == one["query"]
        seen = one["seen"]
        words = store.words([seen["take_id"]]).take(0)
        for pose, frame in zip(one["query"]["poses"], seen["frames"], strict=True):
            assert all(int(words[frame]) >> features[name] & 1 for name in pose["on"])
            assert not any(int(words[frame]) >> features[name] & 1 for name in pose["off"])
        times = np.diff(seen["frames"]) / store.rate_hz
        assert all(gap["low"] <= time + 1e-9 for gap, time in zip(one["query"]["gaps"], times, strict=True))


def test_a_threshold_that_fits_a_class_badly_is_said_unless_it_has_its_own(connect: Connect, folder: Path) -> None:
    client = connect(folder / "store")
    own = client.post("/api/templates/effect", json=KICK).json()
    assert own["advice"] == "--set annotate.tau=calibrated"
    run(folder, "fitted", LEARNED, "{where: class IS NULL, tau: calibrated}")
    alone = "{where: class IS NOT NULL AND actor = 'ann'}"  # the setting needs clips of two actors
    run(folder, "alone", alone, f"{{where: class IS NULL, tau: {TAU}}}")
    anew = connect(folder / "store")
    for name in ("fitted", "alone"):
        found = anew.post("/api/templates/effect", json={**KICK, "stage": f"{name}/learn_templates"}).json()
        assert found["advice"] is None, name
        assert found["pipeline_tau"] == TAU or name == "fitted"


@given(st.integers(1, 6), st.data())
def test_adjusted_templates_keep_columns_and_multiply_weights(columns: int, data: st.DataObject) -> None:
    values = np.random.default_rng(columns).random((columns, 3))
    learned = data.draw(st.sampled_from([None, np.array([1.0, 2.0, 0.0])]))
    factors = np.array(data.draw(st.lists(st.sampled_from([0.0, 1.0, 2.5]), min_size=3, max_size=3)))
    first = data.draw(st.integers(0, columns - 1))
    stop = data.draw(st.integers(first + 1, columns))
    if not (factors * (1 if learned is None else learned)).any():
        return
    found = adjusted(Template(values, np.arange(columns) + 1.0, learned), factors, first, stop)
    assert found.values.tolist() == [values[k].tolist() for k in range(first, stop)]
    assert found.weights.tolist() == [k + 1.0 for k in range(first, stop)]
    weights = [1.0] * 3 if found.feature_weights is None else found.feature_weights.tolist()
    assert weights == [f * (1.0 if learned is None else w) for f, w in zip(factors, [1, 2, 0], strict=True)]


@given(
    st.lists(st.integers(0, 3), min_size=1, max_size=7),
    st.lists(st.integers(0, 3), min_size=1, max_size=3),
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), min_size=2, max_size=2),
)
def test_poses_of_a_query_are_its_first_chain(words: list[int], values: list[int], gaps: list[tuple[int, int]]) -> None:
    bounds = tuple((low, low + more) for low, more in gaps[: len(values) - 1])
    masks = tuple(value | 1 for value in values)
    chains = [
        frames
        for frames in product(range(len(words)), repeat=len(values))
        if all(words[frame] & mask == value & mask for frame, mask, value in zip(frames, masks, values, strict=True))
        and all(low <= b - a <= high for (low, high), a, b in zip(bounds, frames, frames[1:], strict=False))
    ]
    found = frames_of_poses(np.array(words, np.uint64), WordPattern(masks, tuple(values), bounds))
    assert found == (list(min(chains)) if chains else None)
