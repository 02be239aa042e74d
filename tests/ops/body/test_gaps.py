"""Gaps: short ones are closed along straight lines, long ones are left and named."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.body.resample import Gap, fill_gaps, find_gaps

SEEN = st.lists(st.lists(st.booleans(), min_size=1, max_size=12), min_size=1, max_size=3).filter(
    lambda rows: len({len(row) for row in rows}) == 1
)


@given(SEEN, st.integers(0, 5), st.integers(0, 2))
def test_straight_motions_come_back_and_long_gaps_stay(seen: list[list[bool]], longest: int, axis: int) -> None:
    mask = np.array(seen)
    frames = mask.shape[1]
    track = np.arange(frames) * np.array([1.0, -2.0, 0.5])[:, None] + np.array([3.0, 0.0, 1.0])[:, None]
    positions = np.repeat(track[None], len(mask), axis=0)
    for point, t in zip(*np.nonzero(~mask), strict=True):
        positions[point, axis, t] = np.nan
    filled, closed, left = fill_gaps(positions, longest)
    assert sorted([*closed, *left], key=lambda gap: (gap.point, gap.start)) == find_gaps(positions)
    assert sum(gap.frames for gap in find_gaps(positions)) == np.count_nonzero(~mask)
    for gap in closed:
        assert gap.frames <= longest
        inside = filled[gap.point, :, gap.start : gap.stop]
        if gap.start == 0:
            expected = np.repeat(track[:, gap.stop, None], gap.frames, axis=1)
        elif gap.stop == frames:
            expected = np.repeat(track[:, gap.start - 1, None], gap.frames, axis=1)
        else:
            expected = track[:, gap.start : gap.stop]
        np.testing.assert_allclose(inside, expected)
    for gap in left:
        assert gap.frames > longest or gap.frames == frames
        assert np.isnan(filled[gap.point, axis, gap.start : gap.stop]).all()
    np.testing.assert_array_equal(
        filled[mask.nonzero()[0], :, mask.nonzero()[1]], positions[mask.nonzero()[0], :, mask.nonzero()[1]]
    )


def test_a_gap_is_named_by_point_and_frames() -> None:
    positions = np.zeros((2, 3, 6))
    positions[1, 2, 1:3] = np.nan
    positions[1, 0, 2] = np.nan
    positions[1, :, 5] = np.nan
    assert find_gaps(positions) == [Gap(1, 1, 3), Gap(1, 5, 6)]
