"""Data sets that leave a store: what is cut out, how it is changed and divided, and how a killed export goes on."""

from __future__ import annotations

import csv
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from typer.testing import CliRunner

import kinedex
from kinedex.commands.cli import app
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.pipelines.stages.annotate import Annotate
from kinedex.pipelines.stages.index import Index
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from tests.pipelines.archives import context, write_archive
from tests.pipelines.labelled import Line

TAKES = {
    "x_al_hopLeft_1.amc": 90, "x_al_hopLeft_2.amc": 99, "x_bo_sway_1.amc": 88, "x_bo_hopLeft_3.amc": 91,
    "x_cy_sway_2.amc": 120, "x_cy_long_1.amc": 400,
}  # fmt: skip
PATTERNS = [r"x_(?P<actor>[a-z]+)_(?P<class>hopLeft|sway)_(?P<clip>\d)", r"x_(?P<actor>[a-z]+)_long_\d"]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> kinedex.Store:
    """A store of six takes of three actors, annotated and labelled."""
    folder = tmp_path_factory.mktemp("export")
    source = write_archive(folder / "source", TAKES)
    Ingest().run(context(folder / "store"), Ingest.parameters(source=str(source), patterns=PATTERNS))
    Index().run(context(folder / "store", "index"), Index.parameters())
    line = Line(folder / "store")
    line.run(LearnTemplates)
    line.run(Annotate, tau=0.5)
    opened = kinedex.open_store(folder / "store")
    rows = [{"take": "x_cy_long_1", "class": name, "start": start, "stop": start + 20} for name, start in LABELS]
    opened.labels.add(rows, annotator="ann")
    opened.labels.add([{"take": "x_cy_long_1", "class": "sway", "start": 0, "stop": 9, "verdict": "negative"}])
    return kinedex.open_store(folder / "store")


LABELS = [("hopLeft", 5), ("sway", 40), ("sway", 70)]


