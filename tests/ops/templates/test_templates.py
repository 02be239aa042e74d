"""Motion templates: the papers' example, the naive twin, and what must hold on real clips."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.errors import ParameterError
from kinedex.ops.templates import templates
from kinedex.ops.templates.averaging import Hard, rebalance
from kinedex.ops.templates.templates import Kind, QuantisedTemplate, Template, learn, learn_soft, quantise
from kinedex.ops.templates.warping import Paths, Stack, Weighted, align, all_pairs
from kinedex.ops.words import NO_WORD, bits, pack
from tests.oracles import templates as naive

Clip = list[list[float]]
KINDS: tuple[Kind, ...] = ("soft", "hard")


@st.composite
def classes_of_clips(draw: st.DrawFn, least: int = 1, most: int = 5) -> list[Clip]:
    """Draw so many clips of the same 1 to 4 features, each made of few runs so that they resemble motion."""
    features = draw(st.integers(1, 4))
    column = st.lists(st.sampled_from([0.0, 1.0]), min_size=features, max_size=features)
    runs = st.lists(st.tuples(column, st.integers(1, 4)), min_size=1, max_size=4)
    clips = draw(st.lists(runs, min_size=least, max_size=most))
    return [[list(values) for values, times in clip for _ in range(times)] for clip in clips]


def as_words(clip: Clip) -> np.ndarray:
    return pack(np.array(clip, np.uint8))


def hard_cost(template: QuantisedTemplate, words: np.ndarray) -> float:
    """Return the classical DTW cost between a hard template and a clip, all columns of weight 1."""
    contradictions = np.bitwise_count((words[None, :] ^ template.value[:, None]) & template.mask[:, None])
    return align(contradictions.astype(np.float64), np.ones(len(template)), np.ones(len(words))).cost


def test_the_example_of_the_diploma_thesis_merges_to_the_printed_templates_before_rebalancing():
    method = Hard(np.ones(1))
    x = Weighted(method.start(np.array([1, 1, 1, 1, 0, 1], np.uint64)), np.ones(6))
    y = Weighted(method.start(np.array([0, 1, 0, 0, 0, 0, 1], np.uint64)), np.ones(7))
    stack = Stack.of([x, y])
    paths = method.align(stack, all_pairs(2))
    for reference, printed in enumerate([[0.5, 1, 1, 1, 0, 1], [0.5, 1, 0, 0, 0, 0, 1]]):
        merged = method.average(stack, reference, paths, np.zeros(2, np.int64))
        assert method.values(merged.columns)[:, 0].tolist() == printed
        assert merged.weights.sum() == pytest.approx((6 + 7) / 2)


def test_the_columns_of_the_example_are_stretched_and_thinned_as_printed():
    ones, zeros = np.array([0, 1, 1, 1, 0, 1], np.uint64), np.array([0, 0, 0, 0, 1, 0], np.uint64)
    weights = np.array([1, 2 / 3, 2 / 3, 2 / 3, 2.5, 1])
    balanced = rebalance(Weighted(np.stack([ones, zeros], axis=1), weights), Hard(np.ones(1)).merge)
    # Fig. 3.9 makes three columns of the one of weight 2.5; half to even makes it two of 1.25. The merging of
    # columns 2 and 3, then of what is left of the ones with the first zero, and the last doubling are as printed.
    assert Hard(np.ones(1)).values(balanced.columns)[:, 0].tolist() == [0.5, 1, 0.5, 0.5, 0, 1]
    assert balanced.weights.tolist() == pytest.approx([1, 4 / 3, 23 / 24, 23 / 24, 5 / 4, 1])


@settings(max_examples=60)
@given(classes_of_clips(), st.sampled_from(KINDS))
def test_learning_equals_the_naive_twin(clips: list[Clip], kind: Kind):
    learned = learn(kind, [as_words(clip) for clip in clips], len(clips[0][0]))
    (values, weights), costs = naive.learn(kind, clips)
    assert learned.costs == pytest.approx(costs, abs=1e-12)
    assert learned.rounds == len(costs) - 1
    np.testing.assert_allclose(learned.template.values, values, atol=1e-12)
    np.testing.assert_allclose(learned.template.weights, weights, atol=1e-12)


@st.composite
def large_classes(draw: st.DrawFn) -> tuple[list[Clip], list[str]]:
    """Draw five to nine clips as above, with their actors."""
    clips: list[Clip] = draw(classes_of_clips(5, 9))
    return clips, draw(st.lists(st.sampled_from(["ann", "bob"]), min_size=len(clips), max_size=len(clips)))


@settings(max_examples=60)
@given(large_classes(), st.sampled_from(KINDS), st.integers(2, 4), st.integers(2, 4))
def test_a_large_class_equals_the_naive_twin(
    many: tuple[list[Clip], list[str]], kind: Kind, most: int, references: int
):
    clips, actors = many
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(templates, "MAX_AVERAGED", most)
        patch.setattr(templates, "REFERENCES", references)
        learned = learn(kind, [as_words(clip) for clip in clips], len(clips[0][0]), actors=actors)
        again = learn(kind, [as_words(clip) for clip in clips], len(clips[0][0]), pieces=3, actors=actors)
    (values, weights), costs, clip_costs = naive.learn_many(kind, clips, actors, most, references)
    assert learned.costs == pytest.approx(costs, abs=1e-12)
    assert learned.clip_costs == pytest.approx(clip_costs, abs=1e-12)
    np.testing.assert_allclose(learned.template.values, values, atol=1e-12)
    np.testing.assert_allclose(learned.template.weights, weights, atol=1e-12)
    assert np.array_equal(again.template.values, learned.template.values)
    assert again.clip_costs == learned.clip_costs
    if kind == "hard":  # Claim 3.1 holds for the clips that were not drawn, too
        quantised = quantise(learned.template, 0)
        assert all(hard_cost(quantised, as_words(clip)) == 0 for clip in clips)


def test_a_class_of_eighty_clips_is_averaged_as_a_whole_and_a_larger_one_in_linear_work():
    rng = np.random.default_rng(0)
    clips = [np.repeat(np.array([1, 3, 2], np.uint64), rng.integers(1, 5, 3)) for _ in range(162)]
    cells = []

    def counted(align: object, pieces: object) -> list[Paths]:
        pieces = list(pieces)
        cells.append(sum(len(piece.pairs) for piece in pieces))
        return [align(piece) for piece in pieces]

    for count, first in ((80, 80 * 79 // 2), (81, 8 * 72 + 28), (162, 8 * 72 + 28)):
        cells.clear()
        learned = learn("soft", clips[:count], 2, spread=counted, pieces=2)
        assert cells[0] == first
        assert count == 80 or sum(cells) <= first + 10 * 28 + 9 * (count - 80)
        assert len(learned.clip_costs) == count
        assert len(learned.template) == pytest.approx(np.mean([len(clip) for clip in clips[:count]]), abs=1.5)


@given(classes_of_clips(), st.sampled_from(KINDS), st.integers(2, 9))
def test_the_number_of_pieces_changes_no_bit_of_a_template(clips: list[Clip], kind: Kind, pieces: int):
    words, features = [as_words(clip) for clip in clips], len(clips[0][0])
    whole = learn(kind, words, features)
    split = learn(kind, words, features, pieces=pieces)
    assert (split.costs, split.clip_costs) == (whole.costs, whole.clip_costs)
    assert np.array_equal(split.template.values, whole.template.values)
    assert np.array_equal(split.template.weights, whole.template.weights)


@given(classes_of_clips(), st.data())
def test_a_feature_that_does_not_count_aligns_nothing(clips: list[Clip], data: st.DataObject):
    """Whatever it is, the other features' values and the column weights are those learned without it."""
    features = len(clips[0][0])
    noise = data.draw(st.integers(0, features))
    with_noise = [
        [[*column[:noise], data.draw(st.sampled_from([0.0, 1.0])), *column[noise:]] for column in clip]
        for clip in clips
    ]
    weights = np.insert(np.ones(features), noise, 0.0)
    for kind in KINDS:
        plain = learn(kind, [as_words(clip) for clip in clips], features)
        other = learn(kind, [as_words(clip) for clip in with_noise], features + 1, weights)
        assert np.array_equal(np.delete(other.template.values, noise, axis=1), plain.template.values)
        assert np.array_equal(other.template.weights, plain.template.weights)
        assert other.template.feature_weights is weights


