"""Lengths and medians of few numbers are those of numpy, to the bit."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from kinedex.catalog.skeletons.recognition.tree import lengths, medians

NUMBERS = st.one_of(st.floats(-1e6, 1e6), st.sampled_from([np.nan, np.inf, 0.0, 1e-300]))


@given(arrays(np.float64, array_shapes(min_dims=1, max_dims=2, min_side=1, max_side=9), elements=NUMBERS))
def test_medians_are_those_of_numpy(values: np.ndarray) -> None:
    with np.errstate(invalid="ignore"):
        np.testing.assert_array_equal(medians(values), np.median(values, axis=-1))


@given(arrays(np.float64, st.tuples(st.integers(1, 5), st.just(3), st.integers(1, 7)), elements=NUMBERS))
def test_lengths_are_those_of_numpy(vectors: np.ndarray) -> None:
    with np.errstate(invalid="ignore"):
        np.testing.assert_array_equal(lengths(vectors, 1), np.linalg.norm(vectors, axis=1))
        np.testing.assert_array_equal(lengths(vectors[0]), np.linalg.norm(vectors[0], axis=0))
