"""Confidence: the probability that a segment has the right label, learned from segments of which that is known.

A logistic regression of few numbers of each segment (its evidence), with an offset for each class. Few segments are
known, so that coefficients are uncertain: they have a normal prior, and their uncertainty (Laplace's approximation of
the posterior) draws a confidence towards one half. (MacKay, The Evidence Framework Applied to Classification Networks,
1992; Platt, Probabilistic Outputs for Support Vector Machines, 1999, is the case of one number and no prior.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.ops.annotation.decoding import STANDING_OUT
from kinedex.ops.annotation.segments import Segment
from kinedex.ops.errors import ParameterError

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]
Bool = npt.NDArray[np.bool_]

OFFSET_SPREAD, SLOPE_SPREAD, CLASS_SPREAD = 3.0, 0.7, 0.8
"""Standard deviations of the normal prior, in log odds: of the common offset, of slopes (for a change of one scale),
and of the offsets of classes."""

_NO_COST = 0.3  # stands for the cost of a segment in which no path ends
_STEPS, _CLOSE = 100, 1e-10  # of Newton's method: the most, and the improvement below which it ends


@dataclass(frozen=True)
class Prior:
    """The evidence that a method has, and the expectations from other archives.

    Parameters
    ----------
    evidence : tuple of str, length E
        The names of the numbers (see `evidence_of`).
    centres, scales : tuple of float, length E
        The mean and the standard deviation of each, by which they are normalised.
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
        ("lead", "value", "cost", "pace"),
        (0.360, 1.667, 0.164, -0.034),
        (0.120, 0.885, 0.091, 0.227),
        6.458,
        (1.506, -0.073, -1.312, -0.736),
    ),
    "thesis": Prior(
        ("margin", "cost", "others", "haste", "length", "fixed"),
        (0.498, 0.200, 0.378, 0.296, 4.063, 0.826),
        (0.371, 0.101, 0.312, 0.275, 0.659, 0.133),
        3.051,
        (1.921, -1.097, -1.236, -1.162, 0.107, 1.009),
    ),
}
"""The priors of kinedex's methods, from HDM05's actors bd, bk and dg, left out in turn: `python -m studies.confidence
… --prior` prints them."""

UNKNOWN = Prior(PRIORS["thesis"].evidence, PRIORS["thesis"].centres, PRIORS["thesis"].scales, 0.0, (0.0,) * 6)
"""The prior of other methods: it expects nothing."""


@dataclass(frozen=True)
class Confidence:
    """A function from evidence and class of segments to the probability that the label is right.

    Parameters
    ----------
    prior : Prior
        The evidence and its normalisation.
    coefficients : float64 array (1 + E + P,)
        The offset, the slopes, and the offset of each of P classes.
    covariance : float64 array (1 + E + P, 1 + E + P)
        Their uncertainty.
    """

    prior: Prior
    coefficients: F64
    covariance: F64

    def of(self, evidence: F64, classes: I64) -> F64:
        """Return the probability that each label is right.

        Parameters
        ----------
        evidence : float64 array (S, E)
            The evidence of each segment, see `evidence_of`.
        classes : int64 array (S,)
            The classes of the segments, 0 … P − 1.

        Returns
        -------
        float64 array (S,)
            Each above 0 and below 1.
        """
        rows = _design(self.prior, evidence, classes, len(self.coefficients) - 1 - len(self.prior.evidence))
        variance = ((rows @ self.covariance) * rows).sum(axis=1)
        return _sigmoid(rows @ self.coefficients / np.sqrt(1.0 + np.pi * variance / 8.0))


