"""Frames that show the faults of a motion: none in a sound one, and the very frames of a fault that is put in."""

from __future__ import annotations

import numpy as np

from kinedex.ops.body.motion_faults import fault_marks
from tests.ops.body.test_motion_faults import JOINTS, RATE
from tests.ops.body.test_plausibility import swinging


def marked(positions: np.ndarray, valid: np.ndarray | None = None) -> dict[str, list[int]]:
    frames = np.ones(positions.shape[2], np.bool_) if valid is None else valid
    found = fault_marks(positions.transpose(2, 0, 1), JOINTS, RATE, frames)
    return {one.figure: np.flatnonzero(one.frames).tolist() for one in found if one.frames.any()}


def moved(joint: str, frames: slice, by: tuple[float, float, float]) -> np.ndarray:
    positions = swinging().copy()
    positions[JOINTS.index(joint), :, frames] += np.array(by)[:, None]
    return positions


def test_a_sound_motion_has_no_marks() -> None:
    assert marked(swinging()) == {}


def test_a_limb_that_jumps_for_a_frame_is_a_spike_there() -> None:
    spiked = moved("rwrist", slice(20, 21), (0.0, 0.0, 0.6))
    assert marked(spiked)["spike_deg"] == [20]
    valid = np.ones(spiked.shape[2], np.bool_)
    valid[20] = False
    assert "spike_deg" not in marked(spiked, valid)


def test_a_foot_below_the_floor_and_a_wrist_that_stops_are_marked() -> None:
    sunk = moved("ltoes", slice(30, 33), (0.0, -0.4, 0.0))
    assert marked(sunk)["penetration_m"] == [30, 31, 32]
    stuck = swinging() + np.array([0.01, 0.0, 0.0])[:, None] * np.arange(swinging().shape[2])
    wrist = JOINTS.index("rwrist")
    stuck[wrist, :, 10:30] = stuck[wrist, :, 10:11]
    assert set(marked(stuck)["stuck_share"]) <= set(range(10, 30))
    assert len(marked(stuck)["stuck_share"]) >= 6


def test_nothing_known_has_no_marks() -> None:
    assert marked(np.full_like(swinging(), np.nan)) == {}
    assert marked(swinging(), np.zeros(swinging().shape[2], np.bool_)) == {}
