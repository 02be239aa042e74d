"""From the hits of keyframe queries to the frames in which a template is matched: margins, and where keyframes sit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.queries import KeyframeQuery
from kinedex.ops.errors import KinedexError
from kinedex.ops.ranges import TakeRanges, extend_and_unite
from kinedex.ops.search.preselection import KeyframeFit, fit_keyframes, margins
from kinedex.ops.words import I64


@dataclass(frozen=True)
class TemplateWindow:
    """How far a template reaches out of the hits of a query, in frames; `fit` is None where the query has positions."""

    left: int
    right: int
    positions: tuple[int, ...]
    fit: KeyframeFit | None


def template_window(query: KeyframeQuery, template: npt.NDArray[np.float64], feature_set: FeatureSet) -> TemplateWindow:
    """Find how far a template reaches out of the hits of a query.

    Parameters
    ----------
    query: a query with positions; one without gets those at which its keyframes fit the template best. Where it says
        its margins itself, they count, and its positions may be those of another template, as when somebody's clips
        are left out.
    template: float64 (N, f), the template's columns; entry i − 1 of a column belongs to F_i. A quantised template has
        0 and 1, and one half for wildcards.
    feature_set: the features of the query's sets.

    Raises
    ------
    KinedexError: the positions of a query without margins lie outside the template, or it asks for features the
        template does not have.
    """
    columns, features = template.shape
    fit = None
    positions = query.positions
    if positions is None:
        masks = np.zeros((len(query.keyframes), features), bool)
        values = np.zeros_like(masks)
        for k, keyframe in enumerate(query.keyframes):
            for bit, number in enumerate(feature_set.word_set(keyframe.set).numbers):
                if keyframe.mask >> bit & 1:
                    if number > features:
                        raise KinedexError(f"query '{query.name}' asks for F{number}, the template has {features}")
                    masks[k, number - 1] = True
                    values[k, number - 1] = keyframe.value >> bit & 1
        fit = fit_keyframes(template, masks, values, query.bounds)
        positions = fit.positions
    elif positions[-1] >= columns and query.margins is None:
        raise KinedexError(
            f"query '{query.name}' puts a keyframe in template column {positions[-1]}, but the template has {columns}"
            " columns, counted from 0; leave `positions` out to have them found"
        )
    left, right = query.margins or margins(positions[0], positions[-1], columns, query.least_stiffness)
    return TemplateWindow(left, right, positions, fit)


def template_ranges(
    hits: Mapping[KeyframeQuery, TakeRanges],
    queries: Sequence[KeyframeQuery],
    template: npt.NDArray[np.float64],
    feature_set: FeatureSet,
    offsets: I64,
) -> I64:
    """Return the frames in which a template is to be matched: the hits of its queries with their margins, united.

    The hits of a query with alternatives get the widest of their margins, since any of them may have found a hit.

    Parameters
    ----------
    hits: what `preselect` returns. queries: those of them that are for this template, at least one.
    template: float64 (N, f), see `template_window`.
    feature_set: the features of the queries' sets.
    offsets: int64 (T + 1,), where the takes lie among words laid end to end (`TakeWords.offsets`).

    Returns
    -------
    int64 (R, 2), ranges of the words laid end to end.
    """
    reach = []
    for query in queries:
        windows = [template_window(chain, template, feature_set) for chain in query.chains]
        reach.append((max(window.left for window in windows), max(window.right for window in windows)))
    return ranges_around([hits[query] for query in queries], reach, offsets)


def ranges_around(hits: Sequence[TakeRanges], reach: Sequence[tuple[int, int]], offsets: I64) -> I64:
    """Return the hits of several queries extended by margins and united, in frames of words laid end to end.

    Parameters
    ----------
    hits : sequence of TakeRanges
        The hits of each query, one query or more.
    reach : sequence of (int, int)
        The margins of each query, in frames before and after a hit.
    offsets : int64 array (T + 1,)
        The first frame of each take among the words laid end to end, and the end.

    Returns
    -------
    int64 array (R, 2)
    """
    extended = [
        extend_and_unite(found.end_to_end(offsets), offsets, left, right)
        for found, (left, right) in zip(hits, reach, strict=True)
    ]
    return extended[0] if len(extended) == 1 else extend_and_unite(np.concatenate(extended), offsets)
