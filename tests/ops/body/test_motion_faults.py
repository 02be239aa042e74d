"""Faults of a motion: each figure on a body that moves like a person, beside a plain twin, and with the fault."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest

from kinedex.ops.body.motion_faults import (
    CONTACT_M,
    CONTACT_M_S,
    FLOOR_SHARE,
    GROUND_M,
    LAG_S,
    LOCKED,
    MOVES_M_S,
    SIDEWAYS,
    MotionFaults,
    motion_faults,
)
from tests.ops.body.test_plausibility import swinging
from tests.oracles.features import JOINTS

F64 = npt.NDArray[np.float64]
RATE = 30.0


def noisy(seed: int) -> F64:
    return swinging() + np.random.default_rng(seed).normal(0, 0.02, swinging().shape)


def of(positions: F64, rate_hz: float = RATE, valid: npt.NDArray[np.bool_] | None = None) -> MotionFaults:
    frames = positions.shape[2]
    return motion_faults(positions, JOINTS, rate_hz, np.ones(frames, np.bool_) if valid is None else valid)


def joint(positions: F64, name: str) -> F64:
    return positions[JOINTS.index(name)].T


def low(values: F64) -> float:
    return float(np.sort(values)[int(FLOOR_SHARE * (len(values) - 1))])


def naive(positions: F64, rate: float) -> dict[str, float]:
    """Return the figures by their definitions."""
    lowest = positions[:, 1].min(axis=0)
    slid, contact, deepest = 0.0, 0, np.inf
    for side in "lr":
        foot = joint(positions, side + "toes")
        deepest = min(deepest, foot[:, 1].min())
        for a, b in pairwise(foot):
            if max(a[1], b[1]) <= low(foot[:, 1]) + CONTACT_M and abs(b[1] - a[1]) * rate <= CONTACT_M_S:
                slid, contact = slid + np.hypot(b[0] - a[0], b[2] - a[2]), contact + 1
    flight, run = 0, 0
    for height in lowest:
        run = run + 1 if height > low(lowest) + GROUND_M else 0
        flight = max(flight, run)
    hips = joint(positions, "lhip") - joint(positions, "rhip")
    bent = np.zeros(len(hips), bool)
    spike, stuck = 0.0, 0.0
    for side in "lr":
        names = [side + name for name in ("hip", "knee", "ankle")]
        hip, knee, ankle = (joint(positions, name) for name in names)
        for t in range(len(hips)):
            axis = np.cross(knee[t] - hip[t], ankle[t] - knee[t])
            angle = np.arctan2(np.linalg.norm(axis), (knee[t] - hip[t]) @ (ankle[t] - knee[t]))
            bent[t] |= angle > LOCKED and axis @ hips[t] < -SIDEWAYS * np.linalg.norm(axis) * np.linalg.norm(hips[t])
        for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist")):
            begin, end = joint(positions, side + a), joint(positions, side + b)
            bone = (end - begin) / np.linalg.norm(end - begin, axis=1)[:, None]
            angle = [np.arccos(np.clip(bone @ one, -1, 1)) for one in bone]
            for t in range(1, len(bone) - 1):
                spike = max(spike, 0.5 * (angle[t - 1][t] + angle[t][t + 1] - angle[t - 1][t + 1]))
            if b != "ankle":
                still = (np.diff(end, axis=0) == 0).all(axis=1)
                stuck = max(
                    stuck, float((still & (np.linalg.norm(np.diff(begin, axis=0), axis=1) > MOVES_M_S / rate)).mean())
                )
    return {
        "foot_skate_m_s": slid / contact * rate, "penetration_m": max(low(lowest) - deepest, 0.0),
        "flight_s": flight / rate, "knee_forwards_share": float(bent.mean()), "spike_deg": float(np.degrees(spike)),
        "stuck_share": stuck, "invalid_share": 0.0,
    }  # fmt: skip


@pytest.mark.parametrize("seed", range(3))
def test_the_figures_are_those_of_the_twin(seed: int) -> None:
    positions = noisy(seed)
    found = vars(of(positions))
    for name, value in naive(positions, RATE).items():
        assert found[name] == pytest.approx(value, abs=1e-4), name


def test_jitter_is_the_third_derivative_whatever_the_rate() -> None:
    t = np.arange(240) / 120
    positions = np.zeros((len(JOINTS), 3, 240))
    positions[:, 1] = 5.0 * t**3  # whose third derivative is 30
    assert of(positions, 120.0).jitter_m_s3 == pytest.approx(30.0)
    assert of(positions[:, :, ::4], 30.0).jitter_m_s3 == pytest.approx(30.0)
    assert round(120.0 * LAG_S) == 4


def test_invalid_frames_do_not_count() -> None:
    positions, valid = swinging(), np.ones(120, np.bool_)
    before = of(positions)
    positions[JOINTS.index("lwrist"), :, 50] += 3.0
    assert of(positions).spike_deg > before.spike_deg + 20
    valid[50] = False
    after = of(positions, valid=valid)
    assert after.spike_deg <= before.spike_deg + 1e-9
    assert after.invalid_share == pytest.approx(1 / 120)


def test_joints_that_are_missing_leave_figures_unknown() -> None:
    positions = swinging()
    positions[[i for i, name in enumerate(JOINTS) if name[1:] in ("hip", "knee", "ankle", "toes")]] = np.nan
    found = of(positions)
    assert np.isnan([found.foot_skate_m_s, found.penetration_m, found.knee_forwards_share]).all()
    assert np.isfinite([found.spike_deg, found.jitter_m_s3, found.stuck_share]).all()
    assert of(positions[:, :, :3]).invalid_share == 0.0
    assert np.isnan(of(np.full((24, 3, 9), np.nan)).flight_s)
