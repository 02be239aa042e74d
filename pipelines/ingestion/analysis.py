"""Analyse bodies: frames and words at the analysis rate, features that lack joints, and the quality of takes."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

import numpy as np

from kinedex.catalog.feature_definitions import Feature
from kinedex.catalog.features import FeatureSet
from kinedex.catalog.quality import quality_columns, quality_warnings
from kinedex.ops.arrays import F64, U64
from kinedex.ops.body import features
from kinedex.ops.body.plausibility import Plausibility, plausibility
from kinedex.ops.body.resample import feature_rate, resample
from kinedex.ops.intervals import in_seconds
from kinedex.ops.words import NO_WORD
from kinedex.storage.formats.motion.reader import Body


def analyse(body: Body, feature_set: FeatureSet, rate_hz: float) -> tuple[F64, F64, U64]:
    """Compute features at the rate of the source, and sample them at the analysis rate.

    Parameters
    ----------
    body : Body
        The positions of joints at the source rate.
    feature_set : FeatureSet
        The features to compute.
    rate_hz : float
        The analysis rate, in frames per second.

    Returns
    -------
    positions : float64 array (J, 3, T)
        The positions of the joints in metres.
    orientation : float64 array (4, T)
        The orientation of the root, as unit quaternions (w, x, y, z).
    words : uint64 array (T,)
        The words: `NO_WORD` in invalid frames, with 0 in the bits of unknown features.
    """
    rate = feature_rate(body.rate_hz, rate_hz)
    at_rate = resample(body.positions, body.orientation, body.rate_hz, rate, body.valid)
    words = features.words(
        at_rate.positions, at_rate.orientation, rate, feature_set.rules, at_rate.valid, feature_set.plugin_primitives
    )
    known = known_features(feature_set, body)
    if known != feature_set.every_bit:
        words = np.where(words == NO_WORD, NO_WORD, words & np.uint64(known))
    step = round(rate / rate_hz)
    return at_rate.positions[:, :, ::step], at_rate.orientation[:, ::step], words[::step]


def known_features(feature_set: FeatureSet, body: Body) -> int:
    """Return the mask of the features that are known for a body, with the bits of a word."""
    known = feature_set.known(body.unknown)
    if np.isnan(body.orientation).all():
        rotations = [
            one.number for one in feature_set.features if any(t.primitive == "turn_rate" for t in one.rule.terms)
        ]
        known &= ~sum(1 << (number - 1) for number in rotations)
    return known


def unknown_feature_warnings(feature_set: FeatureSet, body: Body) -> list[str]:
    """Return warnings on features that are unknown, or computed from fewer joints, because a skeleton lacks joints."""
    known = known_features(feature_set, body)
    if not body.unknown and known == feature_set.every_bit:
        return []
    unknown = _listed(one for one in feature_set.features if not known >> (one.number - 1) & 1)
    lacks = f"has no {', '.join(body.unknown)}" if body.unknown else "does not give the orientation of the root"
    warnings = [f"skeleton mapping '{body.skeleton}' {lacks}; these features are unknown: {unknown or 'none'}"]
    affected, joints = feature_set.without(body.unknown), ", ".join(body.unknown)
    if affected.narrowed:
        warnings.append(f"without {joints} these features use the other joints only: {_listed(affected.narrowed)}")
    if affected.scaled:
        warnings.append(f"without {joints} these features are scaled by another limb: {_listed(affected.scaled)}")
    return warnings


def _listed(features: Iterable[Feature]) -> str:
    return ", ".join(f"F{feature.number} {feature.name}" for feature in features)


def figures_of(body: Body, joints: tuple[str, ...]) -> Plausibility:
    """Measure the quality figures of a body with the given joint names."""
    return plausibility(body.positions, joints, body.rate_hz, body.valid)


def measured_quality(body: Body, joints: tuple[str, ...], stored: Collection[str]) -> tuple[dict[str, Any], list[str]]:
    """Return the quality figures of a body, and warnings about it.

    Parameters
    ----------
    body : Body
        The body that a reader returned.
    joints : tuple of str
        The names of its joints.
    stored : collection of str
        The columns of figures that the store has, see `stored_figures`.

    Returns
    -------
    columns : dict of str to value
        The figures of the stored columns, None for an unknown one.
    warnings : list of str
        A sentence for each figure beyond its limits.
    """
    figures = figures_of(body, joints)
    recognition: dict[str, Any] = {
        "recognition_confidence": body.confidence,
        "estimated_joints": " ".join(body.estimated),
    }
    recognition |= {"file_up": body.up or None, "filled_frames": body.filled_frames, "filled_from": body.filled_from}
    columns = {name: value for name, value in (recognition | quality_columns(figures)).items() if name in stored}
    return columns, quality_warnings(figures, body.rate_hz)


def body_row(
    body: Body, words: U64, feature_set: FeatureSet, rate_hz: float, stored: Collection[str]
) -> dict[str, Any]:
    """Return the columns of `takes` that follow from a body: skeleton, time, quality, warnings and known features.

    Parameters
    ----------
    body : Body
        The body as it was read.
    words : uint64 array (T,)
        Its words at the analysis rate.
    feature_set : FeatureSet
        The features of the words.
    rate_hz : float
        The analysis rate, in frames per second.
    stored : collection of str
        The names of the quality figures that the store has (`stored_figures`).
    """
    known = known_features(feature_set, body)
    figures, doubts = measured_quality(body, feature_set.joints, stored)
    return figures | {
        "skeleton": body.skeleton,
        "unit": body.unit,
        "source_rate_hz": body.rate_hz,
        "source_frames": body.frames,
        "rate_hz": rate_hz,
        "frames": len(words),
        "seconds": in_seconds(body.frames, body.rate_hz),
        "invalid_frames": int(np.count_nonzero(words == NO_WORD)),
        "warnings": [*body.warnings, *unknown_feature_warnings(feature_set, body), *doubts],
        "known": None if known == feature_set.every_bit else known,
    }
