"""This module mirrors, joins, restricts and contrasts templates.

It also computes feature weights that distinguish accepted examples from rejected intervals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from kinedex.ops.arrays import F64, I64, U64, Bool
from kinedex.ops.errors import ParameterError
from kinedex.ops.templates.templates import QuantisedTemplate, Template, quantise
from kinedex.ops.templates.warping import align
from kinedex.ops.words import NO_WORD, bits, is_applied, known_bits

WILDCARD = 0.5


@dataclass(frozen=True)
class Contrast:
    """Two aligned templates, and the entries in which they contradict each other.

    Parameters
    ----------
    path : int64 array (P, 2)
        Pairs of aligned columns of the first and the second template.
    against : int8 array (P, f)
        1 if a feature is on in the first template and off in the second, −1 for the reverse, and 0 if the entries do
        not contradict each other.
    compared : bool array (P, f)
        True if neither entry is a wildcard.
    """

    path: I64
    against: npt.NDArray[np.int8]
    compared: Bool


def mirrored(template: Template, order: I64) -> Template:
    """Return the template of the same motion with left and right exchanged.

    Parameters
    ----------
    template : Template
        A template with f features.
    order : int64 array (f,)
        A permutation of 0 … f − 1 that gives the mirror image of each feature (`FeatureSet.mirror_order`).

    Raises
    ------
    ParameterError
        If the order is not a permutation.
    """
    if not np.array_equal(np.sort(order), np.arange(template.values.shape[1])):
        raise ParameterError(
            "order", f"a permutation of {template.values.shape[1]} features", np.asarray(order).tolist()
        )
    weights = template.feature_weights
    return replace(
        template, values=template.values[:, order], feature_weights=None if weights is None else weights[order]
    )


def adjusted(template: Template, factors: F64, first: int, stop: int) -> Template:
    """Return the columns [first, stop) of a template, with the weights of its features multiplied by factors.

    Parameters
    ----------
    template : Template
        The template, with N columns and f features.
    factors : float64 array (f,)
        The factor of each feature's weight; 0 makes it a wildcard in distance curves.
    first, stop : int
        The columns to keep, 0 ≤ first < stop ≤ N.

    Returns
    -------
    Template
        The new template; it has no feature weights if the template has none and all factors are 1.

    Raises
    ------
    ParameterError
        If no column is left, a factor is negative or not finite, or all features have the weight 0.

    Examples
    --------
    >>> whole = Template(np.eye(3), np.ones(3))
    >>> part = adjusted(whole, np.array([1.0, 0.0, 2.0]), 1, 3)
    >>> part.values.tolist(), part.feature_weights.tolist()
    ([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [1.0, 0.0, 2.0])
    """
    if not 0 <= first < stop <= len(template):
        raise ParameterError("first and stop", f"columns with 0 <= first < stop <= {len(template)}", [first, stop])
    if not (np.isfinite(factors) & (factors >= 0)).all():
        raise ParameterError("factors", "finite and not negative", factors.tolist())
    weights = template.feature_weights
    if weights is not None or (factors != 1).any():
        weights = factors * (1.0 if weights is None else weights)
        if not weights.any():
            raise ParameterError("factors", "above 0 for one feature that counts at least", factors.tolist())
    return Template(template.values[first:stop], template.weights[first:stop], weights)


def joined(templates: Sequence[Template], gap: int) -> Template:
    """Join templates one after the other, with columns of wildcards between two of them (thesis, Figure 3.11 b).

    A path may pass through columns at half or twice the speed, so the wildcards match about gap / 2 to 2 gap arbitrary
    frames.

    Parameters
    ----------
    templates : sequence of Template
        One or more templates of the same features; the feature weights of the first template are used for all.
    gap : int
        The number of wildcard columns between two templates, 0 or more.

    Raises
    ------
    ParameterError
        If there is no template, numbers of features differ, or the gap is negative.
    """
    if not templates:
        raise ParameterError("templates", "at least one template", 0)
    if gap < 0:
        raise ParameterError("gap", "0 or more columns", gap)
    features = {template.values.shape[1] for template in templates}
    if len(features) > 1:
        raise ParameterError("templates", "templates of the same features", sorted(features))
    between = np.full((gap, features.pop()), WILDCARD)
    values, weights = [templates[0].values], [templates[0].weights]
    for template in templates[1:]:
        values += [between, template.values]
        weights += [np.ones(gap), template.weights]
    return Template(np.concatenate(values), np.concatenate(weights), templates[0].feature_weights)


def consistency(template: Template) -> F64:
    """Return the agreement of the clips on each feature, from 0 (half of them on) to 1 (all equal).

    The agreement is the mean of |2 v − 1| over the columns, weighted by the columns' weights.

    Returns
    -------
    float64 array (f,)
    """
    agreement: F64 = np.abs(2 * template.values - 1)
    result: F64 = np.average(agreement, axis=0, weights=template.weights)
    return result


def contrast(first: Template, second: Template, delta: float) -> Contrast:
    """Align two templates by classical DTW of their averages, and find the entries in which they contradict each other.

    Parameters
    ----------
    first, second : Template
        Two templates of the same features.
    delta : float
        Values within δ of 0 or 1 are fixed, as in `quantise`; other values contradict nothing.

    Raises
    ------
    ParameterError
        If the numbers of features differ.
    """
    if first.values.shape[1] != second.values.shape[1]:
        shapes = [first.values.shape[1], second.values.shape[1]]
        raise ParameterError("templates", "templates of the same features", shapes)
    local = np.abs(first.values[:, None, :] - second.values[None, :, :]).mean(axis=2)
    path = align(local, np.ones(len(first)), np.ones(len(second))).path
    features = first.values.shape[1]
    one, other = (quantise(template, delta).values(features) for template in (first, second))
    one, other = one[path[:, 0]], other[path[:, 1]]
    compared = (one != WILDCARD) & (other != WILDCARD)
    return Contrast(path, np.where(compared, one - other, 0).astype(np.int8), compared)


def restricted_template(template: QuantisedTemplate, known: int) -> QuantisedTemplate | None:
    """Return a template for takes in which only some features are known.

    Entries of unknown features become wildcards, so that a column's cost is the fraction of its known entries that a
    word contradicts.

    Parameters
    ----------
    template : QuantisedTemplate
        The template for complete bodies.
    known : int
        The mask of the known features, with the bits of a word.

    Returns
    -------
    QuantisedTemplate or None
        The template itself if all features that it fixes are known; None if too few of them are known.
    """
    mask = template.mask & np.uint64(known)
    if (mask == template.mask).all():
        return template
    if not is_applied(template.mask.tolist(), known):
        return None
    return QuantisedTemplate(mask, template.value & np.uint64(known), template.feature_weights)


def without_unknown(template: Template, known: int) -> Template:
    """Return a template learned from clips in which only some features are known; the others become wildcards.

    Parameters
    ----------
    template : Template
        The template as learned from the words of the clips, in which unknown features are 0.
    known : int
        The mask of the known features, with the bits of a word.
    """
    bits = known_bits(known, template.values.shape[1])
    weights = np.ones(len(bits)) if template.feature_weights is None else template.feature_weights
    return replace(
        template, values=np.where(bits, template.values, WILDCARD), feature_weights=np.where(bits, weights, 0.0)
    )


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
        The fraction of the fixed entries of a feature, along the path, that the clip contradicts; 0 if none is fixed.
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

    For each feature, the rates at which accepted and rejected clips contradict the template are compared. The rate is a
    mean over clips of the fraction of the feature's entries that a clip contradicts. Half a clip of either kind is
    added for smoothing, so that few clips have little effect. If rejected clips contradict a feature more often, its
    weight is 1 plus the logarithm of the ratio of the odds, divided by the ratio that smoothing alone would give. If
    contradictions of features were independent, costs would then differ by the logarithm of the likelihood ratio, which
    separates accepted from rejected clips best. All other features keep the weight 1. They distinguish the motion from
    other motions of an archive, which rejected intervals do not represent, since all of them are similar to the motion.

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
        The weights; all are 1 if there are no accepted or no rejected clips.
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
