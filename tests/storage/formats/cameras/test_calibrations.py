"""Calibrations of every kind are the same cameras, and what is none is refused with its key."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from kinedex.catalog.cameras import Camera
from kinedex.ops.errors import ConfigError, KinedexError
from kinedex.storage.formats.cameras.calibrations import in_metres, read_calibration
from tests.camera_files import cameras, easymocap, opencv, opencv_yaml, panoptic, toml

RING = cameras()
Z_UP = [camera.in_world(np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])) for camera in RING]
MILLIMETRES = [camera.in_world(np.eye(3), 1000.0) for camera in RING]
TEXTS = {
    "pose2sim.toml": (toml(Z_UP, "fisheye = false\n"), None, None),
    "anipose.toml": (toml(MILLIMETRES), None, "y"),
    "sections.yaml": (yaml.safe_dump({one.name: opencv(one) for one in RING}), "m", "y"),
    "list.json": (json.dumps({"cameras": [{"name": one.name, **opencv(one)} for one in RING]}), "m", "y"),
    "panoptic.json": (json.dumps(panoptic(RING)), None, None),
}


def same(found: tuple[Camera, ...], expected: list[Camera]) -> None:
    for one, other in zip(found, expected, strict=True):
        assert one.name == other.name
        assert one.size == other.size
        for part in ("matrix", "rotation", "translation", "centre"):
            assert getattr(one, part) == pytest.approx(getattr(other, part), abs=1e-9)
        points = np.random.default_rng(0).uniform(-0.5, 1.5, (5, 3))
        assert one.project(points)[0] == pytest.approx(other.project(points)[0], abs=1e-6)


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", TEXTS)
def test_every_kind_of_calibration_is_the_same_cameras(tmp_path: Path, name: str) -> None:
    text, unit, up = TEXTS[name]
    same(in_metres(read_calibration(written(tmp_path, name, text)), unit, up), RING)


def test_a_file_of_one_camera_is_called_by_its_name(tmp_path: Path) -> None:
    path = written(tmp_path, "cam_1.yml", opencv_yaml(RING[0]))
    same(in_metres(read_calibration(path), "m", "y"), RING[:1])


def test_a_matrix_of_opencv_in_json_is_read(tmp_path: Path) -> None:
    values = opencv(RING[0])
    numbers = np.ravel(values["camera_matrix"]).tolist()
    values["camera_matrix"] = {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d", "data": numbers}
    path = written(tmp_path, "cam_1.json", json.dumps(values))
    same(in_metres(read_calibration(path), "m", "y"), RING[:1])


def test_a_camera_may_have_its_centre_in_place_of_the_translation(tmp_path: Path) -> None:
    values = opencv(RING[0]) | {"centre": RING[0].centre.tolist()}
    del values["T"]
    path = written(tmp_path, "cam_1.json", json.dumps(values))
    same(in_metres(read_calibration(path), "m", "y"), RING[:1])


@pytest.mark.parametrize("up", ["x", "y", "z", "-x", "-y", "-z"])
def test_the_axis_that_points_up_becomes_y_without_mirroring(tmp_path: Path, up: str) -> None:
    path = written(tmp_path, "sections.yaml", yaml.safe_dump({one.name: opencv(one) for one in RING}))
    calibration = read_calibration(path)
    axis = np.eye(3)["xyz".index(up[-1])] * (-1 if up[0] == "-" else 1)
    pixel = calibration.cameras[0].project(2 * axis)[0]
    (camera, *_) = in_metres(calibration, "m", up)
    assert camera.project([0, 2.0, 0])[0] == pytest.approx(pixel)
    assert np.linalg.det(camera.rotation) == pytest.approx(1)


def test_what_the_kind_does_not_determine_must_be_written(tmp_path: Path) -> None:
    anipose = read_calibration(written(tmp_path, "a.toml", toml(RING)))
    with pytest.raises(ConfigError, match="of AniPose does not state which axis points up; write `up:` in"):
        in_metres(anipose, None, None)
    opencv_file = read_calibration(written(tmp_path, "a.yml", opencv_yaml(RING[0])))
    with pytest.raises(ConfigError, match=r"of OpenCV does not state its unit; write `unit:` .* m, cm, mm, in"):
        in_metres(opencv_file, None, "y")


def test_zeros_after_the_eighth_number_of_a_distortion_do_not_matter(tmp_path: Path) -> None:
    values = opencv(RING[0]) | {"dist_coeffs": [*RING[0].distortion.tolist(), *[0.0] * 10]}
    found = read_calibration(written(tmp_path, "cam_1.json", json.dumps(values))).cameras[0]
    assert found.distortion.tolist() == RING[0].distortion.tolist()


GOOD = opencv_yaml(RING[0])
BAD = {
    "rubbish.toml": ("[cam_1\nmatrix = 3", "is not valid TOML"),
    "rubbish.yaml": ("a: [1, 2", "is not valid YAML"),
    "rubbish.json": ("{", "is not JSON"),
    "other.txt": (GOOD, "expected a calibration ending in .yaml, .yml, .json, .toml"),
    "empty.yaml": ("{}", "expected cameras, each with `camera_matrix`"),
    "tag.yaml": (GOOD.replace("tvec: !!opencv-matrix", "tvec: !!python/object/apply:os.system"), ""),
    "code.yaml": ("camera_matrix: !!python/name:os.system x", "is not valid YAML"),
    "matrix.yaml": (
        GOOD.replace("cols: 3", "cols: 2", 1),
        "camera_matrix: must be 9 finite numbers, got some",
    ),
    "focal.yaml": (GOOD.replace("500.0", "0.0", 1), "focal lengths of at least 1 pixel"),
    "nan.yaml": (GOOD.replace("500.0", ".nan", 1), "camera_matrix: must be 9 finite numbers"),
    "rotation.yaml": (GOOD.replace("rvec", "other"), "camera without `rotation` or `R` or `rvec`"),
    "size.yaml": (GOOD.replace("image_height", "height_"), "camera without the size of its images; write `size:"),
    "fraction.yaml": (
        GOOD.replace("image_width: 640", "image_width: 640.5"),
        "must be width and height in whole",
    ),
    "fisheye.toml": (toml(RING, "fisheye = true\n"), "fisheye: fisheye lenses are not read; undistort images"),
    "model.yaml": (GOOD + "distortion_model: equidistant\n", "lenses of the model 'equidistant' are not read"),
    "twice.json": (json.dumps({"cameras": [opencv(RING[0]) | {"name": "a"}] * 2}), "two cameras are called 'a'"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_calibration_is_refused_with_the_reason(tmp_path: Path, name: str) -> None:
    text, message = BAD[name]
    path = written(tmp_path, name, text)
    if not message:
        assert read_calibration(path).cameras, "a tag of a mapping is no code, and is passed over"
        return
    with pytest.raises(KinedexError, match=message.replace("[", r"\[")) as caught:
        read_calibration(path)
    assert str(path) in str(caught.value)


def test_an_error_names_the_line_and_the_key(tmp_path: Path) -> None:
    text = toml(RING).replace('"cam_2"', '"cam_2"\ndistortion = [1, 2, 3]')
    with pytest.raises(ConfigError, match=r"a.toml:10: cam_2.distortion: must be 4, 5 or 8 numbers \(k1 k2 p1"):
        read_calibration(written(tmp_path, "a.toml", text))


def test_a_mirrored_rotation_is_refused(tmp_path: Path) -> None:
    values = opencv(RING[0]) | {"R": (RING[0].rotation * [1, 1, -1]).tolist()}
    with pytest.raises(ConfigError, match="R: must be a rotation, three rows of unit length at right angles"):
        read_calibration(written(tmp_path, "a.json", json.dumps(values)))


@pytest.mark.parametrize("more", [{}, {"sizes": False}, {"vectors_too": False}])
@pytest.mark.parametrize("named", ["intri.yml", "extri.yml"])
def test_the_two_files_of_easymocap_are_one_calibration_in_metres(
    tmp_path: Path, named: str, more: dict[str, bool]
) -> None:
    for name, text in easymocap(RING, **more).items():
        written(tmp_path, name, text)
    found = read_calibration(tmp_path / named, None if more.get("sizes", True) else RING[0].size)
    same(in_metres(found, None, "y"), RING)
    with pytest.raises(ConfigError, match="of EasyMocap does not state which axis points up; write `up:`"):
        in_metres(found, None, None)


def test_keys_of_easymocap_may_stand_in_one_file_and_without_names(tmp_path: Path) -> None:
    lenses, places = (text.split('cam_4"\r\n')[1] for text in easymocap(RING).values())
    same(in_metres(read_calibration(written(tmp_path, "calib.yml", lenses + places)), None, "y"), RING)


EASYMOCAP = {
    "lone": ({"extri.yml": None}, "camera 'cam_1' has no `R_cam_1` or `Rot_cam_1` in intri.yml; EasyMocap writes"),
    "unlisted": ({"intri.yml": ("K_cam_3:", "K3:")}, r"intri.yml:3: names: lists camera 'cam_3', which has"),
    "unplaced": ({"extri.yml": ("T_cam_2:", "T2:")}, "camera 'cam_2' has no `T_cam_2` in intri.yml and extri.yml"),
    "short": ({"extri.yml": ("T_cam_2: !!opencv-matrix\r\n  rows: 3", "T_cam_2: !!opencv-matrix\r\n  rows: 2")},
              r"extri.yml:\d+: T_cam_2: must be 3 finite numbers"),
    "sizes": ({"intri.yml": ("W_cam_1:", "X_cam_1:")}, "K_cam_1: camera without the size of its images; write `size"),
    "code": ({"intri.yml": ("!!opencv-matrix", "!!python/object/apply:os.system")}, ""),
}  # fmt: skip


@pytest.mark.parametrize("case", EASYMOCAP)
def test_a_fault_in_files_of_easymocap_names_the_file_and_the_key(tmp_path: Path, case: str) -> None:
    changes, message = EASYMOCAP[case]
    for name, text in easymocap(RING).items():
        change = changes.get(name, ("", ""))
        if change is not None:
            written(tmp_path, name, text.replace(*change))
    if not message:
        assert read_calibration(tmp_path / "intri.yml").cameras, "tags are never executed"
        return
    with pytest.raises(ConfigError, match=message):
        read_calibration(tmp_path / "intri.yml")


def test_numbers_with_an_exponent_and_no_point_are_numbers(tmp_path: Path) -> None:
    values = opencv(RING[0]) | {"dist_coeffs": "[1e-05, -2E+0, 0, 0]"}
    text = yaml.safe_dump(values).replace("'[1e-05, -2E+0, 0, 0]'", "[1e-05, -2E+0, 0, 0]")
    found = read_calibration(written(tmp_path, "cam_1.yml", text)).cameras[0]
    assert found.distortion.tolist()[:2] == [1e-5, -2.0]
