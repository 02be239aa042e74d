"""A recording as a whole: what no tracker can use is refused with file and key, and a real one is read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from kinedex.catalog.camera_recordings import load_recordings, parse_recordings
from kinedex.catalog.cameras import Camera
from kinedex.catalog.configs import parse_yaml
from kinedex.catalog.keypoint_sets import load_keypoint_set
from kinedex.ops.errors import ConfigError
from kinedex.ops.tracking.triangulation import triangulate
from kinedex.pipelines.tracking.observed_recordings import named_files
from kinedex.storage.formats.cameras.recording import Recording, read_recording
from kinedex.storage.formats.motion.positions import parse_trc
from tests.camera_files import Filmed, cameras, easymocap, filmed, opencv, openpose, save_json, toml

KEY = r"recordings.yaml:\d+: recordings.step"


def read(step: Filmed, **changed: Any) -> Recording:
    return read_recording(load_recordings(step.write(**changed)), "step")


def calibrated(step: Filmed, found: list[Camera], more: str = "") -> None:
    (step.folder / "calib.toml").write_text(toml(found, more), encoding="utf-8")


@pytest.fixture
def step(tmp_path: Path) -> Filmed:
    return filmed(tmp_path)


def test_a_good_recording_triangulates_to_the_body(step: Filmed) -> None:
    found = read(step)
    points, seen = triangulate(found.rays())
    assert points == pytest.approx(step.points, abs=1e-5)
    assert (seen == 4).all()
    assert found.notes == ("keypoints are those of coco-17",)


def test_a_calibration_may_be_a_file_for_each_camera(step: Filmed) -> None:
    for camera in step.cameras:
        path = step.folder / f"{camera.name}.yaml"
        path.write_text(yaml.safe_dump(opencv(camera)), encoding="utf-8")
    found = read(step, cameras="{camera}.yaml", rate_hz=60)
    assert [camera.name for camera in found.cameras] == [camera.name for camera in step.cameras]


@pytest.mark.parametrize("named", ["calib", "calib/intri.yml", "calib/extri.yml", "calib/*tri.yml"])
def test_a_folder_and_either_file_name_both_files_of_easymocap(step: Filmed, named: str) -> None:
    (step.folder / "calib").mkdir()
    for name, text in easymocap(step.cameras).items():
        (step.folder / "calib" / name).write_text(text, encoding="utf-8")
    found = read(step, cameras=named, unit=None)
    assert [camera.name for camera in found.cameras] == [camera.name for camera in step.cameras]
    files = named_files(load_recordings(step.folder / "recordings.yaml"), "step")
    assert {path.name for kind, path in files if kind == "cameras"} == {"intri.yml", "extri.yml"}


def test_a_folder_with_several_calibrations_is_refused(step: Filmed) -> None:
    for name in ("calib", "other"):
        (step.folder / f"{name}.toml").write_text(toml(step.cameras), encoding="utf-8")
    with pytest.raises(
        ConfigError, match=rf"{KEY}.cameras: '\*.toml' matches several files \(calib.toml, other.toml\)"
    ):
        read(step, cameras="*.toml")


def test_one_camera_is_too_few(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=f"{KEY}.cameras: one camera with observations .cam_1.: tracking needs"):
        read(filmed(tmp_path, cameras=cameras()[:1]))


def test_names_that_do_not_meet_are_in_the_refusal_of_one_camera(step: Filmed) -> None:
    for v in (2, 3, 4):
        (step.folder / "pose" / f"cam_{v}").rename(step.folder / "pose" / f"left_{v}")
    with pytest.raises(
        ConfigError, match=r"needs two or more; no keypoints of camera cam_2, cam_3, cam_4; keypoints of"
    ):
        read(step)


def test_cameras_in_one_place_are_refused(step: Filmed) -> None:
    centre = step.cameras[0].centre
    calibrated(step, [replace(camera, translation=-camera.rotation @ centre) for camera in step.cameras])
    with pytest.raises(ConfigError, match=f"{KEY}.cameras: all 4 cameras stand in one place, within"):
        read(step)


def test_an_inverted_calibration_is_refused(step: Filmed) -> None:
    calibrated(step, [replace(one, rotation=one.rotation.T, translation=one.centre) for one in step.cameras])
    with pytest.raises(ConfigError, match=f"{KEY}.cameras: the rays of most keypoints meet behind camera .*inverse"):
        read(step)


def test_a_camera_that_looks_away_is_refused(step: Filmed) -> None:
    turned = np.diag([-1.0, 1, -1])
    calibrated(step, [
        replace(one, rotation=turned @ one.rotation, translation=turned @ one.translation) for one in step.cameras
    ])  # fmt: skip
    with pytest.raises(ConfigError, match="meet behind camera"):
        read(step)


def test_keypoints_far_outside_the_image_are_refused(step: Filmed) -> None:
    calibrated(step, [replace(one, size=(320, 240)) for one in step.cameras])
    with pytest.raises(ConfigError, match=f"{KEY}.keypoints: .* of the keypoints of camera 'cam_1' lie far outside"):
        read(step)


def test_keypoints_in_shares_of_the_image_are_refused(step: Filmed) -> None:
    for v, camera in enumerate(step.cameras):
        for t, places in enumerate(step.pixels[:, v]):
            path = step.folder / "pose" / camera.name / f"{camera.name}_{t:012d}_keypoints.json"
            save_json(path, openpose([places / np.array(camera.size)]))
    with pytest.raises(ConfigError, match="they are shares of the image's size; multiply them by its width and height"):
        read(step)


def test_a_rate_of_zero_is_refused(step: Filmed) -> None:
    with pytest.raises(ConfigError, match=f"{KEY}.rate_hz: must be greater than 0, got 0"):
        read(step, rate_hz=0)


def test_frames_that_no_two_cameras_share_are_refused(step: Filmed) -> None:
    with pytest.raises(ConfigError, match=f"{KEY}.keypoints: no frame is seen by two cameras: the numbers of their"):
        read(step, offsets={"cam_1": 10, "cam_2": 20, "cam_3": 30})


@pytest.mark.parametrize(("unit", "message"), [("mm", "stand in one place"), ("cm", "`unit: m` makes it 0.48 m")])
def test_another_unit_is_refused_with_a_guess(step: Filmed, unit: str, message: str) -> None:
    with pytest.raises(ConfigError, match=f"{KEY}.*{message}"):
        read(step, unit=unit)


def test_another_axis_and_a_bad_camera_are_noted(tmp_path: Path) -> None:
    step = filmed(tmp_path)
    assert any("the body stands along" in note and "is `up:` right" in note for note in read(step, up="z").notes)
    step = filmed(tmp_path, points=np.repeat(step.points, 4, axis=0))
    moved = replace(step.cameras[2], translation=step.cameras[2].translation + 0.8)
    calibrated(step, [*step.cameras[:2], moved, step.cameras[3]])
    assert any(note.startswith("camera 'cam_3' disagrees with the others") for note in read(step).notes)


def test_keypoints_in_a_wrong_order_are_noted(step: Filmed) -> None:
    order = list(load_keypoint_set("coco-17").order)
    left, right = order.index("left_ankle"), order.index("right_wrist")
    order[left], order[right] = order[right], order[left]
    (step.folder / "own.yaml").write_text(yaml.safe_dump({"name": "own", "order": order}), encoding="utf-8")
    (note,) = [note for note in read(step, keypoint_set="own.yaml").notes if note.startswith("limbs have lengths")]
    assert "forearm 0.25 m on the left" in note
    assert note.endswith("are the keypoints those of own?")


def test_frames_without_people_and_cuts_are_normal(tmp_path: Path) -> None:
    step = filmed(tmp_path)
    save_json(tmp_path / "pose" / "cam_1" / "cam_1_000000000001_keypoints.json", {"people": []})
    found = read(step, cuts=[2])
    assert not found.confidence[1, 0].any()
    assert found.cuts == (2,)
    with pytest.raises(ConfigError, match=f"{KEY}.cuts: must lie between the frames 0 and 2, got 3"):
        read(step, cuts=[3])


def test_a_track_of_the_store_is_no_recording_by_cameras() -> None:
    with pytest.raises(ConfigError, match="is a 3D track of the store, which has no cameras"):
        read_recording(parse_recordings(parse_yaml("recordings: {a: {track: b}}", "r.yaml")), "a")


@pytest.fixture(scope="module")
def balancing(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    folder = shared / "data" / "cameras" / "balancing"
    entry = {
        "cameras": str(folder / "Calib_qualisys.toml"), "rate_hz": 60,
        "keypoints": str(folder / "S00_P00_T01_BalancingTrial" / "pose" / "{camera}_json" / "*.json"),
    }  # fmt: skip
    path = tmp_path_factory.mktemp("balancing") / "recordings.yaml"
    path.write_text(yaml.safe_dump({"recordings": {"balance_01": entry}}), encoding="utf-8")
    return read_recording(load_recordings(path), "balance_01")


def length(points: np.ndarray, names: tuple[str, ...], start: str, end: str) -> float:
    return float(np.nanmedian(np.linalg.norm(points[:, names.index(start)] - points[:, names.index(end)], axis=1)))


def test_a_real_recording_triangulates(balancing: Recording) -> None:
    assert balancing.notes == (
        "keypoints matched to cameras in natural order: cam_01 = cam01, cam_02 = cam02, cam_03 = cam03, cam_04 = cam04",
        "keypoints are those of body-25b",
        "200 images with several persons: the one whose box of keypoints is largest in the image is tracked (`person: "
        "largest`); other choices are `most_confident`, and an id, of which the files have none",
    )
    assert (balancing.frames, balancing.counts.images_with_several_persons) == (100, 200)
    points, _ = triangulate(balancing.rays())
    names = balancing.keypoints
    assert np.isfinite(points[..., 0]).mean() >= 0.99
    middles = [
        (points[:, names.index(f"left_{part}")] + points[:, names.index(f"right_{part}")]) / 2
        for part in ("hip", "shoulder")
    ]
    assert np.nanmedian(np.linalg.norm(middles[0] - middles[1], axis=1)) == pytest.approx(0.500, abs=0.002)
    assert length(points, names, "left_hip", "left_knee") == pytest.approx(0.416, abs=0.015)
    assert length(points, names, "left_knee", "left_ankle") == pytest.approx(0.418, abs=0.02)
    assert -0.05 < np.nanmin(points[..., 1]) < np.nanmax(points[..., 1]) < 1.75


def test_its_25_keypoints_are_in_the_order_of_body_25b_which_makes_both_feet_alike(balancing: Recording) -> None:
    """Read in the order of HALPE-26, the right big toe is the left heel, and the left one the small toe."""
    points, _ = triangulate(balancing.rays())
    names = balancing.keypoints
    feet = {side: length(points, names, f"{side}_ankle", f"{side}_big_toe") for side in ("left", "right")}
    assert feet["left"] == pytest.approx(feet["right"], rel=0.05)
    assert feet["left"] == pytest.approx(0.17, abs=0.01)
    assert length(points, names, "left_ankle", "left_small_toe") == pytest.approx(0.14, abs=0.005)
    assert length(points, names, "right_ankle", "left_heel") > 0.3


def test_it_agrees_with_the_triangulation_of_another_program(balancing: Recording, shared: Path) -> None:
    path = shared / "data" / "cameras" / "balancing" / "S00_P00_T01_BalancingTrial" / "pose-3d"
    found = parse_trc(path / "S00_P00_T01_BalancingTrial_0-100.trc")
    points, _ = triangulate(balancing.rays())
    distances = {}
    for name in balancing.keypoints:
        side, _, part = name.partition("_")
        theirs = f"{side[0].upper()}{part.title().replace('_', '')}"
        if side in ("left", "right") and theirs in found.names:
            off = points[:, balancing.keypoints.index(name)].T - found.positions[found.names.index(theirs)]
            distances[name] = float(np.nanmedian(np.linalg.norm(off, axis=0)))
    assert len(distances) == 18
    assert np.median(list(distances.values())) < 0.01
    assert (
        max(distances[f"{side}_{toe}"] for side in ("left", "right") for toe in ("big_toe", "small_toe", "heel")) < 0.01
    )


def test_faces_and_feet_are_where_the_keypoint_set_puts_them(balancing: Recording) -> None:
    """The neck joint lies between the shoulders, and the distances from it and from the ankles do not turn."""
    points, _ = triangulate(balancing.rays())
    places = {name: points[:, p] for p, name in enumerate(balancing.keypoints)}
    assert balancing.keypoint_set is not None
    starts = {"neck": 0.5 * (places["left_shoulder"] + places["right_shoulder"])}
    starts |= {f"{side[0]}ankle": places[f"{side}_ankle"] for side in ("left", "right")}
    for name, place in balancing.keypoint_set.positions.items():
        if place.node in starts and not place.joint:
            unit_m = 0.17 if place.bone else 1.0
            expected = unit_m * float(np.linalg.norm(place.offset))
            found = float(np.nanmedian(np.linalg.norm(places[name] - starts[place.node], axis=1)))
            assert found == pytest.approx(expected, abs=0.045), name
