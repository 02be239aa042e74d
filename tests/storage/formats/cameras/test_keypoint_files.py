"""Keypoints of every form are the same arrays; persons, confidences and frames are what files say."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from kinedex.catalog.camera_recordings import load_recordings
from kinedex.catalog.keypoint_sets import load_keypoint_set
from kinedex.ops.errors import KinedexError, SourceError
from kinedex.storage.formats.cameras.file_patterns import find_files, match_cameras, natural_key
from kinedex.storage.formats.cameras.keypoint_tables import read_keypoint_table
from kinedex.storage.formats.cameras.openpose import read_coco_results, read_mmpose, read_openpose
from kinedex.storage.formats.cameras.recording import Recording, read_recording
from tests.camera_files import Filmed, filmed, mmpose, openpose, save_json

COCO = load_keypoint_set("coco-17").order


@pytest.fixture
def step(tmp_path: Path) -> Filmed:
    return filmed(tmp_path)


def read(step: Filmed, **changed: Any) -> Recording:
    return read_recording(load_recordings(step.write(**changed)), "step")


def rows(step: Filmed, **more: Any) -> pl.DataFrame:
    frames, views, points, _ = step.pixels.shape
    frame, view, point = (index.ravel() for index in np.indices((frames, views, points)))
    return pl.DataFrame({
        "camera": np.array([camera.name for camera in step.cameras])[view], "frame": frame,
        "keypoint": np.array(COCO)[point], "x": step.pixels[..., 0].ravel(), "y": step.pixels[..., 1].ravel(),
        "confidence": 0.9, **more,
    })  # fmt: skip


def coco_results(step: Filmed, v: int, image: str) -> list[dict[str, Any]]:
    return [
        {"image_id": image.format(t) if image else t, "category_id": 1, "score": 0.9, "id": t,
         "keypoints": np.append(places, np.full((17, 1), 0.9), axis=1).ravel().tolist()}
        for t, places in enumerate(step.pixels[:, v])
    ]  # fmt: skip


def same(found: Recording, step: Filmed) -> None:
    assert found.keypoints == COCO
    assert found.pixels == pytest.approx(step.pixels, abs=1e-3)
    assert found.confidence == pytest.approx(np.full(found.confidence.shape, 0.9))
    assert [camera.name for camera in found.cameras] == [camera.name for camera in step.cameras]
    assert found.rate_hz == 30


@pytest.mark.parametrize(
    "form",
    [
        "openpose",
        "folder",
        "coco",
        "coco names",
        "mmpose",
        "mmpose list",
        "mmpose images",
        "csv",
        "semicolons",
        "parquet",
        "numbers",
    ],
)
def test_every_form_of_keypoints_is_the_same_recording(step: Filmed, form: str) -> None:
    table = rows(step)
    path = "points.csv"
    match form:
        case "openpose" | "folder":
            path = "pose/{camera}/*.json" if form == "openpose" else "pose/{camera}"
        case "coco" | "coco names":
            path = "results_{camera}.json"
            for v, camera in enumerate(step.cameras):
                results = coco_results(step, v, "" if form == "coco" else "cam3/frame_{}.jpg")
                save_json(step.folder / f"results_{camera.name}.json", results)
        case "mmpose" | "mmpose list":
            path = "{camera}.json"
            for v, camera in enumerate(step.cameras):
                frames = [
                    {"frame_id": t + 1, "instances": mmpose([places])} for t, places in enumerate(step.pixels[:, v])
                ]
                names = {"keypoint_id2name": dict(enumerate(COCO))}
                content = frames if "list" in form else {"meta_info": names, "instance_info": frames}
                save_json(step.folder / f"{camera.name}.json", content)
        case "mmpose images":
            path = "images/{camera}"
            for v, camera in enumerate(step.cameras):
                for t, places in enumerate(step.pixels[:, v]):
                    save_json(step.folder / "images" / camera.name / f"{t + 1:05d}.json", mmpose([places]))
                save_json(step.folder / "images" / camera.name / "00000.json", [])
        case "csv":
            table.write_csv(step.folder / path)
        case "semicolons":
            text = table.write_csv(separator=";").replace(".", ",")
            (step.folder / path).write_text(text, encoding="utf-8-sig")
        case "parquet" | "numbers":
            path = "points.parquet"
            if form == "numbers":
                table = table.with_columns(pl.col("keypoint").replace_strict({n: i for i, n in enumerate(COCO)}))
            table.with_columns(pl.col("camera").cast(pl.Categorical)).write_parquet(step.folder / path)
    found = read(step, keypoints=path)
    if form == "mmpose images":  # nobody in the first one
        assert (found.frames, found.counts.images_without_person) == (4, 4)
        found = replace(found, pixels=found.pixels[1:], confidence=found.confidence[1:])
    same(found, step)


def test_files_of_mmpose_name_their_keypoints_or_have_as_many_as_a_set(step: Filmed) -> None:
    wide = np.concatenate([step.pixels, np.full((*step.pixels.shape[:2], 116, 2), 100.0)], axis=2)
    for v, camera in enumerate(step.cameras):
        frames = [{"frame_id": t, "instances": mmpose([one])} for t, one in enumerate(wide[:, v])]
        save_json(step.folder / f"{camera.name}.json", {"meta_info": {}, "instance_info": frames})
    whole = read(step, keypoints="{camera}.json")
    assert whole.keypoint_set is not None
    assert whole.keypoint_set.name == "coco-133"
    assert whole.keypoints[:17] == COCO
    assert len(whole.keypoints) == 23
    assert any("face-25 and 84 more" in note for note in whole.notes)
    named = ["hip", *COCO[1:]]
    for v, camera in enumerate(step.cameras):
        frames = [{"instances": mmpose([one])} for one in step.pixels[:, v]]
        names = {"keypoint_id2name": dict(enumerate(named))}
        save_json(step.folder / f"{camera.name}.json", {"meta_info": names, "instance_info": frames})
    assert read(step, keypoints="{camera}.json").keypoints == ("mid_hip", *COCO[1:])


def test_what_is_wrong_in_a_file_of_mmpose_is_refused_with_its_place(tmp_path: Path) -> None:
    one = mmpose([np.ones((17, 2))])[0]
    for content, message in (
        ({"instance_info": 3}, "expected keypoints of MMPose"),
        ([{"frame_id": 0.5, "instances": []}], "frame 0: `frame_id` must be a whole number of at least 0, got 0.5"),
        (
            [{"frame_id": 1, "instances": [one]}, {"frame_id": 1, "instances": []}],
            "frame 1: a second frame has the number",
        ),
        ([{"instances": [{**one, "keypoint_scores": [1.0]}]}], "instance 0: `keypoint_scores` must be a list of 17"),
        ([{"instances": [{**one, "keypoints": [[1.0, 2.0, 3.0]] * 17}]}], "3D: ingest the file as motion instead"),
        ([{"instances": [{"keypoints": [[1.0, "x"]]}]}], "frame 0, instance 0: expected numbers"),
        ([{"instances": [one, mmpose([np.ones((3, 2))])[0]]}], "persons or names of 3 and 17 keypoints"),
        ([one], "expected the number of the frame at the end of the name"),
    ):
        path = save_json(tmp_path / "cam.json", content)
        with pytest.raises(SourceError, match=message):
            read_mmpose([path])
    several = [save_json(tmp_path / f"{t}.json", [{"frame_id": t, "instances": [one]}]) for t in range(2)]
    with pytest.raises(SourceError, match="the frames of a video, and must be the one file of a camera; there are 2"):
        read_mmpose(several)


def test_a_table_of_several_recordings_gives_the_rows_of_one(step: Filmed) -> None:
    other = rows(step).with_columns(pl.col("x") + 5, pl.lit("other").alias("recording"))
    pl.concat([other, rows(step).with_columns(pl.lit("step").alias("recording"))]).write_csv(step.folder / "a.csv")
    same(read(step, keypoints="a.csv"), step)


def test_missing_keypoints_and_confidences_are_normal_and_counted(step: Filmed) -> None:
    table = rows(step).with_columns(
        pl.when(pl.col("keypoint") == "nose").then(None).otherwise(pl.col("x")).alias("x"),
        pl.when(pl.col("keypoint") == "left_knee").then(None).when(pl.col("keypoint") == "left_hip").then(1.4)
        .otherwise(pl.col("confidence")).alias("confidence"),
    )  # fmt: skip
    table = table.filter(~((pl.col("camera") == "cam_2") & (pl.col("frame") == 1)))  # nobody in this image
    table.write_csv(step.folder / "a.csv")
    found = read(step, keypoints="a.csv")
    nose, knee, hip = (found.keypoints.index(name) for name in ("nose", "left_knee", "left_hip"))
    assert np.isnan(found.pixels[:, :, nose]).all()
    assert not found.confidence[:, :, nose].any()
    assert (found.confidence[0, :, [knee, hip]] == 1).all()
    assert not found.confidence[1, 1].any()
    counts = found.counts
    assert (counts.keypoints_without_confidence, counts.confidences_above_one) == (11, 11)
    assert counts.images_without_person == 1
    rays = found.rays()
    assert np.isfinite(rays.directions).all()


def test_of_several_persons_the_one_that_is_asked_for_is_tracked(step: Filmed) -> None:
    small = step.pixels[0, 0] * 0.2 + 250
    people = openpose([small], 0.99)["people"] + openpose([step.pixels[0, 0]], 0.5)["people"]
    for one, called in zip(people, ([7], [3]), strict=True):
        one["person_id"] = called
    save_json(step.folder / "pose" / "cam_1" / "cam_1_000000000000_keypoints.json", {"people": people})
    found = {person: read(step, person=person) for person in ("largest", "most_confident")}
    assert found["largest"].pixels == pytest.approx(step.pixels, abs=1e-3)
    assert found["most_confident"].pixels[0, 0] == pytest.approx(small)
    assert found["largest"].counts.images_with_several_persons == 1
    assert found["largest"].notes[-1] == (
        "1 image with several persons: the one whose box of keypoints is largest in the image is tracked (`person: "
        "largest`); other choices are `most_confident`, and an id (3, 7)"
    )
    assert (
        "whose confidences have the greatest sum is tracked (`person: most_confident`)"
        in (found["most_confident"].notes[-1])
    )
    with pytest.raises(SourceError, match=r"no person has the id '3'; its persons have no ids; `person:` may also be"):
        read(step, person=3)
    (camera,) = [read_openpose(sorted((step.folder / "pose" / "cam_1").iterdir()))]
    assert [one.called for one in camera.frames[0]] == ["7", "3"]


def test_frames_meet_by_their_numbers_and_offsets(step: Filmed) -> None:
    for path in sorted((step.folder / "pose" / "cam_2").iterdir(), reverse=True):
        number = int(path.stem.split("_")[2])
        path.rename(path.with_name(f"cam_2_{number + 40:012d}_keypoints.json"))
    same(read(step, offsets={"cam_2": 40}), step)
    found = read(step)
    assert (found.frames, found.first_frame) == (43, 0)
    with pytest.raises(KinedexError, match="offsets: no camera is called 'cam_9'; did you mean 'cam_4'"):
        read(step, offsets={"cam_9": 40})


def test_keypoints_without_a_place_are_not_used_and_noted(step: Filmed) -> None:
    extra = rows(step).with_columns(pl.lit("left_pinky").alias("keypoint")).unique(["camera", "frame"])
    pl.concat([rows(step), extra]).write_csv(step.folder / "a.csv")
    found = read(step, keypoints="a.csv")
    assert "left_pinky" not in found.keypoints
    assert any("not used" in note and "left_pinky" in note for note in found.notes)


def test_names_are_matched_or_else_the_natural_order(tmp_path: Path) -> None:
    assert sorted(["cam10", "cam2", "Cam1"], key=natural_key) == ["Cam1", "cam2", "cam10"]
    pairs, note = match_cameras(tmp_path, "keypoints", ["a2", "a10"], {}, ["left", "right"])
    assert pairs == {"a2": "left", "a10": "right"}
    assert note == "keypoints matched to cameras in natural order: a2 = left, a10 = right"
    pairs, note = match_cameras(tmp_path, "keypoints", ["a", "b"], {"front": "b"}, ["front", "x"])
    assert pairs == {"b": "front"}
    assert "no keypoints of camera a" in note
    assert "of x, which the calibration does not have" in note
    with pytest.raises(
        SourceError, match="stands for x, y, z in the files of the keypoints, and the calibration has a, b"
    ):
        match_cameras(tmp_path, "keypoints", ["a", "b"], {}, ["x", "y", "z"])


def test_patterns_stay_in_their_folder(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for name in ("in/a[1].json", "in/b.json", "out.json", "in/.hidden.json"):
        (tmp_path / name).write_text("{}", encoding="utf-8")
    assert list(find_files(tmp_path / "in", "{camera}.json").files) == ["a[1]", "b"]
    assert list(find_files(tmp_path / "in", str(tmp_path / "{camera}.json")).files) == ["out"]
    for pattern in ("../out.json", "in/../../x", "**/a.json", "x/*.json"):
        with pytest.raises(SourceError, match=r"must be a path below this folder|no file matches"):
            find_files(tmp_path / "in", pattern)


def test_the_same_placeholder_stands_for_the_same_name(tmp_path: Path) -> None:
    for name in ("a/a_1.json", "a/b_1.json", "b/b_1.json"):
        save_json(tmp_path / name, {})
    found = find_files(tmp_path, "{camera}/{camera}_*.json").files
    assert {key: [path.name for path in paths] for key, paths in found.items()} == {
        "a": ["a_1.json"],
        "b": ["b_1.json"],
    }


BAD_TABLES = {
    "frame,keypoint,x\n0,nose,1\n": "has no column `y`; expected camera, frame, keypoint, x, y, confidence",
    "frame,keypoint,x,y\n": "has no rows",
    "frame,keypoint,x,y\n0,nose,1,1\n1.5,nose,1,1\n": "3: `frame` must be a whole number, got '1.5'",
    "frame,keypoint,x,y\n0,nose,1,1\n1,nose,one,1\n": "3: `x` must be a number, got 'one'",
    "frame,keypoint,x,y\n0,nose,1,1e9\n": "2: expected pixels within 1e.06",
    "frame,keypoint,x,y\n0,,1,1\n": "2: `keypoint` must not be empty",
    "frame,keypoint,x,y\n0,-3,1,1\n": "2: `keypoint` must be 0 to 999, or a name",
    "frame,keypoint,x,y\n0,nose,1,1\n0,nose,2,2\n": "3: this keypoint stands twice in its frame; persons of one frame",
}


@pytest.mark.parametrize("text", BAD_TABLES)
def test_a_wrong_table_is_refused_with_its_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SourceError, match=BAD_TABLES[text]):
        read_keypoint_table(path)
    if "1.5" in text:
        pl.read_csv(io.BytesIO(text.encode())).write_parquet(tmp_path / "a.parquet")
        with pytest.raises(SourceError, match=r"a.parquet: row 1: `frame` must be a whole number"):
            read_keypoint_table(tmp_path / "a.parquet")


BAD_JSON: list[tuple[Any, str]] = [
    ([], "expected a JSON object of OpenPose"),
    ({"people": [3]}, "person 0: expected an object with `pose_keypoints_2d`"),
    (
        {"people": [{"pose_keypoints_2d": [1, 2]}]},
        "expected a list of x, y and confidence of each .*, got 2 values",
    ),
    ({"people": [{"pose_keypoints_2d": [1, 2, "x"]}]}, "expected numbers, got 'x'"),
    ({"people": [{"pose_keypoints_2d": [1e9, 2, 1]}]}, "expected pixels within"),
    ({"people": [{"pose_keypoints_2d": []}] * 1001}, "has 1001 persons, and 1000 are read at most"),
]


@pytest.mark.parametrize(("content", "message"), BAD_JSON)
def test_a_wrong_file_of_openpose_is_refused(tmp_path: Path, content: Any, message: str) -> None:
    path = save_json(tmp_path / "a_1.json", content)
    with pytest.raises(SourceError, match=message):
        read_openpose([path])


def test_wrong_coco_results_are_refused_with_the_entry(tmp_path: Path) -> None:
    good = {"image_id": 1, "keypoints": [1, 2, 0.5] * 17}
    for content, message in (
        ({"a": 1}, "expected COCO results"),
        ([good, {"keypoints": []}], "entry 1: expected an object with `image_id`"),
        ([good, good | {"image_id": "x.jpg"}], "entry 1: `image_id` must be a frame's number"),
        ([good, good | {"keypoints": [1, 2, 3] * 16}], "entry 1: has 16 keypoints, and the entries before it 17"),
    ):
        with pytest.raises(SourceError, match=message):
            read_coco_results(save_json(tmp_path / "a.json", content))


def test_frames_need_numbers_that_differ(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="expected the number of the frame at the end of the name"):
        read_openpose([save_json(tmp_path / "a.json", {"people": []})])
    paths = [save_json(tmp_path / name, {"people": []}) for name in ("a_1.json", "b_01.json")]
    with pytest.raises(SourceError, match=r"has the frame number 1, as a_1.json has"):
        read_openpose(paths)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"keypoint_set": "halpe-26"}, "has 17 keypoints of a person, and the set 'halpe-26' 26"),
        (
            {"keypoint_set": "coco"},
            r"recordings.step.keypoint_set: no keypoint set is called that; did you mean",
        ),
        ({"keypoint_set": "own.yaml"}, r"own.yaml: no such file; expected a keypoint set"),
        ({"keypoints": "calib.toml"}, "expected keypoints ending in .json, .csv or .parquet"),
        ({"keypoints": "pose/cam_1/*.json"}, "keypoints in JSON need {camera} in their path"),
        ({"keypoints": "pos/{camera}/*.json"}, "keypoints: no file matches 'pos/{camera}/\\*.json'"),
    ],
)
def test_wrong_keys_are_refused(step: Filmed, changed: dict[str, Any], message: str) -> None:
    with pytest.raises(KinedexError, match=message):
        read(step, **changed)
