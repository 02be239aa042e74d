"""Mirrored queries: the same motion of the other side of the body.

The pairs are those of the feature set (`mirror` of its file). For the 40 features of body40 a mirrored query finds
exactly the mirrored motion on a body that is symmetric in frame 0 (some thresholds are multiples of a right limb for
both sides), while its pelvis does not turn (both hands move forwards with respect to the left hip).
"""

from __future__ import annotations

from dataclasses import replace

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import Keyframe, KeyframeQuery
from kinedex.ops.errors import KinedexError


def mirrored(query: KeyframeQuery, feature_set: FeatureSet) -> KeyframeQuery:
    """Return the query for the same motion of the other side; mirroring it twice gives an equal query.

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
    """Return a keyframe in which left and right have changed places."""
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
