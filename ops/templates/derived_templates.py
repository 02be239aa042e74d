"""Templates made from templates: in the mirror, one after the other; and how two of them differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import ParameterError
from kinedex.ops.templates.templates import Template, quantise
from kinedex.ops.templates.warping import align

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

WILDCARD = 0.5


@dataclass(frozen=True)
class Contrast:
    """Two templates laid along each other.

    path: int64 (P, 2), the columns of the first and the second that stand side by side.
    against: int8 (P, f): 1 where the first says on and the second off, −1 the other way round, 0 where they do not
    contradict each other. compared: bool (P, f), where neither has a wildcard.
    """

    path: I64
    against: npt.NDArray[np.int8]
    compared: npt.NDArray[np.bool_]


def mirrored(template: Template, order: I64) -> Template:
    """The template of the same motion with left and right exchanged.

    Parameters
    ----------
    order: int64 (f,), a permutation of 0 … f − 1: the twin of each feature (`FeatureSet.mirror_order`).
    """
    if not np.array_equal(np.sort(order), np.arange(template.values.shape[1])):
        raise ParameterError(
            "order", f"a permutation of {template.values.shape[1]} features", np.asarray(order).tolist()
        )
    weights = template.feature_weights
    return replace(
        template, values=template.values[:, order], feature_weights=None if weights is None else weights[order]
    )


def joined(templates: Sequence[Template], gap: int) -> Template:
    """Templates one after the other, with columns of wildcards between two of them.

    A column of a template can be passed in half or in twice the time, so that a gap of so many columns stands for
    about gap / 2 to 2 gap frames of anything.

    Parameters
    ----------
    templates: one or more, of the same features; the first one's feature weights hold for all.
    gap: columns of wildcards between two templates, 0 or more.

    Raises
    ------
    ParameterError: no template, different numbers of features, or a negative gap.
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
    """How much the clips agree about each feature, float64 (f,): from 0 (half of them on) to 1 (all alike).

    The mean of |2 v − 1| over the columns, weighted by the columns' weights.
    """
    agreement: F64 = np.abs(2 * template.values - 1)
    result: F64 = np.average(agreement, axis=0, weights=template.weights)
    return result


def contrast(first: Template, second: Template, delta: float) -> Contrast:
    """Lay two templates along each other, by classical DTW of their averages, and find what their fixed entries deny.

    Parameters
    ----------
    delta: values within δ of 0 or 1 are fixed, as in `quantise`; the rest contradicts nothing.
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
