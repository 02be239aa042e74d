"""Distance curves and start frames against their naive twin, which builds the whole matrix."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.distances.costs import cost_table, grid_step
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.errors import ParameterError
from kinedex.ops.templates.templates import QuantisedTemplate, Template, quantise
from kinedex.ops.words import NO_WORD, pack
from tests.oracles import dtw as naive
from tests.oracles.paths import best_paths, start_frames
from tests.plain_python import slow_as_python

FEATURES = 5


def single_bound(columns: int) -> float:
    """Return the largest error of a distance in float32, by the proof in `grid_step`."""
    return grid_step(columns) / 2 + 2.0**-24


entry = st.sampled_from([0, 1, None])
columns = st.lists(entry, min_size=FEATURES, max_size=FEATURES)
# Half of the templates repeat one column, so that neighbouring frames cost the same.
templates = st.one_of(
    st.lists(columns, min_size=1, max_size=9),
    st.tuples(columns, st.integers(1, 9)).map(lambda drawn: [drawn[0]] * drawn[1]),
)
frames = st.lists(st.sampled_from([0, 1]), min_size=FEATURES, max_size=FEATURES)
takes = st.lists(st.tuples(frames, st.integers(1, 5)), max_size=9).map(
    lambda runs: [values for values, times in runs for _ in range(times)]
)


def quantised(template: list[list[int | None]], weights: list[float] | None = None) -> QuantisedTemplate:
    mask = np.array([[value is not None for value in column] for column in template])
    values = pack(np.array([[value == 1 for value in column] for column in template]))
    return QuantisedTemplate(pack(mask), values, None if weights is None else np.array(weights))


feature_weights = st.lists(st.sampled_from([0.1, 0.5, 1.0, 3.0]), min_size=FEATURES, max_size=FEATURES)


def as_words(take: list[list[int]]) -> np.ndarray:
    return pack(np.array(take, np.uint8).reshape(-1, FEATURES))


@given(st.lists(templates, max_size=4), takes)
def test_curves_equal_the_naive_twin(several: list[list[list[int | None]]], take: list[list[int]]):
    curves = distance_curves([quantised(template) for template in several], as_words(take))
    assert curves.shape == (len(several), len(take))
    for template, curve in zip(several, curves, strict=True):
        np.testing.assert_allclose(curve, naive.curve_and_starts(template, take)[0], rtol=0, atol=1e-12)


@given(st.lists(st.tuples(templates, st.none() | feature_weights), min_size=1, max_size=3), takes, st.booleans())
def test_features_count_by_their_weights(
    several: list[tuple[list[list[int | None]], list[float] | None]], take: list[list[int]], single: bool
):
    chosen = [quantised(template, weights) for template, weights in several]
    curves = distance_curves(chosen, as_words(take), None, np.float32 if single else np.float64)
    for (template, weights), one, curve in zip(several, chosen, curves, strict=True):
        expected, starts = naive.curve_and_starts(template, take, weights)
        np.testing.assert_allclose(curve, expected, rtol=0, atol=single_bound(9) if single else 1e-12)
        found, distances = best_paths(one, as_words(take), np.arange(len(take)))
        np.testing.assert_allclose(distances, expected, rtol=0, atol=1e-12)
        if weights is None:
            assert found.tolist() == [-1 if start is None else start for start in starts]


@given(templates, takes, st.sampled_from([0.3, 1.0, 7.0]))
def test_equal_weights_are_the_same_as_none_to_the_bit(
    template: list[list[int | None]], take: list[list[int]], weight: float
):
    plain = quantised(template)
    values = np.array([[0.5 if value is None else value for value in column] for column in template])
    weighted = quantise(Template(values, np.ones(len(values)), np.full(FEATURES, weight)), 0.05)
    assert weighted.feature_weights is None
    np.testing.assert_array_equal(distance_curves([weighted], as_words(take)), distance_curves([plain], as_words(take)))


def test_what_a_heavy_feature_denies_is_dearer():
    template = QuantisedTemplate(np.array([3], np.uint64), np.array([3], np.uint64), np.array([3.0, 1.0]))
    (curve,) = distance_curves([template], np.array([3, 2, 1, 0], np.uint64))
    assert curve.tolist() == [0, 0.75, 0.25, 1]
    with pytest.raises(ParameterError, match="feature_weights must be above 0 for every feature that counts"):
        QuantisedTemplate(np.array([3], np.uint64), np.array([3], np.uint64), np.array([3.0, 0.0]))
    with pytest.raises(ParameterError, match="feature_weights must be"):
        QuantisedTemplate(np.array([3], np.uint64), np.array([3], np.uint64), np.array([3.0]))


@given(templates, takes)
def test_start_frames_equal_those_of_the_whole_matrix(template: list[list[int | None]], take: list[list[int]]):
    curve, expected = naive.curve_and_starts(template, take)
    ends = np.flatnonzero(np.isfinite(curve)).astype(np.int64)
    assert start_frames(quantised(template), as_words(take), ends).tolist() == [expected[end] for end in ends]


@given(templates, takes, st.data())
def test_a_range_is_computed_as_a_take_of_its_own(
    template: list[list[int | None]], take: list[list[int]], data: st.DataObject
):
    cuts = data.draw(st.lists(st.integers(0, len(take)), min_size=4, max_size=4).map(sorted))
    ranges = np.array(cuts, np.int64).reshape(2, 2)
    (curve,) = distance_curves([quantised(template)], as_words(take), ranges)
    expected, starts = np.full(len(take), np.inf), {}
    for start, stop in ranges.tolist():
        inside, begins = naive.curve_and_starts(template, take[start:stop])
        expected[start:stop] = inside
        starts |= {start + at: start + begin for at, begin in enumerate(begins) if begin is not None}
    np.testing.assert_allclose(curve, expected, rtol=0, atol=1e-12)
    ends = np.array(sorted(starts), np.int64)
    found = start_frames(quantised(template), as_words(take), ends, ranges)
    assert found.tolist() == [starts[end] for end in ends.tolist()]


@given(st.lists(columns, min_size=1, max_size=4), st.lists(frames, min_size=1, max_size=6))
def test_no_path_is_cheaper(template: list[list[int | None]], take: list[list[int]]):
    (curve,) = distance_curves([quantised(template)], as_words(take))
    np.testing.assert_allclose(curve, naive.curve_by_enumeration(template, take), rtol=0, atol=1e-12)


def test_a_template_finds_itself_at_no_cost_at_its_own_half_and_double_speed():
    template = QuantisedTemplate(np.full(8, 3, np.uint64), np.array([0, 0, 1, 1, 3, 3, 2, 2], np.uint64))
    own = template.value
    for take in (own, own[[0, 2, 4, 6, 7]], np.repeat(own, 2)):
        (curve,) = distance_curves([template], take)
        assert curve[-1] == 0
    assert np.isinf(distance_curves([template], own[:4])).all()


def test_a_path_may_not_begin_in_the_second_column():
    template = QuantisedTemplate(np.ones(2, np.uint64), np.array([1, 0], np.uint64))
    (curve,) = distance_curves([template], np.zeros(3, np.uint64))
    assert curve.tolist() == [np.inf, 0.5, 0.5]


def test_columns_of_wildcards_alone_cost_nothing():
    template = QuantisedTemplate(np.zeros(3, np.uint64), np.zeros(3, np.uint64))
    (curve,) = distance_curves([template], np.arange(4, dtype=np.uint64))
    assert curve.tolist() == [np.inf, 0, 0, 0]


def test_takes_laid_end_to_end_are_kept_apart_however_many_there_are(monkeypatch: pytest.MonkeyPatch):
    rng = np.random.default_rng(1)
    words = rng.integers(0, 8, 60).astype(np.uint64)
    ranges = np.array([[0, 20], [20, 23], [23, 60]])
    template = QuantisedTemplate(np.full(5, 7, np.uint64), words[25:30])
    whole = distance_curves([template], words, ranges)
    monkeypatch.setattr("kinedex.ops.distances.dtw._TABLE_CELLS", 1)  # every range gets a cost table of its own
    np.testing.assert_array_equal(distance_curves([template], words, ranges), whole)
    for start, stop in ranges.tolist():
        np.testing.assert_array_equal(distance_curves([template], words[start:stop])[0], whole[0, start:stop])


@given(st.lists(templates, min_size=1, max_size=3), takes, st.integers(1, 12), st.data())
def test_curves_do_not_depend_on_the_pieces_that_a_take_is_computed_in(
    several: list[list[list[int | None]]], take: list[list[int]], block: int, data: st.DataObject
):
    words = as_words(take)
    cuts = data.draw(st.lists(st.integers(0, len(take)), min_size=6, max_size=6).map(sorted))
    ranges = data.draw(st.sampled_from([None, np.array(cuts, np.int64).reshape(3, 2)]))
    chosen = [quantised(template) for template in several]
    whole = distance_curves(chosen, words, ranges)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("kinedex.ops.distances.dtw._TABLE_CELLS", block * sum(map(len, chosen)))
        np.testing.assert_array_equal(distance_curves(chosen, words, ranges), whole)


def test_the_table_of_costs_stays_small_however_long_the_take_and_however_far_apart_its_ranges(
    monkeypatch: pytest.MonkeyPatch,
):
    tables = []
    monkeypatch.setattr("kinedex.ops.distances.dtw._TABLE_CELLS", 32 * 50)
    monkeypatch.setattr(
        "kinedex.ops.distances.dtw.cost_table", lambda *given: tables.append(cost_table(*given)) or tables[-1]
    )
    words = np.arange(1000, dtype=np.uint64)
    template = QuantisedTemplate(np.full(8, 1023, np.uint64), words[500:508])
    (curve,) = distance_curves([template], words)
    assert curve[507] == 0
    distance_curves([template], words, np.array([[0, 20], [100, 120], [480, 900]]))
    assert len(tables) > 20
    assert max(table.size for table in tables) <= 32 * (50 + 14)


invalid_or = st.one_of(frames, st.none())
takes_with_gaps = st.lists(st.tuples(invalid_or, st.integers(1, 5)), max_size=9).map(
    lambda runs: [values for values, times in runs for _ in range(times)]
)


def as_words_with_gaps(take: list[list[int] | None]) -> np.ndarray:
    words = as_words([frame or [0] * FEATURES for frame in take])
    words[[frame is None for frame in take]] = NO_WORD
    return words


@given(st.lists(templates, min_size=1, max_size=3), takes_with_gaps, st.booleans())
def test_no_path_crosses_a_frame_without_a_word(
    several: list[list[list[int | None]]], take: list[list[int] | None], single: bool
):
    curves = distance_curves(
        [quantised(template) for template in several],
        as_words_with_gaps(take),
        None,
        np.float32 if single else np.float64,
    )
    for template, curve in zip(several, curves, strict=True):
        expected, starts = naive.curve_and_starts(template, take)
        np.testing.assert_allclose(curve, expected, rtol=0, atol=single_bound(9) if single else 1e-12)
        ends = np.arange(len(take), dtype=np.int64)
        found, distances = best_paths(quantised(template), as_words_with_gaps(take), ends)
        np.testing.assert_allclose(distances, expected, rtol=0, atol=1e-12)
        assert found.tolist() == [-1 if start is None else start for start in starts]


@pytest.mark.parametrize("columns", [1, 2, 37, 64, 65, pytest.param(300, marks=slow_as_python)])
def test_single_precision_stays_within_its_bound(columns: int):
    rng = np.random.default_rng(columns)
    masks = rng.integers(0, 1 << 40, columns).astype(np.uint64)
    template = QuantisedTemplate(masks, rng.integers(0, 1 << 40, columns).astype(np.uint64) & masks)
    words = rng.integers(0, 1 << 40, 40).astype(np.uint64)[rng.integers(0, 40, 3000)]
    words[1500] = NO_WORD
    (double,) = distance_curves([template], words)
    (single,) = distance_curves([template], words, dtype=np.float32)
    finite = np.isfinite(double)
    assert single.dtype == np.float32
    assert np.array_equal(finite, np.isfinite(single))
    assert np.abs(double[finite] - single[finite]).max() <= single_bound(columns)


def test_wrong_ranges_are_refused():
    template = QuantisedTemplate(np.ones(4, np.uint64), np.ones(4, np.uint64))
    words = np.ones(6, np.uint64)
    for ranges in ([[0, 7]], [[3, 2]], [[2, 4], [1, 5]], [[-1, 2]]):
        with pytest.raises(ParameterError, match="ranges must be"):
            distance_curves([template], words, np.array(ranges))


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_wildcards_alone_cost_nothing_whatever_their_weights(dtype: type):
    wild = np.zeros(4, np.uint64)
    plain, none = QuantisedTemplate(wild, wild), QuantisedTemplate(wild, wild, np.zeros(40))
    words = np.arange(20, dtype=np.uint64)
    expected = distance_curves([plain], words, dtype=dtype)[0]
    for chosen in ([none], [none, none], [none, plain]):
        for curve in distance_curves(chosen, words, dtype=dtype):
            np.testing.assert_array_equal(curve, expected)
