"""Lanes and curves of a take: what the store states about it, on the frames of the take."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from kinedex.explorer.curves import (
    MAX_ALIGNED,
    TemplateChoice,
    aligned_intervals,
    curve_of_template,
    nearest_hit,
    template_image,
    templates_of_take,
)
from kinedex.explorer.motion import PositionCache
from kinedex.explorer.take_lanes import (
    limb_error_curve,
    nearest_in_time,
    pose_reading,
    take_document,
    take_lanes,
    words_of_take,
)
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.ops.intervals import Interval
from kinedex.ops.templates.templates import quantise
from kinedex.ops.words import NO_WORD
from kinedex.pipelines.stages.annotate import Annotate
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.pipelines.templates.stored_templates import choose_template
from kinedex.storage.index.builder import build_index
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter
from tests.pipelines.labelled import CLIPS, Line, long_take, write_store
from tests.storage.made_up import BODY

LONG = long_take("cat_take01", "cat", "rest", "walk", "rest", "kick", "rest", "walk")
WORDS = np.concatenate([LONG["words"], np.full(7, NO_WORD), LONG["words"][:5]])  # type: ignore[list-item]
MASK = BODY.every_bit & ~0b11


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Clips and a take with annotations, labels of people, and a body that lacks the joints of two features."""
    two = [{**long_take(f"duo-{name}", "ann", "rest"), "source": "duo.c3d"} for name in ("A", "B")]
    lame = {**long_take("dan_take01", "dan", "walk", "kick"), "known": MASK}
    lame["words"] = np.asarray(lame["words"]) & np.uint64(MASK)
    path: Path = write_store(tmp_path_factory.mktemp("lanes") / "store", [*CLIPS, LONG | {"words": WORDS}, lame, *two])
    line = Line(path)
    line.run(LearnTemplates, methods=["soft"])
    line.run(Annotate, tau=0.2)
    columns = ("take", "class", "start", "stop", "verdict", "annotator", "origin")
    rows = [
        ("cat_take01", "walk", 5, 25, "positive", "eve", "drawn"),
        ("cat_take01", "kick", 3, 9, "negative", "eve", "accepted"),
        ("dan_take01", "walk", 0, 9, "positive", "eve", "drawn"),
    ]
    with StoreWriter.open(path, BODY) as writer:
        writer.put_labels(pa.Table.from_pylist([dict(zip(columns, row, strict=True)) for row in rows]))
        writer.commit()
    build_index(open_store(path))
    return open_store(path)


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """A take with rows of every kind of results that has a lane, put into the store by hand."""
    path: Path = write_store(
        tmp_path_factory.mktemp("full") / "store", [long_take("ann_1", "ann", "rest", "walk", "rest")]
    )
    at = {"take_id": 1, "take": "ann_1", "start": 4, "stop": 20, "start_seconds": 0.1, "stop_seconds": 0.5}
    limb = {**at, "limb": "lshank"}
    rows: dict[str, list[dict[str, object]]] = {
        "hits": [{**at, "saved_as": "mine", "query": "steps"}],
        "ranked_hits": [{**at, "template": "walk", "rank": 2, "cost": 0.05}],
        "ground_truth": [{**at, "class": "walk", "origin": "truth.csv"}],
        "duplicates": [{**at, "of_take_id": 7, "of_take": "bob_1", "same": "motion", "changes": "part"}],
        "limb_error_runs": [{**limb, "kind": "distance", "peak_deg": 80.0, "tau_deg": 30.0}],
        "limb_labels": [{**limb, "annotator": None}, {**limb, "annotator": "eve"}],
        "limb_errors": [
            {**limb, "source_frame": i, "t": i / 120, "degrees": float(i), "valid": i < 40, "tau_deg": 30.0}
            for i in range(60)
        ],
        "method_cells": [
            {"split": "s", "fold": "f", "method": "best", "take": "ann_1", "classes": ["walk"], "starts": [1],
             "stops": [9], "confidences": [0.25]}
        ],
    }  # fmt: skip
    with StoreWriter.open(path, BODY) as writer:
        for kind, own in rows.items():
            known = [{name: one.get(name) for name in result_schema(kind).names} for one in own]
            table = pa.Table.from_pylist(known, schema=result_schema(kind)).drop_columns(["run"])
            writer.put_results(kind, table, stage=f"p/{kind}", run="r")
        writer.commit()
    build_index(open_store(path))
    return open_store(path)


