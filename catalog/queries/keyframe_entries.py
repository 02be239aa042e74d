"""Chains of keyframes as query files write them: poses by feature names or patterns, and the gaps between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from kinedex.catalog.configs import Located
from kinedex.catalog.feature_definitions import WordSet
from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.gap_entries import read_gap
from kinedex.catalog.queries.keyframe_query import SAME_FRAME, Gap, Keyframe
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.search.gaps import UNBOUNDED

_SHORTER_PATTERNS = {"mix": 13}
"""Sets whose patterns may be shorter, and their length in the papers: F40 was added to mix later."""


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
        Their template columns, where the file gives them.
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
        At the first fault, with its line, what was expected, and the nearest valid name.
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
    """Read the gaps of a query, in whichever of the allowed forms they are written."""
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
    """Read a keyframe; features of several sets make several keyframes, which share a frame."""
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
