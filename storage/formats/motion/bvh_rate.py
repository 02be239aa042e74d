"""The frame time of a BVH file, and the rate that it stands for."""

from __future__ import annotations

from decimal import Decimal
from functools import lru_cache

MILLISECONDS = 1000
"""A frame time of more than a second is one in milliseconds."""

_USUAL_HZ = (
    *(24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 72.0, 75.0, 90.0, 100.0, 120.0, 125.0, 144.0, 150.0, 180.0, 200.0),
    *(240.0, 250.0, 256.0, 300.0, 360.0, 400.0, 480.0, 500.0, 600.0, 720.0, 960.0, 1000.0),
    *(24000 / 1001, 30000 / 1001, 60000 / 1001, 120000 / 1001),
)


@lru_cache(maxsize=64)  # The files of an archive state a few.
def frame_rate(frame_time: str) -> float:
    """Return the frames per second of a frame time as it is written.

    Frame times are cut or rounded to a few digits: 0.0083333 stands for 120 Hz and not for 120.0005. So the rate is a
    usual one where its own frame time, cut or rounded to as many digits (or to a 32-bit float), is the one that is
    written and no more than 2.5 % away; whole rates come before those of television (29.97). It is 1 / frame time
    where no usual rate is that near.

    Parameters
    ----------
    frame_time : str
        A positive decimal number of seconds, for instance "0.0333333" or "8.33e-03".
    """
    seconds = float(frame_time)
    exponent = Decimal(frame_time).as_tuple().exponent
    unit = 10.0 ** max(int(exponent), -30)
    best: tuple[bool, float, float] | None = None
    for rate in _USUAL_HZ:
        gap = 1.0 / rate - seconds
        slack = 1e-6 * seconds
        written = abs(gap) <= max(0.5 * unit, slack) or 0.0 <= gap < unit
        if written and abs(gap) <= 0.025 * seconds:
            rank = (rate != int(rate), abs(gap), rate)
            best = rank if best is None else min(best, rank)
    return best[2] if best else 1.0 / seconds


def frame_time(rate_hz: float) -> str:
    """Return a frame time that `frame_rate` turns into a rate: with 8 decimals where they say enough."""
    short = f"{1.0 / rate_hz:.8f}"
    return short if frame_rate(short) == rate_hz else repr(1.0 / rate_hz)
