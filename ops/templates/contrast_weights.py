"""This module weights features by how they distinguish accepted examples from rejected intervals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.templates.derived_templates import WILDCARD
from kinedex.ops.templates.templates import Template, quantise
from kinedex.ops.templates.warping import align
from kinedex.ops.words import NO_WORD, U64, bits


def contradicted_shares(template: Template, clips: Sequence[U64], delta: float) -> F64:
    """Return the fraction of each feature's template entries that each clip contradicts.

    A clip is aligned with the template by classical DTW of its features with the template's values.

    Parameters
    ----------
    template : Template
        The template, with f features.
    clips : sequence of uint64 array
        The words of C clips; invalid frames are ignored.
    delta : float
        Values within delta of 0 or 1 are fixed, as in `quantise`; the others cannot be contradicted.

    Returns
    -------
    float64 array (C, f)
        The share of the fixed entries of a feature, along the path, that the clip contradicts; 0 where none is fixed.
    """
    features = template.values.shape[1]
    fixed = quantise(template, delta).values(features)
    shares = np.zeros((len(clips), features))
    for place, words in enumerate(clips):
        valid = words[words != NO_WORD]
        if not len(valid):
            continue
        seen = bits(valid, features).astype(np.float64)
        local = np.abs(template.values[:, None, :] - seen[None, :, :]).mean(axis=2)
        path = align(local, np.ones(len(template)), np.ones(len(valid))).path
        asked, found = fixed[path[:, 0]], seen[path[:, 1]]
        compared = asked != WILDCARD
        wrong = compared & (asked != found)
        shares[place] = wrong.sum(axis=0) / np.maximum(compared.sum(axis=0), 1)
    return shares


def contrast_weights(template: Template, accepted: Sequence[U64], rejected: Sequence[U64], delta: float) -> F64:
    """Return feature weights that distinguish accepted examples from rejected intervals.

    For each feature, the rates of contradiction by accepted and by rejected clips are compared. Each clip counts once,
    by the share of the feature's entries that it contradicts, and half a clip of either kind is added for smoothing, so
    that few clips have little effect. Where rejected clips contradict a feature more often, its weight is 1 plus the
    logarithm of the ratio of the odds: if features contradicted independently, costs would then differ by the logarithm
    of the likelihood ratio, which separates the two best. All other features keep the weight 1: they distinguish the
    motion from the rest of an archive, which rejected intervals, all of them similar to the motion, do not represent.

    Parameters
    ----------
    template : Template
        The template of the accepted examples, with f features.
    accepted, rejected : sequence of uint64 array
        The words of accepted examples, and of rejected intervals.
    delta : float
        Values within delta of 0 or 1 are fixed, as in `quantise`.

    Returns
    -------
    float64 array (f,)
        The weights, all 1 without accepted or without rejected clips.
    """
    if not len(accepted) or not len(rejected):
        return np.ones(template.values.shape[1])
    odds = []
    for clips in (rejected, accepted):
        rate = (contradicted_shares(template, clips, delta).sum(axis=0) + 0.5) / (len(clips) + 1)
        odds.append(rate / (1 - rate))
    # without contradictions the rates differ only by smoothing, for different numbers of clips
    prior = (0.5 / (len(rejected) + 0.5)) / (0.5 / (len(accepted) + 0.5))
    ratio = odds[0] / odds[1]
    weights: F64 = 1 + np.maximum(0.0, np.log(ratio / max(1.0, prior)))
    return weights
