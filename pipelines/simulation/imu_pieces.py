"""Divide a take into pieces for which sensors can be simulated: long enough, and without jumps and gaps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.ops.inertial.limb_orientation import NONE
from kinedex.ops.inertial.rotations import interpolate
from kinedex.pipelines.inertial.limb_motion import LimbMotion

F64 = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]

LEAST_SECONDS = 2.0
"""The smallest length of a piece in seconds, unless windows are shorter."""

SHORT_GAP_S = 0.1
"""The longest gap, in seconds, over which frames without an orientation are interpolated."""

FASTEST_M_S = 25.0
"""The speed of a limb, in m/s, above which two clips must have been joined there."""


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
    limbs: Mapping[str, LimbMotion], wanted: tuple[str, ...], named: bool, least_s: float = LEAST_SECONDS
) -> Pieces:
    """Divide a take into pieces for which sensors can be simulated.

    Parameters
    ----------
    limbs : mapping of str to LimbMotion
        The limbs of the take.
    wanted : tuple of str
        The limbs that wear sensors.
    named : bool
        True if the user named them; limbs with a known long axis only are always excluded.
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
