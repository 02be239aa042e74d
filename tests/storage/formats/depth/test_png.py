"""Depth images in PNG: written to the same bytes, read to the same depths, and refused where depth is lost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image

from kinedex.catalog.depth_cameras import DepthCamera
from kinedex.ops.errors import ParameterError, SourceError
from kinedex.storage.formats.depth.camera_file import read_camera
from kinedex.storage.formats.depth.png import frame_number, image_size, read_depth_png, read_png, write_depth_png


def camera(size: tuple[int, int], unit_m: float = 0.001) -> DepthCamera:
    return DepthCamera(np.array([[100.0, 0, 2], [0, 100.0, 2], [0, 0, 1]]), np.zeros(0), size, unit_m)


@given(arrays.arrays(np.uint16, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.integers(0, 65534)))
def test_every_value_but_the_largest_is_read_as_written(tmp_path_factory: pytest.TempPathFactory, units) -> None:
    path = tmp_path_factory.mktemp("png") / "0.png"
    write_depth_png(path, units * 0.0002, 0.0002)
    assert (read_png(path, units.shape[::-1]) == units).all()
    depths = read_depth_png(path, camera(units.shape[::-1], 0.0002))
    assert depths == pytest.approx(units * 0.0002, rel=1e-6)
    first = path.read_bytes()
    write_depth_png(path, depths, 0.0002)
    assert path.read_bytes() == first


def test_what_was_not_measured_is_0_and_what_is_too_far_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "0.png"
    write_depth_png(path, np.array([[np.nan, -1, 1.2346]]))
    assert read_png(path, (3, 1)).tolist() == [[0, 0, 1235]]
    with pytest.raises(ParameterError, match=r"depths must be at most 65\.534 m in units of 0\.001 m, got 70"):
        write_depth_png(path, [[70.0]])
    with pytest.raises(ParameterError, match="depths must be of shape"):
        write_depth_png(path, [1.0])
    assert [one.name for one in tmp_path.iterdir()] == ["0.png"]


def test_given_images_are_read_and_written_to_the_same_values(shared: Path, tmp_path: Path) -> None:
    folder = shared / "data" / "depth" / "simulated" / "kickLFront1Reps_tof"
    given_camera = read_camera(folder / "camera.yaml")
    assert image_size(folder / "depth" / "000020.png") == given_camera.size == (320, 288)
    depths = read_depth_png(folder / "depth" / "000020.png", given_camera)
    assert depths.dtype == np.float32
    write_depth_png(tmp_path / "0.png", depths)
    assert (read_depth_png(tmp_path / "0.png", given_camera) == depths).all()


@pytest.mark.parametrize(
    ("mode", "message"), [("L", "got 8 bits a pixel"), ("RGB", "got colours"), ("P", "8 bits"), ("RGBA", "colours")]
)
def test_pictures_of_depth_are_refused(tmp_path: Path, mode: str, message: str) -> None:
    Image.fromarray(np.zeros((4, 4), np.uint8)).convert(mode).save(tmp_path / "0.png")
    with pytest.raises(SourceError, match=message):
        read_depth_png(tmp_path / "0.png", camera((4, 4)))


@pytest.mark.parametrize(
    ("size", "message"),
    [((8, 8), "with the images scaled by 0.5"), ((3, 4), "exchange width and height"), ((5, 4), "one recording")],
)
def test_images_of_another_size_are_refused_with_the_likely_reason(
    tmp_path: Path, size: tuple[int, int], message: str
) -> None:
    write_depth_png(tmp_path / "0.png", np.ones((4, 4)) if size != (3, 4) else np.ones((3, 4)))
    with pytest.raises(SourceError, match=message):
        read_depth_png(tmp_path / "0.png", camera(size))


def test_broken_and_missing_images_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "0.png"
    write_depth_png(path, np.random.default_rng(0).uniform(1, 2, (40, 40)))
    whole = path.read_bytes()
    for broken in (whole[:20], whole[: len(whole) // 2], whole[:300] + b"xx" + whole[302:], b"", b"II*\0"):
        path.write_bytes(broken)
        with pytest.raises(SourceError, match=r"0\.png: cannot be read as PNG"):
            read_depth_png(path, camera((40, 40)))
    with pytest.raises(SourceError, match="cannot be read as PNG: No such file"):
        image_size(tmp_path / "1.png")


def test_the_last_number_of_a_name_counts_frames() -> None:
    assert frame_number(Path("cam2_depth-000012_raw.png")) == 12
    with pytest.raises(SourceError, match="expected a number of the frame in the name"):
        frame_number(Path("depth.png"))
