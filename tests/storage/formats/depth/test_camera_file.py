"""Files of depth cameras: written and read back to the bit, those of vendors, and what is none."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from kinedex.catalog.depth_cameras import DepthCamera
from kinedex.ops.body.axisangle import matrices
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.storage.formats.depth.camera_file import read_camera, write_camera

VALUES: dict[str, Any] = {"width": 320, "height": 288, "fx": 252.0, "fy": 252, "cx": 159.5, "cy": 143.5}
VALUES |= {"depth_unit_m": 0.001}
POSE = {"rotation": [[1, 0, 0], [0, -1, 0], [0, 0, -1]], "place": [0, 1.1, 3]}


def read(folder: Path, text: str, name: str = "camera.yaml", size: tuple[int, int] | None = None) -> DepthCamera:
    (folder / name).write_text(text, encoding="utf-8")
    return read_camera(folder / name, size)


def changed(**keys: Any) -> str:
    return yaml.safe_dump({key: value for key, value in {**VALUES, **keys}.items() if value is not None})


numbers = st.floats(-1e3, 1e3, allow_subnormal=True)


@given(
    fx=st.floats(1, 1e5), centre=st.tuples(numbers, numbers), unit=st.floats(1e-9, 1), rate=st.floats(1e-5, 1e4),
    lens=st.sampled_from([0, 4, 5, 8]).flatmap(lambda n: st.lists(numbers, min_size=n, max_size=n)),
    is_range=st.booleans(), turn=st.lists(st.floats(-3, 3), min_size=3, max_size=3), posed=st.sampled_from("pun"),
)  # fmt: skip
def test_a_camera_is_read_back_to_the_bit(
    tmp_path_factory: pytest.TempPathFactory, fx, centre, unit, rate, lens, is_range, turn, posed
) -> None:
    rotation = matrices(np.array([turn]))[0]
    pose = {"p": {"rotation": rotation, "place": np.array(turn)}, "u": {"up": rotation[1]}, "n": {}}[posed]
    matrix = np.array([[fx, 0, centre[0]], [0, fx, centre[1]], [0, 0, 1]])
    written = DepthCamera(matrix, np.array(lens), (64, 48), unit, rate, is_range, **pose)
    path = tmp_path_factory.mktemp("camera") / "camera.yaml"
    write_camera(path, written)
    found = read_camera(path)
    for key in ("matrix", "rotation", "place"):
        one, other = getattr(found, key), getattr(written, key)
        assert (one is None) == (other is None)
        assert one is None or (one == other).all()
    assert (found.up is None) == (written.up is None)
    assert found.up is None or found.up == pytest.approx(written.up, abs=1e-15)
    assert found.distortion.tolist() == (lens if any(lens) else [])
    assert (found.size, found.depth_unit_m, found.rate_hz, found.is_range) == ((64, 48), unit, rate, is_range)


def test_the_given_cameras_are_read(shared: Path) -> None:
    folder = shared / "data" / "depth"
    kinect = read_camera(folder / "kinect_upper" / "camera.yaml")
    assert (kinect.size, kinect.matrix[0, 0], kinect.rate_hz, kinect.upwards) == ((640, 480), 580.0, None, None)
    posed = read_camera(folder / "simulated" / "squat1Reps_tof" / "camera.yaml")
    assert posed.camera.centre == pytest.approx([-2.774566, 1.1, -0.054986])
    assert posed.upwards is not None
    assert posed.upwards.tolist() == [0, -1, 0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (changed(fx=None), r"camera\.yaml:\d+: fx: this key is missing"),
        (changed(fx=0), r"camera\.yaml:\d+: fx: matrix must be one with focal lengths"),
        (changed(fx=-3.0), "focal lengths"),
        (changed(width="wide"), "width: must be a valid integer"),
        (changed(heigth=3), "heigth: no such key; did you mean 'height'"),
        (changed(depth_unit_m=1.5), "depth_unit_m: must be less than or equal to 1"),
        (changed(depth_unit_m=None), "depth_unit_m: this key is missing"),
        (changed(distortion=[1.0, 2.0]), "distortion: distortion must be of 0, 4, 5 or 8 numbers"),
        (changed(up=[0, 0, 0]), "up: up must be a finite direction"),
        (changed(up=[0, -1, 0], pose=POSE), "up: up must be absent beside a pose"),
        (changed(pose={"rotation": POSE["rotation"]}), r"pose\.place: this key is missing"),
        (changed(pose=POSE | {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}), r"pose\.rotation: must be a rotation"),
        (changed(fx=float("nan")), "fx: must be"),
        ("[1, 2]", "expected a mapping"),
        ("a: [", "is not valid YAML"),
    ],
)
def test_what_is_no_camera_is_refused_with_line_and_key(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(KinedexError, match=message):
        read(tmp_path, text)


def test_a_rounded_rotation_becomes_an_exact_one(tmp_path: Path) -> None:
    exact = matrices(np.array([[0.1, 0.7, -0.3]]))[0]
    found = read(tmp_path, changed(pose=POSE | {"rotation": exact.round(4).tolist()}))
    assert found.rotation is not None
    assert found.rotation @ found.rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert found.rotation == pytest.approx(exact, abs=1e-4)


def test_a_camera_with_skew_is_not_written(tmp_path: Path) -> None:
    skewed = DepthCamera(np.array([[9.0, 1, 2], [0, 9, 2], [0, 0, 1]]), np.zeros(0), (4, 4))
    with pytest.raises(ParameterError, match="one without skew"):
        write_camera(tmp_path / "camera.yaml", skewed)
    assert not list(tmp_path.iterdir())


REALSENSE = {"width": 848, "height": 480, "ppx": 424.5, "ppy": 238.1, "fx": 421.0, "fy": 421.0, "coeffs": [0.0] * 5}
REALSENSE |= {"model": "distortion.brown_conrady"}
OPEN3D = {"width": 640, "height": 480, "depth_scale": 1000.0, "intrinsic_matrix": [600.0, 0, 0, 0, 601, 0, 320, 240, 1]}
LENS = [0.51, 0.5, 0.49, 0.492, 3.0, 2.0, 0.125, 3.5, 3.25, 0.5, 0, 0, -0.0005, 0.001, 1.7]
AZURE = {
    "CalibrationInformation": {
        "Cameras": [
            {"Location": "CALIBRATION_CameraLocationPV0"},
            {
                "Location": "CALIBRATION_CameraLocationD0",
                "Intrinsics": {
                    "ModelType": "CALIBRATION_LensDistortionModelBrownConrady",
                    "ModelParameters": LENS,
                },
            },
        ]
    }
}  # fmt: skip


def test_intrinsics_of_realsense_are_read(tmp_path: Path) -> None:
    found = read(tmp_path, json.dumps(REALSENSE | {"depth_scale": 0.00025, "fps": 30}), "camera.json")
    assert (found.size, found.depth_unit_m, found.rate_hz) == ((848, 480), 0.00025, 30)
    assert found.matrix.tolist() == [[421, 0, 424.5], [0, 421, 238.1], [0, 0, 1]]
    nested = read(tmp_path, json.dumps({"serial": "1", "intrinsics": REALSENSE}), "nested.json")
    assert (nested.matrix == found.matrix).all()


def test_intrinsics_of_open3d_are_read_by_columns_and_by_rows(tmp_path: Path) -> None:
    found = read(tmp_path, json.dumps(OPEN3D), "camera.json")
    assert found.matrix.tolist() == [[600, 0, 320], [0, 601, 240], [0, 0, 1]]
    assert found.depth_unit_m == 0.001
    rows = OPEN3D | {"intrinsic_matrix": found.matrix.tolist()}
    assert (read(tmp_path, json.dumps(rows), "rows.json").matrix == found.matrix).all()


@pytest.mark.parametrize(("size", "focal", "cx"), [((640, 576), 501.76, 329.74), ((512, 512), 250.88, 260.62)])
def test_the_calibration_of_azure_kinect_is_cut_to_the_mode_of_the_images(
    tmp_path: Path, size: tuple[int, int], focal: float, cx: float
) -> None:
    found = read(tmp_path, json.dumps(AZURE), "camera.json", size)
    assert found.matrix[0, 0] == pytest.approx(focal)
    assert found.matrix[0, 2] == pytest.approx(cx)
    assert found.distortion.tolist() == [3.0, 2.0, 0.001, -0.0005, 0.125, 3.5, 3.25, 0.5]


def test_the_text_of_tum_has_units_of_a_fifth_of_a_millimetre(tmp_path: Path) -> None:
    found = read(tmp_path, "# fx fy cx cy\n525.0 525.0 319.5 239.5\n", "camera.txt", (640, 480))
    assert (found.matrix[0, 2], found.depth_unit_m, found.size) == (319.5, 0.0002, (640, 480))
    assert len(read(tmp_path, "525 525 319.5 239.5 0.2 -0.9 0 0 1.1", "b.txt", (640, 480)).distortion) == 5


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.json", json.dumps(REALSENSE | {"fx": "wide"}), "fx: must be a finite number"),
        ("a.json", json.dumps({"width": 3, "height": 3}), "no intrinsics: expected `fx fy ppx ppy`"),
        ("a.json", json.dumps({"fx": 1, "fy": 1, "cx": 1, "cy": 1}), "states no `width` and `height`"),
        ("a.json", json.dumps(REALSENSE | {"model": "distortion.inverse_brown_conrady", "coeffs": [0.1] * 5}),
         "coeffs: the lens model 'distortion.inverse_brown_conrady' is not read"),
        ("a.json", json.dumps(REALSENSE | {"depth_scale": 0}), "depth_scale: must be above 0"),
        ("a.json", json.dumps(REALSENSE | {"width": 3.5}), "width: must be a whole number of pixels"),
        ("a.json", json.dumps(AZURE), "an Azure Kinect's depth images have 320 × 288"),
        ("a.json", json.dumps({"CalibrationInformation": {"Cameras": []}}), "no camera with the location"),
        ("a.json", "{", "is not JSON"),
        ("a.txt", "525 525 319.5", "expected fx fy cx cy, and optionally k1 k2 p1 p2 k3, got 3 numbers"),
        ("a.txt", "\nfx: 3", "a.txt:2: expected the numbers fx fy cx cy"),
        ("a.txt", "5 5 3 2", "states no size of the images"),
        ("a.bag", "", "expected the file of a depth camera ending in .yaml, .yml, .json, .txt"),
    ],
)  # fmt: skip
def test_what_is_no_camera_of_a_vendor_is_refused(tmp_path: Path, name: str, text: str, message: str) -> None:
    with pytest.raises(KinedexError, match=message):
        read(tmp_path, text, name)
