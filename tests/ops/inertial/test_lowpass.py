"""The low pass that runs forth and back agrees with scipy's."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.errors import ParameterError
from kinedex.ops.inertial.lowpass import lowpass
from kinedex.ops.inertial.time_offset import _fast_length


@pytest.mark.parametrize(
    ("count", "rate", "cutoff", "padding"), [(400, 200.0, 5.0, 9), (50, 120.0, 15.0, 24), (10, 100.0, 30.0, 9)]
)
def test_it_agrees_with_scipy(count: int, rate: float, cutoff: float, padding: int) -> None:
    signal = pytest.importorskip("scipy.signal")
    values = np.cumsum(np.random.default_rng(count).normal(size=(count, 3)), axis=0)
    sections = signal.butter(2, cutoff, fs=rate, output="sos")
    wanted = signal.sosfiltfilt(sections, values, axis=0, padlen=padding)
    np.testing.assert_allclose(lowpass(values, rate, cutoff, padding), wanted, rtol=0, atol=1e-11)
    np.testing.assert_array_equal(
        lowpass(values[:, 1], rate, cutoff, padding), lowpass(values, rate, cutoff, padding)[:, 1]
    )


def test_bad_frequencies_and_too_few_values_are_refused() -> None:
    with pytest.raises(ParameterError, match="cutoff_hz must be between 0 and 50"):
        lowpass(np.zeros(20), 100.0, 50.0)
    with pytest.raises(ParameterError, match="values must be more than 9"):
        lowpass(np.zeros(9), 100.0, 5.0)


def test_fast_lengths_have_no_other_factors() -> None:
    fft = pytest.importorskip("scipy.fft")
    for least in (1, 2, 7, 97, 1000, 12_345, 60_001):
        assert _fast_length(least) == fft.next_fast_len(least, real=True)
