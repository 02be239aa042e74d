"""Coarse sums of templates side by side against those of each one alone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.distances import pruning
from kinedex.ops.distances.costs import column_layout, encode
from kinedex.ops.distances.pruning import coarse_bounds
from kinedex.ops.distances.sweep import BLOCK, SLOTS, aligned_bytes, least_sums, pieces_of, place_columns
from tests.ops.distances.test_dtw import as_words_with_gaps, feature_weights, quantised, takes_with_gaps, templates
from tests.oracles.stripes import CAP, coarse_sums

Drawn = tuple[list[list[int | None]], list[float] | None, float]
drawn = st.tuples(templates, st.none() | feature_weights, st.sampled_from([0.05, 0.1, 0.3, 1.0]))


def by_blocks(sums: list[int]) -> list[int]:
    return [min(sums[first : first + BLOCK]) for first in range(0, len(sums), BLOCK)]


@given(st.lists(drawn, min_size=1, max_size=6), takes_with_gaps, st.integers(1, 20))
def test_coarse_sums_are_those_of_the_naive_twin(several: list[Drawn], take: list[list[int] | None], longest: int):
    layout = column_layout([quantised(template, weights) for template, weights, _ in several])
    units = np.array([threshold for *_, threshold in several]) * layout.lengths / CAP
    pieces = pieces_of(np.array([[0, len(take)]]), longest, 2 * (int(layout.lengths.max()) - 1))
    found = least_sums(layout, encode(as_words_with_gaps(take)), units, pieces)
    for own, (template, weights, threshold) in zip(found.tolist(), several, strict=True):
        assert own == by_blocks(coarse_sums(template, take, threshold, weights))


@given(takes_with_gaps, takes_with_gaps, templates)
def test_no_path_leads_from_one_take_into_the_next(
    one: list[list[int] | None], other: list[list[int] | None], template: list[list[int | None]]
):
    words = np.concatenate([as_words_with_gaps(one), as_words_with_gaps(other)])
    takes = np.array([[0, len(one)], [len(one), len(words)]])
    pieces = pieces_of(takes[takes[:, 0] < takes[:, 1]], 4096, 2 * (len(template) - 1))
    found = least_sums(column_layout([quantised(template)]), encode(words), np.array([len(template) / CAP]), pieces)
    assert found[0].tolist() == by_blocks(coarse_sums(template, one, 1.0) + coarse_sums(template, other, 1.0))


@given(st.lists(st.integers(1, 500), min_size=1, max_size=SLOTS // 2))
def test_templates_end_in_the_last_row_below_a_cell_of_their_own(lengths: list[int]):
    rows, slots, positions = place_columns(np.array(lengths))
    assert rows % 2 == 0
    assert len(np.unique(positions)) == len(positions) == sum(lengths)
    assert 0 <= positions.min() <= positions.max() < rows * SLOTS
    # read slot by slot, a template's columns follow each other, and the cell above the first belongs to nobody
    down = positions % SLOTS * rows + positions // SLOTS
    for length, slot, last in zip(lengths, slots.tolist(), np.cumsum(lengths).tolist(), strict=True):
        own = down[last - length : last]
        assert own[-1] == (slot + 1) * rows - 1
        assert (np.diff(own) == 1).all()
        assert own[0] - 1 not in down
        assert own[0] > 0


def test_more_templates_than_a_pass_has_room_for_are_bounded_in_several(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(pruning, "_MAX_TEMPLATES", 2)
    template = quantised([[0, 1, None, 1, 0], [1, 1, 0, None, 0], [0, 0, 0, 1, 1]])
    take = [[0, 1, 0, 1, 0], [1, 1, 0, 0, 0], [0, 0, 0, 1, 1]] * 5
    words, ranges = encode(as_words_with_gaps(take)), np.array([[0, len(take)]])
    together = coarse_bounds([template] * 5, words, np.full(5, 0.2), ranges)
    alone = coarse_bounds([template], words, np.full(1, 0.2), ranges)
    for one in together:
        np.testing.assert_array_equal(one.sums, alone[0].sums)
    assert alone[0].sums.min() == 0


@pytest.mark.parametrize("shape", [(1,), (3, 128), (7, 5)])
def test_rows_begin_with_a_line_of_the_cache(shape: tuple[int, ...]):
    cells = aligned_bytes(shape, 7)
    assert cells.shape == shape
    assert cells.ctypes.data % SLOTS == 0
    assert (cells == 7).all()
