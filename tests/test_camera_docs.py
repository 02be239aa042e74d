"""The page of camera recordings: its examples are read, and its tables are complete."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from kinedex.catalog.camera_recordings import CameraRecording, parse_recordings
from kinedex.catalog.configs import config_names, parse_yaml
from kinedex.catalog.keypoint_sets import load_keypoint_set, parse_keypoint_set
from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.storage.formats.cameras.calibrations import in_metres, read_calibration
from kinedex.storage.formats.cameras.keypoint_tables import read_keypoint_table

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "camera-recordings.md").read_text(encoding="utf-8")


def example(language: str, nth: int = 0) -> str:
    """Return the n-th example of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)[nth]


def test_the_file_of_recordings_is_one_and_every_key_is_explained() -> None:
    found = parse_recordings(parse_yaml(example("yaml"), "recordings.yaml")).recordings
    assert list(found) == ["balance_01", "kick_02", "bad_track"]
    rows = set(re.findall(r"^\| `(\w+)` \|", PAGE, re.MULTILINE))
    assert rows == set(CameraRecording.model_fields)


def test_the_calibrations_are_one_camera(tmp_path: Path) -> None:
    found = []
    for name, text in (("cam_01.yml", example("text")), ("calib.toml", example("toml"))):
        (tmp_path / name).write_text(text, encoding="utf-8")
        (camera,) = in_metres(read_calibration(tmp_path / name), "m", "z")
        found.append(camera)
    assert found[0].name == found[1].name == "cam_01"
    assert found[0].centre == pytest.approx(found[1].centre)
    assert found[0].project([0, 1.0, 0])[0] == pytest.approx(found[1].project([0, 1.0, 0])[0], abs=1e-6)


def test_the_table_is_one(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(example("text", 1), encoding="utf-8")
    assert read_keypoint_table(tmp_path / "a.csv")["cam_01"].names == ("left_knee", "right_knee")


def test_the_keypoint_set_is_one_and_all_shipped_ones_are_named() -> None:
    found = parse_keypoint_set(parse_yaml(example("yaml", 1), "own.yaml"), load_kinematic_chain())
    assert list(found.positions) == list(found.order)
    assert all(f"`{name}`" in PAGE for name in config_names("keypoints") if load_keypoint_set(name).by_count)
