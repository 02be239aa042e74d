"""Silhouettes in PNG and in packed bits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from kinedex.catalog.camera_recordings import load_recordings
from kinedex.ops.errors import KinedexError, SourceError
from kinedex.storage.formats.cameras.masks import read_mask
from kinedex.storage.formats.cameras.recording import Recording, read_recording
from tests.camera_files import SIZE, Filmed, filmed

FRAMES = 3


def masks(width: int, height: int) -> np.ndarray:
    """Masks (V, T, H, W), a box that moves."""
    found = np.zeros((4, FRAMES, height, width), np.bool_)
    for v in range(4):
        for t in range(FRAMES):
            found[v, t, 10 + t : 50, 5 * v + 3 : 5 * v + 40] = True
    return found


def save_png(path: Path, pixels: np.ndarray, mode: str = "L") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).convert(mode).save(path)
    return path


@pytest.fixture
def step(tmp_path: Path) -> Filmed:
    return filmed(tmp_path)


def read(step: Filmed, **changed: Any) -> Recording:
    return read_recording(load_recordings(step.write(**changed)), "step")


def same(found: Recording, expected: np.ndarray) -> None:
    assert found.masks is not None
    assert len(found.masks) == found.frames == FRAMES
    for t in range(FRAMES):
        for v, mask in enumerate(found.masks[t]):
            assert mask is not None
            assert mask.dtype == np.uint8
            assert ((mask > 127) == expected[v, t]).all()


@pytest.mark.parametrize(("scale", "mode"), [(1, "L"), (2, "1"), (4, "RGB")])
def test_masks_in_png_are_as_large_as_the_images_or_a_whole_fraction(step: Filmed, scale: int, mode: str) -> None:
    expected = masks(SIZE[0] // scale, SIZE[1] // scale)
    for v, camera in enumerate(step.cameras):
        for t in range(FRAMES):
            save_png(step.folder / "masks" / camera.name / f"{t:06d}.png", 255 * expected[v, t].astype(np.uint8), mode)
    same(read(step, silhouettes="masks/{camera}/*.png"), expected)
    alone = read(step, silhouettes="masks/{camera}", keypoints=None)
    same(alone, expected)
    assert alone.pixels.shape == (FRAMES, 4, 0, 2)
    assert alone.keypoint_set is None


@pytest.mark.parametrize("each", [True, False])
def test_packed_bits_are_the_same_masks(step: Filmed, each: bool) -> None:
    expected = masks(SIZE[0] // 2, SIZE[1] // 2)
    arrays = {camera.name: np.packbits(one, axis=2) for camera, one in zip(step.cameras, expected, strict=True)}
    if each:
        for name, bits in arrays.items():
            np.savez_compressed(step.folder / f"masks_{name}.npz", masks=bits)
    else:
        np.savez_compressed(step.folder / "masks.npz", **arrays)
    same(read(step, silhouettes="masks_{camera}.npz" if each else "masks.npz"), expected)


def test_a_frame_without_a_mask_is_none_and_a_probability_stays_one(step: Filmed) -> None:
    for camera in step.cameras:
        for t in (0, 2):
            save_png(step.folder / "masks" / camera.name / f"{t}.png", np.full(SIZE[::-1], 90 * t, np.uint8))
    found = read(step, silhouettes="masks/{camera}/*.png")
    assert found.masks is not None
    assert found.masks[1] == (None, None, None, None)
    assert {int(mask.max()) for mask in found.masks[2] if mask is not None} == {180}


def test_wrong_masks_are_refused(step: Filmed) -> None:
    for camera in step.cameras:
        save_png(step.folder / "masks" / camera.name / "0.png", np.zeros(SIZE[::-1], np.uint8))
    first = step.folder / "masks" / "cam_1" / "0.png"
    keys = {"silhouettes": "masks/{camera}/*.png"}
    save_png(first, np.zeros((100, 100), np.uint8))
    with pytest.raises(SourceError, match="has 100 × 100 pixels, which is no whole fraction of the 640 × 480"):
        read(step, **keys)
    save_png(first, np.zeros(SIZE[::-1], np.uint8))
    save_png(first.with_name("1.png"), np.zeros((240, 320), np.uint8))
    with pytest.raises(SourceError, match="has 320 × 240 pixels, and the first mask of its camera 640 × 480"):
        read(step, **keys)
    save_png(first.with_name("1.png"), np.zeros(SIZE[::-1], np.uint8), "P")
    with pytest.raises(SourceError, match="expected an 8-bit grey image, got one of Pillow's mode P"):
        read(step, **keys)
    first.with_name("1.png").write_bytes(first.read_bytes()[:60])
    with pytest.raises(SourceError, match="cannot be read as PNG"):
        read(step, **keys).masks[1]  # type: ignore[index]
    with pytest.raises(KinedexError, match=r"masks in PNG need {camera} in their path"):
        read(step, silhouettes="masks/cam_1/*.png")


def test_a_mask_of_zeros_and_ones_is_no_mask(tmp_path: Path) -> None:
    path = save_png(tmp_path / "0.png", np.eye(8, dtype=np.uint8))
    with pytest.raises(SourceError, match="has only the values 0 and 1; foreground must be above 127: multiply"):
        read_mask(path, (8, 8))


def test_wrong_packed_bits_are_refused(step: Filmed) -> None:
    path = step.folder / "masks.npz"
    for array, message in (
        (np.zeros((3, 480, 640), np.bool_), "must be uint8 of shape .* write numpy.packbits"),
        (np.zeros((3, 480, 70), np.uint8), "has 480 rows of 560 bits, which is no whole fraction of the 640 × 480"),
    ):
        np.savez(path, cam_1=array, cam_2=array)
        with pytest.raises(SourceError, match=message):
            read(step, silhouettes="masks.npz")
