"""Replace impossible rates of files with a wrong header by likely ones, estimated from the motion."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.body.tempo import likely_rate
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.reader import ReadSettings

F64 = npt.NDArray[np.float64]

SLOWEST_LIKELY_HZ, FASTEST_LIKELY_HZ = 5.0, 1000.0
"""The range of plausible rates; a stated rate outside it is compared with the motion."""

_FAR = 4.0  # ratio to the likely rate from which a doubtful rate is replaced
_SWUNG = ("lwrist", "rwrist", "lankle", "rankle")


def corrected_rate(
    path: str | Path,
    stated_hz: float,
    positions: F64,
    joints: tuple[str, ...],
    settings: ReadSettings,
    warnings: list[str],
    statement: str = "",
) -> float:
    """Return the rate of a file, or the likely one if it is impossible, such as the 1 Hz of `Frame Time: 1.0`.

    Parameters
    ----------
    path : str or Path
        The file that an error names.
    stated_hz : float
        The rate that the file states; NaN, infinite, 0 or negative if its statement is not valid.
    positions : float64 array (J, 3, T)
        The named joints, in any unit.
    joints : tuple of str
        The names of the J joints.
    settings : ReadSettings
        Settings of the user; a rate in them takes precedence over the file's.
    warnings : list of str
        A sentence is appended if another rate than the stated one is used.
    statement : str, optional
        The statement in the file's words, for messages: "Frame Time 1.0"; by default its rate.

    Returns
    -------
    float
        Frames per second.

    Raises
    ------
    SourceError
        The stated rate is not a positive number, and none can be estimated from the motion.
    """
    if settings.override_rate_hz is not None:
        known = math.isfinite(stated_hz) and stated_hz > 0
        return settings.rate_of(stated_hz, warnings) if known else settings.override_rate_hz
    if SLOWEST_LIKELY_HZ <= stated_hz <= FASTEST_LIKELY_HZ:
        return stated_hz
    claim = statement or f"{stated_hz:.6g} Hz"
    tracks = positions[[i for i, joint in enumerate(joints) if joint in _SWUNG]]
    likely = likely_rate(tracks[np.isfinite(tracks).any(axis=(1, 2))])
    stated = math.isfinite(stated_hz) and stated_hz > 0
    if likely is None and not stated:
        raise SourceError(path, f"its rate is not known: it states {claim}, and nothing moves; give --rate HZ")
    if likely is None or (stated and 1 / _FAR <= stated_hz / likely <= _FAR):
        return stated_hz
    warnings.append(
        f"its rate is wrong: it states {claim}, but hands and feet move as they do at about {likely:g} Hz, at which it "
        "is read; if you know the rate, give --rate HZ"
    )
    return likely
