"""Define keyframe queries, which have keyframes over feature sets, gaps between them, alternatives, and a class.

A mirrored query finds the same motion on the other side of the body. The feature set defines which features are
exchanged (`mirror` in its file). With the 40 features of body40, a mirrored query finds exactly the mirrored motion
under two conditions. The body must be symmetric in frame 0, since some thresholds of both sides are multiples of the
length of a right limb. The pelvis must not rotate, since the forward motion of both hands is measured from the left
hip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import KinedexError, ParameterError, did_you_mean
from kinedex.ops.search.gaps import UNBOUNDED, gap_bounds, nominal_gap
from kinedex.ops.words import is_applied, known_share


@dataclass(frozen=True)
class Keyframe:
    """A pose in one feature set, which matches every word of the set with ``word & mask == value``.

    Parameters
    ----------
    set : str
        The name of the feature set.
    mask, value : int
        Bits of the set, the lowest feature first; bits outside the mask are wildcards.
    name : str
        A descriptive name, which comparisons ignore.
    """

    set: str
    mask: int
    value: int
    name: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        if self.mask < 0 or self.value & ~self.mask:
            raise ParameterError("value", f"within the bits of the mask {self.mask:#x}", self.value)


@dataclass(frozen=True)
class Gap:
    """The admissible number of frames between two keyframes (thesis, Eq. 4.3 and 4.4).

    Parameters
    ----------
    low, high : int
        The range, both ends included; `UNBOUNDED` is no upper bound.
    distance : int or None
        The distance from which the range was computed; None if the gap was written as a range.
    stiffness : float or None
        The stiffness from which the range was computed; None if the gap was written as a range.
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
        """Return the gap of a distance in frames and a stiffness (thesis, Eq. 4.5 and 4.6)."""
        return cls(*gap_bounds(distance, stiffness), distance, float(stiffness))

    @property
    def nominal_stiffness(self) -> float:
        """The stiffness of the gap; if it was written as a range, the stiffness of that range (thesis, Eq. 4.7)."""
        return nominal_gap(self.low, self.high)[1] if self.stiffness is None else self.stiffness


SAME_FRAME = Gap.of_distance(0, 1.0)
"""The gap of 0 frames between keyframes on the same frame, into which features of several sets are split."""


@dataclass(frozen=True)
class KeyframeQuery:
    """A keyframe query in bits and frames (thesis, Section 3.4): K keyframes and K - 1 gaps, and alternatives.

    Parameters
    ----------
    name : str
        The name of the query.
    target : str
        The class or subclass whose motions the query preselects.
    keyframes : tuple of Keyframe
        The K keyframes of the first chain.
    gaps : tuple of Gap
        The K - 1 gaps between them.
    positions : tuple of int or None
        The template column of each keyframe; None to use the columns that match the template best.
    description : str
        A description of the query.
    takes : str or None
        A SQL filter over the takes that are searched, or None for all takes.
    margins : (int, int) or None
        The number of frames before and after a hit that the motion may extend; None to derive it from the template.
    alternatives : tuple of KeyframeQuery
        Further chains of keyframes whose hits are also hits of this query; they must have no alternatives.
    takes_at : str
        The file and line of `takes`, used only in error messages.
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
        """The query without its alternatives, followed by the alternatives; their hits are united."""
        return (replace(self, alternatives=()), *self.alternatives) if self.alternatives else (self,)

    @property
    def bounds(self) -> list[tuple[int, int]]:
        """The gaps as pairs (low, high), as searches expect them."""
        return [(gap.low, gap.high) for gap in self.gaps]

    @property
    def least_stiffness(self) -> float:
        """The smallest stiffness of all gaps; 0 if all keyframes are on one frame, since the tempo is then unknown."""
        return min((gap.nominal_stiffness for gap in self.gaps if gap != SAME_FRAME), default=0.0)


def choose_queries(queries: Sequence[KeyframeQuery], names: Sequence[str]) -> tuple[KeyframeQuery, ...]:
    """Choose queries by name.

    Parameters
    ----------
    queries : sequence of KeyframeQuery
        The queries to choose from.
    names : sequence of str
        The names, in the order of the result; if there are none, all queries are returned.

    Raises
    ------
    KinedexError
        If no query has one of the names; the message gives the nearest.
    """
    by_name = {query.name: query for query in queries}
    for name in names:
        if name not in by_name:
            raise KinedexError(f"no query is named '{name}'{did_you_mean(name, by_name)}")
    return tuple(by_name[name] for name in names) if names else tuple(queries)


@dataclass(frozen=True)
class WordPattern:
    """A chain of keyframes whose masks and values are bits of whole words, not of single feature sets.

    Parameters
    ----------
    masks, values : tuple of int
        The mask and the value of each of K keyframes.
    gaps : tuple of (int, int)
        The K - 1 gaps (low, high) between them, in frames.
    """

    masks: tuple[int, ...]
    values: tuple[int, ...]
    gaps: tuple[tuple[int, int], ...]


def word_pattern(chain: KeyframeQuery, feature_set: FeatureSet) -> WordPattern:
    """Convert a chain to bits of whole words; keyframes of several sets on the same frame are merged.

    Parameters
    ----------
    chain : KeyframeQuery
        A query, whose alternatives are ignored.
    feature_set : FeatureSet
        The features of the words.

    Raises
    ------
    KinedexError
        If a keyframe is over a set that the feature set does not have; the message gives the nearest.
    """
    masks: list[int] = []
    values: list[int] = []
    gaps: list[tuple[int, int]] = []
    for number, keyframe in enumerate(chain.keyframes):
        shift = feature_set.word_set(keyframe.set).first - 1
        mask, value = keyframe.mask << shift, keyframe.value << shift
        if number:
            gap = chain.gaps[number - 1]
            # merged keyframes may require different values of a feature, so that no frame matches
            if gap.high == 0 and not masks[-1] & mask:
                masks[-1] |= mask
                values[-1] |= value
                continue
            gaps.append((gap.low, gap.high))
        masks.append(mask)
        values.append(value)
    return WordPattern(tuple(masks), tuple(values), tuple(gaps))


def query_share(query: KeyframeQuery, feature_set: FeatureSet, known: int) -> float:
    """Return the fraction of a query's fixed entries whose features are known, the maximum over its alternatives."""
    return max(known_share(_whole_masks(chain, feature_set), known) for chain in query.chains)


