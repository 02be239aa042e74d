"""The stages limb_errors and evaluate_limb_errors: errors, runs, labels and metrics of a small archive."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from typer.testing import CliRunner

from kinedex.commands.app import LEFT_OUT
from kinedex.commands.cli import app
from kinedex.ops.errors import KinedexError, SourceError
from kinedex.ops.inertial import rotations as r
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.inertial.limb_motion import limb_table, stored_limbs
from kinedex.pipelines.labels.unmatched_labels import unmatched_summary
from kinedex.pipelines.stages.calibrate_sensors import CalibrateSensors
from kinedex.pipelines.stages.evaluate_limb_errors import EvaluateLimbErrors
from kinedex.pipelines.stages.evaluate_track import EvaluateTrack
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.pipelines.stages.limb_errors import LimbErrors
from kinedex.pipelines.stages.limb_orientations import LimbOrientations
from kinedex.pipelines.stages.synchronise import Synchronise
from kinedex.storage.formats.labels.formats import read_labels
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.limb_checks import limb_error_problems
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from tests.pipelines.archives import context, write_archive
from tests.pipelines.inertial.test_synchronise_calibrate import OFFSETS, put_sensors

INPUTS = {
    "sensors": "read_imu",
    "limbs": "limb_orientations",
    "clocks": "synchronise",
    "mounts": "calibrate_sensors",
    "errors": "limb_errors",
}
TAKE, START, STOP, DEGREES = "x_al_hop_1", 300, 420, 70.0


def stage_context(folder: Path, stage: str) -> StageContext:
    return dataclasses.replace(context(folder / "store", stage), inputs=INPUTS)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store with calibrated sensors; one shank is wrong by 70° for a second, another is known by its axis alone."""
    made = tmp_path_factory.mktemp("errors")
    write_archive(made / "source", {"x_al_hop_1.amc": 1000, "x_al_hop_2.amc": 900, "x_bo_sway_1.amc": 900})
    pattern = [r"x_(?P<actor>[a-z]+)_(?P<class>[a-z]+)_\d"]
    Ingest().run(context(made / "store"), Ingest.parameters(source=str(made / "source"), patterns=pattern))
    given = LimbOrientations.parameters(limbs=["lshank", "rhand", "torso"])
    LimbOrientations().run(context(made / "store", "limb_orientations"), given)
    put_sensors(made)
    tables = []
    for found in stored_limbs(open_store(made / "store", at="newest"), "test/limb_orientations"):
        limbs = dict(found.limbs)
        if found.take == TAKE:
            turn = np.zeros((len(limbs["lshank"].times), 3))
            turn[START:STOP, 0] = np.radians(DEGREES)
            limbs["lshank"] = dataclasses.replace(
                limbs["lshank"], orientation=r.multiply(limbs["lshank"].orientation, r.exp(turn))
            )
            limbs["torso"].jump[50:60] = True
        if found.take == "x_bo_sway_1":
            shank = limbs["lshank"]
            lost = np.full_like(shank.orientation, np.nan)
            limbs["lshank"] = dataclasses.replace(shank, basis="none", orientation=lost)
        tables.append(limb_table(found.take_id, found.take, limbs, "run-2"))
    with context(made / "store").writer() as writer:
        writer.put_results("limb_orientations", iter(tables), stage="test/limb_orientations", run="run-2")
        writer.commit()
    Synchronise().run(stage_context(made, "synchronise"), Synchronise.parameters())
    CalibrateSensors().run(stage_context(made, "calibrate_sensors"), CalibrateSensors.parameters())
    return made


def limb_errors(folder: Path, **params: object) -> list[dict[str, Any]]:
    LimbErrors().run(stage_context(folder, "limb_errors"), LimbErrors.parameters(**params))
    return open_store(folder / "store", at="newest").result("limb_error_runs").to_pylist()


@pytest.fixture(scope="module")
def judged(folder: Path) -> Path:
    limb_errors(folder)
    return folder


def test_the_wrong_frames_are_a_run(judged: Path) -> None:
    store = open_store(judged / "store", at="newest")
    rows = store.sql("SELECT * FROM limb_error_runs ORDER BY kind").to_pylist()
    wrong, jump = rows
    assert (wrong["take"], wrong["limb"], wrong["kind"]) == (TAKE, "lshank", "distance")
    assert (wrong["start"], wrong["stop"], wrong["tau_deg"]) == (START, STOP, 45.0)
    assert wrong["seconds"] == pytest.approx((STOP - START) / 120)
    assert wrong["mean_deg"] == pytest.approx(DEGREES, abs=1.0)
    assert (jump["limb"], jump["kind"], jump["start"], jump["stop"]) == ("torso", "jump", 50, 60)
    assert [one for one in verify(store) if "limb_" in one.file] == []