def take(store: Store, name: str = "cat_take01") -> int:
    return int(store.take_ids[name])


def test_the_document_of_a_take_has_what_its_page_needs_first(store: Store) -> None:
    found = take_document(store, take(store))
    assert (found["name"], found["frames"], found["rate_hz"]) == ("cat_take01", len(WORDS), 30.0)
    assert found["columns"]["actor"] == "cat"
    assert found["unknown"] == []
    assert take_document(store, take(store, "dan_take01"))["unknown"] == [0, 1]
    assert found["persons"] == []
    (other,) = take_document(store, take(store, "duo-A"))["persons"]
    assert (other["name"], other["take_id"]) == ("duo-B", take(store, "duo-B"))
    with pytest.raises(KinedexError, match="no take has the id 99"):
        take_document(store, 99)


def test_the_lanes_have_labels_by_verdict_annotations_by_stage_and_invalid_frames(store: Store) -> None:
    found = take_lanes(PositionCache(), store, take(store))
    lanes = {lane["id"]: lane for lane in found["lanes"]}
    assert [lane["group"] for lane in found["lanes"]] == ["labels", "labels", "annotations", "quality"]
    (label,) = lanes["labels/positive"]["segments"]
    assert (label["class"], label["start"], label["stop"], label["annotator"]) == ("walk", 5, 25, "eve")
    assert [one["class"] for one in lanes["labels/negative"]["segments"]] == ["kick"]
    (annotations,) = (lane for lane in found["lanes"] if lane["group"] == "annotations")
    assert annotations["name"] == "test"
    rows = store.sql(
        "SELECT start, stop, class, cost FROM annotations WHERE take = 'cat_take01' ORDER BY ALL"
    ).to_pylist()
    shown = [{key: one[key] for key in ("start", "stop", "class", "cost")} for one in annotations["segments"]]
    assert sorted(shown, key=lambda one: one["start"]) == rows
    assert rows
    (invalid,) = lanes["quality/invalid"]["segments"]
    assert (invalid["start"], invalid["stop"]) == (len(WORDS) - 12, len(WORDS) - 5)


def test_every_kind_of_results_has_its_lane_in_frames_of_the_analysis(full: Store) -> None:
    found = take_lanes(PositionCache(), full, 1)
    lanes = {lane["id"]: lane["segments"] for lane in found["lanes"]}
    assert lanes["ground_truth/p"] == [{"class": "walk", "start": 4, "stop": 20, "origin": "truth.csv"}]
    assert lanes["compared/s, f, best"] == [{"class": "walk", "start": 1, "stop": 9, "confidence": 0.25}]
    assert lanes["hits/mine"][0]["class"] == "steps"
    assert (lanes["hits/Ranked hits"][0]["class"], lanes["hits/Ranked hits"][0]["rank"]) == ("walk", 2)
    (copy,) = lanes["duplicates/Also in another take"]
    assert (copy["class"], copy["changes"]) == ("bob_1", "part")
    (error,) = lanes["limbs/errors/lshank"]
    assert (error["start"], error["stop"], error["class"], error["peak_deg"]) == (3, 15, "distance", 80.0)
    assert {one["class"] for one in lanes["limbs/marked/lshank"]} == {"wrong", "eve"}
    assert found["limbs"] == [{"limb": "lshank", "tau_deg": 30.0}]
    curve = limb_error_curve(full, 1, "lshank")
    assert curve[:10].tolist() == [0.0, 4.0, 8.0, 12.0, 16.0, 20.0, 24.0, 28.0, 32.0, 36.0]
    assert np.isinf(curve[12:]).all()
    with pytest.raises(ParameterError, match="limb must be a limb with errors in this take"):
        limb_error_curve(full, 1, "rshank")


