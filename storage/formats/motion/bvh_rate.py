"""Convert between the frame time of a BVH file and the frame rate."""

from __future__ import annotations

from decimal import Decimal
from functools import lru_cache

MILLISECONDS = 1000
"""The factor for frame times above one second, which are taken as milliseconds."""

_USUAL_HZ = (
    *(24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 72.0, 75.0, 90.0, 100.0, 120.0, 125.0, 144.0, 150.0, 180.0, 200.0),
    *(240.0, 250.0, 256.0, 300.0, 360.0, 400.0, 480.0, 500.0, 600.0, 720.0, 960.0, 1000.0),
    *(24000 / 1001, 30000 / 1001, 60000 / 1001, 120000 / 1001),
)


@lru_cache(maxsize=64)  # The files of an archive share a few frame times.
def frame_rate(frame_time: str) -> float:
    """Return the frames per second of a frame time as it is written.

    Frame times are truncated or rounded to a few digits: 0.0083333 stands for 120 Hz and not for 120.0005. So the
    result is a usual rate whose frame time, truncated or rounded to as many digits (or to a 32-bit float), equals the
    given one and which is at most 2.5 % away; integer rates take precedence over those of television (29.97). Without
    such a rate it is 1 / frame time.

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
    """Return a frame time that `frame_rate` converts back to the rate, with 8 decimals if they suffice."""
    short = f"{1.0 / rate_hz:.8f}"
    return short if frame_rate(short) == rate_hz else repr(1.0 / rate_hz)
