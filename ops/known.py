"""This module handles known features: how templates and keyframes apply to a take whose body lacks joints.

A mask with the bits of a word marks the features that are known in a take. An unknown feature is 0 in its words, which
is not evidence: entries of templates and keyframes for this feature are wildcards for the take, and if too few entries
are left, the template or query is not applied to it. The kernels do not use masks: takes with the same mask are
searched together, by templates and queries that are restricted to it.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from kinedex.ops.arrays import Bool
from kinedex.ops.words import NO_WORD, U64

LEAST_KNOWN = 0.6
"""Minimum fraction of known fixed entries for which a template or query is applied to a take."""


def known_share(masks: Iterable[int], known: int) -> float:
    """Return the fraction of fixed entries that are known; 1 where nothing is fixed.

    Parameters
    ----------
    masks : iterable of int
        The fixed bits of each column or keyframe.
    known : int
        The mask of the known features.
    """
    fixed = [int(mask) for mask in masks]
    total = sum(mask.bit_count() for mask in fixed)
    return sum((mask & known).bit_count() for mask in fixed) / total if total else 1.0


def is_applied(masks: Iterable[int], known: int) -> bool:
    """Return True if enough of the fixed entries are known, see `known_share` and `LEAST_KNOWN`."""
    return known_share(masks, known) >= LEAST_KNOWN


def known_bits(known: int, features: int) -> Bool:
    """Return a mask of the known features among f features, bool (f,)."""
    return np.array([known >> bit & 1 for bit in range(features)], np.bool_)


def compacted(words: U64, known: int, features: int) -> U64:
    """Return words of the known features only, with their bits moved together in order.

    Parameters
    ----------
    words : uint64 array (L,)
        Complete words; `NO_WORD` is kept.
    known : int
        The mask of the known features.
    features : int
        The number of features of complete words.
    """
    result = np.zeros(len(words), np.uint64)
    for place, bit in enumerate(np.flatnonzero(known_bits(known, features)).tolist()):
        result |= ((words >> np.uint64(bit)) & np.uint64(1)) << np.uint64(place)
    return np.where(words == NO_WORD, NO_WORD, result)