def learn_confidence(
    prior: Prior, evidence: F64, classes: I64, right: Bool, weights: F64, class_count: int
) -> Confidence:
    """Learn the confidence from segments of which it is known whether they are right.

    The coefficients maximise Σ w log P(right | evidence) plus the logarithm of the prior; with no segment they are
    those of the prior.

    Parameters
    ----------
    prior : Prior
        The evidence and what is expected of it.
    evidence : float64 array (S, E)
        The evidence of each segment.
    classes : int64 array (S,)
        The classes of the segments, 0 … P − 1.
    right : bool array (S,)
        True where the label is right.
    weights : float64 array (S,)
        The weight of each segment: 1 for one that is independent of all others, less for one of many that are alike.
    class_count : int
        The number of classes P.

    Raises
    ------
    ParameterError
        If the arrays do not fit together, or a class is not among P.
    """
    if not len(evidence) == len(classes) == len(right) == len(weights):
        raise ParameterError("right", f"one value for each of {len(evidence)} segments", len(right))
    if len(classes) and not 0 <= classes.min() <= classes.max() < class_count:
        raise ParameterError("classes", f"0 to {class_count - 1}", classes.tolist()[:8])
    rows, truth = _design(prior, evidence, classes, class_count), right.astype(np.float64)
    mean = np.concatenate([[prior.offset], prior.slopes, np.zeros(class_count)])
    spread = [OFFSET_SPREAD, *[SLOPE_SPREAD] * len(prior.slopes), *[CLASS_SPREAD] * class_count]
    precision = np.array(spread) ** -2.0

    def loss(point: F64) -> float:
        odds = rows @ point
        return float(weights @ (np.logaddexp(0.0, odds) - truth * odds) + precision @ (point - mean) ** 2 / 2)

    def curvature(point: F64) -> F64:
        share = _sigmoid(rows @ point)
        result: F64 = (rows * (weights * share * (1.0 - share))[:, None]).T @ rows + np.diag(precision)
        return result

    point, least = mean, loss(mean)
    for _ in range(_STEPS):
        slope = rows.T @ (weights * (truth - _sigmoid(rows @ point))) - precision * (point - mean)
        step = np.linalg.solve(curvature(point), slope)
        while (value := loss(point + step)) > least and np.abs(step).max() > _CLOSE:
            step = step / 2
        if value > least - _CLOSE:
            break
        point, least = point + step, value
    return Confidence(prior, point, np.asarray(np.linalg.inv(curvature(point)), np.float64))


def evidence_of(
    names: Sequence[str],
    found: Sequence[Sequence[Segment]],
    offsets: I64,
    columns: Sequence[int],
    fixed: Sequence[float],
) -> F64:
    """Return numbers of segments that tell right labels from wrong ones.

    Parameters
    ----------
    names : sequence of str, length E
        The numbers: "lead", the root of the value per frame that only the segment's class can give; "value", the
        logarithm of the value; "margin"; "cost", its root; "pace", the logarithm of the length over that of the
        template; "haste", its magnitude; "length", the logarithm of the frames; "fixed", the share of features that
        the template asks for; "others", log(1 + n), n being the number of other labels of a frame on average.
    found : sequence of sequence of Segment, length T
        The segments of each take, in frames of the take.
    offsets : int64 array (T + 1,)
        The first frame of each take where all are laid end to end, and the end.
    columns : sequence of int
        The number of columns of each template.
    fixed : sequence of float
        The share of fixed entries of each template.

    Returns
    -------
    float64 array (S, E)
        The numbers of all segments, take by take.
    """
    segments = [one for own in found for one in own]
    if not segments:
        return np.empty((0, len(names)))
    starts, stops, subclasses = np.array([(one.start, one.stop, one.subclass) for one in segments], np.int64).T
    costs, values, margins = np.array([(one.cost, one.value, one.margin) for one in segments]).T
    lengths = (stops - starts).astype(np.float64)
    wanted = set(names)
    numbers: dict[str, F64] = {"margin": margins, "length": np.log(lengths), "fixed": np.array(fixed)[subclasses]}
    numbers["cost"] = np.sqrt(np.where(np.isfinite(costs), costs, _NO_COST))
    numbers["pace"] = np.log(lengths / np.array(columns)[subclasses])
    numbers["haste"] = np.abs(numbers["pace"])
    if wanted & {"lead", "value"}:
        a_frame = np.maximum(values, 0.0) / lengths
        alone = np.clip(margins / np.maximum(-np.expm1(-a_frame / STANDING_OUT), 1e-9), 0.0, 1.0)
        numbers["lead"], numbers["value"] = np.sqrt(a_frame * alone), np.log(np.maximum(values, 0.01))
    if "others" in wanted:
        first = np.repeat(offsets[:-1], [len(own) for own in found])
        labels = np.zeros(int(offsets[-1]) + 1)
        np.add.at(labels, starts + first, 1.0)
        np.add.at(labels, stops + first, -1.0)
        before = np.concatenate([[0.0], np.cumsum(np.cumsum(labels))])
        numbers["others"] = np.log((before[stops + first] - before[starts + first]) / lengths)
    return np.stack([numbers[name] for name in names], axis=1)


def _design(prior: Prior, evidence: F64, classes: I64, class_count: int) -> F64:
    """Return a row (1, normalised evidence, one-hot class) of each segment."""
    normalised = (evidence - np.array(prior.centres)) / np.array(prior.scales)
    return np.concatenate([np.ones((len(classes), 1)), normalised, np.eye(class_count)[classes]], axis=1)


def _sigmoid(odds: F64) -> F64:
    result: F64 = 0.5 * (1.0 + np.tanh(odds / 2.0))
    return result
