"""This module simulates sensors worn on limbs: it divides a take into pieces, draws mounts and clocks, and samples.

Each piece is a part of the take in which all limbs are known and nothing jumps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from kinedex.ops.arrays import F64, Bool
from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial.limb_motion import LimbMotion
from kinedex.ops.inertial.limb_orientation import NONE
from kinedex.ops.inertial.rotations import interpolate
from kinedex.ops.inertial.sensor_model import (
    FIELD_UT,
    INCLINATION_DEG,
    Clock,
    Grade,
    Readings,
    magnetic_field,
    measured,
    random_clock,
    random_mount,
    seeded_generator,
    sensor_motion,
    world_rotation,
)

MIN_SECONDS = 2.0
"""The smallest length of a piece in seconds, unless windows are shorter."""

SHORT_GAP_S = 0.1
"""The longest gap, in seconds, over which frames without an orientation are interpolated."""

FASTEST_M_S = 25.0
"""The speed of a limb, in m/s, above which the frames before and after must be of different clips."""

RANDOM = "random"
MOUNTS = (RANDOM, "limb")
"""The ways in which sensors are mounted."""


@dataclass(frozen=True, eq=False)
class LimbPiece:
    """A limb in a piece of a take: times (T,), positions (T, 3) and orientations (T, 4), all known."""

    times: F64
    position: F64
    orientation: F64


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of a take in which all limbs are known and without jumps.

    Attributes
    ----------
    start, stop : int
        The frames [start, stop) of the source.
    limbs : dict of str to LimbPiece
        Its limbs by name.
    """

    start: int
    stop: int
    limbs: dict[str, LimbPiece]


@dataclass(frozen=True, eq=False)
class Pieces:
    """The pieces of a take.

    Attributes
    ----------
    pieces : tuple of Piece
        The pieces in order of time.
    short : int
        The number of pieces that were excluded because they are too short.
    lost_frames : int
        The number of frames outside of all pieces.
    without : dict of str to str
        Limb → the reason why it has no sensor.
    """

    pieces: tuple[Piece, ...]
    short: int
    lost_frames: int
    without: dict[str, str]


def take_pieces(
    limbs: Mapping[str, LimbMotion], wanted: tuple[str, ...], named: bool, least_s: float = MIN_SECONDS
) -> Pieces:
    """Divide a take into pieces for which sensors can be simulated.

    Parameters
    ----------
    limbs : mapping of str to LimbMotion
        The limbs of the take.
    wanted : tuple of str
        The limbs that wear sensors.
    named : bool
        True if the user named the limbs, so that a limb which the skeleton lacks is reported. Limbs of which only the
        long axis is known are excluded and reported in any case.
    least_s : float
        The smallest length of a piece in seconds.
    """
    without = {}
    usable: dict[str, tuple[LimbMotion, F64, F64, Bool]] = {}
    for name in wanted:
        one = limbs.get(name)
        if one is None:
            if named:
                without[name] = "the skeleton does not have it"
            continue
        if one.basis == NONE:
            without[name] = "only its long axis is known, and a sensor turns about it, too"
            continue
        orientation, known = interpolate(one.times[one.valid], one.orientation[one.valid], one.times, SHORT_GAP_S)
        position = _filled(one.times, one.position)
        usable[name] = one, orientation, position, known & ~one.jump & ~_glued(one.times, position)
    if not usable:
        return Pieces((), 0, 0, without)
    good = np.logical_and.reduce([one[3] & np.isfinite(one[2]).all(axis=1) for one in usable.values()])
    times = next(iter(usable.values()))[0].times
    # both frames at a jump are marked
    edges = np.flatnonzero(np.diff(good, prepend=False, append=False)).reshape(-1, 2).tolist()
    step = float(times[1] - times[0]) if len(times) > 1 else 0.0
    long = [(start, stop) for start, stop in edges if (stop - start - 1) * step >= least_s - 1e-9]
    pieces = tuple(
        Piece(
            start,
            stop,
            {
                name: LimbPiece(times[start:stop], position[start:stop], orientation[start:stop])
                for name, (_, orientation, position, _) in usable.items()
            },
        )
        for start, stop in long
    )
    lost = len(times) - sum(stop - start for start, stop in long)
    return Pieces(pieces, len(edges) - len(long), lost, without)


def _filled(times: F64, position: F64) -> F64:
    """Return positions with short gaps interpolated linearly."""
    known = np.isfinite(position).all(axis=1)
    if known.all() or not known.any():
        return position
    at = times[known]
    filled = np.stack([np.interp(times, at, position[known, axis]) for axis in range(3)], axis=1)
    after = np.minimum(np.searchsorted(at, times), len(at) - 1)
    before = np.maximum(after - (at[after] > times), 0)
    near = (at[after] - at[before] <= SHORT_GAP_S * (1 + 1e-9)) & (times >= at[0]) & (times <= at[-1])
    filled[~near] = np.nan
    return filled


def _glued(times: F64, position: F64) -> Bool:
    """Return the frames at both ends of a step that is too fast for a person, bool (T,)."""
    found = np.zeros(len(times), np.bool_)
    with np.errstate(invalid="ignore"):
        fast = np.linalg.norm(np.diff(position, axis=0), axis=1) > FASTEST_M_S * np.diff(times)
    found[:-1] |= fast
    found[1:] |= fast
    return found


