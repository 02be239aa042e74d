"""Gaps between keyframes as query files write them: short texts ("within 2 s") or mappings, in frames or seconds."""

from __future__ import annotations

import math
import re
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.configs import Located
from kinedex.catalog.queries.keyframe_query import Gap
from kinedex.ops.errors import ParameterError
from kinedex.ops.search.gaps import UNBOUNDED

FORMS = (
    '"within 2 s", "0.5 s to 2 s", "5 to 12 frames", "at least 1 s", "exactly 3 frames", "0.5 s ± 0.2 s", '
    '"0.5 s, stiffness 0.6", "any time", "same frame"'
)
"""Examples of the texts that are understood."""

UNITS = "ms, s, min, h or frames, also written out"
"""The units of time in these texts."""

_SECONDS = {
    "milliseconds?|ms": 0.001,
    "seconds?|secs?|s": 1.0,
    "minutes?|mins?": 60.0,
    "hours?|h": 3600.0,
}
_UNIT = "|".join(["frames?", *_SECONDS])
_TIME = r"(?P<{0}>\d+(?:\.\d*)?|\.\d+)\s*(?P<{0}_unit>" + _UNIT + ")"
_BARE = _TIME + "?"
_TEXTS = {
    "any": re.compile(r"any ?time"),
    "same": re.compile(r"(?:the )?same frame"),
    "within": re.compile(f"(?:within |up to )+{_TIME.format('high')}"),
    "least": re.compile(f"at least {_TIME.format('low')}"),
    "exact": re.compile(f"exactly {_TIME.format('middle')}"),
    "range": re.compile(f"{_BARE.format('low')}\\s*(?:to|–)\\s*{_TIME.format('high')}"),
    "around": re.compile(f"{_BARE.format('middle')}\\s*(?:±|\\+-|\\+/-)\\s*{_TIME.format('tolerance')}"),
    "soft": re.compile(f"{_TIME.format('middle')},? stiffness (?P<stiffness>(?:\\d*\\.)?\\d+)"),
}


class GapEntry(BaseModel):
    """A gap as a mapping: a distance with a stiffness or a tolerance, or a range."""

    model_config = ConfigDict(extra="forbid")
    frames: int | None = Field(default=None, ge=0, le=UNBOUNDED)
    seconds: float | None = Field(default=None, ge=0, allow_inf_nan=False)
    range: tuple[int, int | None] | None = None
    seconds_range: tuple[float, float | None] | None = None
    stiffness: float | None = Field(default=None, ge=0, le=1)
    tolerance: float | None = Field(default=None, ge=0, allow_inf_nan=False)


def read_gap(located: Located, written: Any, rate_hz: float, *key: str | int) -> Gap:
    """Convert one gap of a query file to a `Gap`.

    Parameters
    ----------
    located : Located
        The file, for errors.
    written : str or dict
        The gap as the file writes it.
    rate_hz : float
        Frames per second.
    *key : str or int
        The key of the gap in the file.

    Raises
    ------
    ConfigError
        If it is no gap, or holds no whole number of frames.
    """
    if isinstance(written, str):
        return _from_text(located, written, rate_hz, *key)
    if not isinstance(written, dict):
        raise located.error(f"must be a gap, such as {FORMS}, got {written!r}", *key)
    return _from_mapping(located, located.model(GapEntry, *key, data=written), rate_hz, *key)


