"""Read chains of keyframes from query files: poses given by feature names or patterns, and the gaps between them."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from kinedex.catalog.configs import Located
from kinedex.catalog.feature_definitions import WordSet
from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import SAME_FRAME, Gap, Keyframe
from kinedex.ops.errors import KinedexError, ParameterError, did_you_mean
from kinedex.ops.search.gaps import UNBOUNDED

FORMS = (
    '"within 2 s", "0.5 s to 2 s", "5 to 12 frames", "at least 1 s", "exactly 3 frames", "0.5 s ± 0.2 s", '
    '"0.5 s, stiffness 0.6", "any time", "same frame"'
)
"""Examples of texts that are valid gaps, for error messages."""

UNITS = "ms, s, min, h or frames, also written out"
"""The units of time that gaps may have, for error messages."""

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


_SHORTER_PATTERNS = {"mix": 13}
"""The shorter length that patterns of a set may have, as in the papers: F40 was added to the set `mix` later."""


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
        If the value is not a valid gap, or its range contains no whole number of frames.
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
    """Return the gap that contains the whole numbers of frames in a range."""
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


@dataclass(frozen=True)
class Chain:
    """A chain of keyframes of a query file.

    Parameters
    ----------
    keyframes : tuple of Keyframe
        The keyframes.
    gaps : tuple of Gap
        The gaps between them.
    positions : tuple of int or None
        The template column of each keyframe; None if the file gives none.
    """

    keyframes: tuple[Keyframe, ...]
    gaps: tuple[Gap, ...]
    positions: tuple[int, ...] | None = None


def _unquoted_pattern(pattern: object) -> object:
    if isinstance(pattern, int | float):
        raise ValueError("put the pattern in quotes; without them YAML reads a number")
    return pattern


def _as_text(names: object) -> object:
    if isinstance(names, list):
        return [str(name) if isinstance(name, int) and not isinstance(name, bool) else name for name in names]
    return names


_Names = Annotated[list[str], BeforeValidator(_as_text)]


class _KeyframeEntry(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str = ""
    after: Any = None
    set: str | None = None
    feature_set: str | None = None
    pattern: Annotated[str | None, BeforeValidator(_unquoted_pattern)] = None
    on: _Names | None = None
    off: _Names | None = None


class ChainEntry(BaseModel):
    """The part of a query's entry that describes its keyframes."""

    model_config = ConfigDict(extra="forbid")
    keyframes: list[_KeyframeEntry] | None = Field(default=None, min_length=1)
    gaps: list[Any] | None = None
    distances: list[Annotated[int, Field(ge=0, le=UNBOUNDED)]] | None = None
    stiffness: list[Annotated[float, Field(ge=0, le=1)]] | None = None
    positions: list[Annotated[int, Field(ge=0)]] | None = None


def read_chain(located: Located, entry: ChainEntry, feature_set: FeatureSet, rate_hz: float, *key: str | int) -> Chain:
    """Read the keyframes and gaps of one query.

    Parameters
    ----------
    located : Located
        The file, for errors.
    entry : ChainEntry
        The entry of the query.
    feature_set : FeatureSet
        The features of the keyframes.
    rate_hz : float
        The analysis rate, by which seconds become frames.
    *key : str or int
        The key of the entry in the file.

    Raises
    ------
    ConfigError
        If the entry is invalid; the message has the line of the first fault, what was expected, and the nearest valid
        name.
    """
    written = entry.keyframes or []
    gaps = _gaps(located, entry, rate_hz, *key)
    if len(gaps) != len(written) - 1:
        raise located.error(
            f"{len(written)} keyframes need {len(written) - 1} gaps between them, found {len(gaps)}",
            *(*key, "gaps" if entry.gaps is not None else "distances" if entry.distances is not None else "keyframes"),
        )
    positions = entry.positions
    if positions is not None and len(positions) != len(written):
        raise located.error(
            f"must be one template column for each of the {len(written)} keyframes, found {len(positions)}",
            *(*key, "positions"),
        )
    if positions is not None and positions != sorted(positions):
        raise located.error(f"must not fall from one keyframe to the next, got {positions}", *key, "positions")
    keyframes: list[Keyframe] = []
    between: list[Gap] = []
    columns: list[int] = []
    for i, frame in enumerate(written):
        parts = _keyframe(located, frame, feature_set, *key, "keyframes", i)
        if i:
            between.append(gaps[i - 1])
        between += [SAME_FRAME] * (len(parts) - 1)
        keyframes += [replace(part, name=frame.name) for part in parts]
        columns += [positions[i] if positions is not None else 0] * len(parts)
    return Chain(tuple(keyframes), tuple(between), None if positions is None else tuple(columns))


