"""This module describes intervals of words by numbers: how often each feature is on, and how often it changes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from kinedex.ops.arrays import F64, I64, U8, U64, Bool
from kinedex.ops.errors import ParameterError
from kinedex.ops.words import ALL_KNOWN, NO_WORD

_FRAMES = 200_000
"""Number of frames that are unpacked at a time."""


def interval_numbers(words: U64, bounds: I64, features: int, known: U64 | None = None) -> F64:
    """Return for each interval and feature the share of frames in which it is on, and the root of its change rate.

    Parameters
    ----------
    words : uint64 array (N,)
        The concatenated words of all intervals; `NO_WORD` if a frame is invalid.
    bounds : int64 array (P + 1,)
        Ascending indices; interval p has the words bounds[p] to bounds[p + 1] − 1.
    features : int
        The number of features f.
    known : uint64 array (P,), optional
        The mask of the known features of each interval; None if all features are known.

    Returns
    -------
    float64 array (P, 2 f)
        Columns 0 to f − 1 are the shares of valid frames in which features are on. Columns f to 2 f − 1 are square
        roots of change rates: the number of changes from off to on or back, divided by the number of pairs of
        successive valid frames. NaN if a feature is unknown, or an interval has no valid frame.

    Raises
    ------
    ParameterError
        If the bounds do not ascend from 0 to N.

    Examples
    --------
    A feature that is on in one of two frames has changed once in one pair of frames.

    >>> interval_numbers(np.array([0, 1], np.uint64), np.array([0, 2]), 1).tolist()
    [[0.5, 1.0]]
    """
    if len(bounds) == 0 or bounds[0] != 0 or bounds[-1] != len(words) or (np.diff(bounds) < 0).any():
        raise ParameterError("bounds", f"ascending from 0 to {len(words)}", bounds[:10].tolist())
    numbers = np.full((len(bounds) - 1, 2 * features), np.nan)
    for first, last in _blocks(bounds):
        own = bounds[first : last + 1] - bounds[first]
        _fill(numbers[first:last], words[bounds[first] : bounds[last]], own, features)
    if known is not None and not (known == ALL_KNOWN).all():
        shifts = np.arange(features, dtype=np.uint64)
        unknown = (known[:, None] >> shifts) & np.uint64(1) == 0
        numbers[np.concatenate([unknown, unknown], axis=1)] = np.nan
    return numbers


def _blocks(bounds: I64) -> Iterator[tuple[int, int]]:
    """Yield ranges of intervals with about `_FRAMES` words each; a longer interval is alone."""
    first = 0
    while first < len(bounds) - 1:
        last = int(np.searchsorted(bounds, bounds[first] + _FRAMES, side="right")) - 1
        last = max(first + 1, last)
        yield first, last
        first = last


def _fill(numbers: F64, words: U64, bounds: I64, features: int) -> None:
    """Compute the numbers of intervals whose words are concatenated."""
    valid = words != NO_WORD
    on = _unpacked(np.where(valid, words, np.uint64(0)), features)
    frames = _sums(valid[:, None], bounds)
    # True if a frame and the previous frame are both valid and in the same interval
    pair = np.zeros(len(words), bool)
    pair[1:] = valid[1:] & valid[:-1]
    starts = bounds[:-1]
    pair[starts[starts < len(words)]] = False
    changed = np.zeros(on.shape, bool)
    changed[1:] = (on[1:] != on[:-1]) & pair[1:, None]
    pairs = _sums(pair[:, None], bounds)
    with np.errstate(invalid="ignore"):
        numbers[:, :features] = _sums(on, bounds) / frames
        numbers[:, features:] = np.where(frames > 0, np.sqrt(_sums(changed, bounds) / np.maximum(pairs, 1)), np.nan)


def _unpacked(words: U64, features: int) -> U8:
    """Unpack words to bits as `ops.words.bits` does, but byte by byte."""
    few = -(-features // 8)
    octets = words.astype("<u8").view(np.uint8).reshape(-1, 8)[:, :few]
    return np.unpackbits(octets, axis=1, bitorder="little", count=features)


def _sums(values: U8 | Bool, bounds: I64) -> F64:
    """Return the sums of the rows of each interval, 0 for an empty one."""
    found = np.zeros((len(bounds) - 1, values.shape[1]))
    full = np.flatnonzero(np.diff(bounds) > 0)
    if len(full):
        found[full] = np.add.reduceat(values, bounds[full], axis=0, dtype=np.int64)
    return found


def standardised(numbers: F64) -> F64:
    """Return columns scaled to mean 0 and standard deviation 1; unknown values and constant columns become 0.

    Parameters
    ----------
    numbers : float64 array (P, n)
        Numbers; NaN if unknown.

    Returns
    -------
    float64 array (P, n)

    Examples
    --------
    >>> standardised(np.array([[1.0, 5.0], [3.0, 5.0], [np.nan, 5.0]])).tolist()
    [[-1.0, 0.0], [1.0, 0.0], [0.0, 0.0]]
    """
    there = ~np.isnan(numbers)
    count = np.maximum(there.sum(axis=0), 1)
    filled = np.where(there, numbers, 0.0)
    deviation = np.where(there, filled - filled.sum(axis=0) / count, 0.0)
    spread = np.sqrt((deviation**2).sum(axis=0) / count)
    return deviation / np.where(spread > 1e-9, spread, np.inf)
