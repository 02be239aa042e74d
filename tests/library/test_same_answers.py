"""The Python interface gives the answers of stages and commands, to the last bit, and clear errors."""

from __future__ import annotations

import html
import pickle
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import kinedex

LONG = "class IS NULL"


def test_a_take_of_a_file_is_the_take_of_the_store(store: kinedex.Store, motion_file: Path) -> None:
    read, stored = kinedex.read(motion_file), store[motion_file.stem]
    assert np.array_equal(read.positions, stored.positions, equal_nan=True)
    assert np.array_equal(read.orientation, stored.orientation, equal_nan=True)
    assert np.array_equal(read.words(), stored.words())
    assert read.positions.dtype == stored.positions.dtype == np.float32
    assert read.positions.shape == (len(read), 24, 3)
    assert read.orientation.shape == (len(read), 4)
    shared = read.info.keys() & stored.info.keys() - {"source", "skeleton_source"}
    assert {key: read.info[key] for key in shared} == {key: stored.info[key] for key in shared}


def test_a_take_is_named_by_name_id_or_itself(store: kinedex.Store) -> None:
    take = store["SYN_al_take01"]
    assert take.take_id is not None
    for named in (take, take.name, take.take_id, np.int64(take.take_id)):
        assert np.array_equal(store.words(named), take.words())
        assert store.positions(named).shape == take.positions.shape
    assert take.name in store
    assert take.take_id in store
    assert [one.name for one in store] == store.takes()["name"].to_list()


def test_intervals_of_takes_are_takes(store: kinedex.Store) -> None:
    take = store["SYN_al_take01"]
    part = take[30:90][10:20]
    assert part.label == "SYN_al_take01[40:50]"
    assert np.array_equal(part.words(), take.words()[40:50])
    assert np.array_equal(part.positions, take.positions[40:50])
    assert np.array_equal(pickle.loads(pickle.dumps(part)).words(), part.words())
    assert len(take[5:2]) == 0


def test_features_are_the_bits_of_words(store: kinedex.Store) -> None:
    take = store["SYN_al_take01"]
    table = take.features()
    assert table.shape == (len(take), 40)
    assert set(table.dtypes) == {pl.Boolean}
    on = store.runs("rknee_bent", take=take)
    assert int((on["stop"] - on["start"]).sum()) == table["rknee_bent"].sum()


def test_invalid_frames_of_an_array_have_no_features(store: kinedex.Store) -> None:
    positions = store["SYN_al_take01"].positions[:60].copy()
    positions[20, 3] = np.nan
    table = kinedex.features(positions, rate=30)
    assert table["rknee_bent"].is_null().to_list() == [frame == 20 for frame in range(60)]
    lower = kinedex.Take.from_positions(positions[:, :9], 30, joints=store["SYN_al_take01"].joints[:9])
    assert any("these features are unknown" in warning for warning in lower.warnings)


def test_learned_templates_are_those_of_the_pipeline(store: kinedex.Store) -> None:
    for name in ("squat1Reps", "lieDown"):
        clips = [store[clip] for clip in store.takes(f"class = '{name}'")["name"]]
        for kind in ("soft", "hard"):
            learned, stored = kinedex.Template.learn(clips, kind=kind), store.template(name, kind)
            assert np.array_equal(learned.values, stored.values)
            assert np.array_equal(learned.weights, stored.weights)
            assert learned.description == stored.description