@given(classes_of_clips(), st.integers(2, 5))
def test_a_weight_counts_like_so_many_copies_of_the_feature(clips: list[Clip], times: int):
    features = len(clips[0][0])
    copied = [[column + [column[0]] * (times - 1) for column in clip] for clip in clips]
    weights = np.array([times, *[1] * (features - 1)], float)
    by_weight = learn("soft", [as_words(clip) for clip in clips], features, weights)
    by_copies = learn("soft", [as_words(clip) for clip in copied], features + times - 1)
    assert by_weight.costs[0] == pytest.approx(by_copies.costs[0])
    assert by_weight.clip_costs == pytest.approx(by_copies.clip_costs)


def test_the_clip_that_differs_from_all_others_costs_most():
    step = np.repeat(np.array([1, 3, 2, 0], np.uint64), [5, 4, 6, 5])
    other = np.repeat(np.array([0, 2, 3, 1], np.uint64), [5, 4, 6, 5])
    for kind in KINDS:
        costs = learn(kind, [step, step[1:], other, step[:-1]], 2).clip_costs
        assert costs[2] > 0.2
        assert costs[0] == costs[1] == costs[3] == 0


@given(classes_of_clips())
def test_a_hard_template_contradicts_none_of_its_clips(clips: list[Clip]):
    template = learn("hard", [as_words(clip) for clip in clips], len(clips[0][0])).template
    quantised = quantise(template, 0)
    for clip in clips:
        assert hard_cost(quantised, as_words(clip)) == 0
        assert naive.classical_cost("hard", template.values.tolist(), clip) == 0


