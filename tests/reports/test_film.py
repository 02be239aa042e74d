"""Films of motions: as long as the motion, with both sides in their colours, and the same bytes every time."""

from __future__ import annotations

import builtins
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageColor

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.inspection.stick_figures import LEFT, RIGHT
from kinedex.reports import film
from kinedex.reports.film import write_gif, write_mp4
from kinedex.storage.formats.motion.joint_motion import JointMotion
from tests.bodies import standing
from tests.oracles.features import JOINTS


def walking(frames: int = 12, rate_hz: float = 30.0) -> JointMotion:
    """A figure that glides along Z, invalid in one frame."""
    places = standing(frames).transpose(2, 0, 1).astype(np.float32)
    places[:, :, 2] += 0.05 * np.arange(frames, dtype=np.float32)[:, None]
    places[frames // 2] = np.nan
    return JointMotion("glide", JOINTS, places, rate_hz)


def middle_of(image: Image.Image, colour: str, view: int) -> float:
    """The mean column of the pixels of nearly a colour in one of the two views, below the legend."""
    pixels = np.asarray(image.convert("RGB")).astype(int)[40:, 320 * view : 320 * (view + 1)]
    near = np.abs(pixels - ImageColor.getrgb(colour)).sum(axis=2) < 90
    return float(np.nonzero(near)[1].mean()) if near.any() else float("nan")


def test_a_gif_shows_the_left_side_on_the_right_as_one_faces_it(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_gif(tmp_path / name, walking())
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    with Image.open(tmp_path / "a") as image:
        assert (image.n_frames, image.info["duration"], image.size) == (10, 40, (640, 400))  # type: ignore[attr-defined]
        assert middle_of(image, LEFT, 0) > 165 > 155 > middle_of(image, RIGHT, 0)
        assert middle_of(image, LEFT, 0) + middle_of(image, RIGHT, 0) == pytest.approx(320, abs=3)
        image.seek(5)  # the invalid frame
        assert np.isnan(middle_of(image, LEFT, 0))


def test_an_mp4_has_the_rate_of_the_motion(tmp_path: Path) -> None:
    av: Any = pytest.importorskip("av")
    for name in ("a", "b"):
        write_mp4(tmp_path / name, walking(rate_hz=20.0))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    with av.open(str(tmp_path / "a")) as container:
        stream = container.streams.video[0]
        frames = [frame.to_image() for frame in container.decode(stream)]
    assert (len(frames), stream.average_rate, stream.codec_context.name) == (12, 20, "h264")
    assert middle_of(frames[1], LEFT, 0) > 165 > 155 > middle_of(frames[1], RIGHT, 0)


def test_an_mp4_without_its_library_names_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = builtins.__import__

    def absent(name: str, *others: Any) -> Any:
        if name == "av":
            raise ImportError(name)
        return found(name, *others)

    monkeypatch.setattr(builtins, "__import__", absent)
    with pytest.raises(KinedexError, match=r"pip install 'kinedex\[film\]'"):
        write_mp4(tmp_path / "a.mp4", walking())


def test_a_long_gif_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(film, "MAX_GIF_FRAMES", 9)
    with pytest.raises(KinedexError, match=r"has 0 s; a GIF can have 0 s; export a shorter range, or an mp4"):
        write_gif(tmp_path / "a.gif", walking())
    empty = JointMotion("none", JOINTS, np.full((3, 24, 3), np.nan, np.float32), 30.0)
    with pytest.raises(KinedexError, match="no joint that is seen"):
        write_gif(tmp_path / "a.gif", empty)
