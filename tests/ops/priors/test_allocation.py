"""Hits and their allocation: the thesis's Figure 6.8, the twin with loops, and other frame rates."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.errors import ParameterError
from kinedex.ops.priors.allocation import MotionHit, allocate, at_rate, find_hits, prior_rows
from kinedex.ops.priors.archive_poses import PriorMotion
from kinedex.ops.priors.constraints import Mark
from kinedex.ops.priors.stabilisation import refuted_frames
from kinedex.ops.templates.templates import QuantisedTemplate
from tests.oracles import allocation as oracle


def hit(motion: int, start: int, cost: float, columns: list[float]) -> MotionHit:
    return MotionHit(motion, start, start + len(columns), cost, np.array(columns, np.float64))


FIGURE = [hit(0, 9, 0.01, [1, 2, 4, 5]), hit(0, 3, 0.06, [1, 2, 3, 4, 5])]
"""The hits of Figure 6.8, the cheaper one first; frames and columns from 1, as printed."""


def test_frames_9_to_12_of_figure_6_8_lend_to_3_to_7_and_never_back():
    allocation = allocate(FIGURE, 14, 0.13)
    assert allocation.lenders.tolist() == [-1, -1, -1, 9, 10, 10, 11, 12, -1, -1, -1, -1, -1, -1]
    assert allocation.owners.tolist() == [-1, -1, -1, 1, 1, 1, 1, 1, -1, 0, 0, 0, 0, -1]
    assert allocation.qualities == pytest.approx([1 - 0.01 / 0.13, 1 - 0.06 / 0.13])


hits = st.lists(
    st.tuples(
        st.integers(0, 1), st.integers(0, 20), st.sampled_from([0.01, 0.02, 0.05, 0.12]),
        st.lists(st.sampled_from([0.0, 0.5, 1.0, 1.0, 2.0]), min_size=1, max_size=8),
    ),
    max_size=7,
)  # fmt: skip


@given(hits)
def test_owners_and_lenders_are_those_of_the_twin(rows: list[tuple[int, int, float, list[float]]]):
    allocation = allocate([hit(m, start, cost, sorted(columns)) for m, start, cost, columns in rows], 30, 0.13)
    plain = [(m, start, start + len(c) - 1, cost, sorted(c)) for m, start, cost, c in rows]
    assert allocation.owners.tolist() == [oracle.owner(plain, t) for t in range(30)]
    assert allocation.lenders.tolist() == [oracle.lender(plain, t) for t in range(30)]


def patterned(columns: list[int]) -> QuantisedTemplate:
    return QuantisedTemplate(np.full(len(columns), 3, np.uint64), np.array(columns, np.uint64))


def test_hits_are_essential_minima_of_the_least_curve_and_other_motions_are_alternatives():
    words = np.array([0] * 6 + [1, 2, 3, 0] + [3] * 6, np.uint64)
    exact, near = patterned([1, 2, 3, 0]), patterned([1, 2, 3, 1])
    best, others = find_hits([near, exact], words, 0.2)
    assert [(h.motion, h.start, h.stop, h.cost, h.columns.tolist()) for h in best] == [(1, 6, 10, 0.0, [0, 1, 2, 3])]
    assert [(h.motion, h.stop, h.cost) for h in others] == [(0, 10, distance_curves([near], words)[0][9])]
    assert find_hits([], words, 0.2) == ([], [])
    with pytest.raises(ParameterError, match="above 0"):
        find_hits([exact], words, 0.0)


def test_hits_of_words_at_30_hz_cover_the_frames_of_a_recording_at_60_hz():
    (fast,) = at_rate([hit(0, 2, 0.1, [0, 1, 1.5, 2])], 30.0, 60.0, 100)
    assert (fast.start, fast.stop) == (4, 11)
    assert fast.columns.tolist() == [0, 0.5, 1, 1.25, 1.5, 1.75, 2]
    (slow,) = at_rate([hit(0, 3, 0.1, [0, 1, 2, 3])], 30.0, 15.0, 100)
    assert (slow.start, slow.stop, slow.columns.tolist()) == (2, 4, [1, 3])
    (same,) = at_rate([hit(0, 3, 0.1, [0, 1])], 30.0, 30.0, 4)
    assert (same.start, same.stop) == (3, 4)


def test_rows_are_runs_of_frames_with_priors_of_one_kind():
    motion = PriorMotion("step", patterned([1] * 6), None, (Mark("elbow_bent", "left", 2, 4),))
    rows = prior_rows(allocate(FIGURE, 14, 0.13), [motion], {"pose": 2.0, "elbow_bent": 1.0}, 1, [0, 1])
    found = [(r.kind, r.side, r.hit, r.start, r.stop, r.first_column, r.last_column) for r in rows]
    assert found == [
        ("elbow_bent", "left", 0, 10, 11, 2, 2), ("pose", "", 1, 3, 8, 1, 5), ("elbow_bent", "left", 1, 4, 6, 2, 3),
    ]  # fmt: skip
    assert rows[1].weight == pytest.approx(2 * (1 - 0.06 / 0.13))


def test_archive_poses_are_withdrawn_around_the_frames_that_refute_them() -> None:
    allocation = allocate([MotionHit(0, 20, 80, 0.01, np.linspace(0, 9, 60))], 100, 0.13)
    without = np.full(100, 10.0)
    assert not refuted_frames(allocation, without * 1.04, without, 30.0).any()
    costs = without.copy()
    costs[50:60] *= 1.5
    found = np.flatnonzero(refuted_frames(allocation, costs, without, 30.0))
    assert found.tolist() == list(range(found[0], found[-1] + 1))
    assert found[0] < 50
    assert found[-1] >= 60
    costs[50:60], costs[:10] = 10.0, 15.0  # no hit is there
    assert not refuted_frames(allocation, costs, without, 30.0).any()
