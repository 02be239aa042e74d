"""Simulated sensors against real ones: noise at rest, and readings made of optical truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from studies.inertial_sensors import agreement, allan, densities, longest_rest, read_trial, simulated_rest

pytest.importorskip("scipy")


def test_the_noise_of_simulated_sensors_is_white_and_as_dense_as_their_grade_says() -> None:
    rest = simulated_rest("good", 100.0, 60.0)
    assert densities(np.degrees(rest.gyr), 100.0) == pytest.approx([0.007] * 3, rel=0.1)
    assert densities(rest.acc, 100.0)[1:] == pytest.approx([8e-4] * 2, rel=0.1)
    assert allan(simulated_rest("good", 100.0, 30.0)) == "rest of 30 s: density only"


def test_a_rest_is_found_between_movements() -> None:
    gyr = np.full((2000, 3), 1.0)
    gyr[600:1400] = 0.001
    rest = longest_rest("a", 100.0, np.ones((2000, 3)), gyr)
    assert rest is not None
    assert 5.5 < rest.seconds < 8.0
    assert longest_rest("a", 100.0, np.ones((300, 3)), gyr[:300]) is None


@pytest.mark.shared
def test_readings_of_optical_truth_are_near_those_of_the_sensor(shared: Path) -> None:
    pytest.importorskip("h5py")
    (path,) = (shared / "data" / "imu" / "broad").glob("05_*.hdf5")
    found = agreement(read_trial(path))
    assert found.gyr_deg_s < 1.5
    assert found.gyr > 0.999
    assert found.acc_m_s2 < 0.12
    assert found.acc > 0.9995
    assert found.mag_ut < 0.8
