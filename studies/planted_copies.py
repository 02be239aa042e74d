"""Copies of takes as they come about in archives: resampled, trimmed, exported anew, with noise, or on other bodies.

Every kind of copy changes a recording in one way, or in several ways together. Motion is interpolated linearly, which
is the crudest way that programs take.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from kinedex.ops.body.joint_tree import JOINTS, PARENTS
from kinedex.storage.formats.motion.c3d_writer import write_c3d
from kinedex.storage.formats.motion.joint_motion import MARKER_NAMES, JointMotion

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]

BONES, SIZES = (0.88, 1.12), (0.85, 1.15)
"""The smallest and the largest factor of one bone, and of the whole body."""

MIN_SECONDS = 1.5
"""The shortest part that is cut out of a take, or the whole take if it is shorter."""


class Copy(NamedTuple):
    """A copy of a take: places (T, J, 3) in metres with Y up, frames a second, and the unit and up axis of its file."""

    positions: F32
    rate_hz: float
    unit: str = "m"
    up: str = "y"

    def write(self, folder: Path, name: str) -> None:
        """Write the file of the copy: NPZ, or C3D in millimetres if Z is up, as motion capture systems write it."""
        if self.up == "z":
            turned = np.stack([self.positions[..., 0], -self.positions[..., 2], self.positions[..., 1]], axis=-1)
            path = folder / f"{name}.c3d"
            write_c3d(path, JointMotion(name, JOINTS, turned, self.rate_hz))
            data = path.read_bytes()
            at = data.index(b"+Y", data.index(b"Y_SCREEN"))
            path.write_bytes(data[:at] + b"+Z" + data[at + 2 :])
            return
        places = self.positions * np.float32({"m": 1.0, "cm": 100.0}[self.unit])
        # under kinedex's own names places are in metres; of markers the reader judges the unit
        names = JOINTS if self.unit == "m" else [MARKER_NAMES[joint] for joint in JOINTS]
        np.savez(folder / f"{name}.npz", positions=places, names=np.array(names), rate_hz=np.array(self.rate_hz))


def moved_and_turned(positions: F32, degrees: float = 53.13) -> F32:
    """Return places that are turned about the vertical axis, with another origin."""
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]], np.float32)
    moved: F32 = positions @ turn + np.float32([2, 0, 5])
    return moved


def mirrored(positions: F32) -> F32:
    """Return the mirror image of a body, with left and right exchanged."""
    other = {"l": "r", "r": "l"}
    names = [joint if joint == "root" else other.get(joint[0], joint[0]) + joint[1:] for joint in JOINTS]
    image: F32 = positions[:, [JOINTS.index(name) for name in names]] * np.float32([-1, 1, 1])
    return image


def sampled(positions: F32, at: F64) -> F32:
    """Return places between frames, at times in frames."""
    left = np.clip(np.floor(at).astype(np.int64), 0, len(positions) - 2)
    share = (at - left).astype(np.float32)[:, None, None]
    between: F32 = positions[left] * (1 - share) + positions[left + 1] * share
    return between


def at_rate(positions: F32, share: float, begin: float = 0.0) -> F32:
    """Return a take sampled at a share of its rate, from a time in frames on."""
    return sampled(positions, np.arange(begin, len(positions) - 1 + 1e-9, 1 / share))


def part(positions: F32, rate_hz: float, share: float, at: float) -> F32:
    """Return a share of a take, of `MIN_SECONDS` at least; `at` is 0 for its beginning and 1 for its end."""
    count = min(len(positions), max(round(share * len(positions)), round(MIN_SECONDS * rate_hz)))
    begin = round(at * (len(positions) - count))
    return positions[begin : begin + count]


def on_another_body(positions: F32, random: np.random.Generator) -> F32:
    """Return the same motion of another body: each bone has another length, that of both sides the same."""
    size = random.uniform(*SIZES)
    own = {name: random.uniform(*BONES) for name in JOINTS}
    names = [f"r{name[1:]}" if name[0] == "l" else name for name in JOINTS]
    found = np.empty_like(positions)
    found[:, 0] = positions[:, 0] * np.float32(size)
    for joint, parent in enumerate(PARENTS.tolist()):
        if parent >= 0:
            bone = positions[:, joint] - positions[:, parent]
            found[:, joint] = found[:, parent] + bone * np.float32(size * own[names[joint]])
    return found


def with_noise(positions: F32, metres: float, random: np.random.Generator) -> F32:
    """Return places with normal noise of this standard deviation in each coordinate."""
    return positions + random.normal(0, metres, positions.shape).astype(np.float32)


def planted(positions: F32, rate_hz: float, random: np.random.Generator) -> Iterator[tuple[str, Callable[[], Copy]]]:
    """Yield the name of each kind of copy, with a function that makes the copy of a take."""
    turned = moved_and_turned(positions)
    shift = 0.4 * max(1.0, rate_hz / 30)
    yield "the same frames", lambda: Copy(positions, rate_hz)
    yield "half the rate", lambda: Copy(positions[1::2], rate_hz / 2)
    yield "five sixths of the rate", lambda: Copy(at_rate(positions, 5 / 6), rate_hz * 5 / 6)
    yield "shifted by 13 ms", lambda: Copy(at_rate(positions, 1.0, shift), rate_hz)
    yield "trimmed to two thirds", lambda: Copy(part(positions, rate_hz, 2 / 3, 0.6), rate_hz)
    yield "trimmed to a third", lambda: Copy(part(positions, rate_hz, 1 / 3, 0.3), rate_hz)
    yield (
        "exported as C3D: whole millimetres, Z up, turned",
        lambda: Copy(np.round(turned, 3), rate_hz, up="z"),
    )
    yield "moved and turned, in centimetres", lambda: Copy(turned, rate_hz, "cm")
    yield "in place", lambda: Copy(positions - positions[:, :1] * np.float32([1, 0, 1]), rate_hz)
    yield "noise of 1 mm", lambda: Copy(with_noise(positions, 0.001, random), rate_hz)
    yield "noise of 3 mm", lambda: Copy(with_noise(positions, 0.003, random), rate_hz)
    yield "larger by a tenth", lambda: Copy(positions * np.float32(1.1), rate_hz)
    yield "another body", lambda: Copy(on_another_body(positions, random), rate_hz)
    yield "clock of 1000/1001", lambda: Copy(positions, rate_hz * 1000 / 1001)
    yield "film at 24 of 25 frames a second", lambda: Copy(positions, rate_hz * 24 / 25)
    yield "mirrored", lambda: Copy(mirrored(positions), rate_hz)
    yield (
        "trimmed, half the rate, mirrored",
        lambda: Copy(mirrored(part(positions, rate_hz, 2 / 3, 0.6))[::2], rate_hz / 2),
    )
    yield (
        "trimmed, five sixths of the rate, turned, noise of 2 mm",
        lambda: Copy(
            with_noise(at_rate(part(turned, rate_hz, 2 / 3, 0.3), 5 / 6), 0.002, random), rate_hz * 5 / 6, up="z"
        ),
    )
