"""Files of sensors: which limb wears a sensor, by its number, its file or its own name."""

from __future__ import annotations

import re

import numpy as np
import pytest

from kinedex.catalog.configs import config_names, parse_yaml
from kinedex.catalog.limbs import LIMB_NAMES
from kinedex.catalog.sensorsets import SensorSet, load_sensor_set, parse_sensor_set
from kinedex.ops.errors import ConfigError


def of(content: str) -> SensorSet:
    return parse_sensor_set(parse_yaml(content, "five.yaml"))


@pytest.mark.parametrize("name", config_names("sensors"))
def test_a_shipped_file_has_limbs_once_each(name: str) -> None:
    worn = list(load_sensor_set(name).entries.sensors.values())
    assert set(worn) <= set(LIMB_NAMES)
    assert len(set(worn)) == len(worn)


def test_a_number_comes_before_patterns_and_a_limbs_name_needs_no_entry() -> None:
    chosen = of("sensors: {'00B421ED': lshank, '*_r*.csv': rshank, 'left/*': lhand}")
    assert chosen.limb("00B421ED", "left/a.csv") == "lshank"
    assert chosen.limb("other", "kick/a_right.csv") == "rshank"
    assert chosen.limb("other", "left/b.csv") == "lhand"
    assert chosen.limb("lhand", "b.csv") is None
    assert SensorSet().limb("lhand") == "lhand"
    assert SensorSet().limb("a") is None


def test_two_sensors_on_one_limb_are_refused_with_the_line() -> None:
    chosen = of("# two\nsensors:\n  a: lshank\n  b: lshank\n")
    assert chosen.limbs({"a": "x.csv", "c": "x.csv"}) == {"a": "lshank"}
    message = "five.yaml:2: sensors: the sensors 'a' and 'b' of one recording are both worn on lshank"
    with pytest.raises(ConfigError, match=re.escape(message)):
        chosen.limbs({"a": "x.csv", "b": "x.csv"})


def test_axes_are_a_turn() -> None:
    matrix = of("axes: [-y, x, z]").matrix()
    assert matrix is not None
    np.testing.assert_array_equal(matrix @ [1, 2, 3], [-2, 1, 3])
    assert of("{}").matrix() is None
