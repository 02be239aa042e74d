"""Statistics of the features of a take: shares of frames, runs, and features that lack a joint."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from kinedex.catalog.features import Feature, FeatureSet
from kinedex.ops.search.runs import feature_runs
from kinedex.ops.words import NO_WORD


def feature_shares(
    words: npt.NDArray[np.uint64], rate_hz: float, feature_set: FeatureSet, unknown: Collection[str] = ()
) -> pa.Table:
    """Count the frames and runs in which every feature holds.

    Parameters
    ----------
    words : uint64 array (T,)
        The words of one take; `NO_WORD` in invalid frames.
    rate_hz : float
        Frames per second of the words.
    feature_set : FeatureSet
        The features of the words.
    unknown : collection of str
        Joints that the skeleton of the take lacks.

    Returns
    -------
    pyarrow.Table
        A row for each feature, in order: `feature` (F1, …), `name`, `percent` of the valid frames, `runs`,
        `longest_seconds` of a run, and `remark`: the joints that the feature lacks, NULL where it lacks none.
    """
    count = len(feature_set.features)
    found = feature_runs(words, np.array([0, len(words)]), count)
    lengths = (found.stop - found.start).astype(np.float64)
    place = found.feature - 1
    runs = np.bincount(place, minlength=count)
    frames = np.bincount(place, lengths, minlength=count)
    longest = np.zeros(count)
    np.maximum.at(longest, place, lengths)
    valid = int(np.count_nonzero(words != NO_WORD))
    return pa.table(
        {
            "feature": [f"F{feature.number}" for feature in feature_set.features],
            "name": [feature.name for feature in feature_set.features],
            "percent": 100 * frames / max(valid, 1),
            "runs": runs,
            "longest_seconds": longest / rate_hz,
            "remark": pa.array(
                [_remark(feature, feature_set.joints, set(unknown)) for feature in feature_set.features], pa.string()
            ),
        }
    )


def _remark(feature: Feature, joints: tuple[str, ...], unknown: set[str]) -> str | None:
    """Return the joints that a feature lacks in words, as `FeatureSet.without` treats them."""
    fixed, several = ([joints[i] for i in sorted(which)] for which in feature.rule.joints(range(len(joints))))
    if needed := [joint for joint in fixed if joint in unknown]:
        return f"off in every frame: no {', '.join(needed)}"
    if wanted := [joint for joint in several if joint in unknown]:
        return f"without {', '.join(wanted)}"
    return None
