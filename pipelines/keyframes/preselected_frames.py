"""Preselect frames: find the hit ranges of keyframe queries, and the frames in which a template is then matched."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import KeyframeQuery, restricted_query
from kinedex.ops.errors import KinedexError
from kinedex.ops.ranges import TakeRanges, extend_and_unite
from kinedex.ops.search.preselection import fit_keyframes, template_margins
from kinedex.ops.words import I64, TakeWords
from kinedex.pipelines.keyframes.slice_search import sliced_index, sliced_words
from kinedex.storage.store.store import Store


def preselect(
    words: TakeWords, feature_set: FeatureSet, queries: Sequence[KeyframeQuery]
) -> dict[KeyframeQuery, TakeRanges]:
    """Search words in memory for keyframe queries (thesis, Section 5.3).

    Parameters
    ----------
    words : TakeWords
        The words of T takes.
    feature_set : FeatureSet
        The features of the words.
    queries : sequence of KeyframeQuery
        Queries; several may have the same name, for instance a learned and a manual one.

    Returns
    -------
    dict of KeyframeQuery to TakeRanges
        The ranges of each query, from first to last keyframe, without margins.

    Raises
    ------
    KinedexError
        If a query has a filter over takes, which cannot be evaluated on words in memory.
    """
    _refuse_filters(queries)
    return dict(zip(queries, sliced_words(words, feature_set).search(queries), strict=True)) if queries else {}


def preselect_stored(
    store: Store, words: TakeWords, queries: Sequence[KeyframeQuery]
) -> dict[KeyframeQuery, TakeRanges]:
    """Search takes of a store like `preselect`, in the bit slices of its index, or in the words without an index.

    Parameters
    ----------
    store : Store
        The store; all workers share the mapped slices of its index.
    words : TakeWords
        The words of the takes to search, from `Store.words`.
    queries : sequence of KeyframeQuery
        Queries without filters over takes.
    """
    sliced = sliced_index(store) if queries else None
    if sliced is None:
        return preselect(words, store.feature_set, queries)
    _refuse_filters(queries)
    return dict(zip(queries, sliced.select(words.take_ids).search(queries), strict=True))


def _refuse_filters(queries: Sequence[KeyframeQuery]) -> None:
    for query in queries:
        if query.takes is not None:
            raise KinedexError(
                f"query '{query.name}' has a filter over takes (`takes: {query.takes}`), which preselection does not "
                "support; choose the takes by the filter of the stage, and remove it from the query"
            )


def template_window(
    query: KeyframeQuery, template: npt.NDArray[np.float64], feature_set: FeatureSet
) -> tuple[int, int]:
    """Return the margins by which a template extends beyond the hits of a query.

    Parameters
    ----------
    query : KeyframeQuery
        A query. If it has no positions, its keyframes are placed where they fit the template best. If it has margins,
        these are returned unchanged; its positions may then belong to another template, for instance to one that was
        learned without some clips.
    template : float64 array (N, f)
        The template's columns; entry i - 1 of a column belongs to F_i. A quantised template has 0 and 1, and one half
        for wildcards.
    feature_set : FeatureSet
        The features of the query's sets.

    Returns
    -------
    tuple of int
        The numbers of frames before and after a hit.

    Raises
    ------
    KinedexError
        If the positions of a query without margins lie outside the template, or the query asks for features that the
        template does not have.
    """
    columns, features = template.shape
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
        positions = fit_keyframes(template, masks, values, query.bounds)
    elif positions[-1] >= columns and query.margins is None:
        raise KinedexError(
            f"query '{query.name}' puts a keyframe in template column {positions[-1]}, but the template has {columns}"
            " columns, counted from 0; leave `positions` out to have them found"
        )
    return query.margins or template_margins(positions[0], positions[-1], columns, query.least_stiffness)


def template_ranges(
    hits: Mapping[KeyframeQuery, TakeRanges],
    queries: Sequence[KeyframeQuery],
    template: npt.NDArray[np.float64],
    feature_set: FeatureSet,
    offsets: I64,
) -> I64:
    """Return the frames in which a template is matched: the union of the hits of its queries with their margins.

    The hits of a query with alternatives get the widest margins of all alternatives, because any of these may have
    found a hit.

    Parameters
    ----------
    hits : mapping of KeyframeQuery to TakeRanges
        The ranges from `preselect`.
    queries : sequence of KeyframeQuery
        The queries for this template, at least one.
    template : float64 array (N, f)
        See `template_window`.
    feature_set : FeatureSet
        The features of the queries' sets.
    offsets : int64 array (T + 1,)
        The first frame of each take in the concatenated words, followed by their length (`TakeWords.offsets`).

    Returns
    -------
    int64 array (R, 2)
        Ranges of the concatenated words.
    """
    margins = [widest_margins(query, template, feature_set) for query in queries]
    return ranges_around([hits[query] for query in queries], margins, offsets)


def known_queries(
    queries: Sequence[KeyframeQuery], margins: Sequence[tuple[int, int]], feature_set: FeatureSet, known: int
) -> tuple[KeyframeQuery, ...]:
    """Return the queries of a template that apply to takes in which only some features are known.

    Parameters
    ----------
    queries : sequence of KeyframeQuery
        The queries for complete bodies.
    margins : sequence of (int, int)
        The margins of each query, which the restricted queries keep, because the template has the same length.
    feature_set : FeatureSet
        The features of the queries.
    known : int
        The mask of the known features, with the bits of a word.

    Returns
    -------
    tuple of KeyframeQuery
        The queries restricted to known features, without queries of which too few entries are known.
    """
    found = []
    for query, own in zip(queries, margins, strict=True):
        one = restricted_query(query, feature_set, known)
        if one is not None:
            found.append(
                replace(one, margins=own, alternatives=tuple(replace(other, margins=own) for other in one.alternatives))
            )
    return tuple(found)


def widest_margins(query: KeyframeQuery, template: npt.NDArray[np.float64], feature_set: FeatureSet) -> tuple[int, int]:
    """Return the widest margins of a query and its alternatives, because any of them may have found a hit."""
    margins = [template_window(chain, template, feature_set) for chain in query.chains]
    return max(left for left, _ in margins), max(right for _, right in margins)


def ranges_around(hits: Sequence[TakeRanges], margins: Sequence[tuple[int, int]], offsets: I64) -> I64:
    """Return the union of the hits of several queries, extended by margins, in frames of concatenated words.

    Parameters
    ----------
    hits : sequence of TakeRanges
        The hits of each query, for at least one query.
    margins : sequence of (int, int)
        The margins of each query, in frames before and after a hit.
    offsets : int64 array (T + 1,)
        The first frame of each take in the concatenated words, followed by their length.

    Returns
    -------
    int64 array (R, 2)
        Ranges of the concatenated words.
    """
    extended = [
        extend_and_unite(found.end_to_end(offsets), offsets, left, right)
        for found, (left, right) in zip(hits, margins, strict=True)
    ]
    return extended[0] if len(extended) == 1 else extend_and_unite(np.concatenate(extended), offsets)
