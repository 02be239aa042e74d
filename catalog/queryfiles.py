"""Query files: keyframe queries as YAML that people write, the papers' JSON included, and the way back."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from catalog.configs import Located, config_path, load_yaml, parse_yaml
from catalog.features import FeatureSet, WordSet
from catalog.queries import SAME_FRAME, Gap, Keyframe, KeyframeQuery, features_of, pattern_of
from ops.errors import KinedexError, did_you_mean
from ops.keyframes import UNBOUNDED

ANALYSIS_RATE_HZ = 30.0
_SHORTER_PATTERNS = {"mix": 13}
"""Sets whose patterns may end before the last feature, as the papers' do: F40 came to mix later."""


def read_queries(
    name_or_path: str | Path, feature_set: FeatureSet, rate_hz: float = ANALYSIS_RATE_HZ
) -> tuple[KeyframeQuery, ...]:
    """Read a file of keyframe queries, YAML or the papers' JSON.

    Parameters
    ----------
    name_or_path: a file, or the name of one in `configs/queries/`.
    feature_set: the features that the file speaks of.
    rate_hz: the analysis rate, by which seconds become frames.

    Raises
    ------
    ConfigError: the first fault, with its line, what was expected, and the nearest valid name.
    """
    return _queries(load_yaml(config_path("queries", name_or_path)), feature_set, rate_hz)


def parse_queries(
    text: str, feature_set: FeatureSet, path: str | Path = "queries", rate_hz: float = ANALYSIS_RATE_HZ
) -> tuple[KeyframeQuery, ...]:
    """Like `read_queries`, for text that is already read; `path` is what errors name."""
    return _queries(parse_yaml(text, path), feature_set, rate_hz)


def write_queries(queries: Iterable[KeyframeQuery], feature_set: FeatureSet) -> str:
    """Write queries as YAML that `read_queries` reads as the same queries.

    Keyframes are written by feature names; parts in different sets that share a frame become one keyframe again.

    Parameters
    ----------
    queries: queries over the sets of `feature_set`, of different names.
    feature_set: the features whose names are written.

    Returns
    -------
    The text of a query file.
    """
    return "\n".join(_written(query, feature_set) for query in queries) or "{}\n"


# ---- the file --------------------------------------------------------------------------------------------


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
    set: str | None = None
    feature_set: str | None = None
    pattern: Annotated[str | None, BeforeValidator(_unquoted_pattern)] = None
    on: _Names | None = None
    off: _Names | None = None


class _GapEntry(BaseModel):
    model_config = ConfigDict(extra="forbid")
    frames: int | None = Field(default=None, ge=0, le=UNBOUNDED)
    seconds: float | None = Field(default=None, ge=0, allow_inf_nan=False)
    range: tuple[int, int | None] | None = None
    seconds_range: tuple[float, float | None] | None = None
    stiffness: float | None = Field(default=None, ge=0, le=1)