def _from_text(located: Located, text: str, rate_hz: float, *key: str | int) -> Gap:
    """Read a gap written as a text."""
    words = " ".join(text.lower().split())
    found = ((kind, match) for kind, form in _TEXTS.items() if (match := form.fullmatch(words)))
    kind, match = next(found, (None, None))
    if match is None:
        raise located.error(f"'{text}' is no gap; written so: {FORMS}; units are {UNITS}", *key)
    if kind == "any":
        return Gap(0, UNBOUNDED)
    if kind == "same":
        return Gap.of_distance(0, 1.0)
    part = match.groupdict()

    def frames(name: str) -> float:
        unit = part[f"{name}_unit"] or part.get("high_unit") or part.get("tolerance_unit") or ""
        return round(float(part[name]) * _frames_in(unit, rate_hz), 9)

    if kind in ("exact", "soft"):
        stiffness = float(part["stiffness"]) if kind == "soft" else 1.0
        try:
            return Gap.of_distance(round(frames("middle")), stiffness)
        except ParameterError as fault:
            raise located.error(f"'{text}': {fault}", *key) from None
    if kind == "around":
        low, high = frames("middle") - frames("tolerance"), frames("middle") + frames("tolerance")
    else:
        low = 0.0 if kind == "within" else frames("low")
        high = math.inf if kind == "least" else frames("high")
    return _range(located, max(low, 0.0), high, repr(text), *key)


def _frames_in(unit: str, rate_hz: float) -> float:
    """Return the number of frames of a unit of time."""
    return next((seconds * rate_hz for form, seconds in _SECONDS.items() if re.fullmatch(form, unit)), 1.0)


def _from_mapping(located: Located, entry: GapEntry, rate_hz: float, *key: str | int) -> Gap:
    """Read a gap written as a mapping."""
    kinds = [kind for kind in ("frames", "seconds", "range", "seconds_range") if getattr(entry, kind) is not None]
    if len(kinds) != 1:
        got = " and ".join(kinds) or "none of them"
        raise located.error(f"a gap is one of frames, seconds, range or seconds_range, got {got}", *key)
    if kinds[0] in ("frames", "seconds"):
        return _from_distance(located, entry, rate_hz, *key)
    for word in ("stiffness", "tolerance"):
        if getattr(entry, word) is not None:
            raise located.error(f"a range has no {word}", *key, word)
    if entry.range is not None:
        low, high = entry.range
        return _range(located, low, math.inf if high is None else high, str(list(entry.range)), *key, "range")
    assert entry.seconds_range is not None
    least, most = entry.seconds_range
    if not 0 <= least * rate_hz < math.inf or (most is not None and math.isnan(most)):
        raise located.error(f"must be a range of seconds from 0 up, got {list(entry.seconds_range)}", *key)
    upper = math.inf if most is None else round(most * rate_hz, 9)
    return _range(located, round(least * rate_hz, 9), upper, str(list(entry.seconds_range)), *key, "seconds_range")


def _from_distance(located: Located, entry: GapEntry, rate_hz: float, *key: str | int) -> Gap:
    """Read a gap written as a distance with a stiffness or a tolerance."""
    unit = 1.0 if entry.frames is not None else rate_hz
    middle = float(entry.frames) if entry.frames is not None else (entry.seconds or 0.0) * rate_hz
    if (entry.stiffness is None) == (entry.tolerance is None):
        raise located.error(
            "a distance needs its `stiffness`, from 0 (any later frame) to 1 (exactly this distance), "
            "or else its `tolerance` in the same unit",
            *key,
        )
    if round(middle) > UNBOUNDED:
        raise located.error(f"must be at most {UNBOUNDED} frames, got {round(middle)}", *key, "seconds")
    if entry.stiffness is not None:
        return Gap.of_distance(round(middle), entry.stiffness)
    spread = (entry.tolerance or 0.0) * unit
    low, high = round(middle - spread, 9), round(middle + spread, 9)
    return _range(located, max(low, 0.0), high, f"{entry.tolerance}", *key, "tolerance")


def _range(located: Located, low: float, high: float, written: str, *key: str | int) -> Gap:
    """Return the gap of the whole frames in a range."""
    if low > high:
        raise located.error(f"must have low <= high: the first time must not exceed the second, got {written}", *key)
    least = math.ceil(low)
    most = UNBOUNDED if high >= UNBOUNDED else math.floor(high)
    if not 0 <= least <= most or least > UNBOUNDED:
        raise located.error(
            f"must hold a whole number of frames, [low, high] with 0 <= low <= high (null for no upper bound),"
            f" got {written}",
            *key,
        )
    return Gap(least, most)
