"""This module learns a background model: the postures that the takes of an archive usually show.

One average over all frames would be a poor background: features occur together (a person who lies has no foot raised
and no fast hand), so no frame resembles the average, and every motion is likelier under its own model. So the
background is a few postures, each with its own share of frames in which a feature is on, found by splitting: the
average is divided into two along the direction in which frames differ most, both are improved by expectation and
maximisation, and so on (Linde, Buzo and Gray, An Algorithm for Vector Quantizer Design, 1980; here for a mixture of
Bernoulli distributions).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinedex.ops.arrays import F64, I64, U64
from kinedex.ops.errors import ParameterError
from kinedex.ops.words import NO_WORD, bits

SPLITS = 2
"""The number of times that every posture is divided: 2 gives four postures. Chosen on clips of excluded actors
(`studies.decoding`).
"""

_ROUNDS = 20
_MIN_PROBABILITY = 0.05  # probabilities of features stay at least this far from 0 and 1 while postures are learned


def background(words: Sequence[U64], features: int, splits: int = SPLITS) -> F64:
    """Learn the postures of the background from frames of all kinds by repeated splitting.

    Parameters
    ----------
    words : sequence of uint64 array
        The words of takes; `NO_WORD` is ignored.
    features : int
        The number of features f.
    splits : int
        The number of times that every posture is divided; 0 gives the average alone.

    Returns
    -------
    float64 array (K, f)
        K = 2 ** splits postures that are equally usual (fewer where there are fewer different words): in each, the
        share of frames in which each feature is on. One half each where there is no frame.

    Raises
    ------
    ParameterError
        If the number of splits is below 0.
    """
    if splits < 0:
        raise ParameterError("splits", "0 or more", splits)
    frames = np.concatenate([np.zeros(0, np.uint64), *words])
    vocabulary, counts = np.unique(frames[frames != NO_WORD], return_counts=True)
    if not len(vocabulary):
        return np.full((1, features), 0.5)
    on = bits(vocabulary, features).astype(np.float64)
    postures: F64 = (counts @ on / counts.sum())[None]
    for _ in range(splits):
        if 2 * len(postures) > len(vocabulary):
            break
        postures = _split(on, counts, postures)
        for _ in range(_ROUNDS):
            belongs = _belongings(on, counts, postures)
            # half a frame with and half a frame without each feature are added, so that an empty posture has
            # probabilities of 1/2
            postures = (belongs.T @ on + 0.5) / (belongs.sum(axis=0) + 1.0)[:, None]
    return postures


def log_likelihoods(words: U64, usual: F64, smoothing: float) -> F64:
    """Return the log likelihood of words under the background model.

    Parameters
    ----------
    words : uint64 array (V,)
        One word a frame; `NO_WORD` counts as a word of all features.
    usual : float64 array (K, f)
        The usual postures, see `background`.
    smoothing : float
        Shares of postures lie between this and 1 − this.

    Returns
    -------
    float64 array (V,)
        log P(word | background).
    """
    scores = _scores(bits(words, usual.shape[1]).astype(np.float64), np.clip(usual, smoothing, 1.0 - smoothing))
    most = scores.max(axis=1)
    result: F64 = most + np.log(np.exp(scores - most[:, None]).mean(axis=1))
    return result


def _scores(on: F64, postures: F64) -> F64:
    """Return the log likelihood of each row of bits under each posture, (V, K)."""
    result: F64 = on @ (np.log(postures) - np.log1p(-postures)).T + np.log1p(-postures).sum(axis=1)
    return result


def _belongings(on: F64, counts: I64, postures: F64) -> F64:
    """Return how many frames of each word belong to each posture, (V, K), by the posterior of the mixture."""
    scores = _scores(on, np.clip(postures, _MIN_PROBABILITY, 1.0 - _MIN_PROBABILITY))
    shares = np.exp(scores - scores.max(axis=1, keepdims=True))
    result: F64 = shares / shares.sum(axis=1, keepdims=True) * counts[:, None]
    return result


def _split(on: F64, counts: I64, postures: F64) -> F64:
    """Divide every posture into two, one standard deviation to either side along the first principal component."""
    halves = []
    for belongs in _belongings(on, counts, postures).T:
        total = max(float(belongs.sum()), 1e-12)
        centre = belongs @ on / total
        around = on - centre
        variances, directions = np.linalg.eigh((around * belongs[:, None]).T @ around / total)
        direction = directions[:, -1] * np.sqrt(max(float(variances[-1]), 0.0))
        # the sign of an eigenvector is arbitrary, so it is fixed here
        direction *= np.sign(direction[int(np.argmax(np.abs(direction)))])
        halves += [centre + direction, centre - direction]
    return np.stack(halves)