class _QueryEntry(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str | None = None
    description: str = ""
    target: str | None = Field(default=None, alias="class")
    keyframes: list[_KeyframeEntry] = Field(min_length=1)
    gaps: list[_GapEntry] | None = None
    distances: list[Annotated[int, Field(ge=0, le=UNBOUNDED)]] | None = None
    stiffness: list[Annotated[float, Field(ge=0, le=1)]] | None = None
    positions: list[Annotated[int, Field(ge=0)]] | None = None


def _queries(located: Located, feature_set: FeatureSet, rate_hz: float) -> tuple[KeyframeQuery, ...]:
    located = _with_switches(located)
    items: list[tuple[str | int, Any]]
    if isinstance(located.data, list):
        items = list(enumerate(located.data))
    else:
        items = list(located.mapping().items())
    found: dict[str, KeyframeQuery] = {}
    for key, body in items:
        if not isinstance(body, dict):
            raise located.error("a query is a mapping with `keyframes` and `gaps`", key)
        _refuse_unknown_keys(located, key, body)
        entry = located.model(_QueryEntry, key, data=body)
        name = _query_name(located, key, entry)
        if name in found:
            raise located.error(f"a second query is named '{name}'", key)
        found[name] = _query(located, key, name, entry, feature_set, rate_hz)
    return tuple(found.values())


def _refuse_unknown_keys(located: Located, key: str | int, body: dict[Any, Any]) -> None:
    """A misspelt key is told as such, before the key that it was meant to be is missed."""
    parts: list[tuple[Any, type[BaseModel], tuple[str | int, ...]]] = [(body, _QueryEntry, (key,))]
    inner: dict[str, type[BaseModel]] = {"keyframes": _KeyframeEntry, "gaps": _GapEntry}
    for name, model in inner.items():
        items = body.get(name)
        parts += [(item, model, (key, name, i)) for i, item in enumerate(items if isinstance(items, list) else [])]
    for part, model, at in parts:
        known = [field.alias or name for name, field in model.model_fields.items()]
        for word in part if isinstance(part, dict) else ():
            if word not in known:
                raise located.error(f"no such key{did_you_mean(str(word), known)}", *at, word)


def _with_switches(located: Located) -> Located:
    """YAML 1.1 takes the keys `on` and `off` for true and false; here they are words."""

    def word(step: Any) -> Any:
        return "on" if step is True else "off" if step is False else step

    def renamed(part: Any) -> Any:
        if isinstance(part, dict):
            return {word(key): renamed(inner) for key, inner in part.items()}
        return [renamed(inner) for inner in part] if isinstance(part, list) else part

    lines = {tuple(word(step) for step in key): line for key, line in located.lines.items()}
    return Located(located.path, renamed(located.data), lines)


def _query_name(located: Located, key: str | int, entry: _QueryEntry) -> str:
    if isinstance(located.data, list):
        if entry.name is None:
            raise located.error("this key is missing", key, "name")
        return entry.name
    if not isinstance(key, str):
        raise located.error("the name of a query must be a text; put it in quotes", key)
    if entry.name not in (None, key):
        raise located.error(f"the query is already named '{key}'", key, "name")
    return key


def _query(
    located: Located, key: str | int, name: str, entry: _QueryEntry, feature_set: FeatureSet, rate_hz: float
) -> KeyframeQuery:
    gaps = _gaps(located, key, entry, rate_hz)
    if len(gaps) != len(entry.keyframes) - 1:
        raise located.error(
            f"{len(entry.keyframes)} keyframes need {len(entry.keyframes) - 1} gaps between them, found {len(gaps)}",
            *(key, "gaps" if entry.gaps is not None else "distances" if entry.distances is not None else "keyframes"),
        )
    positions = entry.positions
    if positions is not None and len(positions) != len(entry.keyframes):
        raise located.error(
            f"must be one template column for each of the {len(entry.keyframes)} keyframes, found {len(positions)}",
            *(key, "positions"),
        )
    if positions is not None and positions != sorted(positions):
        raise located.error(f"must not fall from one keyframe to the next, got {positions}", key, "positions")
    keyframes: list[Keyframe] = []
    between: list[Gap] = []
    columns: list[int] = []
    for i, frame in enumerate(entry.keyframes):
        parts = _keyframe(located, frame, feature_set, key, "keyframes", i)
        if i:
            between.append(gaps[i - 1])
        between += [SAME_FRAME] * (len(parts) - 1)
        keyframes += parts
        columns += [positions[i] if positions is not None else 0] * len(parts)
    return KeyframeQuery(
        name=name,
        target=entry.target or name,
        keyframes=tuple(keyframes),
        gaps=tuple(between),
        positions=None if positions is None else tuple(columns),
        description=entry.description,
    )


def _keyframe(located: Located, entry: _KeyframeEntry, feature_set: FeatureSet, *key: str | int) -> list[Keyframe]:
    if entry.set is not None and entry.feature_set is not None:
        raise located.error("give either `set` or `feature_set`, they mean the same", *key)
    set_key = "set" if entry.set is not None else "feature_set"
    set_name = entry.set if entry.set is not None else entry.feature_set
    if entry.pattern is not None:
        if entry.on is not None or entry.off is not None:
            raise located.error("give either a pattern or features that are `on` and `off`", *key)
        if set_name is None:
            raise located.error("a pattern needs the `set` whose features it is about", *key)
        if set_name not in feature_set.sets:
            raise located.error(f"no such feature set{did_you_mean(set_name, feature_set.sets)}", *key, set_key)
        return [_from_pattern(located, entry.pattern, feature_set.sets[set_name], *key, "pattern")]
    if set_name is not None:
        raise located.error("a `set` goes with a pattern; named features know their sets", *key, set_key)
    return _from_names(located, entry, feature_set, *key)


def _from_pattern(located: Located, pattern: str, word_set: WordSet, *key: str | int) -> Keyframe:
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
                raise located.error(f"the feature '{feature.name}' stands twice in this keyframe", *key, switch, i)
            masks[word_set.name] |= bit
            values[word_set.name] |= bit * (switch == "on")
    found = [Keyframe(name, mask, values[name]) for name, mask in masks.items() if mask]
    if not found:
        raise located.error("a keyframe needs a pattern, or features that are `on` or `off`", *key)
    return found


def _gaps(located: Located, key: str | int, entry: _QueryEntry, rate_hz: float) -> list[Gap]:
    if entry.gaps is not None:
        if entry.distances is not None or entry.stiffness is not None:
            raise located.error("give either `gaps` or `distances` with `stiffness`", key, "gaps")
        return [_gap(located, gap, rate_hz, key, "gaps", i) for i, gap in enumerate(entry.gaps)]
    distances, stiffness = entry.distances or [], entry.stiffness or []
    if len(distances) != len(stiffness):
        raise located.error(
            f"must be as many as the {len(distances)} distances, found {len(stiffness)}", key, "stiffness"
        )
    return [Gap.of_distance(d, s) for d, s in zip(distances, stiffness, strict=True)]


def _gap(located: Located, entry: _GapEntry, rate_hz: float, *key: str | int) -> Gap:
    kinds = [kind for kind in ("frames", "seconds", "range", "seconds_range") if getattr(entry, kind) is not None]
    if len(kinds) != 1:
        got = " and ".join(kinds) or "none of them"
        raise located.error(f"a gap is one of frames, seconds, range or seconds_range, got {got}", *key)
    if kinds[0] in ("frames", "seconds"):
        if entry.stiffness is None:
            raise located.error(
                "a distance needs its `stiffness`, from 0 (any later frame) to 1 (exactly this distance)", *key
            )
        distance = entry.frames if entry.frames is not None else round((entry.seconds or 0.0) * rate_hz)
        if distance > UNBOUNDED:
            raise located.error(f"must be at most {UNBOUNDED} frames, got {distance}", *key, "seconds")
        return Gap.of_distance(distance, entry.stiffness)
    if entry.stiffness is not None:
        raise located.error("a range has no stiffness", *key, "stiffness")
    if entry.range is not None:
        low, high = entry.range
        return _range_gap(located, low, UNBOUNDED if high is None else high, entry.range, *key, "range")
    assert entry.seconds_range is not None
    least, most = entry.seconds_range
    if not 0 <= least < math.inf or (most is not None and math.isnan(most)):
        raise located.error(f"must be a range of seconds from 0 up, got {list(entry.seconds_range)}", *key)
    unbounded = most is None or most * rate_hz >= UNBOUNDED
    low = math.ceil(round(least * rate_hz, 9))
    high = UNBOUNDED if unbounded else math.floor(round((most or 0.0) * rate_hz, 9))
    return _range_gap(located, low, high, entry.seconds_range, *key, "seconds_range")


def _range_gap(located: Located, low: int, high: int, written: tuple[Any, Any], *key: str | int) -> Gap:
    if not 0 <= low <= high <= UNBOUNDED:
        raise located.error(
            f"must hold a whole number of frames, [low, high] with 0 <= low <= high (null for no upper bound),"
            f" got {list(written)}",
            *key,
        )
    return Gap(low, high)


# ---- the way back ----------------------------------------------------------------------------------------


def _written(query: KeyframeQuery, feature_set: FeatureSet) -> str:
    groups = _frames_shared(query, feature_set)
    lines = [f"{_scalar(query.name)}:"]
    if query.description:
        lines.append(f"  description: {_scalar(query.description)}")
    if query.target != query.name:
        lines.append(f"  class: {_scalar(query.target)}")
    lines.append("  keyframes:")
    lines += [f"    - {_keyframe_text([query.keyframes[i] for i in group], feature_set)}" for group in groups]
    if len(groups) > 1:
        lines.append("  gaps:")
        lines += [f"    - {_gap_text(query.gaps[group[0] - 1])}" for group in groups[1:]]
    if query.positions is not None:
        lines.append(f"  positions: [{', '.join(str(query.positions[group[0]]) for group in groups)}]")
    return "\n".join(lines) + "\n"


def _frames_shared(query: KeyframeQuery, feature_set: FeatureSet) -> list[list[int]]:
    """Group the keyframes that one keyframe of named features would be split into."""
    order = list(feature_set.sets)
    groups = [[0]]
    for i, (before, here) in enumerate(zip(query.keyframes, query.keyframes[1:], strict=False), start=1):
        joined = (
            query.gaps[i - 1] == SAME_FRAME
            and order.index(before.set) < order.index(here.set)
            and before.mask != 0 != here.mask
            and (query.positions is None or query.positions[i - 1] == query.positions[i])
        )
        if joined:
            groups[-1].append(i)
        else:
            groups.append([i])
    return groups


def _keyframe_text(parts: list[Keyframe], feature_set: FeatureSet) -> str:
    if not parts[0].mask:
        return f'{{set: {_scalar(parts[0].set)}, pattern: "{pattern_of(parts[0], feature_set)}"}}'
    on: list[str] = []
    off: list[str] = []
    for part in parts:
        for names, more in zip((on, off), features_of(part, feature_set), strict=True):
            names += [_scalar(name) for name in more]
    switches = [f"{word}: [{', '.join(names)}]" for word, names in (("on", on), ("off", off)) if names]
    return "{" + ", ".join(switches) + "}"


def _gap_text(gap: Gap) -> str:
    if gap.distance is not None and gap.stiffness is not None:
        return f"{{frames: {gap.distance}, stiffness: {gap.stiffness!r}}}"
    return f"{{range: [{gap.low}, {'null' if gap.high == UNBOUNDED else gap.high}]}}"


def _scalar(text: str) -> str:
    """A text as YAML: plain where it reads back as itself, else in quotes."""
    plain = text.isascii() and text.replace("_", "").isalnum() and yaml.safe_load(text) == text
    return text if plain else yaml.safe_dump(text, default_style='"', width=math.inf, allow_unicode=True).strip()
