"""The study of simulated sensors: the aims for clocks, worlds and wrong frames hold on a take."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinedex.ops.inertial.rotations import distance_deg
from studies.inertial_judged import judge
from studies.inertial_trials import read_trials, sources

pytest.importorskip("scipy")
pytest.importorskip("vqf")


@pytest.mark.shared
def test_errors_of_a_take_are_found_by_the_sensors_that_it_wears(shared: Path) -> None:
    (trial,) = read_trials(sources(shared / "data")["CMU"][2:3], "good")
    judged = judge(trial)
    assert judged.clock.offset_s == pytest.approx(trial.worn.clock.offset_s, abs=1e-3)
    for one in judged.fits:
        assert one.fit is not None
        assert float(distance_deg(one.fit.q_global, trial.worn.q_global)) < 0.6
    (shanks,) = judged.counts("shank", [20.0])
    (hands,) = judged.counts("hand", [20.0])
    assert min(shanks.f1, hands.f1) > 0.95
