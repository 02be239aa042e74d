"""Real sensors beside optical truth: orientations, offsets and calibrations are as measured when they were designed."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinedex.ops.inertial.hand_eye import Options
from studies.inertial import (
    SETTINGS,
    feet_errors,
    feet_offset,
    feet_streams,
    lag,
    orientation_errors,
    trial_calibration,
    trial_offset,
)
from studies.inertial_recordings import read_broad, read_feet

pytestmark = pytest.mark.shared

ORIENTATIONS = {
    "05_undisturbed_slow_rotation_with_breaks_B": ((0.63, 0.27), (0.79, 0.27)),
    "07_undisturbed_fast_rotation_B": ((1.71, 0.96), (1.49, 0.96)),
    "18_undisturbed_fast_translation_with_breaks_B": ((0.68, 0.54), (1.15, 0.54)),
    "24_disturbed_tapping_A": ((1.16, 0.51), (1.23, 0.51)),
    "31_disturbed_stationary_magnet_D": ((3.98, 0.92), (6.83, 0.92)),
}
"""Total error and inclination, RMS in degrees, with and without the magnetometer."""

CALIBRATIONS = {
    "05": ((0.15, 0.42), (0.13, 0.43), (0.19, 0.61), (0.12, 0.33)),
    "07": ((0.57, 1.56), (0.56, 1.56), (0.39, 1.46), (0.23, 1.22)),
    "18": ((0.65, 0.61), (0.14, 0.65), (0.09, 0.76), (0.15, 0.63)),
    "24": ((0.31, 0.82), (0.30, 0.83), (0.25, 0.77), (0.23, 0.55)),
    "31": ((0.89, 1.47), (0.57, 1.63), (0.38, 2.94), (0.34, 1.01)),
}
"""By how much q_L is off, and RMS of e in degrees, for each of the study's settings."""


@pytest.mark.parametrize("name", ORIENTATIONS)
def test_trials_of_broad_are_as_measured(shared: Path, name: str) -> None:
    trial = read_broad(shared / "data" / "imu" / "broad" / f"{name}.hdf5")
    for magnetometer, wanted in zip((True, False), ORIENTATIONS[name], strict=True):
        assert orientation_errors(trial, magnetometer) == pytest.approx(wanted, abs=0.05)
    assert 0.0039 < lag([trial], 5.0).offset_s < 0.0043
    assert 0.0020 < trial_offset(trial) < 0.0025  # without the half interval by which a rate lags
    for (magnetometer, options), wanted in zip(SETTINGS.values(), CALIBRATIONS[trial.name], strict=True):
        assert trial_calibration(trial, magnetometer, options) == pytest.approx(wanted, abs=0.05)


def test_feet_are_as_measured(shared: Path) -> None:
    feet = read_feet(shared / "data" / "imu" / "feet")
    found = lag(feet)
    assert not found.refused
    assert (found.correlation, found.next_best) == pytest.approx((0.99, 0.88), abs=0.006)
    assert 1000 * found.offset_s == pytest.approx(2.1, abs=0.3)
    assert [1000 * lag([foot]).offset_s for foot in feet] == pytest.approx([0.3, 3.9], abs=0.3)
    offset = feet_offset(feet)
    assert -0.0014 < offset < -0.0008
    assert -0.0010 < feet_offset(feet, whitened=True) < -0.0002
    streams = feet_streams(feet, offset)
    for options, wanted in (
        (Options(shared=False), [(2.5, 1.7, 6.2), (3.4, 3.1, 10.9)]),
        (Options(shared=False, drift=True), [(2.4, 1.7, 6.2), (3.1, 3.1, 10.9)]),
    ):
        for foot, numbers in zip(feet_errors(streams, options), wanted, strict=True):
            assert foot[:3] == pytest.approx(numbers, abs=0.3)
    tilts = [foot.tilt for foot in feet_errors(streams, Options(shared=False, vertical_known=False))]
    assert tilts == pytest.approx([0.2, 0.6], abs=0.1)
    assert feet_errors(streams, Options())[1].mean == pytest.approx(29.0, abs=1.0)  # each heading is arbitrary
