"""Curves of limb errors where a take has several recordings."""

from __future__ import annotations

import numpy as np

from kinedex.ops.inertial.limb_motion import LimbMotion
from kinedex.ops.inertial.rotations import exp
from kinedex.pipelines.inertial.limb_error_curves import take_errors
from kinedex.pipelines.inertial.parameters import LimbErrorsParameters
from kinedex.pipelines.inertial.worn_sensors import Clock, WornSensor, WornTake

FRAMES = 300
TIMES = np.arange(FRAMES) / 100.0
STILL = np.tile([1.0, 0.0, 0.0, 0.0], (FRAMES, 1))
SAME = {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}


def sensor(recording: str, start: int, stop: int, degrees: float) -> WornSensor:
    """A sensor that lies still at an angle, in a recording of some of the frames."""
    turned = np.tile(exp(np.radians([0.0, degrees, 0.0])), (stop - start, 1))
    return WornSensor(recording, f"s-{recording}", "lshank", TIMES[start:stop], None, turned, True)


def test_recordings_of_parts_of_a_take_judge_their_frames() -> None:
    limb = LimbMotion(
        "lshank", "full", TIMES, STILL, np.zeros((FRAMES, 3)), np.tile([0.0, 1.0, 0.0], (FRAMES, 1)),
        np.ones(FRAMES, bool), np.zeros(FRAMES, bool), None,
    )  # fmt: skip
    sensors = (sensor("a", 0, 100, 60.0), sensor("b", 100, 300, 10.0))
    take = WornTake(1, "take", {"lshank": limb}, sensors, {})
    clocks = {(1, name): Clock(0.0) for name in "ab"}
    row = {"q_global": SAME, "q_mount": SAME, "drift": None}
    rows = {(1, name, f"s-{name}"): row for name in "ab"}
    found = take_errors(take, clocks, rows, LimbErrorsParameters())
    (curve,) = found.curves
    assert curve.valid.all()
    assert found.left_out == []
    assert take_errors(take, {}, rows, LimbErrorsParameters()).left_out == [
        "s-a of a: no clock or no mount", "s-b of b: no clock or no mount",
    ]  # fmt: skip
    both = WornTake(1, "take", {"lshank": limb}, (sensors[0], sensor("a", 0, 100, 5.0)), {})
    assert take_errors(both, {}, {}, LimbErrorsParameters()).left_out == ["2 sensors of a: no clock or no mount"]
    assert np.allclose(curve.degrees, np.where(TIMES < 0.995, 60.0, 10.0))
    assert [str(name) for name in curve.recording[[0, 99, 100, 299]]] == ["a", "a", "b", "b"]
    assert [(run.start, run.stop) for run in found.runs["lshank"][0]] == [(0, 100)]
