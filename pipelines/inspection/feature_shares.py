"""Compute statistics of the features of a take: fractions of frames, runs, and missing joints."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.ops.arrays import U64
from kinedex.ops.intervals import in_seconds
from kinedex.ops.search.runs import feature_runs
from kinedex.ops.words import NO_WORD


def feature_shares(words: U64, rate_hz: float, feature_set: FeatureSet, unknown: Collection[str] = ()) -> pa.Table:
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
        A row for each feature, in order: `feature` (F1, …), `name`, `percent` of the valid frames, number of `runs`,
        `longest_seconds` of a run, and `remark`: the joints that the feature lacks, and whether it is unknown without
        them; NULL where it lacks none.
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
            "longest_seconds": in_seconds(longest, rate_hz),
            "remark": pa.array(_remarks(feature_set, set(unknown)), pa.string()),
        }
    )


def _remarks(feature_set: FeatureSet, unknown: set[str]) -> list[str | None]:
    """Return for each feature a remark on the joints that it lacks, and on whether it is unknown without them."""
    affected = feature_set.without(unknown)
    remarks: list[str | None] = []
    for feature in feature_set.features:
        rule = feature.rule
        fixed, several = rule.joints(range(len(feature_set.joints)))
        lengths = set().union(*rule.length_joints[:1])
        lacks = next(
            (own for which in (fixed, lengths, several) if (own := _names(feature_set, which) & unknown)), set()
        )
        if feature in affected.unknown:
            remarks.append(f"unknown: no {_in_order(feature_set, lacks)}")
        elif feature in affected.scaled:
            remarks.append(
                f"scaled by another limb: no {_in_order(feature_set, _names(feature_set, lengths) & unknown)}"
            )
        elif feature in affected.narrowed:
            remarks.append(f"without {_in_order(feature_set, lacks)}")
        else:
            remarks.append(None)
    return remarks


def _names(feature_set: FeatureSet, joints: set[int]) -> set[str]:
    return {feature_set.joints[joint] for joint in joints}


def _in_order(feature_set: FeatureSet, names: set[str]) -> str:
    return ", ".join(joint for joint in feature_set.joints if joint in names)