def test_a_pose_reads_as_features_that_hold_do_not_hold_and_are_unknown(store: Store) -> None:
    found = pose_reading(store, take(store, "dan_take01"), 3)
    word = int(words_of_take(store, take(store, "dan_take01"))[3])
    assert found["on"] == BODY.named(word)
    assert found["unknown"] == BODY.named(0b11)
    assert sorted([*found["on"], *found["off"], *found["unknown"]]) == sorted(BODY.named(BODY.every_bit))
    blind = pose_reading(store, take(store), len(WORDS) - 7)
    assert not blind["valid"]
    assert len(blind["unknown"]) == 40
    with pytest.raises(ParameterError, match="frame must be from 0 to"):
        pose_reading(store, take(store), len(WORDS))


def test_a_curve_is_that_of_the_annotation_and_a_hit_has_its_path(store: Store) -> None:
    offered = templates_of_take(store, take(store))
    assert (offered["tau"], offered["delta"]) == (0.2, 0.05)
    assert {one["name"] for one in offered["templates"]} == {"walk", "kick", "wave"}
    assert set(offered["found"]) <= {"walk", "kick", "wave"}
    curve = curve_of_template(store, take(store), TemplateChoice("walk"))
    whole = quantise(choose_template(store, "walk").learned.template, 0.05)
    np.testing.assert_allclose(curve, distance_curves([whole], WORDS)[0], rtol=1e-6)
    hit = nearest_hit(store, take(store), TemplateChoice("walk"), 20, 0.2)
    assert hit["below"]
    assert hit["start"] <= 20 < hit["stop"]
    assert hit["cost"] == pytest.approx(curve[hit["stop"] - 1])
    assert len(hit["columns"]) == hit["stop"] - hit["start"] == len(hit["example"]["frames"])
    assert hit["example"]["take"] in {str(one["name"]) for one in CLIPS}
    image = template_image(store, TemplateChoice("walk"))
    assert (len(image["values"]), len(image["values"][0])) == (40, image["columns"])


def test_what_fits_nowhere_or_is_not_there_is_an_error(store: Store) -> None:
    with pytest.raises(KinedexError, match="no template of 'wlak'; did you mean 'walk'"):
        curve_of_template(store, take(store), TemplateChoice("wlak"))
    with pytest.raises(ParameterError, match="frame must be from 0 to"):
        nearest_hit(store, take(store), TemplateChoice("walk"), -1)


def test_two_intervals_in_step_have_the_same_words(store: Store) -> None:
    one, other = Interval("cat_take01", 0, 60), Interval("dan_take01", 0, 20)
    found = aligned_intervals(store, Interval(one.take, 5, 25), other)
    assert found["frames"][0] == 0
    assert found["frames"][-1] == 19
    assert found["frames"] == sorted(found["frames"])
    same = aligned_intervals(store, one, one)
    assert (same["cost"], same["frames"]) == (0.0, list(range(60)))
    with pytest.raises(ParameterError, match="the second interval must be 0 <= start < stop"):
        aligned_intervals(store, one, Interval(one.take, 9, 9))
    assert MAX_ALIGNED >= 1800


def test_values_nearest_in_time_leave_gaps_open() -> None:
    times, values = np.array([0.0, 0.1, 0.2, 1.0]), np.array([1.0, np.nan, 3.0, 4.0])
    found = nearest_in_time(times, values, np.array([0.02, 0.09, 0.16, 0.5, 0.98, 1.5]), 0.05)
    assert found.tolist() == [1.0, np.inf, 3.0, np.inf, 4.0, np.inf]
