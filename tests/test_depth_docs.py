"""The page of depth recordings: its examples are read, and its tables are complete."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from kinedex.catalog.configs import parse_yaml
from kinedex.catalog.depth_recordings import DepthEntry, parse_depth_recordings
from kinedex.storage.formats.depth.camera_file import CameraValues, parse_camera, read_camera
from kinedex.storage.formats.depth.frame_files import CONVERTERS
from kinedex.storage.formats.depth.npz import npz_values

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "depth-recordings.md").read_text(encoding="utf-8")
RECORDINGS, CAMERAS = PAGE.split("\n## Cameras\n")


def example(language: str, nth: int = 0) -> str:
    """Return the n-th example of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)[nth]


def keys(text: str) -> set[str]:
    """Return the keys that the rows of tables begin with."""
    return {
        key for row in re.findall(r"^\| ((?:`\w+`(?:, )?)+) \|", text, re.MULTILINE) for key in re.findall(r"\w+", row)
    }


def test_the_file_of_recordings_is_one_and_every_key_is_explained() -> None:
    found = parse_depth_recordings(parse_yaml(example("yaml"), "recordings.yaml")).recordings
    assert list(found) == ["kick", "squat", "desk", "lab"]
    assert keys(RECORDINGS) == set(DepthEntry.model_fields)
    assert {key for entry in found.values() for key in entry.model_fields_set} == set(DepthEntry.model_fields)


def test_the_camera_is_one_and_every_key_is_explained() -> None:
    found = parse_camera(parse_yaml(example("yaml", 1), "camera.yaml"))
    assert (found.size, found.is_range, found.rate_hz) == ((320, 288), True, 30)
    assert keys(CAMERAS) == set(CameraValues.model_fields)


def test_cameras_of_others_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(example("json"))
    assert read_camera(tmp_path / "a.json").matrix[0, 2] == 423.9
    (tmp_path / "a.txt").write_text(example("text"))
    assert read_camera(tmp_path / "a.txt", (640, 480)).depth_unit_m == 0.0002


def test_the_npz_is_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    exec(example("python"), {})
    values = npz_values(tmp_path / "squat.npz")
    assert (values.size, values.rate_hz) == ((320, 288), 30)


def test_every_recording_that_is_refused_has_its_command() -> None:
    rows = [line for line in PAGE.splitlines() if line.startswith("| `.")]
    for ending, command in CONVERTERS.items():
        assert any(f"`{ending}`" in row for row in rows), ending
        for quoted in re.findall(r"`([^`]{12,})`", command):
            assert quoted in PAGE, quoted