@dataclass(frozen=True)
class WearOptions:
    """The way in which simulated sensors are worn and sampled.

    Attributes
    ----------
    seed : int
        Seed of all random numbers, 0 or above.
    rate_hz : float
        Samples per second.
    grade : Grade
        The errors of the sensors.
    lever_m : tuple of float
        The vector from the middle of a limb to its sensor, in metres, in the limb's own axes.
    field_ut, inclination_deg, declination_deg : float
        The magnetic field: strength in µT, inclination below the horizon, and angle between the X axis of the
        sensors' world F_GI and magnetic north.
    stand_s : float
        Seconds that the actor holds the first pose before each piece, and the last one after it.
    mount : {"random", "limb"}
        The rotation between sensor and limb: drawn for each actor and limb, or none, with the axes of the limb.
    """

    seed: int = 0
    rate_hz: float = 100.0
    grade: Grade = field(default_factory=Grade)
    lever_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    field_ut: float = FIELD_UT
    inclination_deg: float = INCLINATION_DEG
    declination_deg: float = 0.0
    stand_s: float = 0.0
    mount: str = RANDOM

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise ParameterError("seed", "at least 0", self.seed)
        if not 1.0 <= self.rate_hz <= 10_000.0:
            raise ParameterError("rate_hz", "1 to 10,000 Hz", self.rate_hz)
        if not 0.0 <= self.stand_s <= 60.0:
            raise ParameterError("stand_s", "0 to 60 seconds", self.stand_s)
        if self.mount not in MOUNTS:
            raise ParameterError("mount", f"one of {', '.join(MOUNTS)}", self.mount)


@dataclass(frozen=True, eq=False)
class TakeSensors:
    """The sensors of one take.

    Attributes
    ----------
    q_global : float64 array (4,)
        Unit quaternion (w, x, y, z) from the sensors' world F_GI to the take's world.
    mounts : dict of str to float64 array (4,)
        Limb → unit quaternion from the sensor's axes to those of the limb.
    clock : Clock
        The clock that all sensors of the take share.
    """

    q_global: F64
    mounts: dict[str, F64]
    clock: Clock


@dataclass(frozen=True, eq=False)
class SampledPiece:
    """The readings of a piece of a take.

    Attributes
    ----------
    piece : Piece
        The piece.
    times : float64 array (N,)
        Times on the sensors' clock, in seconds.
    take_times : float64 array (N,)
        Times in the take, in seconds.
    readings : dict of str to Readings
        Limb → the readings of its sensor.
    """

    piece: Piece
    times: F64
    take_times: F64
    readings: dict[str, Readings]


def worn_sensors(wearing: WearOptions, take: str, actor: str | None, limbs: Mapping[str, object]) -> TakeSensors:
    """Draw heading, mounts and clock of a take's sensors; takes of one actor share heading and mounts.

    Parameters
    ----------
    wearing : WearOptions
        Seed and grade.
    take : str
        Name of the take.
    actor : str or None
        Its actor; a take without one has a heading and mounts of its own.
    limbs : mapping of str to object
        The limbs, by name.
    """
    who = f"actor {actor}" if actor else f"take {take}"
    heading = float(seeded_generator(wearing.seed, "heading", who).uniform(-180.0, 180.0))
    mounts = {limb: np.array([1.0, 0.0, 0.0, 0.0]) for limb in limbs}
    if wearing.mount == RANDOM:
        mounts = {limb: random_mount(seeded_generator(wearing.seed, "mount", who, limb)) for limb in limbs}
    clock = random_clock(wearing.grade, seeded_generator(wearing.seed, "clock", take))
    return TakeSensors(world_rotation(heading), mounts, clock)


def sample_piece(piece: Piece, number: int, take: str, worn: TakeSensors, wearing: WearOptions) -> SampledPiece:
    """Return the readings of all sensors in a piece of a take.

    Parameters
    ----------
    piece : Piece
        The piece.
    number : int
        Its number in the take, which determines its random numbers.
    take : str
        Name of the take.
    worn : TakeSensors
        Mounts and clock.
    wearing : WearOptions
        The rate, sensor grade and magnetic field.
    """
    limbs = {limb: _held(own, wearing.stand_s) for limb, own in piece.limbs.items()}
    first = next(iter(limbs.values())).times
    start, stop = worn.clock.of_take(np.array([first[0], first[-1]]))
    ticks = np.arange(np.ceil(start * wearing.rate_hz - 1e-6), np.floor(stop * wearing.rate_hz + 1e-6) + 1)
    times = ticks / wearing.rate_hz
    take_times = np.clip(worn.clock.to_take(times), first[0], first[-1])
    field_ut = magnetic_field(wearing.field_ut, wearing.inclination_deg, wearing.declination_deg)
    readings = {}
    for limb, own in limbs.items():
        motion = sensor_motion(
            own.times, own.position, own.orientation, take_times, worn.q_global, worn.mounts[limb],
            np.array(wearing.lever_m),
        )  # fmt: skip
        random = seeded_generator(wearing.seed, "noise", take, limb, str(number))
        readings[limb] = measured(motion, wearing.grade, field_ut, random)
    return SampledPiece(piece, times, take_times, readings)


def _held(own: LimbPiece, seconds: float) -> LimbPiece:
    """Return a limb that holds its first pose before the piece, and its last pose after it, for some seconds."""
    step = (own.times[-1] - own.times[0]) / (len(own.times) - 1)
    frames = round(seconds / step)
    if not frames:
        return own
    ahead = own.times[0] - step * np.arange(frames, 0, -1)
    behind = own.times[-1] + step * np.arange(1, frames + 1)
    place, turn = (
        np.concatenate([np.repeat(rows[:1], frames, axis=0), rows, np.repeat(rows[-1:], frames, axis=0)])
        for rows in (own.position, own.orientation)
    )
    return LimbPiece(np.concatenate([ahead, own.times, behind]), place, turn)
