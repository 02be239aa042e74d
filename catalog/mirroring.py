"""Left and right: which features change places when a body is seen in a mirror, and queries of the other side.

The names say it. `rhand_fast` and `lhand_fast` are a pair, because they differ in a leading r and l alone; so are
`shoulders_right` and `shoulders_left`, by what they end in. Any other feature is its own mirror image, which asks of
its rule to say the same of the mirrored body (`feet_apart`); one that does not must have a twin of such a name. For
the 40 features of body40 this is exact on a body that is symmetric in frame 0 (some thresholds are multiples of a right
limb for both sides), while its pelvis does not turn (both hands move forwards with respect to the left hip).
"""

from __future__ import annotations

from dataclasses import replace

from catalog.features import FeatureSet
from catalog.queries import Keyframe, KeyframeQuery
from ops.errors import KinedexError


def mirror_numbers(feature_set: FeatureSet) -> dict[int, int]:
    """The number of each feature's mirror image; its own where it has no twin."""
    numbers = {feature.name: feature.number for feature in feature_set.features}
    return {number: numbers.get(_twin(name, numbers), number) for name, number in numbers.items()}


def mirrored(query: KeyframeQuery, feature_set: FeatureSet) -> KeyframeQuery:
    """The query for the same motion of the other side; mirrored twice, it is the query again.

    Raises
    ------
    KinedexError: a feature and its twin lie in different sets, so that a word has no mirror image.
    """
    numbers = mirror_numbers(feature_set)
    keyframes = tuple(_mirrored(keyframe, feature_set, numbers) for keyframe in query.keyframes)
    others = tuple(mirrored(other, feature_set) for other in query.alternatives)
    return replace(query, keyframes=keyframes, alternatives=others)


def _twin(name: str, names: dict[str, int]) -> str:
    for one, other in (("r", "l"), ("l", "r")):
        if name.startswith(one) and other + name[1:] in names:
            return other + name[1:]
    for one, other in (("_right", "_left"), ("_left", "_right")):
        if name.endswith(one):
            return name.removesuffix(one) + other
    return name


def _mirrored(keyframe: Keyframe, feature_set: FeatureSet, numbers: dict[int, int]) -> Keyframe:
    home = feature_set.word_set(keyframe.set)
    mask = value = 0
    for number in home.numbers:
        bit = 1 << (number - home.first)
        if keyframe.mask & bit:
            if numbers[number] not in home.numbers:
                raise KinedexError(f"F{number} and its mirror image F{numbers[number]} lie in different feature sets")
            twin = 1 << (numbers[number] - home.first)
            mask |= twin
            value |= twin * bool(keyframe.value & bit)
    return replace(keyframe, mask=mask, value=value)
