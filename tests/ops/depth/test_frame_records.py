"""Packed results of frames give back what takes and their results are made of."""

from __future__ import annotations

import numpy as np

from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.depth.frame_records import FrameRecords
from kinedex.ops.depth.pose_fit import PoseCost
from kinedex.ops.depth.tracker import Candidate, FrameResult, Hypothesis


def made(seed: int, hypothesis: Hypothesis | None) -> FrameResult:
    random = np.random.default_rng(seed)
    local, database = PoseCost(*random.random(4).tolist()), PoseCost(*random.random(4).tolist())
    numbers = random.random((3, 3)).tolist()
    return FrameResult(
        pose=random.random((24, 3)), hypothesis=hypothesis, cost_local=local.total, cost_database=database.total, row=7,
        local=None, database=None, extrema=random.random((20, 3)), facing=random.random(3), centre=random.random(3),
        points=3000, components=2, links=1, maps=random.integers(0, 6, (12, 5)), sums=random.random(12),
        candidates=tuple(Candidate(k, numbers[k][0], 5 * k, *numbers[k][1:]) for k in range(3)),
        unseen=random.random(24) < 0.2, started=True, people=1, parts=(local, database), box=(1, 2, 30, 40),
    )  # fmt: skip


def test_records_give_back_frames_in_either_order() -> None:
    frames = [made(1, "local"), None, made(2, "database"), made(3, None)]
    records = FrameRecords(candidates=3, frames=2)
    for frame in frames:
        records.append(frame)
    assert records.nbytes < 1300 * len(frames)
    for _ in range(2):
        assert [one is None for one in records] == [one is None for one in frames]
        for given, found in zip(frames, records, strict=True):
            if given is None or found is None:
                continue
            for name in ("pose", "facing", "centre", "unseen"):
                assert np.array_equal(getattr(given, name), getattr(found, name))
            assert np.allclose(given.extrema, found.extrema, atol=1e-6)
            plain = ("hypothesis", "cost_local", "row", "points", "candidates", "parts", "box")
            assert [getattr(given, name) for name in plain] == [getattr(found, name) for name in plain]
            assert len(found.maps) == 12
            for one in found.candidates:
                assert found.maps[one.map].tolist() == given.maps[one.map].tolist()
                assert found.sums[one.map] == given.sums[one.map]
        costs = [np.nan if one is None or one.hypothesis is None else one.cost for one in frames]
        assert np.array_equal(records.costs, costs, equal_nan=True)
        assert records.poses.shape == (4, len(JOINTS), 3)
        assert np.isnan(records.poses[[one is None for one in frames]]).all()
        records.reverse()
        frames.reverse()
