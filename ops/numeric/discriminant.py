"""This module provides a linear discriminant whose covariance within classes is shrunk towards its diagonal.

The covariance is common to all classes, so that what varies within one of them (style, tempo, body) counts less in all.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.errors import ParameterError

SHRINKAGE = 0.1
"""The share of the diagonal in the covariance."""

FLOOR = 1e-3
"""The share of the mean variance that is added to each variance, so that numbers which never vary have one."""


@dataclass(frozen=True)
class Discriminant:
    """Scores of P classes that are linear in a descriptor of D numbers.

    Attributes
    ----------
    centre, scale : float64 array (D,)
        Descriptors are standardised: the centre is subtracted, and they are divided by the scale.
    weights : float64 array (D, P)
        The weights of each class.
    biases : float64 array (P,)
        The constant of each class.
    means : float64 array (P, D)
        The standardised means of the classes.
    lower : float64 array (D, D)
        The Cholesky factor of the covariance within classes.
    """

    centre: F64
    scale: F64
    weights: F64
    biases: F64
    means: F64
    lower: F64

    @classmethod
    def fit(cls, descriptors: F64, classes: I64, shrinkage: float = SHRINKAGE) -> Discriminant:
        """Fit a discriminant with equal prior probabilities of all classes.

        Parameters
        ----------
        descriptors : float64 array (E, D)
            The descriptors of the examples.
        classes : int64 array (E,)
            The class of each example, from 0; every class up to the greatest has one.
        shrinkage : float
            The share of the diagonal in the covariance, from 0 to 1.

        Raises
        ------
        ParameterError
            A class has no example.
        """
        count = int(classes.max(initial=-1)) + 1
        sizes = np.bincount(classes, minlength=count)
        if not count or not sizes.all():
            raise ParameterError("classes", "with an example of each", f"none of class {int(np.argmin(sizes))}")
        centre, scale = descriptors.mean(axis=0), descriptors.std(axis=0)
        scale = np.where(scale > 0, scale, 1.0)
        standard = (descriptors - centre) / scale
        means = np.stack([standard[classes == one].mean(axis=0) for one in range(count)])
        within = standard - means[classes]
        covariance = within.T @ within / max(len(within) - count, 1)
        lower: F64 = np.linalg.cholesky(shrunk(covariance, shrinkage)).astype(np.float64)
        weights: F64 = np.linalg.solve(lower.T, np.linalg.solve(lower, means.T)).astype(np.float64)
        return cls(centre, scale, weights, -0.5 * np.sum(means.T * weights, axis=0), means, lower)

    def log_posteriors(self, descriptors: F64) -> F64:
        """Return the logarithm of the probability of each class, float64 (S, P)."""
        scores = (descriptors - self.centre) / self.scale @ self.weights + self.biases
        scores -= scores.max(axis=1, keepdims=True)
        return scores - np.log(np.exp(scores).sum(axis=1, keepdims=True))

    @cached_property
    def _whitening(self) -> tuple[F64, F64]:
        """Return the matrix (D, D) that whitens standardised descriptors, and the axes that the whitened means span."""
        whitening = np.linalg.inv(self.lower).astype(np.float64).T
        white = self.means @ whitening
        return whitening, np.linalg.svd(white - white.mean(axis=0), full_matrices=False)[2][: max(len(white) - 1, 1)]

    def distances(self, descriptors: F64, classes: I64) -> F64:
        """Return how far descriptors are from the mean of a class, by the covariance within classes, float64 (S, 2).

        The squared Mahalanobis distance is divided into the part within the space that the means of the classes span,
        in which classes differ, and the other part, in which they do not.

        Parameters
        ----------
        descriptors : float64 array (S, D)
            The descriptors.
        classes : int64 array (S,)
            The class of each.
        """
        whitening, axes = self._whitening
        away = ((descriptors - self.centre) / self.scale - self.means[classes]) @ whitening
        within = ((away @ axes.T) ** 2).sum(axis=1)
        return np.stack([within, np.maximum((away**2).sum(axis=1) - within, 0.0)], axis=1)


def shrunk(covariance: F64, share: float) -> F64:
    """Return a covariance with off-diagonal entries reduced by a share, and `FLOOR` of the mean variance added."""
    variances = np.diag(covariance)
    found = (1.0 - share) * covariance
    np.fill_diagonal(found, variances + FLOOR * variances.mean() + 1e-9)
    return found
