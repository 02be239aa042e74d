"""Keyframe queries: keyframes over feature sets, the gaps between them, alternatives, and the class they are for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import KinedexError, ParameterError, did_you_mean
from kinedex.ops.search.gaps import UNBOUNDED, gap_bounds, nominal_gap


@dataclass(frozen=True)
class Keyframe:
    """A pose in one feature set: every word of the set with `word & mask == value`; its name is for people alone."""

    set: str
    mask: int
    value: int
    name: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        if self.mask < 0 or self.value & ~self.mask:
            raise ParameterError("value", f"within the bits of the mask {self.mask:#x}", self.value)


@dataclass(frozen=True)
class Gap:
    """How many frames may lie between two keyframes, both ends included (thesis, Eq. 4.4).

    distance and stiffness are what the gap was written as, or None where it was written as a range.
    """

    low: int
    high: int
    distance: int | None = None
    stiffness: float | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.low <= self.high <= UNBOUNDED:
            raise ParameterError("gap", f"a range within 0 to {UNBOUNDED} frames", (self.low, self.high))

    @classmethod
    def of_distance(cls, distance: int, stiffness: float) -> Gap:
        """The gap of a distance in frames and a stiffness (Eq. 4.5 and 4.6)."""
        return cls(*gap_bounds(distance, stiffness), distance, float(stiffness))

    @property
    def nominal_stiffness(self) -> float:
        """The stiffness as written, else the one that the range stands for (Eq. 4.7)."""
        return nominal_gap(self.low, self.high)[1] if self.stiffness is None else self.stiffness


SAME_FRAME = Gap.of_distance(0, 1.0)
"""The gap between the parts of a keyframe whose features lie in several sets: no frame at all, so nothing is lost."""


@dataclass(frozen=True)
class KeyframeQuery:
    """K keyframes and K − 1 gaps; `target` is the class or subclass whose motions it preselects.

    positions: for each keyframe the template column it stands for, or None where that is left to the template.
    margins: how many frames before and after a hit the motion may reach, or None where positions and template say it.
    takes: a SQL filter over the takes that are searched, or None for all. alternatives: further chains of keyframes,
    without alternatives of their own, whose hits are hits of this query as well. takes_at: the file and line where
    `takes` stands, for errors alone.
    """

    name: str
    target: str
    keyframes: tuple[Keyframe, ...]
    gaps: tuple[Gap, ...]
    positions: tuple[int, ...] | None = None
    description: str = ""
    takes: str | None = None
    margins: tuple[int, int] | None = None
    alternatives: tuple[KeyframeQuery, ...] = ()
    takes_at: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        if any(other.alternatives for other in self.alternatives):
            raise ParameterError("alternatives", "without alternatives of their own", self.name)
        if self.margins is not None and min(self.margins) < 0:
            raise ParameterError("margins", "0 or more frames before and after a hit", self.margins)
        if not self.keyframes:
            raise ParameterError("keyframes", "at least one", 0)
        if len(self.gaps) != len(self.keyframes) - 1:
            raise ParameterError("gaps", f"{len(self.keyframes) - 1}, one fewer than keyframes", len(self.gaps))
        if self.positions is not None and len(self.positions) != len(self.keyframes):
            raise ParameterError("positions", f"{len(self.keyframes)}, one for each keyframe", len(self.positions))

    @property
    def chains(self) -> tuple[KeyframeQuery, ...]:
        """The query without its alternatives, and these: what is searched one by one, and united."""
        return (replace(self, alternatives=()), *self.alternatives) if self.alternatives else (self,)

    @property
    def bounds(self) -> list[tuple[int, int]]:
        """The gaps as the search takes them."""
        return [(gap.low, gap.high) for gap in self.gaps]

    @property
    def least_stiffness(self) -> float:
        """The smallest stiffness of all gaps; 0 where all share a frame, which says nothing of the tempo."""
        return min((gap.nominal_stiffness for gap in self.gaps if gap != SAME_FRAME), default=0.0)


def choose_queries(queries: Sequence[KeyframeQuery], names: Sequence[str]) -> tuple[KeyframeQuery, ...]:
    """Pick queries by name, in the order asked for; all of them where no name is given.

    Raises
    ------
    KinedexError: no query of that name; the message names the nearest.
    """
    by_name = {query.name: query for query in queries}
    for name in names:
        if name not in by_name:
            raise KinedexError(f"no query is named '{name}'{did_you_mean(name, by_name)}")
    return tuple(by_name[name] for name in names) if names else tuple(queries)


@dataclass(frozen=True)
class WordPattern:
    """One chain of keyframes in bits of whole words: `masks`, `values`, and the gaps (low, high) between them."""

    masks: tuple[int, ...]
    values: tuple[int, ...]
    gaps: tuple[tuple[int, int], ...]


def word_pattern(chain: KeyframeQuery, feature_set: FeatureSet) -> WordPattern:
    """Write a chain in bits of whole words; keyframes of several sets on the same frame become one.

    Raises
    ------
    KinedexError: a set that the feature set does not have; the message names the nearest.
    """
    masks: list[int] = []
    values: list[int] = []
    gaps: list[tuple[int, int]] = []
    for number, keyframe in enumerate(chain.keyframes):
        shift = feature_set.word_set(keyframe.set).first - 1
        mask, value = keyframe.mask << shift, keyframe.value << shift
        if number:
            gap = chain.gaps[number - 1]
            # where both ask for a feature, they may ask for different things, which no frame meets
            if gap.high == 0 and not masks[-1] & mask:
                masks[-1] |= mask
                values[-1] |= value
                continue
            gaps.append((gap.low, gap.high))
        masks.append(mask)
        values.append(value)
    return WordPattern(tuple(masks), tuple(values), tuple(gaps))


def features_of(keyframe: Keyframe, feature_set: FeatureSet) -> tuple[list[str], list[str]]:
    """The names of the features that a keyframe wants on, and of those it wants off."""
    on: list[str] = []
    off: list[str] = []
    for number in feature_set.word_set(keyframe.set).numbers:
        bit = 1 << (number - feature_set.sets[keyframe.set].first)
        if keyframe.mask & bit:
            (on if keyframe.value & bit else off).append(feature_set.features[number - 1].name)
    return on, off


def words_of(keyframe: Keyframe, feature_set: FeatureSet) -> str:
    """The keyframe in words: the features that it wants on, by name, and those that it wants off after a "not"."""
    on, off = features_of(keyframe, feature_set)
    return ", ".join([*on, *(f"not {name}" for name in off)])


def pattern_of(keyframe: Keyframe, feature_set: FeatureSet) -> str:
    """The keyframe as the papers write it: 0, 1 or * for each feature of its set, the lowest first."""
    count = feature_set.word_set(keyframe.set).count
    letters = ("*" if not keyframe.mask >> i & 1 else str(keyframe.value >> i & 1) for i in range(count))
    return "".join(letters)
