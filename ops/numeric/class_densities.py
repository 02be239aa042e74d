"""This module compares descriptors with classes, which are modelled by normal densities with a common covariance.

Densities without some of the examples are computed quickly, from sums over only these. The covariance is that within
classes, shrunk towards its diagonal as in `discriminant`. The squared distance between a descriptor and a class has the
same scale for all classes; half of it is the negative logarithm of the density, up to a constant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.numeric.discriminant import SHRINKAGE, shrunk

TEMPERATURE = 3.0
"""The divisor of log densities in probabilities, since numbers that vary together make them too certain."""


@dataclass(frozen=True)
class ClassDensities:
    """The densities of P classes of descriptors with D numbers.

    Attributes
    ----------
    centre, scale : float64 array (D,)
        Descriptors are standardised: the centre is subtracted, and they are divided by the scale.
    whitening : float64 array (D, D)
        The matrix that turns standardised rows into rows whose covariance within classes is the identity.
    means : float64 array (P, D)
        The whitened means of the classes; NaN for a class without an example.
    """

    centre: F64
    scale: F64
    whitening: F64
    means: F64

    def squared_distances(self, descriptors: F64) -> F64:
        """Return the squared distance of each descriptor to each class, float64 (S, P); ∞ without an example."""
        rows = self.whitened(descriptors)
        found = np.sum(rows**2, axis=1)[:, None] - 2.0 * rows @ self.means.T + np.sum(self.means**2, axis=1)
        return np.where(np.isnan(found), np.inf, np.maximum(found, 0.0))

    def whitened(self, descriptors: F64) -> F64:
        """Return descriptors (S, D) as rows whose covariance within classes is the identity."""
        whitened: F64 = (descriptors - self.centre) / self.scale @ self.whitening
        return whitened

    def shares(self, descriptor: F64, one: int, other: int) -> F64:
        """Return the share of each number of a descriptor in the evidence for one class against another.

        Parameters
        ----------
        descriptor : float64 array (D,)
            The descriptor.
        one, other : int
            Two classes with examples.

        Returns
        -------
        float64 array (D,)
            The shares. Their sum is half of the squared distance to `other` minus half of that to `one`.
        """
        difference, middle = self.means[one] - self.means[other], 0.5 * (self.means[one] + self.means[other])
        away = (descriptor - self.centre) / self.scale - np.linalg.solve(self.whitening.T, middle)
        shares: F64 = away * (self.whitening @ difference)
        return shares


class ClassSums:
    """The sums over examples from which class densities are computed, also without some of the examples.

    Parameters
    ----------
    descriptors : float64 array (E, D)
        The descriptors of the examples.
    classes : int64 array (E,)
        The class of each example, from 0.
    count : int
        The number of classes, P; some of them may have no example.
    """

    def __init__(self, descriptors: F64, classes: I64, count: int) -> None:
        self.centre, scale = descriptors.mean(axis=0), descriptors.std(axis=0)
        self.scale = np.where(scale > 0, scale, 1.0)
        self._rows = (descriptors - self.centre) / self.scale
        self._classes, self._count = classes, count
        self._all = self._sums_of(np.arange(len(classes)))

    def without(self, left_out: I64) -> ClassDensities:
        """Return the densities of all examples but some.

        Parameters
        ----------
        left_out : int64 array (B,)
            The indices of the examples to leave out, without duplicates.
        """
        sizes, sums, products = (whole - part for whole, part in zip(self._all, self._sums_of(left_out), strict=True))
        known = sizes > 0
        means = sums / np.where(known, sizes, 1.0)[:, None]
        within = products - (means * sizes[:, None]).T @ means
        covariance = within / max(float(sizes.sum()) - int(known.sum()), 1.0)
        whitening = np.linalg.inv(np.linalg.cholesky(shrunk(covariance, SHRINKAGE))).T
        return ClassDensities(self.centre, self.scale, whitening, np.where(known[:, None], means @ whitening, np.nan))

    def _sums_of(self, places: I64) -> tuple[F64, F64, F64]:
        """Return of given examples the number (P,) and sum (P, D) of each class, and the sum of products (D, D)."""
        rows, member = self._rows[places], self._classes[places][:, None] == np.arange(self._count)
        return member.sum(axis=0).astype(np.float64), member.T.astype(np.float64) @ rows, rows.T @ rows