def content(folder: Path) -> dict[str, str]:
    """Return the checksum of every file below a folder."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def clip(folder: Path, row: dict[str, Any]) -> dict[str, np.ndarray]:
    with np.load(folder / row["file"]) as arrays:
        return dict(arrays)


# ---- what is cut out -----------------------------------------------------------------------------------------


def test_whole_takes_have_the_positions_and_words_of_the_store(store: kinedex.Store, tmp_path: Path) -> None:
    rows = store.export(tmp_path / "a", where="class = 'sway'")
    assert rows["file"].to_list() == ["clips/x_bo_sway_1.npz", "clips/x_cy_sway_2.npz"]
    for row in rows.to_dicts():
        arrays = clip(tmp_path / "a", row)
        np.testing.assert_array_equal(arrays["positions"], store.positions(row["take"]))
        np.testing.assert_array_equal(arrays["words"], store.words(row["take"]))
        assert row["sha256"] == hashlib.sha256((tmp_path / "a" / row["file"]).read_bytes()).hexdigest()
        names = arrays["smpl24_names"].tolist()
        np.testing.assert_array_equal(
            arrays["smpl24"][:, names.index("left_foot")],
            arrays["positions"][:, arrays["names"].tolist().index("ltoes")],
        )


def test_annotations_labels_and_sql_name_their_intervals(store: kinedex.Store, tmp_path: Path) -> None:
    found = store.results("annotations")
    made = store.export(tmp_path / "a", annotations=True)
    places = ["take", "start", "stop", "class"]
    assert made.select(places).sort(places).rows() == found.select(places).sort(places).rows()
    assert set(made["run"]) == set(found["run"])
    assert made["confidence"].to_list() == [round(one, 4) for one in made["confidence"]]
    assert {"height_m", "actor"} <= set(made.columns)
    assert not {"jitter_m_s3", "foot_skate_m_s", "up_axis"} & set(made.columns)
    made = store.export(tmp_path / "b", labels=True)
    assert [(row["class"], row["start"]) for row in made.to_dicts()] == LABELS
    query = "SELECT take, start, stop, class, 'x' AS note FROM labels WHERE class = 'sway' AND verdict = 'positive'"
    made = store.export(tmp_path / "c", sql=query)
    assert made.select("start", "note").rows() == [(40, "x"), (70, "x")]
    assert made["file"][0] == "clips/x_cy_long_1_00040-00060_sway.npz"


def test_a_file_of_ranges_has_frames_or_seconds_and_its_faults_have_a_line(
    store: kinedex.Store, tmp_path: Path
) -> None:
    file = tmp_path / "ranges.csv"
    file.write_text("take;start;stop;class\nx_cy_long_1;1s;1.5s;'=go\nx_cy_long_1;3;9;\n", encoding="utf-8-sig")
    made = store.export(tmp_path / "a", ranges=file)
    assert made.select("start", "stop", "class").rows() == [(3, 9, None), (30, 45, "=go")]
    with (tmp_path / "a" / "metadata.csv").open(encoding="utf-8", newline="") as text:
        assert [row["class"] for row in csv.DictReader(text)] == ["", "'=go"]
    for row, fault in (("x_cy_long_1,5,500", r":2: x_cy_long_1\[5:500\] is no"), ("nobody,1,2", ":2: .*'nobody'")):
        file.write_text(f"take,start,stop\n{row}\n")
        with pytest.raises(KinedexError, match=fault):
            store.export(tmp_path / "b", ranges=file)
    file.write_text("take,begin,stop\n")
    with pytest.raises(KinedexError, match="no column 'start'"):
        store.export(tmp_path / "b", ranges=file)


@pytest.mark.parametrize(
    ("request_", "fault"),
    [
        ({"where": "class = 'fly'"}, "the filter `class = 'fly'` selects no take"),
        ({"labels": True, "classes": ["swya"]}, "none of 3 intervals is of class swya; did you mean 'sway'"),
        ({"labels": True, "min_length": 5.0}, "none of 3 intervals lasts 5 s; the longest lasts 0.67 s"),
        ({"annotations": True, "min_confidence": 1.1}, "min_confidence must be a number from 0 to 1"),
        ({"labels": True, "min_confidence": 1.0}, "with a confidence of 1 or more"),
        ({"hits": "mine"}, "no hits were saved as 'mine'"),
        ({"takes": ["x_al_hop"]}, "no take is named 'x_al_hop'; did you mean"),
        ({"sql": "SELECT name FROM takes"}, "no column 'take'"),
        ({"labels": True, "annotations": True}, "two sources of clips"),
        ({"split": "studio"}, "takes have no column 'studio'"),
        ({"where": "actor = 'al'", "split": "actor"}, "2 clips have 1 value of it .*'al'.*3 splits need as many"),
        ({"format": "bhv"}, "no export format 'bhv'; did you mean 'bvh'"),
    ],
)
def test_a_request_that_means_nothing_says_why(
    store: kinedex.Store, tmp_path: Path, request_: dict[str, Any], fault: str
) -> None:
    with pytest.raises(KinedexError, match=fault):
        store.export(tmp_path / "a", **request_)
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("wrong", [{"margin": -1.0}, {"resample": 0.0}, {"shares": (1.0,)}, {"distinct": 0.0}])
def test_values_out_of_their_domain_are_refused(store: kinedex.Store, tmp_path: Path, wrong: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        store.export(tmp_path / "a", **wrong)


# ---- how it is changed ---------------------------------------------------------------------------------------


def test_margins_belong_to_a_clip_and_its_context_only_to_the_file(store: kinedex.Store, tmp_path: Path) -> None:
    (row, *_) = store.export(tmp_path / "a", labels=True, margin=0.1, context=0.4, resample=60.0).to_dicts()
    assert (row["start"], row["stop"], row["outer_start"], row["outer_stop"]) == (2, 28, 0, 40)
    assert (row["inner_start"], row["inner_stop"], row["frames"], row["rate_hz"]) == (4, 56, 79, 60.0)
    arrays = clip(tmp_path / "a", row)
    places = store.positions("x_cy_long_1")
    np.testing.assert_array_equal(arrays["positions"][::2], places[:40])
    np.testing.assert_allclose(arrays["positions"][1], (places[0] + places[1]) / 2, atol=1e-6)
    np.testing.assert_array_equal(arrays["words"][::2], store.words("x_cy_long_1")[:40])


def test_a_clip_in_place_begins_at_the_origin_facing_z_and_keeps_its_shape(
    store: kinedex.Store, tmp_path: Path
) -> None:
    (row, *_) = store.export(tmp_path / "a", labels=True, context=0.1, in_place=True).to_dicts()
    arrays = clip(tmp_path / "a", row)
    names, first = arrays["names"].tolist(), arrays["positions"][row["inner_start"]]
    np.testing.assert_allclose(first[names.index("root")][[0, 2]], 0.0, atol=1e-6)
    across = first[names.index("lhip")] + first[names.index("lshoulder")]
    across -= first[names.index("rhip")] + first[names.index("rshoulder")]
    assert across[0] > 0
    assert abs(across[2]) < 1e-5
    before = store.positions("x_cy_long_1")[row["outer_start"] : row["outer_stop"]]
    lengths = [np.linalg.norm(places - places[:, :1], axis=-1) for places in (before, arrays["positions"])]
    np.testing.assert_allclose(lengths[1], lengths[0], atol=1e-5)


def test_each_clip_has_a_twin_of_the_other_side(store: kinedex.Store, tmp_path: Path) -> None:
    rows = store.export(tmp_path / "a", labels=True, mirror=True).to_dicts()
    assert [row["class"] for row in rows] == ["hopLeft", "hopRight", "sway", "sway", "sway", "sway"]
    one, twin = (clip(tmp_path / "a", row) for row in rows[:2])
    left, right = (one["names"].tolist().index(name) for name in ("lwrist", "rwrist"))
    np.testing.assert_array_equal(twin["positions"][:, left] * [-1, 1, 1], one["positions"][:, right])
    np.testing.assert_array_equal(twin["words"], store.feature_set.mirrored(one["words"]))
    facts = json.loads((tmp_path / "a" / "dataset.json").read_text())
    assert facts["mirrored_classes"] == {"hopLeft": "hopRight", "sway": "sway"}


# ---- how it is divided ---------------------------------------------------------------------------------------


def test_no_actor_is_in_two_splits_and_twins_stay_together(store: kinedex.Store, tmp_path: Path) -> None:
    made = store.export(tmp_path / "a", split="actor", mirror=True, where="class IS NOT NULL")
    assert made.group_by("split").agg(pl.col("actor").n_unique())["actor"].to_list() == [1, 1, 1]
    assert made.group_by("take").agg(pl.col("split").n_unique())["split"].max() == 1
    assert sorted(path.name for path in (tmp_path / "a").iterdir() if path.is_dir()) == ["test", "train", "val"]
    facts = json.loads((tmp_path / "a" / "dataset.json").read_text())["splits"]
    assert sum(split["share"] for split in facts.values()) == pytest.approx(1, abs=1e-3)
    assert sum(split["clips"] for split in facts.values()) == 10
    longest = max(("train", "val", "test"), key=lambda name: facts[name]["seconds"])
    assert longest == "train"


def test_classes_are_balanced_and_clips_drawn_by_their_content(store: kinedex.Store, tmp_path: Path) -> None:
    made = store.export(tmp_path / "a", labels=True, balance=True)
    assert sorted(made["class"].to_list()) == ["hopLeft", "sway"]
    drawn = {store.export(tmp_path / str(seed), labels=True, balance=True, seed=seed)["start"][1] for seed in range(8)}
    assert drawn == {40, 70}
    made = store.export(tmp_path / "b", where="class IS NOT NULL", per_class=2)
    assert sorted(made["class"].to_list()) == ["hopLeft", "hopLeft", "sway", "sway"]


def test_the_same_motion_twice_is_one_clip_of_a_distinct_set(store: kinedex.Store, tmp_path: Path) -> None:
    places = "('x_cy_long_1', 10, 40), ('x_cy_long_1', 11, 41), ('x_cy_sway_2', 0, 30)"
    query = f"SELECT * FROM (VALUES {places}) AS one(take, start, stop)"
    with pytest.warns(UserWarning, match="1 near-duplicate of 3 clips"):
        made = store.export(tmp_path / "a", sql=query, distinct=0.2)
    assert made["start"].to_list() == [10, 0]


# ---- files ---------------------------------------------------------------------------------------------------


def test_the_same_request_makes_the_same_bytes_whatever_was_there_and_however_many_work(
    store: kinedex.Store, tmp_path: Path
) -> None:
    store.export(tmp_path / "a", labels=True, mirror=True)
    once = content(tmp_path / "a")
    store.export(tmp_path / "b", where="class = 'sway'", format="csv")
    (tmp_path / "b" / "notes.txt").write_text("mine")
    store.export(tmp_path / "b", labels=True, mirror=True)
    assert set(content(tmp_path / "b")) == {*once, "notes.txt"}
    assert {name: value for name, value in content(tmp_path / "b").items() if name != "notes.txt"} == once


def test_an_export_that_was_killed_goes_on_where_it_was(
    store: kinedex.Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from kinedex.pipelines.export import clip_batches

    store.export(tmp_path / "whole", labels=True)
    write, done = clip_batches.write_files, []

    def killed(*arguments: Any) -> None:
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(write(*arguments))

    monkeypatch.setattr(clip_batches, "CLIPS_A_TASK", 1)
    monkeypatch.setattr(clip_batches, "write_files", killed)
    with pytest.raises(KeyboardInterrupt):
        store.export(tmp_path / "a", takes=["x_cy_long_1", "x_bo_sway_1", "x_cy_sway_2"])
    assert not (tmp_path / "a" / "dataset.json").exists()
    counted = []
    monkeypatch.setattr(clip_batches, "write_files", lambda *arguments: counted.append(write(*arguments)))
    store.export(tmp_path / "a", takes=["x_cy_long_1", "x_bo_sway_1", "x_cy_sway_2"])
    assert len(counted) == 1
    first = tmp_path / "a" / "clips" / "x_bo_sway_1.npz"
    first.write_bytes(b"torn")
    store.export(tmp_path / "a", takes=["x_cy_long_1", "x_bo_sway_1", "x_cy_sway_2"])
    assert len(counted) == 2
    assert first.stat().st_size > 1000
    assert not [path for path in (tmp_path / "a").iterdir() if path.name.startswith(".")]


def test_a_folder_of_somebody_else_is_left_alone(store: kinedex.Store, tmp_path: Path) -> None:
    (tmp_path / "a" / "clips").mkdir(parents=True)
    (tmp_path / "a" / "clips" / "thesis.tex").write_text("years of work")
    with pytest.raises(KinedexError, match=r"no data set of kinedex \(it has 'clips'\); give a new folder"):
        store.export(tmp_path / "a")
    hostile = {"file": "clips/../../b.txt", "fingerprint": "", "sha256": ""}
    (tmp_path / "b.txt").write_text("mine")
    facts = {"format": "kinedex data set 1", "clips": [{"files": [hostile, {"file": 3}]}, "?"]}
    (tmp_path / "a" / "dataset.json").write_text(json.dumps(facts))
    store.export(tmp_path / "a", labels=True)
    assert (tmp_path / "b.txt").read_text() == "mine"
    assert (tmp_path / "a" / "clips" / "thesis.tex").read_text() == "years of work"
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "train").symlink_to(tmp_path / "a")
    (tmp_path / "c" / "dataset.json").write_text(json.dumps({"format": "kinedex data set 1", "clips": []}))
    with pytest.raises(KinedexError, match="is a link"):
        store.export(tmp_path / "c", split="actor")


def test_names_of_classes_never_leave_the_folder(store: kinedex.Store, tmp_path: Path) -> None:
    names = ["../../up", "con", "a/b", "A", "a", "=cmd|x", "x\n\x1b[2J", "é" * 200, ".."]
    file = tmp_path / "ranges.csv"
    with file.open("w", encoding="utf-8", newline="") as text:
        rows = csv.writer(text)
        rows.writerow(["take", "start", "stop", "class"])
        rows.writerows(["x_cy_long_1", 3, 9, name] for name in names)
    made = store.export(tmp_path / "out" / "a", ranges=file, mirror=True)
    files = {path.name.casefold() for path in (tmp_path / "out" / "a" / "clips").iterdir()}
    assert len(files) == made.height == 2 * len(names)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["a"]
    assert all(name.isprintable() and len(name.encode()) < 255 for name in files)
    assert set(made["class"]) == {*names}


# ---- sources, and the command --------------------------------------------------------------------------------


def test_clips_of_channels_need_their_sources_and_all_that_are_gone_are_named(
    store: kinedex.Store, tmp_path: Path
) -> None:
    source = Path(store.takes()["source_root"][0])
    request_: dict[str, Any] = {"where": "class = 'sway'", "format": "amc"}
    made = store.export(tmp_path / "a", **request_)
    assert made["from"].to_list() == ["channels"] * 2
    assert (tmp_path / "a" / "clips" / "x_bo_sway_1.asf").is_file()
    gone, changed = source / "x_bo_sway_1.amc", source / "x_cy_sway_2.amc"
    text = changed.read_bytes()
    try:
        changed.write_bytes(text + b"\n")
        with pytest.warns(UserWarning, match="x_cy_sway_2.amc.*was changed since it was ingested"):
            made = store.export(tmp_path / "b", **request_)
        assert made["take"].to_list() == ["x_bo_sway_1"]
        (left_out,) = json.loads((tmp_path / "b" / "dataset.json").read_text())["excluded"]
        assert left_out["file"] == "clips/x_cy_sway_2.amc"
        for file in (gone, changed):
            file.rename(file.with_suffix(".away"))
        with pytest.raises(KinedexError, match=r"2 source files are not there.*--joints(.|\n)*_sway_1(.|\n)*_sway_2"):
            store.export(tmp_path / "c", **request_)
        assert store.export(tmp_path / "c", where="class = 'sway'", format="bvh").height == 2
    finally:
        for file in (gone, changed):
            if file.with_suffix(".away").exists():
                file.with_suffix(".away").rename(file)
        changed.write_bytes(text)
    with pytest.raises(KinedexError, match="the form 'amc' is cut out of amc files; not of the 24"):
        store.export(tmp_path / "d", where="class = 'sway'", format="amc", joints=True)


def test_one_take_is_a_file_and_a_folder_ends_in_a_slash(
    store: kinedex.Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def export(*words: str) -> Any:
        return CliRunner().invoke(app, ["export", str(store.path), *words])

    monkeypatch.chdir(tmp_path)
    assert export("x_bo_sway_1").stdout == "x_bo_sway_1.csv\n"
    header, first, *rest = (tmp_path / "x_bo_sway_1.csv").read_text().splitlines()
    assert header.startswith('"frame","time","root_x","root_y"')
    assert len(rest) + 1 == len(store["x_bo_sway_1"])
    np.testing.assert_allclose([float(cell) for cell in first.split(",")[2:5]], store.positions("x_bo_sway_1")[0, 0])
    assert export("x_bo_sway_1", "-o", "a.npz", "--resample", "60", "--in-place").exit_code == 0
    assert clip(tmp_path, {"file": "a.npz"})["rate_hz"] == 60
    assert export("x_bo_sway_1", "-o", "a.amc").stdout.split() == ["a.amc", "a.asf"]
    assert export("x_bo_sway_1", "-o", "made/", "--format", "npz", "--workers", "1").exit_code == 0
    assert (tmp_path / "made" / "clips" / "x_bo_sway_1.npz").is_file()
    for words, fault in (
        (("x_bo_sway_1", "-o", "b.npz", "--mirror"), "--mirror makes a data set: give its folder"),
        (("--labels",), "-o is missing"),
        (("--labels", "-o", "c", "--distinct", "3"), "no length"),
        (("--labels", "-o", "c", "--shares", "a,b"), "--shares a,b: expected"),
    ):
        result = export(*words)
        assert result.exit_code != 0
        assert fault in f"{result.output}{result.exception}"


def test_saved_hits_are_cut_out(store: kinedex.Store, tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("bent:\n  keyframes:\n    - {off: [rknee_bent]}\n")
    found = CliRunner().invoke(app, ["search", str(store.path), str(file), "--save", "mine", "--json"])
    assert found.exit_code == 0, found.output
    opened = kinedex.open_store(store.path)
    hits = opened.results("hits").filter(pl.col("saved_as") == "mine")
    made = opened.export(tmp_path / "a", hits="mine")
    assert made.height == hits.height > 0
    assert set(made["class"]) == {"bent"}
    with pytest.raises(KinedexError, match="no hits were saved as 'mien'; did you mean 'mine'"):
        opened.export(tmp_path / "b", hits="mien")
