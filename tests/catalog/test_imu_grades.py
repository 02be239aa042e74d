"""Grades of simulated sensors: shipped ones, and messages about wrong files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.configs import config_names, config_path, load_yaml
from kinedex.catalog.imu_grades import load_grade
from kinedex.ops.errors import ConfigError
from kinedex.ops.inertial.sensor_model import ChannelErrors, Grade


def test_shipped_grades_are_in_si_units() -> None:
    assert load_grade("perfect") == Grade()
    good, cheap = load_grade("good"), load_grade("cheap")
    assert good.acc == ChannelErrors(8e-4, 0.02, 2e-4)
    assert np.degrees([good.gyr.density, good.gyr.bias, good.gyr.walk]) == pytest.approx([0.007, 0.2, 0.003])
    assert np.degrees([cheap.gyr.density, cheap.gyr.bias, cheap.gyr.walk]) == pytest.approx([0.03, 1.0, 0.02])
    assert (good.mag.density, cheap.mag.density, cheap.mag.bias) == (0.05, 0.3, 2.0)
    assert load_grade("mpu-9250").acc.density == pytest.approx(300e-6 * 9.80665)


@pytest.mark.parametrize("name", config_names("imu_grades"))
def test_grades_of_devices_name_their_source(name: str) -> None:
    load_grade(name)
    content = load_yaml(config_path("imu_grades", name)).mapping()
    assert content["name"] == name
    assert bool(content.get("source")) == (name not in ("perfect", "good", "cheap"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("acc: {density: -1}", "acc.density"),
        ("acc: {unit: deg/s}", "must be m/s2 or g, got deg/s"),
        ("gyro: {density: 1}", "gyro"),
        ("gaps: {per_minute: .inf}", "gaps.per_minute"),
        ("soft_tissue_deg: much", "soft_tissue_deg"),
    ],
)
def test_wrong_grades_are_named_by_line_and_key(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "own.yaml").write_text(f"name: own\n{text}\n")
    with pytest.raises(ConfigError, match=message) as fault:
        load_grade(tmp_path / "own.yaml")
    assert fault.value.line == 2
    with pytest.raises(ConfigError, match="did you mean 'cheap'"):
        load_grade("chepa")
