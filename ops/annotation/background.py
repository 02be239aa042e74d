"""This module learns a background model, a mixture of a few postures that the takes of an archive usually show.

The average of all frames would be a poor background. Features occur together (a person who lies has no foot raised and
no fast hand), so no frame resembles the average, and every motion is likelier under any other model. The background is
therefore a mixture of Bernoulli distributions, called postures, each with a probability of every feature. They are
found by repeated splitting: each posture, at first the average, is divided into two along the direction in which frames
differ most, and then all postures are improved by expectation maximisation (Linde, Buzo and Gray, An Algorithm for
Vector Quantizer Design, 1980).
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
        The number of times that every posture is divided; with 0, the average is the only posture.

    Returns
    -------
    float64 array (K, f)
        The probability of each feature in each of K postures, which have equal weights. K is 2 ** splits, or less if
        there are fewer different words. Without any frame, all probabilities are one half.

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
        One word for each frame; `NO_WORD` is treated as a word with all features on.
    usual : float64 array (K, f)
        The postures, see `background`.
    smoothing : float
        Probabilities of postures are limited to the range from `smoothing` to 1 − `smoothing`.

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
    """Return the expected number of frames of each word in each posture, (V, K), by the posterior of the mixture."""
    scores = _scores(on, np.clip(postures, _MIN_PROBABILITY, 1.0 - _MIN_PROBABILITY))
    shares = np.exp(scores - scores.max(axis=1, keepdims=True))
    result: F64 = shares / shares.sum(axis=1, keepdims=True) * counts[:, None]
    return result


def _split(on: F64, counts: I64, postures: F64) -> F64:
    """Divide each posture into two, displaced by ± a standard deviation along the first principal component."""
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