@given(classes_of_clips())
def test_columns_of_a_template_weigh_about_one(clips: list[Clip]):
    weights = learn_soft([as_words(clip) for clip in clips], len(clips[0][0])).template.weights
    assert weights.sum() == pytest.approx(np.mean([len(clip) for clip in clips]))
    assert len(weights) == 1 or weights.min() >= 0.75 - 1e-9
    assert weights.max() < 1.5


def test_a_single_clip_is_its_own_template():
    clip = np.array([5, 5, 2, 7], np.uint64)
    for kind in KINDS:
        learned = learn(kind, [clip], 3)
        assert learned.template.values.tolist() == bits(clip, 3).tolist()
        assert (learned.rounds, learned.costs) == (0, (0.0,))


def test_the_same_movement_at_another_tempo_is_no_variation():
    slow = np.repeat(np.array([1, 3, 2], np.uint64), [6, 4, 8])
    fast = np.repeat(np.array([1, 3, 2], np.uint64), [3, 2, 4])
    template = learn_soft([slow, fast], 2).template
    assert set(np.unique(template.values)) == {0.0, 1.0}
    assert len(template) in (13, 14)  # between the two, as long as they are on average


def test_values_near_the_threshold_are_quantised_despite_rounding():
    values = np.array([[0.05 + 1e-12, 0.0501], [0.9999999999999999, 0.95 - 1e-12], [0.5, 0.0]])
    quantised = quantise(Template(values, np.ones(3)), 0.05)
    assert quantised.mask.tolist() == [0b01, 0b11, 0b10]
    assert quantised.value.tolist() == [0b00, 0b11, 0b00]
    strict = quantise(Template(values, np.ones(3)), 0)
    assert strict.mask.tolist() == [0b00, 0b01, 0b10]


def test_wrong_input_is_refused_in_words():
    with pytest.raises(ParameterError, match="clips must be at least one clip"):
        learn_soft([], 4)
    with pytest.raises(ParameterError, match="at least one frame"):
        learn("hard", [np.array([], np.uint64)], 4)
    with pytest.raises(ParameterError, match="without invalid frames"):
        learn_soft([np.array([1, NO_WORD], np.uint64)], 4)
    with pytest.raises(ParameterError, match="feature_weights must be of shape"):
        learn("soft", [np.array([1], np.uint64)], 4, np.ones(3))
    with pytest.raises(ParameterError, match="not all 0"):
        learn("hard", [np.array([1], np.uint64)], 4, np.zeros(4))
    with pytest.raises(ParameterError, match="words of 3 bits"):
        learn_soft([np.array([8], np.uint64)], 3)
    with pytest.raises(ParameterError, match="delta must be"):
        quantise(Template(np.zeros((1, 1)), np.ones(1)), 0.5)
    with pytest.raises(ParameterError, match="0 wherever mask is 0"):
        QuantisedTemplate(np.zeros(1, np.uint64), np.ones(1, np.uint64))


@pytest.fixture(scope="module")
def hdm05_clips(shared: Path) -> dict[str, list[np.ndarray]]:
    words = (
        pl.scan_parquet(shared / "reference" / "feature_words.parquet")
        .filter(pl.col("source_frame") % 4 == 0)
        .with_columns(pl.col("take").cast(pl.String))
        .sort("take", "source_frame")
        .collect()
    )
    clips: dict[str, list[np.ndarray]] = {}
    for (take,), frames in words.group_by("take", maintain_order=True):
        found = re.fullmatch(r"HDM_(?:bd|bk|dg)_(\w+)_\d+_120", str(take))
        if found:
            clips.setdefault(found[1], []).append(frames["word"].to_numpy())
    return clips


@pytest.mark.shared
def test_hard_templates_of_real_classes_contradict_none_of_their_clips(
    hdm05_clips: dict[str, list[np.ndarray]],
):
    assert len(hdm05_clips) == 11
    for clips in hdm05_clips.values():
        learned = learn("hard", clips, 40)
        assert max(hard_cost(quantise(learned.template, 0), clip) for clip in clips) == 0
        assert learned.costs[-1] == 0


@pytest.mark.shared
def test_soft_templates_of_real_classes_settle_and_are_as_long_as_their_clips(
    hdm05_clips: dict[str, list[np.ndarray]],
):
    for clips in hdm05_clips.values():
        learned = learn_soft(clips, 40)
        assert learned.rounds <= 8
        assert learned.costs[-1] < 0.005
        assert len(learned.template) == pytest.approx(np.mean([len(clip) for clip in clips]), rel=0.1)