def test_errors_are_small_elsewhere_and_divide_into_swing_and_twist(judged: Path) -> None:
    store = open_store(judged / "store", at="newest")
    rows = store.sql("SELECT * FROM limb_errors WHERE valid").to_pylist()
    assert {row["take"] for row in rows} == set(OFFSETS)
    elsewhere = [row for row in rows if row["take"] != TAKE or row["limb"] != "lshank"]
    assert max(row["degrees"] or row["swing_deg"] for row in elsewhere) < 3.0
    for row in rows[::50]:
        only_axis = row["take"] == "x_bo_sway_1" and row["limb"] == "lshank"
        assert (row["degrees"] is None) == (row["twist_deg"] is None) == only_axis
        if not only_axis:
            half = [np.radians(row[name] / 2) for name in ("degrees", "swing_deg", "twist_deg")]
            assert np.cos(half[0]) == pytest.approx(np.cos(half[1]) * np.cos(half[2]), abs=1e-6)
    assert not store.sql(
        f"SELECT * FROM limb_errors WHERE valid AND take = '{TAKE}' AND limb = 'torso' "
        "AND source_frame BETWEEN 50 AND 59"
    ).num_rows


def test_macros_find_the_wrong_limb(judged: Path) -> None:
    store = open_store(judged / "store", at="newest")
    (row,) = store.sql("SELECT * FROM limb_errors_above('lshank', 45, 0.5)").to_pylist()
    assert (row["take"], row["start"], row["stop"]) == (TAKE, START, STOP)
    assert store.sql("SELECT * FROM limb_errors_above(NULL, 45, 1.5)").num_rows == 0
    worst = store.sql("SELECT * FROM worst_limbs(2)").to_pylist()
    assert (worst[0]["take"], worst[0]["limb"]) == (TAKE, "lshank")
    assert worst[0]["wrong"] > 0.1 > worst[1]["wrong"]
    with pytest.raises(Exception, match="no limb is named lshnk; the limbs are pelvis"):
        store.sql("SELECT * FROM limb_errors_above('lshnk', 45)")


def test_tau_follows_the_errors_and_runs_follow_the_rules(folder: Path, judged: Path) -> None:
    auto = limb_errors(folder, tau="auto")
    assert {row["tau_deg"] for row in auto} == {15.0}
    assert [row for row in limb_errors(folder, min_s=2.0) if row["kind"] == "distance"] == []
    assert [row for row in limb_errors(folder, tau=80.0) if row["kind"] == "distance"] == []
    with pytest.raises(ValueError, match="low must be at most tau"):
        LimbErrors.parameters(tau=20, low=30)
    limb_errors(folder)


HEADER = "take,class,start,stop"
LABELS = f"""take,class,start,stop,limb,annotator
{TAKE},error,{START},{STOP},lshank,ann A1
{TAKE},error,{START + 60},{STOP + 60},lshank,ann A2
{TAKE},error,50,60,torso,ann A2
x_al_hop_2,,,,,
elsewhere,error,0,10,lshank,ann A1
"""


def evaluate(folder: Path, **params: object) -> dict[str, object]:
    place = dataclasses.replace(stage_context(folder, "evaluate_limb_errors"), uses="evaluate_limb_errors")
    done = EvaluateLimbErrors().run(place, EvaluateLimbErrors.parameters(**params))
    return done | unmatched_summary(place.unmatched)


def metrics(folder: Path, where: str) -> dict[str, Any]:
    store = open_store(folder / "store", at="newest")
    (row,) = store.sql(f"SELECT * FROM limb_error_metrics WHERE {where}").to_pylist()
    return row