@pytest.mark.parametrize("method", ["thesis", "best"])
def test_annotations_are_those_of_the_pipeline(store: kinedex.Store, demo: Path, tmp_path: Path, method: str) -> None:
    stored = store.results("annotations", pipeline="annotate")
    names = store.templates(stage="annotate").filter(kind="soft")["subclass"].to_list()
    found = kinedex.annotate(store, names, method, classes="synthetic", where=LONG)
    takes = [store[name] for name in store.takes(LONG)["name"]]
    files = [kinedex.read(demo / "archive" / take.info["source"]) for take in takes]
    templates = [store.template(name) for name in names]
    known = store.takes()["class"].drop_nulls().unique().to_list()
    assert set(names) == set(known)
    outside = kinedex.annotate(files, templates, method, classes="synthetic")
    assert outside["take_id"].null_count() == outside.height
    assert outside.drop("take_id").equals(found.drop("take_id"))
    if method == "thesis":
        same = found.drop("take_id", "confidence")  # the pipeline calibrates confidence on the examples of the store
        assert same.equals(stored.select(same.columns))
        truth = demo / "archive" / "takes" / "ground_truth.csv"
        evaluation = kinedex.evaluate(found, truth, takes=store)
        pooled = store.results("metrics").filter(evaluation="annotate", scope="pooled")
        assert (evaluation.f_frames, evaluation.f_segments) == (pooled["f1"][0], pooled["f2"][0])


def test_ranking_by_a_file_is_ranking_by_the_stored_template(store: kinedex.Store, tmp_path: Path) -> None:
    template = store.template("squat1Reps")
    template.save(tmp_path / "squat1Reps.yaml")
    ranked = store.rank("squat1Reps", top=5)
    assert store.rank(template, top=5).equals(ranked)
    assert store.rank(kinedex.Template.load(tmp_path / "squat1Reps.yaml"), top=5).equals(ranked)
    assert store.rank(str(tmp_path / "squat1Reps.yaml"), top=5).equals(ranked)


def test_searching_a_query_in_python_is_searching_its_file(store: kinedex.Store) -> None:
    assert store.search(kinedex.Query.load_all("example")).equals(store.search("example"))


def test_the_player_and_the_tables_need_no_network_and_escape_names(store: kinedex.Store) -> None:
    take = store["SYN_al_take01"]
    odd = kinedex.Take.from_positions(take.positions[:30], 30, name="<script>alert(1)</script>")
    for text in (odd._repr_html_(), store._repr_html_(), kinedex.Query.load("example", "kick")._repr_html_()):
        assert "<script>alert" not in text
        page = html.unescape("".join(re.findall(r'srcdoc="([^"]*)"', text)))
        assert "<script>alert" not in page
        assert not re.search(r"(src|href)=[\"']?http", text + page)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda store: store["SYN_al_tak01"], "did you mean 'SYN_al_take01'"),
        (lambda store: store[10**6], "no take has the id 1000000"),
        (lambda store: store.runs("rknee_bnt"), "did you mean 'rknee_bent'"),
        (lambda store: store.template("squat1Rep"), "did you mean 'squat1Reps'"),
        (lambda store: kinedex.read("missing.bvh"), "no such file"),
        (lambda store: kinedex.features(np.zeros((3, 24, 3)), 0), "rate must be from 1 to 10000"),
        (lambda store: kinedex.features(np.zeros((24, 3)), 30), r"of shape \(frames, 24, 3\)"),
        (lambda store: kinedex.Template.learn([]), "no clip to learn from"),
        (lambda store: kinedex.Template.from_clip(store["SYN_al_take01"], 0, 10**6), "expected 0 <= START < STOP"),
        (lambda store: kinedex.annotate(store["SYN_al_take01"], "squat1Reps"), "only a store knows"),
        (lambda store: kinedex.annotate([], store.template("squat1Reps")), "no take to annotate"),
        (lambda store: kinedex.evaluate(pl.DataFrame({"take": []}), pl.DataFrame()), "must have a column 'class'"),
        (lambda store: kinedex.run_pipeline("annotate", store, {"tauu": 1}), "has no setting of that name"),
        (lambda store: store["SYN_al_take01"][::2], "a slice with step 1"),
    ],
)
def test_errors_name_the_way_out(store: kinedex.Store, call: Callable[[kinedex.Store], object], message: str) -> None:
    with pytest.raises(kinedex.KinedexError, match=message):
        call(store)
