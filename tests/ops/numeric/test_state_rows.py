"""Rows of states: paths are the best of all, and states say where in a motion a frame lies."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.arrays import F64
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.errors import ParameterError
from kinedex.ops.numeric.channels import channels
from kinedex.ops.numeric.state_rows import StateRows, best_path, usual_frames, widened
from tests.ops.numeric.motions import RATE_HZ, in_a_row, motion


def every_path(frames: int, states: int) -> list[tuple[int, ...]]:
    """Return all paths from the first to the last state that stay, take the next state, or leave one out."""
    found = []
    for steps in product(range(3), repeat=frames - 1):
        path = np.concatenate([[0], np.cumsum(steps)]).astype(int)
        if path[-1] == states - 1:
            found.append(tuple(path.tolist()))
    return found


@settings(max_examples=40, deadline=None)
@given(frames=st.integers(1, 7), states=st.integers(1, 5), seed=st.integers(0, 99))
def test_a_path_has_the_most_evidence_of_all(frames: int, states: int, seed: int) -> None:
    evidence: F64 = np.random.default_rng(seed).normal(size=(frames, states))
    paths = every_path(frames, states)
    if paths:
        best = max(paths, key=lambda path: evidence[range(frames), path].sum())
        found = best_path(evidence)
        assert evidence[range(frames), found].sum() == pytest.approx(evidence[range(frames), best].sum())
        assert tuple(found.tolist()) in paths


def test_states_explain_their_own_motions_best() -> None:
    names = ("raise left", "raise right", "bow")
    clips = [channels(motion(names[k % 3], 40 + k, k), JOINTS, RATE_HZ).frames for k in range(9)]
    archive = channels(in_a_row(["walk", "stand"], [60, 60]), JOINTS, RATE_HZ).frames
    rows = StateRows.fit(clips, np.arange(9) % 3, archive, RATE_HZ)
    assert np.diff(rows.firsts).tolist() == [9, 9, 9]
    evidence = rows.evidence(channels(motion("bow", 44, 77), JOINTS, RATE_HZ).frames)
    middle = int(evidence[22].argmax())
    assert rows.firsts[2] + 2 <= middle < rows.firsts[3] - 2
    assert rows.evidence(archive[10:50]).max(axis=1).mean() < evidence[10:34].max(axis=1).mean()


def test_usual_frames_are_the_middles_of_groups() -> None:
    generator = np.random.default_rng(1)
    groups = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]])
    frames = np.concatenate([one + generator.normal(0, 0.1, (30, 2)) for one in groups])
    found = usual_frames(frames, 6)
    assert len(found) == 6
    assert all(np.linalg.norm(found - one, axis=1).min() < 0.2 for one in groups)
    assert usual_frames(frames[:3], 6).tolist() == frames[:3].tolist()


def test_examples_that_teach_nothing_are_refused() -> None:
    frames = np.zeros((10, 4))
    with pytest.raises(ParameterError, match="two frames or more"):
        StateRows.fit([frames, frames[:1]], np.array([0, 1]), frames, RATE_HZ)
    with pytest.raises(ParameterError, match="none of class 1"):
        StateRows.fit([frames, frames], np.array([0, 2]), frames, RATE_HZ)


def test_few_examples_say_little_of_what_varies() -> None:
    narrow = 0.01 * np.eye(3)
    spreads = [float(widened(narrow, count)[0, 0]) for count in (1.0, 2.0, 5.0, 100.0)]
    assert spreads == sorted(spreads, reverse=True)
    assert spreads[0] > 0.5
    assert spreads[-1] == pytest.approx(0.01, rel=0.01)