def _gaps(located: Located, entry: ChainEntry, rate_hz: float, *key: str | int) -> list[Gap]:
    """Read the gaps of a query, which may be written in any of the allowed forms."""
    frames = entry.keyframes or []
    with_gap = [i for i, frame in enumerate(frames) if frame.after is not None]
    if with_gap:
        apart = next((name for name in ("gaps", "distances", "stiffness") if getattr(entry, name) is not None), None)
        if apart is not None:
            raise located.error("the keyframes have gaps of their own, as `after`", *key, apart)
        if with_gap[0] == 0:
            raise located.error("no keyframe comes before the first", *key, "keyframes", 0, "after")
        lacking = next((i for i in range(1, len(frames)) if i not in with_gap), None)
        if lacking is not None:
            raise located.error("needs a gap as `after`, since other keyframes have one", *key, "keyframes", lacking)
        return [read_gap(located, frames[i].after, rate_hz, *key, "keyframes", i, "after") for i in with_gap]
    if entry.gaps is not None:
        if entry.distances is not None or entry.stiffness is not None:
            raise located.error("give either `gaps` or `distances` with `stiffness`", *key, "gaps")
        return [read_gap(located, gap, rate_hz, *key, "gaps", i) for i, gap in enumerate(entry.gaps)]
    distances, stiffness = entry.distances or [], entry.stiffness or []
    if len(distances) != len(stiffness):
        raise located.error(
            f"must be as many as the {len(distances)} distances, found {len(stiffness)}", *key, "stiffness"
        )
    return [Gap.of_distance(d, s) for d, s in zip(distances, stiffness, strict=True)]


def _keyframe(located: Located, entry: _KeyframeEntry, feature_set: FeatureSet, *key: str | int) -> list[Keyframe]:
    """Read a keyframe; features of several sets give several keyframes on the same frame."""
    if entry.set is not None and entry.feature_set is not None:
        raise located.error("give either `set` or `feature_set`; they mean the same", *key)
    set_key = "set" if entry.set is not None else "feature_set"
    set_name = entry.set if entry.set is not None else entry.feature_set
    if entry.pattern is not None:
        if entry.on is not None or entry.off is not None:
            raise located.error("give either a pattern or features that are `on` and `off`", *key)
        if set_name is None:
            raise located.error("a pattern needs the `set` of its features", *key)
        if set_name not in feature_set.sets:
            raise located.error(f"no such feature set{did_you_mean(set_name, feature_set.sets)}", *key, set_key)
        return [_from_pattern(located, entry.pattern, feature_set.sets[set_name], *key, "pattern")]
    if set_name is not None:
        raise located.error("a `set` goes with a pattern; named features know their sets", *key, set_key)
    return _from_names(located, entry, feature_set, *key)


def _from_pattern(located: Located, pattern: str, word_set: WordSet, *key: str | int) -> Keyframe:
    """Read a keyframe written as a pattern."""
    lengths = {word_set.count, _SHORTER_PATTERNS.get(word_set.name, word_set.count)}
    if len(pattern) not in lengths:
        expected = " or ".join(str(length) for length in sorted(lengths))
        raise located.error(
            f"a pattern over {word_set.name} has {expected} characters, got {len(pattern)} in '{pattern}'", *key
        )
    mask = value = 0
    for i, letter in enumerate(pattern):
        if letter not in "01*":
            raise located.error(f"must be made of 0, 1 and *, got '{letter}' in '{pattern}'", *key)
        mask |= (letter != "*") << i
        value |= (letter == "1") << i
    return Keyframe(word_set.name, mask, value)


def _from_names(located: Located, entry: _KeyframeEntry, feature_set: FeatureSet, *key: str | int) -> list[Keyframe]:
    """Read a keyframe written with the names of features."""
    masks = dict.fromkeys(feature_set.sets, 0)
    values = dict.fromkeys(feature_set.sets, 0)
    for switch, names in (("on", entry.on or []), ("off", entry.off or [])):
        for i, name in enumerate(names):
            try:
                feature = feature_set.feature(name)
            except KinedexError as fault:
                raise located.error(str(fault), *key, switch, i) from None
            word_set = feature_set.set_of(feature.number)
            bit = 1 << (feature.number - word_set.first)
            if masks[word_set.name] & bit:
                raise located.error(f"the feature '{feature.name}' occurs twice in this keyframe", *key, switch, i)
            masks[word_set.name] |= bit
            values[word_set.name] |= bit * (switch == "on")
    found = [Keyframe(name, mask, values[name]) for name, mask in masks.items() if mask]
    if not found:
        raise located.error("a keyframe needs a pattern, or features that are `on` or `off`", *key)
    return found
