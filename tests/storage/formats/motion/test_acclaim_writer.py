"""Motions that are written as Acclaim files are the same when they are read again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.body import kinematics
from kinedex.ops.errors import ParameterError
from kinedex.ops.synth.body import draw_actor
from kinedex.ops.synth.performance import perform_clip
from kinedex.ops.synth.solve import columns
from kinedex.storage.formats.motion.acclaim import AmcFile
from kinedex.storage.formats.motion.acclaim_writer import Dialect, _fixed, _scientific, write_amc, write_asf
from kinedex.storage.formats.motion.asf import read_asf
from tests.ops.synth.bodies import places

DIALECTS = (
    Dialect(),
    Dialect(newline="\r\n", length=0.5, decimals=6, remarks=("Körper",)),
    Dialect(scientific=True, decimals=6, length=1.0),
)


@pytest.mark.parametrize("dialect", DIALECTS)
def test_joints_are_where_the_body_put_them_after_writing_and_reading(dialect: Dialect, tmp_path: Path) -> None:
    body = draw_actor(4, 9).body
    angles = perform_clip(draw_actor(4, 9), "cartwheelLeft", 0, 9).angles[::25]
    write_asf(tmp_path / "one.asf", body, "one", dialect)
    size = write_amc(tmp_path / "one.amc", columns(body), angles, dialect)
    assert (tmp_path / "one.amc").stat().st_size == size
    skeleton = read_asf(tmp_path / "one.asf")
    motion = AmcFile(tmp_path / "one.amc", skeleton)
    positions, _ = kinematics.forward(skeleton.nodes, motion.channels())
    assert motion.warnings == ()
    wanted = places(body, angles)
    for name, index in skeleton.bones.items():
        np.testing.assert_allclose(positions[index].T, wanted[name], atol=1e-4)


def text(pair: tuple[np.ndarray, np.ndarray]) -> str:
    digits, kept = pair
    return digits[0][kept[0]].tobytes().decode()


@settings(max_examples=200)
@given(st.floats(-1e6, 1e6), st.integers(1, 6))
def test_numbers_read_as_they_were_to_the_last_decimal(value: float, decimals: int) -> None:
    row = np.array([value])
    assert abs(float(text(_fixed(row, decimals))) - value) <= 0.5000001 * 10.0**-decimals
    assert abs(float(text(_scientific(row, decimals))) - value) <= 0.5000001 * 10.0**-decimals * abs(value) + 1e-99


def test_numbers_are_written_as_usual() -> None:
    assert text(_fixed(np.array([-12.5]), 3)) == "-12.500"
    assert text(_fixed(np.array([0.04]), 1)) == "0.0"
    assert text(_scientific(np.array([-0.0125]), 4)) == "-1.2500e-002"
    assert text(_scientific(np.array([9.99999]), 2)) == "1.00e+001"
    assert text(_scientific(np.array([0.0]), 2)) == "0.00e+000"


def test_a_table_that_does_not_fit_the_columns_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="one column for every dof"):
        write_amc(tmp_path / "one.amc", columns(draw_actor(0, 1).body), np.zeros((2, 5)), Dialect())
    assert not list(tmp_path.iterdir())