def test_labels_are_counted_by_limb_group_and_annotator(judged: Path, tmp_path: Path) -> None:
    (tmp_path / "labels.csv").write_text(LABELS)
    done = evaluate(judged, ground_truth=str(tmp_path / "labels.csv"), printed="chapter7")
    unmatched = [{"file": str(tmp_path / "labels.csv"), "labels": 1, "of": 5, "takes": ["elsewhere"]}]
    counts = {"evaluated_takes": 2, "labels": 3, "annotators": ["ann A1", "ann A2"]}
    assert done == {**counts, "unmatched_labels": unmatched}
    one = metrics(judged, "name = 'legs' AND detector = 'sensors' AND annotator = 'ann A1' AND tau_deg = 45")
    assert (one["p1"], one["r1"], one["f2"], one["printed_p1"], one["printed_r1"]) == (1.0, 1.0, 1.0, 0.65, 0.91)
    two = metrics(judged, "name = 'lshank' AND detector = 'sensors' AND annotator = 'ann A2' AND tau_deg = 45")
    assert (two["p1"], two["r1"], two["f2"], two["printed_p1"]) == (0.5, 0.5, 1.0, None)
    both = metrics(judged, "scope = 'all' AND detector = 'sensors' AND annotator = 'all' AND tau_deg = 120")
    assert (both["frames_automatic"], both["frames_manual"], both["takes"]) == (0, 240, 2)
    # the jump of the torso is taken out of both sides
    assert metrics(judged, "name = 'trunk' AND annotator = 'ann A2' AND tau_deg = 5")["frames_manual"] == 0
    against = metrics(judged, "scope = 'all' AND detector = 'ann A1' AND annotator = 'ann A2'")
    assert (against["p1"], against["r1"], against["tau_deg"]) == (0.5, 0.5, None)
    runs = metrics(judged, "scope = 'all' AND detector = 'runs' AND annotator = 'ann A1'")
    assert (runs["p1"], runs["r1"]) == (1.0, 1.0)
    store = open_store(judged / "store", at="newest")
    assert store.sql("SELECT count(DISTINCT tau_deg) FROM limb_error_metrics").to_pylist() == [
        {"count(DISTINCT tau_deg)": 24}
    ]
    assert store.sql("SELECT * FROM limb_labels").num_rows == 3
    assert [one for one in verify(store) if "limb_" in one.file] == []


JSON = (
    '{"takes": [{"take": "x_al_hop_1", "segments": '
    '[{"class": "error", "start": 300, "stop": 420, "limb": "lshank", "annotator": "A1"}]}]}'
)
EAF = """<?xml version="1.0"?>
<ANNOTATION_DOCUMENT><HEADER TIME_UNITS="milliseconds"/>
<TIME_ORDER><TIME_SLOT TIME_SLOT_ID="a" TIME_VALUE="2500"/><TIME_SLOT TIME_SLOT_ID="b" TIME_VALUE="3500"/></TIME_ORDER>
<TIER TIER_ID="A1:lshank"><ANNOTATION><ALIGNABLE_ANNOTATION ANNOTATION_ID="x" TIME_SLOT_REF1="a" TIME_SLOT_REF2="b">
<ANNOTATION_VALUE>error</ANNOTATION_VALUE></ALIGNABLE_ANNOTATION></ANNOTATION></TIER></ANNOTATION_DOCUMENT>"""


