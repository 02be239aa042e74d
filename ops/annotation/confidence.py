"""This module learns the confidence of segments, which is the probability that a segment's label is right.

It learns from segments whose labels were checked. The model is a logistic regression on a few numbers of each segment
(the evidence), with an offset for each class. Since few segments have been checked, the coefficients are uncertain.
They have a normal prior, and their uncertainty, by Laplace's approximation of the posterior, moves confidences towards
one half (MacKay, The Evidence Framework Applied to Classification Networks, 1992). With a single number and without a
prior, the method is that of Platt, Probabilistic Outputs for Support Vector Machines, 1999.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.errors import ParameterError

OFFSET_SPREAD, SLOPE_SPREAD, CLASS_SPREAD = 1.5, 0.5, 0.5
"""Standard deviations of the normal prior in log odds: of the common offset, of slopes (per normalised unit), and of
the offsets of classes.
"""

_STEPS, _CLOSE = 100, 1e-10  # Newton's method: the most iterations, and the improvement at which it ends


@dataclass(frozen=True)
class Prior:
    """The prior of a method: the numbers used as evidence, and the coefficients expected from other archives.

    Parameters
    ----------
    evidence : tuple of str, length E
        The names of the numbers (see `ops.annotation.evidence`).
    centres, scales : tuple of float, length E
        The mean and the standard deviation of each number, by which it is normalised.
    offset : float
        The expected log odds of a segment of mean evidence.
    slopes : tuple of float, length E
        The expected change of the log odds with each normalised number.
    """

    evidence: tuple[str, ...]
    centres: tuple[float, ...]
    scales: tuple[float, ...]
    offset: float
    slopes: tuple[float, ...]


PRIORS: Mapping[str, Prior] = {
    "best": Prior(
        ("lead", "cost", "pace", "covered"),
        (0.364, 0.162, -0.030, 0.796),
        (0.120, 0.090, 0.224, 0.194),
        5.717,
        (1.271, -0.591, -0.459, 0.593),
    ),
    "thesis": Prior(
        ("margin", "cost", "others", "haste", "fixed", "support", "covered"),
        (0.497, 0.199, 0.386, 0.292, 0.821, -0.566, 0.941),
        (0.372, 0.101, 0.312, 0.278, 0.136, 2.061, 0.120),
        2.895,
        (1.842, -0.998, -1.116, -1.043, 1.147, 0.213, 0.451),
    ),
}
"""The priors of kinedex's methods, learned by leaving out HDM05's actors bd, bk and dg in turn; `python -m
studies.confidence … --seeds 0 1 --prior` prints them.
"""

UNKNOWN = Prior(PRIORS["thesis"].evidence, PRIORS["thesis"].centres, PRIORS["thesis"].scales, 0.0, (0.0,) * 7)
"""The prior of methods that `PRIORS` lacks: all of its expected coefficients are 0."""


@dataclass(frozen=True)
class Confidence:
    """A model that gives the probability that a segment's label is right, from its evidence and class.

    Parameters
    ----------
    prior : Prior
        The evidence and its normalisation.
    coefficients : float64 array (1 + E + P,)
        The offset, the slopes, and the offset of each of P classes.
    covariance : float64 array (1 + E + P, 1 + E + P)
        The covariance of the coefficients.
    """

    prior: Prior
    coefficients: F64
    covariance: F64

    def of(self, evidence: F64, classes: I64) -> F64:
        """Return the probability that each label is right.

        Parameters
        ----------
        evidence : float64 array (S, E)
            The evidence of each segment, see `ops.annotation.evidence`.
        classes : int64 array (S,)
            The classes of the segments, 0 … P − 1.

        Returns
        -------
        float64 array (S,)
            The probabilities, above 0 and below 1.
        """
        rows = _design(self.prior, evidence, classes, len(self.coefficients) - 1 - len(self.prior.evidence))
        variance = ((rows @ self.covariance) * rows).sum(axis=1)
        return _sigmoid(rows @ self.coefficients / np.sqrt(1.0 + np.pi * variance / 8.0))


def learn_confidence(prior: Prior, evidence: F64, classes: I64, right: Bool, class_count: int) -> Confidence:
    """Learn the confidence model from segments whose labels were checked.

    The coefficients maximise Σ log P(right | evidence) plus the logarithm of the prior. Without any segment, the result
    has the coefficients of the prior.

    Parameters
    ----------
    prior : Prior
        The evidence and the expected coefficients.
    evidence : float64 array (S, E)
        The evidence of each segment.
    classes : int64 array (S,)
        The classes of the segments, 0 … P − 1.
    right : bool array (S,)
        True if the label of a segment is right.
    class_count : int
        The number of classes P.

    Raises
    ------
    ParameterError
        If the shapes of the arrays do not agree, or a class is not in 0 … P − 1.
    """
    if not len(evidence) == len(classes) == len(right):
        raise ParameterError("right", f"one value for each of {len(evidence)} segments", len(right))
    if len(classes) and not 0 <= classes.min() <= classes.max() < class_count:
        raise ParameterError("classes", f"0 to {class_count - 1}", classes.tolist()[:8])
    rows, truth = _design(prior, evidence, classes, class_count), right.astype(np.float64)
    mean = np.concatenate([[prior.offset], prior.slopes, np.zeros(class_count)])
    spread = [OFFSET_SPREAD, *[SLOPE_SPREAD] * len(prior.slopes), *[CLASS_SPREAD] * class_count]
    precision = np.array(spread) ** -2.0

    def loss(point: F64) -> float:
        odds = rows @ point
        return float((np.logaddexp(0.0, odds) - truth * odds).sum() + precision @ (point - mean) ** 2 / 2)

    def curvature(point: F64) -> F64:
        share = _sigmoid(rows @ point)
        result: F64 = (rows * (share * (1.0 - share))[:, None]).T @ rows + np.diag(precision)
        return result

    point, least = mean, loss(mean)
    for _ in range(_STEPS):
        slope = rows.T @ (truth - _sigmoid(rows @ point)) - precision * (point - mean)
        step = np.linalg.solve(curvature(point), slope)
        while (value := loss(point + step)) > least and np.abs(step).max() > _CLOSE:
            step = step / 2
        if value > least - _CLOSE:
            break
        point, least = point + step, value
    return Confidence(prior, point, np.asarray(np.linalg.inv(curvature(point)), np.float64))


def _design(prior: Prior, evidence: F64, classes: I64, class_count: int) -> F64:
    """Return the design matrix, with a row (1, normalised evidence, one-hot class) for each segment."""
    normalised = (evidence - np.array(prior.centres)) / np.array(prior.scales)
    return np.concatenate([np.ones((len(classes), 1)), normalised, np.eye(class_count)[classes]], axis=1)


def _sigmoid(odds: F64) -> F64:
    result: F64 = 0.5 * (1.0 + np.tanh(odds / 2.0))
    return result
