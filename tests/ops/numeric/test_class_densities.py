"""Distances to classes are those of normal densities, also where some examples are left out."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.arrays import F64, I64
from kinedex.ops.numeric.class_densities import ClassSums
from kinedex.ops.numeric.discriminant import SHRINKAGE, Discriminant, shrunk

GENERATOR = np.random.default_rng(3)
CLASSES = np.repeat(np.arange(4), [9, 7, 1, 8])
DESCRIPTORS = GENERATOR.normal(0, [3.0, 1.0, 0.2, 5.0, 1.0], (25, 5)) + GENERATOR.normal(0, 2.0, (4, 5))[CLASSES]


def plain_distances(examples: F64, classes: I64, every: F64, asked: F64) -> F64:
    """Return squared distances by the definition, of numbers that are standardised by all examples."""
    standard, rows = ((some - every.mean(axis=0)) / every.std(axis=0) for some in (examples, asked))
    within = np.concatenate([standard[classes == one] - standard[classes == one].mean(axis=0) for one in set(classes)])
    inverse = np.linalg.inv(shrunk(within.T @ within / (len(standard) - len(set(classes))), SHRINKAGE))
    found = np.full((len(asked), 4), np.inf)
    for one in set(classes):
        away = rows - standard[classes == one].mean(axis=0)
        found[:, one] = np.einsum("sd,de,se->s", away, inverse, away)
    return found


@pytest.mark.parametrize("left_out", [[], [3], [0, 5, 11, 24], [16], list(range(9))])
def test_examples_that_are_left_out_teach_nothing(left_out: list[int]) -> None:
    kept = np.setdiff1d(np.arange(25), left_out)
    asked = GENERATOR.normal(0, 3, (6, 5))
    found = ClassSums(DESCRIPTORS, CLASSES, 4).without(np.array(left_out, np.int64)).squared_distances(asked)
    plain = plain_distances(DESCRIPTORS[kept], CLASSES[kept], DESCRIPTORS, asked)
    np.testing.assert_allclose(found, plain, rtol=1e-8)


def test_half_the_difference_of_two_distances_is_that_of_the_discriminants_scores() -> None:
    asked = GENERATOR.normal(0, 3, (6, 5))
    distances = ClassSums(DESCRIPTORS, CLASSES, 4).without(np.empty(0, np.int64)).squared_distances(asked)
    logs = Discriminant.fit(DESCRIPTORS, CLASSES).log_posteriors(asked)
    np.testing.assert_allclose(0.5 * (distances[:, :1] - distances), logs - logs[:, :1], atol=1e-8)


def test_numbers_that_never_vary_do_not_matter() -> None:
    still = np.concatenate([DESCRIPTORS, np.full((25, 1), 7.0)], axis=1)
    found = ClassSums(still, CLASSES, 4).without(np.array([2])).squared_distances(still)
    assert np.isfinite(found[:, [0, 1, 3]]).all()