@pytest.mark.parametrize(("name", "text"), [("l.json", JSON), (f"{TAKE}.eaf", EAF)])
def test_json_and_elan_have_places_for_limbs_and_annotators(judged: Path, tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    assert evaluate(judged, ground_truth=str(tmp_path / name), taus=[45])["annotators"] == ["A1"]
    row = metrics(judged, "name = 'lshank' AND detector = 'sensors' AND annotator = 'A1'")
    assert (row["p1"], row["r1"]) == (1.0, 1.0)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("l.csv", f"{HEADER},limb\n{TAKE},error,1,2,lshnk\n", r"l.csv:2: no limb is named 'lshnk'.*lshank"),
        ("l.csv", f"{HEADER}\n{TAKE},error,1,2\n", "l.csv:2: the label 'error' names no limb; CSV and JSON"),
        ("l.csv", f"{HEADER},limb\n{TAKE},error,1,2000,lshank\n", "l.csv:2: .*beyond x_al_hop_1, which has"),
        ("l.txt", "0\t1\terror\n", "Audacity labels has no place for the limb of a label; use CSV or JSON"),
        ("l.vtt", "WEBVTT\n", "WebVTT has no place"),
    ],
)  # fmt: skip
def test_labels_that_cannot_be_used_are_errors(
    judged: Path, tmp_path: Path, name: str, text: str, message: str
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(SourceError, match=message):
        evaluate(judged, ground_truth=str(tmp_path / name))


def test_without_labels_there_is_nothing_to_evaluate(judged: Path) -> None:
    assert evaluate(judged) == {"evaluated_takes": 0}


def test_labels_of_the_store_count_as_those_of_their_file(judged: Path, tmp_path: Path) -> None:
    shutil.copytree(judged / "store", tmp_path / "store")
    file = tmp_path / "labels.csv"
    file.write_text(LABELS)
    params, without = EvaluateLimbErrors.parameters(), open_store(tmp_path / "store")
    before = EvaluateLimbErrors().reading(params, without).digest
    by_file = evaluate(tmp_path, ground_truth=str(file))
    expected = open_store(tmp_path / "store", at="newest").result("limb_error_metrics")
    result = CliRunner().invoke(app, ["labels", "import", str(tmp_path / "store"), str(file)])
    assert result.exit_code == LEFT_OUT, result.output
    assert "1 of 5 labels matches no take: elsewhere" in result.output
    assert evaluate(tmp_path) == {name: value for name, value in by_file.items() if name != "unmatched_labels"}
    found = open_store(tmp_path / "store", at="newest")
    assert found.result("limb_error_metrics").equals(expected)
    assert EvaluateLimbErrors().reading(params, found).digest != before


def test_sensors_judge_tracked_takes(judged: Path) -> None:
    store = open_store(judged / "store", at="newest")
    take_id = store.take_ids[TAKE]
    with context(judged / "store").writer() as writer:
        row = {"run": "run-1", "take_id": take_id, "take": TAKE, "recording": "none"}
        tracks = pa.Table.from_pylist([row], schema=result_schema("tracks"))
        writer.put_results("tracks", tracks, stage="test/track", run="run-1")
        writer.commit()
    place = dataclasses.replace(stage_context(judged, "evaluate_track"), inputs={**INPUTS, "tracks": "track"})
    done = EvaluateTrack().run(place, EvaluateTrack.parameters())
    assert done["without_truth"] == [TAKE]
    store = open_store(judged / "store", at="newest")
    rows = store.sql("SELECT * FROM track_metrics ORDER BY name").to_pylist()
    assert [(row["scope"], row["name"]) for row in rows] == [
        ("sensors", "all"), ("limb", "lshank"), ("limb", "rhand"), ("limb", "torso")
    ]  # fmt: skip
    assert rows[1]["max_deg"] == pytest.approx(DEGREES, abs=1.0)
    assert (rows[1]["reference"], rows[1]["mean_mm"]) == ("sensors", None)
    assert rows[0]["frames"] == sum(row["frames"] for row in rows[1:])


def test_patterns_of_label_files_are_found_below_the_working_folder(
    judged: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "labels.csv").write_text(f"{HEADER},limb\n{TAKE},error,1,2,lshank\n")
    monkeypatch.chdir(tmp_path)
    assert evaluate(judged, ground_truth="own/*.csv", taus=[45])["labels"] == 1
    for pattern in ("other/*.csv", "**/labels.csv"):
        with pytest.raises(KinedexError, match=r"no file '.*csv' below .*limb and annotator"):
            evaluate(judged, ground_truth=pattern)


@pytest.mark.parametrize("form", ["csv", "json", "eaf"])
def test_runs_leave_the_store_as_labels_that_agree_with_them(judged: Path, tmp_path: Path, form: str) -> None:
    given = ["labels", "export", str(judged / "store"), "--limbs", "--format", form, "-o", f"{tmp_path / 'out'}/"]
    done = CliRunner().invoke(app, given)
    assert done.exit_code == 0, done.output
    assert "1 segment of 3 takes, found wrong by test/limb_errors: 3 files in" in done.output
    (one,) = read_labels(tmp_path / "out" / f"{TAKE}.{form}").segments
    assert (one.label, one.limb, one.annotator) == ("error", "lshank", "")
    assert one.source_frames(120.0) == (START, STOP)
    covered = read_labels(tmp_path / "out" / f"{TAKE}.{form}").covered
    assert sorted(covered) == [(TAKE, "rhand", ""), (TAKE, "torso", "")], "compared, and never wrong"
    summary = evaluate(judged, ground_truth=str(tmp_path / "out" / f"*.{form}"), taus=[45])
    assert (summary["evaluated_takes"], summary["labels"]) == (3, 1)
    runs = metrics(judged, "scope = 'all' AND detector = 'runs' AND annotator = 'all'")
    assert (runs["p1"], runs["r1"], runs["p2"], runs["r2"]) == (1.0, 1.0, 1.0, 1.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--format", "vtt"], "WebVTT has no place for the limb of a label 'error' (x_al_hop_1, lshank); use csv"),
        (["--take", "x_al"], "did not compare 'x_al' with sensors"),
        (["--stage", "other"], "no stage 'other' has compared limbs"),
        (["--labels"], "choose one of --labels and --limbs"),
    ],
)  # fmt: skip
def test_runs_that_cannot_be_exported_are_errors(
    judged: Path, tmp_path: Path, options: list[str], message: str
) -> None:
    given = ["labels", "export", str(judged / "store"), "--limbs", "-o", str(tmp_path / "out"), *options]
    done = CliRunner().invoke(app, given)
    assert done.exit_code in (1, 2)
    assert message in " ".join(done.output.replace("│", " ").split())
    assert not (tmp_path / "out").exists()


