"""The discriminant is that of textbooks, with a covariance that is shrunk towards its diagonal."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.errors import ParameterError
from kinedex.ops.numeric.discriminant import FLOOR, Discriminant, shrunk


def examples() -> tuple[np.ndarray, np.ndarray]:
    """Return descriptors of four classes that overlap, and the classes."""
    generator = np.random.default_rng(2)
    classes = np.repeat(np.arange(4), 9)
    mixed = generator.normal(size=(6, 6))
    return generator.normal(size=(4, 6))[classes] * 2 + generator.normal(size=(36, 6)) @ mixed, classes


def test_posteriors_are_those_of_scikit_learn() -> None:
    from sklearn.base import BaseEstimator
    from sklearn.discriminant_analysis import LinearDiscriminantAnalysis

    descriptors, classes = examples()
    standard = (descriptors - descriptors.mean(axis=0)) / descriptors.std(axis=0)
    means = np.stack([standard[classes == one].mean(axis=0) for one in range(4)])
    within = standard - means[classes]
    common = shrunk(within.T @ within / (36 - 4), 0.3)

    class Given(BaseEstimator):  # type: ignore[misc]
        def fit(self, _: object) -> Given:
            self.covariance_ = common
            return self

    theirs = LinearDiscriminantAnalysis(solver="lsqr", covariance_estimator=Given(), priors=[0.25] * 4)
    theirs.fit(standard, classes)
    found = Discriminant.fit(descriptors, classes, 0.3)
    np.testing.assert_allclose(found.log_posteriors(descriptors), theirs.predict_log_proba(standard), atol=1e-8)


def test_a_shrunk_covariance_has_its_variances_and_less_of_the_rest() -> None:
    covariance = np.array([[2.0, 1.0], [1.0, 4.0]])
    np.testing.assert_allclose(shrunk(covariance, 0.25), [[2.0 + 3 * FLOOR, 0.75], [0.75, 4.0 + 3 * FLOOR]], atol=1e-8)


def test_units_do_not_matter_and_numbers_that_never_vary_do_no_harm() -> None:
    descriptors, classes = examples()
    scaled = np.concatenate([descriptors * np.array([1, 1e3, 1e-3, 1, 1, 7]) + 5, np.full((36, 1), 3.0)], axis=1)
    plain = Discriminant.fit(descriptors, classes).log_posteriors(descriptors)
    found = Discriminant.fit(scaled, classes).log_posteriors(scaled)
    np.testing.assert_allclose(np.exp(found), np.exp(plain), atol=0.01)
    assert np.exp(found).sum(axis=1) == pytest.approx(1.0)


def test_a_class_without_an_example_is_refused() -> None:
    descriptors, classes = examples()
    with pytest.raises(ParameterError, match="none of class 2"):
        Discriminant.fit(descriptors[classes != 2], classes[classes != 2])


def test_distances_are_those_of_mahalanobis_in_two_parts() -> None:
    generator = np.random.default_rng(3)
    classes = np.arange(60) % 3
    descriptors = generator.normal(size=(60, 5)) + 2.0 * np.eye(5)[classes]
    found = Discriminant.fit(descriptors, classes)
    new = generator.normal(size=(7, 5))
    inverse = np.linalg.inv(found.lower @ found.lower.T)
    standard = (new - found.centre) / found.scale
    within = []
    for label in range(3):
        away = standard - found.means[label]
        parts = found.distances(new, np.full(7, label))
        np.testing.assert_allclose(parts.sum(axis=1), np.einsum("ij,jk,ik->i", away, inverse, away))
        within.append(parts[:, 0])
    odds = found.log_posteriors(new)
    np.testing.assert_allclose(odds[:, 1] - odds[:, 0], (within[0] - within[1]) / 2)
