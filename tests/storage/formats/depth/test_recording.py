"""Depth recordings are read lazily from every form, and what cannot be right is refused with file and key."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from kinedex.catalog.depth_cameras import placement_of
from kinedex.catalog.depth_recordings import load_depth_recordings
from kinedex.ops.depth.background import percentile_depths
from kinedex.ops.errors import KinedexError
from kinedex.storage.formats.depth import npz as npz_reader
from kinedex.storage.formats.depth import recording as recording_reader
from kinedex.storage.formats.depth.camera_file import write_camera
from kinedex.storage.formats.depth.frame_files import CONVERTERS
from kinedex.storage.formats.depth.png import write_depth_png
from kinedex.storage.formats.depth.recording import DepthRecording, read_recording
from tests.depth_files import SIZE, Recorded, camera, cloud_points, pcd, ply, recorded, room, with_person


@pytest.fixture
def walk(tmp_path: Path) -> Recorded:
    return recorded(tmp_path)


def read(walk: Recorded, **changed: Any) -> DepthRecording:
    return only(walk.write(**changed))


def only(path: Path) -> DepthRecording:
    """Return the only recording of a file."""
    file = load_depth_recordings(path)
    (name,) = file.recordings
    return read_recording(file, name)


def same(found: DepthRecording, walk: Recorded) -> None:
    assert len(found.frames) == len(walk.depths)
    for t, expected in enumerate(walk.depths):
        image = found.frames[t]
        assert image is not None
        assert image.dtype == np.float32
        assert image == pytest.approx(expected, abs=6e-4)


def test_a_recording_has_camera_background_and_images(walk: Recorded) -> None:
    found = read(walk, body="anna_01", truth="anna_02")
    same(found, walk)
    assert (found.name, found.rate_hz, found.body, found.truth) == ("walk", 30.0, "anna_01", "anna_02")
    assert found.background is not None
    assert found.background == pytest.approx(room(walk.camera), abs=6e-4)
    assert found.camera.matrix.tolist() == walk.camera.matrix.tolist()
    assert not found.notes
    same(read(walk, depth="depth"), walk)
    (walk.folder / "truth.csv").write_text("frame\n")
    assert read(walk, truth="truth.csv").truth == walk.folder / "truth.csv"


def write_npz(walk: Recorded) -> dict[str, Any]:
    units = np.round(walk.depths * 1000).astype(">u2")
    np.savez_compressed(walk.folder / "a.npz", depth=units, intrinsics=walk.camera.matrix, rate_hz=30)
    return {"depth": "a.npz", "camera": None}


def write_float_npz(walk: Recorded) -> dict[str, Any]:
    (fx, _, cx), (_, fy, cy) = walk.camera.matrix[:2]
    metres = np.where(walk.depths > 0, walk.depths, np.nan).astype(np.float16)
    np.savez(walk.folder / "a.npz", depth=metres.astype(np.float64), fx=fx, fy=fy, cx=cx, cy=cy)
    walk.depths[:] = np.nan_to_num(metres)
    return {"depth": "a.npz", "camera": None, "rate_hz": 30}


def write_raw(walk: Recorded) -> dict[str, Any]:
    (walk.folder / "a.raw").write_bytes(np.round(walk.depths * 1000).astype("<u2").tobytes())
    return {"depth": "a.raw"}


def write_raw_files(walk: Recorded) -> dict[str, Any]:
    for t, one in enumerate(walk.depths):
        (walk.folder / f"d_Depth_{1529565338471.3 + 33.3 * t:.4f}.raw").write_bytes(
            np.round(one * 1000).astype("<u2").tobytes()
        )
    return {"depth": "d_*.raw"}


def write_pcd(walk: Recorded) -> dict[str, Any]:
    for t, one in enumerate(walk.depths):
        (walk.folder / f"{t}.pcd").write_bytes(pcd(cloud_points(walk.camera, one), "binary_compressed", SIZE))
    return {"depth": "*.pcd", "camera": None, "rate_hz": 30}


def write_ply(walk: Recorded) -> dict[str, Any]:
    for t, one in enumerate(walk.depths):
        (walk.folder / f"{t}.ply").write_bytes(ply(cloud_points(walk.camera, 1000 * one), "binary_little_endian", True))
    return {"depth": "*.ply", "depth_unit_m": 0.001}


def write_tum(walk: Recorded) -> dict[str, Any]:
    lines = ["# depth maps", "# timestamp filename"]
    for t, one in enumerate(walk.depths):
        time = f"{1305031102.160407 + t / 30 + 0.004 * (t % 2):.6f}"
        write_depth_png(walk.folder / "tum" / f"{time}.png", one, 0.0002)
        lines.append(f"{time} {time}.png")
    (walk.folder / "tum" / "depth.txt").write_text("\n".join(lines))
    (walk.folder / "tum" / "background.png").write_bytes(b"")
    write_depth_png(walk.folder / "tum" / "background.png", room(walk.camera), 0.0002)
    (walk.folder / "tum" / "camera.txt").write_text("28 28 15.5 11.5")
    return {"depth": "tum/depth.txt", "camera": "tum/camera.txt", "background": "tum/background.png", "rate_hz": 30}


def write_azure(walk: Recorded) -> dict[str, Any]:
    content = {"width": 32, "height": 24, "intrinsic_matrix": walk.camera.matrix.T.ravel().tolist(), "fps": 30}
    (walk.folder / "intrinsic.json").write_text(json.dumps(content))
    return {"camera": "intrinsic.json"}


FORMS = [
    write_npz, write_float_npz, write_raw, write_raw_files, write_pcd, write_ply, write_tum, write_azure,
]  # fmt: skip


@pytest.mark.parametrize("write", FORMS)
def test_every_form_is_the_same_recording(walk: Recorded, write: Callable[[Recorded], dict[str, Any]]) -> None:
    (walk.folder / "tum").mkdir()
    keys = write(walk)
    found = read(walk, **keys)
    same(found, walk)
    assert found.rate_hz == pytest.approx(30)
    assert found.background is not None


def test_images_of_an_npz_are_unpacked_in_blocks_in_any_order(walk: Recorded, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(npz_reader, "_BLOCK_BYTES", 2 * 2 * SIZE[0] * SIZE[1])
    found = read(walk, **write_npz(walk))
    for t in (5, 0, 3, 2, 4, 1):
        image = found.frames[t]
        assert image is not None
        assert image == pytest.approx(walk.depths[t], abs=6e-4)


def test_holes_in_the_numbering_and_broken_images_are_missing_frames(walk: Recorded) -> None:
    (walk.folder / "depth" / "frame_0002.png").unlink()
    broken = walk.folder / "depth" / "frame_0004.png"
    broken.write_bytes(broken.read_bytes()[:70])
    found = read(walk)
    assert [found.frames[t] is None for t in range(6)] == [False, False, True, False, True, False]
    assert found.frames.missing == (2,)
    assert list(found.frames.damaged) == [4]
    assert "frame_0004.png: cannot be read as PNG" in found.frames.damaged[4]
    missing, damaged = found.frames.notes()
    assert found.notes == (missing, damaged)
    assert missing == "1 of 6 frames are missing in the numbering of the files"
    assert damaged.startswith("frame 4 is damaged and counts as missing: ")
    with pytest.raises(IndexError):
        found.frames[6]


def test_names_are_sorted_by_their_last_number(walk: Recorded) -> None:
    for t in range(6):
        (walk.folder / "depth" / f"frame_{t:04d}.png").rename(walk.folder / "depth" / f"k2_{t + 8}.png")
    found = read(walk)
    assert found.frames.numbers == range(8, 14)
    same(found, walk)


def test_a_background_is_measured_where_the_images_show_the_room(walk: Recorded, monkeypatch: Any) -> None:
    for given, noted in ((None, True), ("auto", False)):
        found = read(walk, background=given)
        assert found.background is not None
        assert (np.abs(found.background - room(walk.camera)) < 1e-3).mean() > 0.9
        assert any("background: auto, for the images show the room" in note for note in found.notes) == noted
    assert "all of which counts as the person; write `auto`" in read(walk, background="none").notes[0]
    monkeypatch.setattr(recording_reader, "MAX_BACKGROUND_BYTES", 0)
    monkeypatch.setattr(recording_reader, "SAMPLE", 3)
    assert any("measured in 3 frames, evenly spaced" in note for note in read(walk, background="auto").notes)


def test_a_background_that_was_removed_needs_none(walk: Recorded) -> None:
    for t in range(6):
        alone = with_person(np.full(SIZE[::-1], 9.0, np.float32), walk.camera, 0.3 * t - 0.8)
        write_depth_png(walk.folder / "depth" / f"frame_{t:04d}.png", np.where(alone < 9, alone, 0))
    found = read(walk, background=None)
    assert found.background is None
    assert "background: none" in found.notes[0]
    assert read(walk, background="none").background is None


def test_the_percentile_is_that_of_what_was_measured() -> None:
    images = np.random.default_rng(0).uniform(0.5, 5, (13, 5, 4)).astype(np.float32)
    images[np.random.default_rng(1).uniform(size=images.shape) < 0.4] = 0
    images[:, 0, 0] = 0
    expected = np.nan_to_num(np.nanpercentile(np.where(images > 0, images, np.nan)[:, 1:], 90, axis=0))
    found = percentile_depths(images)
    assert found[1:] == pytest.approx(expected, rel=1e-6)
    assert found[0, 0] == 0


@pytest.mark.parametrize("name", ["squat1Reps_tof", "kickLFront1Reps_tof", "throwBasketball_structured"])
def test_the_given_recordings_are_read(shared: Path, tmp_path: Path, name: str) -> None:
    folder = shared / "data" / "depth" / "simulated" / name
    entry = {"depth": f"{folder}/depth/*.png", "camera": f"{folder}/camera.yaml", "truth": f"{folder}/ground_truth.csv"}
    path = tmp_path / "recordings.yaml"
    path.write_text(yaml.safe_dump({"recordings": {name: entry | {"background": f"{folder}/background.png"}}}))
    found = only(path)
    assert len(found.frames) == {"squat": 47, "kickL": 31, "throw": 60}[name[:5]]
    assert found.rate_hz == 30
    assert not found.notes
    assert found.truth == folder / "ground_truth.csv"
    placed = placement_of(found.camera, found.background)
    assert placed.floor_height == -1.1
    bare = camera(matrix=found.camera.matrix, size=found.camera.size)
    searched = placement_of(bare, found.background)
    assert searched.floor_height == pytest.approx(-1.1, abs=0.02)
    assert searched.turn[1, 1] == pytest.approx(1, abs=1e-3)


def test_the_given_frames_of_a_kinect_are_read(shared: Path, tmp_path: Path) -> None:
    folder = shared / "data" / "depth" / "kinect_upper"
    entry = {"depth": f"{folder}/depth_*.png", "camera": f"{folder}/camera.yaml", "rate_hz": 30}
    path = tmp_path / "recordings.yaml"
    path.write_text(yaml.safe_dump({"recordings": {"kinect": entry}}))
    found = only(path)
    assert len(found.frames) == 11
    assert found.frames.missing == (9,)
    assert found.background is None


def _rewrite(walk: Recorded, **changed: Any) -> None:
    write_camera(walk.folder / "camera.yaml", camera(**changed))


def _scale(walk: Recorded, factor: float) -> Recorded:
    for t, one in enumerate(walk.depths):
        write_depth_png(walk.folder / "depth" / f"frame_{t:04d}.png", factor * one)
    write_depth_png(walk.folder / "background.png", factor * room(walk.camera))
    return walk


def _copy_png(walk: Recorded) -> None:
    (walk.folder / "depth" / "b_0003.png").write_bytes((walk.folder / "depth" / "frame_0003.png").read_bytes())


def _rename(walk: Recorded) -> None:
    for t in range(6):
        (walk.folder / "depth" / f"frame_{t:04d}.png").rename(walk.folder / "depth" / f"{t}_{33 * t:09d}.png")


def _break_all(walk: Recorded) -> None:
    for t in range(6):
        (walk.folder / "depth" / f"frame_{t:04d}.png").write_bytes(b"")


def _list(walk: Recorded, text: str) -> None:
    (walk.folder / "depth.txt").write_text(text)


@pytest.mark.parametrize(
    ("spoil", "keys", "message"),
    [
        (lambda w: _rewrite(w, rate_hz=None), {}, r"recordings\.yaml:\d+: recordings\.walk\.rate_hz: this key is miss"),
        (lambda w: _rewrite(w, size=(64, 48)), {}, "walk.depth: no frame can be read; .* the images scaled by 0.5"),
        (lambda w: write_depth_png(w.folder / "background.png", np.ones((9, 9))), {},
         "walk.background: .*background.png: has 9 × 9 pixels, and its camera 32 × 24"),
        (lambda w: _rewrite(w, depth_unit_m=0.0001), {},
         "camera.yaml:7: depth_unit_m: 0.0001 puts who is seen 0.25 m away.*`depth_unit_m: 0.001` gives 2.50 m and 1"),
        (lambda w: _scale(w, 5), {}, "depth_unit_m: 0.001 puts who is seen 12.5 m away.*`depth_unit_m: 0.0002` gives"),
        (lambda w: None, {"depth_unit_m": 0.01}, "walk.depth_unit_m: 0.01 puts who is seen 25 m away"),
        (lambda w: _rewrite(w, matrix=np.array([[200.0, 0, 15.5], [0, 200, 11.5], [0, 0, 1]])), {},
         "and the size of a person"),
        (lambda w: write_depth_png(w.folder / "background.png", np.full((24, 32), 0.9)), {},
         "walk.background: lies before .* the camera moved"),
        (lambda w: write_depth_png(w.folder / "background.png", np.full((24, 32), 0.05)), {},
         "walk.depth_unit_m: the images lie .* times as far away as the background"),
        (_copy_png, {}, "has the frame number 3, as"),
        (_rename, {}, "go up by 33 in the median, and must count frames"),
        (lambda w: write_depth_png(w.folder / "depth" / "frame_99999.png", w.depths[0]), {},
         "frame_99999.png: most of the frames 0 to 99999 are missing"),
        (_break_all, {}, "cannot be read as PNG"),
        (lambda w: None, {"background": "none", "depth_unit_m": 0.01},
         "0.01 puts who is seen 2. m away; expected 0.4 to 8 m: `depth_unit_m: 0.001` gives 2"),
        (lambda w: write_azure(_scale(w, 5)), {"camera": "intrinsic.json"},
         "recordings.walk.depth_unit_m: 0.001 puts who is seen 12.5 m away"),
        (lambda w: None, {"depth": "a" * 5000}, "walk.depth: .*no file matches 'a"),
        (lambda w: None, {"depth": "nothing/*.png"}, "walk.depth: .*no file matches 'nothing"),
        (lambda w: None, {"depth": "../depth/*.png"}, "walk.depth: .*must be a path below this folder"),
        (lambda w: None, {"depth": "{camera}/*.png"}, "is of several cameras"),
        (lambda w: None, {"camera": None}, "walk.camera: this key is missing: only NPZ files with `intrinsics`"),
        (lambda w: None, {"camera": "depth/*.png"}, "walk.camera: 'depth/.*.png' matches 6 files; name one"),
        (lambda w: None, {"depth": "background.*", "backgruond": "auto"}, "backgruond: no such key; did you mean"),
        (lambda w: None, {"depth": "camera.yaml"}, "is no depth image that is read; expected"),
        (lambda w: None, {"rate_hz": 0}, "rate_hz: must be greater than 0"),
        (lambda w: _list(w, "1.0 ../a.png"), {"depth": "depth.txt"}, "depth.txt:1: '../a.png' must be a path"),
        (lambda w: _list(w, "one a.png"), {"depth": "depth.txt"}, "depth.txt:1: expected a time in seconds and a file"),
        (lambda w: _list(w, "# nothing"), {"depth": "depth.txt"}, "lists 0 frames"),
        (lambda w: _list(w, "\n".join(f"{t / 15} {t}.png" for t in range(60))), {"depth": "depth.txt", "rate_hz": 60},
         "60 frames in 3.93 s are not 60 frames per second; `rate_hz: 15` fits"),
    ],
)  # fmt: skip
def test_what_cannot_be_right_is_refused(
    walk: Recorded, spoil: Callable[[Recorded], None], keys: dict[str, Any], message: str
) -> None:
    spoil(walk)
    with pytest.raises(KinedexError, match=message):
        read(walk, **keys)


@pytest.mark.parametrize("ending", CONVERTERS)
def test_recordings_of_vendors_are_refused_with_the_command_that_converts_them(walk: Recorded, ending: str) -> None:
    with pytest.raises(KinedexError, match=rf"recordings ending in {ending} are not read: .*`"):
        read(walk, depth=f"take{ending}")


def test_arrays_that_are_no_images_are_refused(walk: Recorded) -> None:
    images = np.round(walk.depths * 1000).astype(np.uint16)
    for arrays, message in (
        ({"images": images}, "has no array 'depth' of shape .*; it has images"),
        ({"depth": images[0]}, "'depth' must be integers in units or floats in metres"),
        ({"depth": np.asfortranarray(images)}, "is stored by columns; write numpy.ascontiguousarray"),
        ({"depth": images > 0}, "'depth' must be integers"),
        ({"depth": images, "intrinsics": np.eye(2)}, r"'intrinsics' must be of shape \(3, 3\)"),
        ({"depth": images, "intrinsics": np.eye(3) * np.nan}, "'intrinsics' must be finite numbers"),
        ({"depth": images, "intrinsics": walk.camera.matrix + 2}, "walk.camera: contradicts the intrinsics in a.npz"),
        ({"depth": images, "rate_hz": -1}, "'rate_hz' must be above 0"),
        ({"depth": images[:, :, :8]}, "'depth' has 8 × 24 pixels, and its camera 32 × 24"),
    ):
        np.savez(walk.folder / "a.npz", **arrays)
        with pytest.raises(KinedexError, match=message):
            read(walk, depth="a.npz")
    (walk.folder / "a.npz").write_bytes(b"PK\3\4")
    with pytest.raises(KinedexError, match=r"a\.npz: cannot be read as NumPy arrays"):
        read(walk, depth="a.npz")


def test_raw_numbers_must_fit_exactly(walk: Recorded) -> None:
    (walk.folder / "a.raw").write_bytes(bytes(2 * 32 * 24 + 2))
    with pytest.raises(KinedexError, match="has 1,538 bytes, which is no whole number of images of 32 × 24 pixels"):
        read(walk, depth="a.raw")


def test_a_camera_that_moves_is_noted_with_its_frames(walk: Recorded) -> None:
    write_depth_png(walk.folder / "depth" / "frame_0003.png", np.minimum(1.6 * walk.depths[3], 6.0))
    found = read(walk)
    assert found.notes == ("frames 3: much lies behind the background; did the camera move?",)


def test_intrinsics_far_from_the_middle_and_empty_rooms_are_noted(walk: Recorded) -> None:
    _rewrite(walk, matrix=np.array([[28.0, 0, 30.0], [0, 28, 11.5], [0, 0, 1]]))
    assert any(note.startswith("cx 30 lies far from the middle of 32 pixels") for note in read(walk).notes)
    for t in range(6):
        write_depth_png(walk.folder / "depth" / f"frame_{t:04d}.png", room(walk.camera))
    assert any("nobody is seen in 6 frames" in note for note in read(walk).notes)


def test_the_file_of_recordings_names_the_nearest_recording(walk: Recorded) -> None:
    with pytest.raises(KinedexError, match="no recording is called 'wlak'; did you mean 'walk'"):
        load_depth_recordings(walk.write()).entry("wlak")
