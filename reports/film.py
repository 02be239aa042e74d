"""Write films of motions as GIF or MP4, with a stick figure from the front and the side, the floor and the time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from PIL import Image, ImageColor

from kinedex.ops.arrays import F64, Bool
from kinedex.ops.body.joint_tree import JOINT_PARENTS
from kinedex.ops.errors import KinedexError
from kinedex.ops.intervals import shown_seconds
from kinedex.pipelines.inspection.stick_figures import LEFT, MIDDLE, RIGHT
from kinedex.reports.stick_figures import FAINT, GROUND, TEXT, Pen
from kinedex.storage.formats.motion.joint_motion import JointMotion

MAX_GIF_FRAMES = 1500
"""Largest number of frames of a GIF (one minute), because the library holds all of them in memory."""

_VIEWS = (("front", 0, 2, 1.0), ("side", 2, 0, -1.0))  # axes to the right and in depth, sign of the near side
_WIDE, _HIGH, _HEAD, _FOOT = 320, 400, 44, 40  # pixels of a view, and of what lies above and below the figure
_FINE = 2  # frames are drawn this many times larger and then reduced, so that lines are smooth
_MIN_HEIGHT_M, _TICK_M = 2.0, 0.5
_GIF_HZ, _FASTEST_HZ, _USUAL_HZ = 25.0, 60.0, 30.0
_STEADY_S = 1.0  # seconds over which the position of the view is averaged
_SHADES = 20  # shades of each colour in the palette of a GIF


def write_gif(path: Path, motion: JointMotion) -> None:
    """Write a motion as a GIF with 25 frames per second, or with about the rate of the motion if that is lower.

    A frame of a GIF lasts a whole number of hundredths of a second, to which its duration is rounded.

    Parameters
    ----------
    path : Path
        The file to write.
    motion : JointMotion
        The motion; frames without any joint show the floor only.

    Raises
    ------
    KinedexError
        No frame has a joint, or the motion is longer than a GIF of `MAX_GIF_FRAMES` frames.
    """
    hundredths = max(round(100 / min(motion.rate_hz, _GIF_HZ)), 1)
    film = _Film(motion, 100 / hundredths)
    if len(film) > MAX_GIF_FRAMES:
        seconds = MAX_GIF_FRAMES * hundredths / 100
        raise KinedexError(
            f"'{motion.name}' has {len(film) * hundredths / 100:.0f} s; a GIF can have {seconds:.0f} s; export a "
            "shorter range, or an mp4"
        )
    palette = _palette()
    frames = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in film.frames())
    first = next(frames)
    first.save(path, "GIF", save_all=True, append_images=frames, duration=10 * hundredths, loop=0, optimize=False)


def write_mp4(path: Path, motion: JointMotion) -> None:
    """Write a motion as an MP4 file (H.264) with the rate of the motion, or 30 frames per second if it is over 60.

    Parameters
    ----------
    path : Path
        The file to write.
    motion : JointMotion
        The motion; frames without any joint show the floor only.

    Raises
    ------
    KinedexError
        PyAV is not installed, or no frame has a joint.
    """
    try:
        import av
    except ImportError:
        raise KinedexError(
            "an mp4 is written by PyAV, which is not installed: `pip install 'kinedex[film]'`; --format gif needs "
            "nothing more"
        ) from None
    from fractions import Fraction

    film = _Film(motion, motion.rate_hz if motion.rate_hz <= _FASTEST_HZ else _USUAL_HZ)
    rate = Fraction(film.rate_hz).limit_denominator(1001)
    options = {"movflags": "faststart", "fflags": "bitexact"}  # without versions and dates: equal bytes each time
    with av.open(str(path), "w", format="mp4", options=options) as container:
        stream = container.add_stream("libx264", rate=rate, options={"crf": "20", "preset": "fast", "threads": "1"})
        stream.width, stream.height, stream.pix_fmt = *film.size, "yuv420p"
        stream.codec_context.flags |= av.codec.context.Flags.bitexact
        for frame in film.frames():
            container.mux(stream.encode(av.VideoFrame.from_image(frame)))
        container.mux(stream.encode())


def _palette() -> Image.Image:
    """Return the colours of all lines and texts, each in shades from the colour itself to that of the paper."""
    colours = np.array([ImageColor.getrgb(colour) for colour in (LEFT, RIGHT, MIDDLE, GROUND, TEXT, FAINT)])
    shades = colours[:, None] + (255.0 - colours[:, None]) * np.linspace(0.0, 1.0, _SHADES)[:, None]
    image = Image.new("P", (1, 1))
    image.putpalette(shades.round().astype(np.uint8).reshape(-1, 3).tobytes())
    return image


@dataclass(frozen=True)
class _Film:
    """The pictures of a motion at a given frame rate."""

    motion: JointMotion
    rate_hz: float

    @property
    def size(self) -> tuple[int, int]:
        """Return width and height in pixels."""
        return len(_VIEWS) * _WIDE, _HIGH

    def __len__(self) -> int:
        return int((len(self.motion.positions) - 1) / self.motion.rate_hz * self.rate_hz + 1e-6) + 1

    @cached_property
    def positions(self) -> F64:
        """Return the joint positions (T, joints, 3) of the shown frames, turned so that the body first faces +Z."""
        positions = self.motion.positions.astype(np.float64)
        if not np.isfinite(positions).all(axis=2).any():
            raise KinedexError(f"'{self.motion.name}' has no joint that is seen in any of its {len(positions)} frames")
        shown = np.round(np.arange(len(self)) * (self.motion.rate_hz / self.rate_hz)).astype(np.int64)
        x, z = self._across
        turn = np.array([[x, 0.0, z], [0.0, 1.0, 0.0], [-z, 0.0, x]])
        turned: F64 = positions[np.minimum(shown, len(positions) - 1)] @ turn.T
        return turned

    @property
    def _across(self) -> tuple[float, float]:
        """Return the horizontal direction (x, z) from the right hip to the left in the first frame that has both."""
        if {"lhip", "rhip"} <= set(self.motion.joints):
            left, right = (self.motion.positions[:, self.motion.joints.index(name)] for name in ("lhip", "rhip"))
            ways = (left - right)[:, [0, 2]].astype(np.float64)
            length = np.linalg.norm(ways, axis=1)
            usable = np.flatnonzero(np.isfinite(length) & (length > 1e-3))
            if len(usable):
                x, z = ways[usable[0]] / length[usable[0]]
                return float(x), float(z)
        return 1.0, 0.0

    @cached_property
    def floor(self) -> float:
        """Return the height of the floor: a low percentile of the height of the lowest joint."""
        heights = self.positions[:, :, 1]
        seen = np.isfinite(heights).any(axis=1)
        return float(np.percentile(np.nanmin(heights[seen], axis=1), 2))

    @cached_property
    def scale(self) -> float:
        """Return pixels per metre, such that the highest joint and, in any case, a standing body fit into a view."""
        tall = max(float(np.nanmax(self.positions[:, :, 1])) - self.floor, _MIN_HEIGHT_M)
        reach = self.positions - self.centres[:, None]
        wide = 2.1 * float(np.nanmax(np.abs(reach[:, :, [0, 2]])))
        return min((_HIGH - _HEAD - _FOOT) / tall, _WIDE / wide)

    @cached_property
    def centres(self) -> F64:
        """Return the positions (T, 3) that the views follow: the middle of the body, averaged over a second."""
        seen: Bool = np.any(np.isfinite(self.positions), axis=(1, 2))
        middle = (np.nanmin(self.positions[seen], axis=1) + np.nanmax(self.positions[seen], axis=1)) / 2
        frames = np.arange(len(seen))
        filled = np.stack([np.interp(frames, frames[seen], track) for track in middle.T], axis=1)
        half = int(_STEADY_S * self.rate_hz / 2)
        around = np.concatenate([filled[:1].repeat(half, 0), filled, filled[-1:].repeat(half, 0)])
        sums = np.concatenate([np.zeros((1, 3)), np.cumsum(around, axis=0)])
        return np.asarray((sums[2 * half + 1 :] - sums[: -2 * half - 1]) / (2 * half + 1))

    def frames(self) -> Iterator[Image.Image]:
        """Yield a picture for each frame of the film."""
        ground = self._ground()
        index = {joint: i for i, joint in enumerate(self.motion.joints)}
        sides = {"l": LEFT, "r": RIGHT}
        bones = [
            (index[joint], index[parent], sides.get(joint[0], MIDDLE))
            for joint, parent in JOINT_PARENTS.items()
            if parent in index and joint in index
        ]
        for i, positions in enumerate(self.positions):
            image = ground.copy()
            pen = Pen(image, _FINE)
            for view, (_, across, away, sign) in enumerate(_VIEWS):
                self._draw(pen, view, positions, self.centres[i], bones, across, away, sign)
            pen.write(12, _HIGH - 22, f"{shown_seconds(i, self.rate_hz)} s", 13, TEXT)
            yield image.reduce(_FINE)

    def _ground(self) -> Image.Image:
        """Return the picture of everything that is the same in every frame, before its size is reduced."""
        pen = Pen.on_paper(*self.size, _FINE)
        pen.write(12, 8, self.motion.name[:60], 14, TEXT)
        for i, (word, colour) in enumerate((("left", LEFT), ("right", RIGHT))):
            x = self.size[0] - 130 + 64 * i
            pen.line(x, 17, x + 16, 17, colour, 3)
            pen.write(x + 21, 9, word, 12, TEXT)
        for view, (name, *_) in enumerate(_VIEWS):
            pen.write(view * _WIDE + 12, 28, name, 12, FAINT)
        y = _HIGH - _FOOT
        pen.line(0, y, self.size[0], y, GROUND)
        return pen.image

    def _draw(
        self, pen: Pen, view: int, positions: F64, centre: F64,
        bones: list[tuple[int, int, str]], across: int, away: int, sign: float,
    ) -> None:  # fmt: skip
        """Draw a view: marks on the floor every half metre, and the bones from the farthest to the nearest."""
        middle = (view + 0.5) * _WIDE
        reach = _WIDE / 2 / self.scale
        first = int(np.ceil((centre[across] - reach) / _TICK_M))
        for tick in range(first, int(np.floor((centre[across] + reach) / _TICK_M)) + 1):
            x = middle + (tick * _TICK_M - centre[across]) * self.scale
            pen.line(x, _HIGH - _FOOT, x, _HIGH - _FOOT + 5, GROUND)
        x = middle + (positions[:, across] - centre[across]) * self.scale
        y = _HIGH - _FOOT - (positions[:, 1] - self.floor) * self.scale
        seen = np.isfinite(x) & np.isfinite(y)
        shown = [bone for bone in bones if seen[bone[0]] and seen[bone[1]]]
        for a, b, colour in sorted(
            shown, key=lambda bone: sign * float(positions[bone[0], away] + positions[bone[1], away])
        ):
            pen.line(x[a], y[a], x[b], y[b], colour, 4)
            for joint in (a, b):
                pen.dot(x[joint], y[joint], 2.4, colour)