def changed(**values: Any) -> Callable[[dict[str, Any]], None]:
    return lambda row: row.update(values)


CONTRADICTIONS: list[tuple[str, str, Callable[[dict[str, Any]], None], str]] = [
    ("limb_errors", "limb_errors", changed(degrees=181.0), "degrees is not within 0 and 180"),
    ("limb_errors", "limb_errors", changed(valid=True, degrees=None, swing_deg=None), "counts without an error"),
    ("limb_errors", "limb_errors", changed(source_frame=1), "are not 0, 1, …"),
    ("limb_errors", "limb_errors", changed(tau_deg=-1.0), "tau_deg is not within 0 and 180"),
    ("limb_error_runs", "limb_errors", changed(kind="other"), "no such kind of run"),
    ("limb_error_runs", "limb_errors", changed(stop=5000), "is not within the frames of the limb"),
    ("limb_error_runs", "limb_errors", changed(take_id=99), "is not within the frames of the limb"),
    ("limb_error_runs", "limb_errors", changed(kind="distance", peak_deg=30.0), "its error is not above 45 degrees"),
    ("limb_error_runs", "limb_errors", changed(kind="distance", peak_deg=None), "its error is not above 45 degrees"),
    ("limb_labels", "evaluate_limb_errors", changed(stop=0), "is not before stop 0"),
    ("limb_error_metrics", "evaluate_limb_errors", changed(frames_both=10**6), "frames_both 1000000 is not within"),
    ("limb_error_metrics", "evaluate_limb_errors", changed(p1=1.5), "p1 is not within 0 and 1"),
]


def test_parts_that_contradict_themselves_are_found(judged: Path, tmp_path: Path) -> None:
    (tmp_path / "labels.csv").write_text(LABELS)
    evaluate(judged, ground_truth=str(tmp_path / "labels.csv"), taus=[45])
    shutil.copytree(judged / "store", tmp_path / "store")
    for kind, stage, change, message in CONTRADICTIONS:
        before = open_store(tmp_path / "store", at="newest").result(kind, stage=f"test/{stage}")
        rows = before.slice(0, 1).to_pylist()
        change(rows[0])
        after = pa.concat_tables([pa.Table.from_pylist(rows, schema=before.schema), before.slice(1)])
        with context(tmp_path / "store").writer() as writer:
            writer.put_results(kind, after, stage=f"test/{stage}", run="run-1")
            writer.commit()
            ((path, problem),) = limb_error_problems(writer.store)
            assert f"results/{kind}/" in path
            assert message in problem
            writer.put_results(kind, before, stage=f"test/{stage}", run="run-1")
            writer.commit()


@pytest.mark.parametrize("kind", ["limb_errors", "limb_error_runs", "limb_error_metrics", "limb_labels"])
def test_a_damaged_part_fails_verification(judged: Path, tmp_path: Path, kind: str) -> None:
    (tmp_path / "labels.csv").write_text(LABELS)
    evaluate(judged, ground_truth=str(tmp_path / "labels.csv"), taus=[45])
    shutil.copytree(judged / "store", tmp_path / "store")
    (part,) = open_store(tmp_path / "store", at="newest").manifest.results[kind]
    file = tmp_path / "store" / part.path
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 0xFF
    file.write_bytes(content)
    found = CliRunner().invoke(app, ["verify", str(tmp_path / "store")])
    assert found.exit_code == 1
    assert part.path in found.stdout + found.stderr
