"""Weights of features by which examples that were accepted differ from intervals that were rejected."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from kinedex.ops.templates.derived_templates import WILDCARD
from kinedex.ops.templates.templates import Template, quantise
from kinedex.ops.templates.warping import align
from kinedex.ops.words import NO_WORD, U64, bits

F64 = npt.NDArray[np.float64]


def contradicted_shares(template: Template, clips: Sequence[U64], delta: float) -> F64:
    """Return how much each clip contradicts a template in each feature.

    A clip is aligned with the template by classical DTW of its features with the template's values.

    Parameters
    ----------
    template : Template
        The template, with f features.
    clips : sequence of uint64 array
        The words of C clips; invalid frames are ignored.
    delta : float
        Values within delta of 0 or 1 are fixed, as in `quantise`; the others are contradicted by nothing.

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
    """Return weights of features that set accepted examples apart from rejected intervals.

    A feature is contradicted with some rate by what was accepted and with another by what was rejected. Clips count
    once each, by the share of the feature's entries that they contradict, and half a clip of either kind is added, so
    that few clips state little. Where rejected clips contradict a feature more often, its weight is 1 plus the
    logarithm of the ratio of the odds: if features contradicted independently, costs would then differ by the
    logarithm of the likelihood ratio, which separates the two best. All other features keep the weight 1: they tell the
    motion from the rest of an archive, of which rejected intervals, all of them near, say nothing.

    Parameters
    ----------
    template : Template
        The template of the accepted examples, with f features.
    accepted, rejected : sequence of uint64 array
        The words of examples, and of intervals that are none.
    delta : float
        Values within delta of 0 or 1 are fixed, as in `quantise`.

    Returns
    -------
    float64 array (f,)
        All 1 where nothing is accepted or nothing is rejected.
    """
    if not len(accepted) or not len(rejected):
        return np.ones(template.values.shape[1])
    odds = []
    for clips in (rejected, accepted):
        rate = (contradicted_shares(template, clips, delta).sum(axis=0) + 0.5) / (len(clips) + 1)
        odds.append(rate / (1 - rate))
    # without any contradiction the two rates differ by what is added alone, for different numbers of clips
    prior = (0.5 / (len(rejected) + 0.5)) / (0.5 / (len(accepted) + 0.5))
    ratio = odds[0] / odds[1]
    weights: F64 = 1 + np.maximum(0.0, np.log(ratio / max(1.0, prior)))
    return weights