def restricted_query(query: KeyframeQuery, feature_set: FeatureSet, known: int) -> KeyframeQuery | None:
    """Return a query for takes in which only some features are known.

    Entries of unknown features become wildcards. Alternatives with too few known entries are excluded.

    Parameters
    ----------
    query : KeyframeQuery
        The query for whole bodies.
    feature_set : FeatureSet
        The features of the query.
    known : int
        The mask of the known features, with the bits of a word.

    Returns
    -------
    KeyframeQuery or None
        The query itself if all features that it fixes are known; None if every alternative has too few known entries.
    """
    if not any(mask & ~known for chain in query.chains for mask in _whole_masks(chain, feature_set)):
        return query
    chains = [
        replace(chain, keyframes=tuple(_restricted(one, feature_set, known) for one in chain.keyframes))
        for chain in query.chains
        if is_applied(_whole_masks(chain, feature_set), known)
    ]
    return replace(chains[0], alternatives=tuple(chains[1:])) if chains else None


def _whole_masks(chain: KeyframeQuery, feature_set: FeatureSet) -> list[int]:
    """Return the mask of each keyframe in bits of whole words."""
    return [one.mask << (feature_set.word_set(one.set).first - 1) for one in chain.keyframes]


def _restricted(keyframe: Keyframe, feature_set: FeatureSet, known: int) -> Keyframe:
    own = known >> (feature_set.word_set(keyframe.set).first - 1)
    return replace(keyframe, mask=keyframe.mask & own, value=keyframe.value & own)


def features_of(keyframe: Keyframe, feature_set: FeatureSet) -> tuple[list[str], list[str]]:
    """Return the names of the features that a keyframe requires to be on, and of those that must be off."""
    on: list[str] = []
    off: list[str] = []
    for number in feature_set.word_set(keyframe.set).numbers:
        bit = 1 << (number - feature_set.sets[keyframe.set].first)
        if keyframe.mask & bit:
            (on if keyframe.value & bit else off).append(feature_set.features[number - 1].name)
    return on, off


def words_of(keyframe: Keyframe, feature_set: FeatureSet) -> str:
    """Describe a keyframe: the names of the features that must be on, then those that must be off, each with "not"."""
    on, off = features_of(keyframe, feature_set)
    return ", ".join([*on, *(f"not {name}" for name in off)])


def pattern_of(keyframe: Keyframe, feature_set: FeatureSet) -> str:
    """Return a keyframe in the papers' notation: 0, 1 or * for each feature of its set, the lowest first."""
    count = feature_set.word_set(keyframe.set).count
    letters = ("*" if not keyframe.mask >> i & 1 else str(keyframe.value >> i & 1) for i in range(count))
    return "".join(letters)


def mirrored(query: KeyframeQuery, feature_set: FeatureSet) -> KeyframeQuery:
    """Return the query for the same motion on the other side of the body; mirroring twice gives an equal query.

    Parameters
    ----------
    query : KeyframeQuery
        A query over the feature set.
    feature_set : FeatureSet
        The features, with their pairs of left and right.

    Raises
    ------
    KinedexError
        If the feature set names no pairs of left and right, or a feature and its mirror image lie in different sets.
    """
    if not feature_set.mirror:
        raise KinedexError(
            f"feature set '{feature_set.name}' does not define which features are left and right, so a query "
            "cannot be mirrored; add `mirror: [[1, 2], …]`, pairs of feature numbers, to its file"
        )
    keyframes = tuple(_mirrored(keyframe, feature_set) for keyframe in query.keyframes)
    others = tuple(mirrored(other, feature_set) for other in query.alternatives)
    return replace(query, keyframes=keyframes, alternatives=others)


def _mirrored(keyframe: Keyframe, feature_set: FeatureSet) -> Keyframe:
    """Return a keyframe in which left and right are exchanged."""
    word_set = feature_set.word_set(keyframe.set)
    mask = value = 0
    for number in word_set.numbers:
        bit = 1 << (number - word_set.first)
        if keyframe.mask & bit:
            other = feature_set.mirrored_number(number)
            if other not in word_set.numbers:
                raise KinedexError(f"F{number} and its mirror image F{other} lie in different feature sets")
            image = 1 << (other - word_set.first)
            mask |= image
            value |= image * bool(keyframe.value & bit)
    return replace(keyframe, mask=mask, value=value)
