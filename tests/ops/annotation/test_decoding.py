"""The best explanation of a take by templates in a row."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.annotation.background import background
from kinedex.ops.annotation.decoding import (
    STANDING_OUT,
    Decoding,
    ExplainedSegment,
    exclusive_shares,
    explain,
    margins,
)
from kinedex.ops.errors import ParameterError
from kinedex.ops.templates.templates import Template
from kinedex.ops.words import NO_WORD, bits, pack
from tests.oracles import decoding as oracle

FEATURES = 3
COLUMN = st.tuples(*[st.sampled_from([0.0, 0.25, 0.5, 1.0])] * FEATURES)
TEMPLATES = st.lists(st.lists(COLUMN, min_size=1, max_size=6), min_size=1, max_size=3)
WORDS = st.lists(st.sampled_from([*range(2**FEATURES), int(NO_WORD)]), max_size=14)
USUAL = st.lists(COLUMN, min_size=1, max_size=3)
EVEN = np.full((1, FEATURES), 0.5)
HALF = [(0.5,) * FEATURES]


def template(columns: list[tuple[float, ...]]) -> Template:
    return Template(np.array(columns), np.ones(len(columns)))


def as_bits(words: list[int]) -> list[list[int] | None]:
    return [None if word == int(NO_WORD) else bits(np.array([word], np.uint64), FEATURES)[0].tolist() for word in words]


@settings(deadline=None, max_examples=150)
@given(
    TEMPLATES,
    USUAL,
    WORDS,
    st.sampled_from([0.0, 0.1, 0.5]),
    st.sampled_from([0.0, 0.05, 0.3]),
    st.sampled_from([0.0, 0.1]),
    st.sampled_from([-0.2, 0.0, 0.3]),
    st.booleans(),
)
def test_no_explanation_has_a_greater_value(
    columns: list[list[tuple[float, ...]]],
    postures: list[tuple[float, ...]],
    words: list[int],
    entry: float,
    skip: float,
    stay: float,
    gain: float,
    limited: bool,
) -> None:
    decoding = Decoding(0.05, entry, skip, stay, gain)
    ranges = [np.array([[index, len(words) - index]]) for index in range(len(columns))] if limited else None
    allowed = None
    if ranges is not None:
        ranges = [one if one[0, 0] < one[0, 1] else one[:0] for one in ranges]
        allowed = [[any(a <= f < b for a, b in one) for f in range(len(words))] for one in ranges]
    usual = np.array(postures)
    found = explain([template(one) for one in columns], usual, np.array(words, np.uint64), decoding, ranges)
    expected = oracle.best_value(columns, postures, as_bits(words), 0.05, entry, skip, gain, stay, allowed)
    assert sum(one.value for one in found) == pytest.approx(expected, abs=1e-9)
    edges = [edge for one in found for edge in (one.start, one.stop)]
    assert edges == sorted(edges)
    assert all(one.value > 0 and one.start < one.stop for one in found)
    # each segment alone is an explanation of its frames, of the value that is stated
    for one in found:
        alone = oracle.best_value(
            [columns[one.template]], postures, as_bits(words[one.start : one.stop]), 0.05, entry, skip, gain, stay
        )
        assert alone >= one.value - 1e-9


def test_a_motion_is_found_between_frames_of_background() -> None:
    rising = template([(1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (1.0, 1.0, 1.0)])
    motion = pack(np.array([[1, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1]], np.uint8))
    rest = np.zeros(4, np.uint64)
    words = np.concatenate([rest, motion, rest])
    usual = background([words], FEATURES)
    (found,) = explain([rising], usual, words, Decoding(entry=0.1, stay=0.0, gain=0.0))
    assert (found.start, found.stop, found.template) == (4, 8, 0)


def test_nothing_is_explained_by_what_fits_no_better_than_the_background() -> None:
    words = np.array([0b101] * 9, np.uint64)
    usual = background([words], FEATURES)
    assert explain([template([(1.0, 0.0, 1.0)] * 3)], usual, words, Decoding(gain=0.0)) == []
    assert explain([], usual, words, Decoding()) == []
    assert explain([template([(1.0, 0.0, 1.0)])], usual, words[:0], Decoding()) == []


def test_an_invalid_frame_is_in_no_segment() -> None:
    words = np.array([0b001] * 4 + [NO_WORD] + [0b001] * 4, np.uint64)
    found = explain([template([(1.0, 0.0, 0.0)])], EVEN, words, Decoding(stay=0.0, gain=0.0))
    assert [(one.start, one.stop) for one in found] == [(0, 4), (5, 9)]


def test_log_ratios_that_change_from_frame_to_frame_are_those_of_the_words() -> None:
    random = np.random.default_rng(3)
    columns = [[tuple(random.random(FEATURES).round(2)) for _ in range(length)] for length in (4, 2, 3)]
    # more changes than log ratios are carried over, and invalid frames between them
    words = random.integers(0, 2**FEATURES, 110).astype(np.uint64)
    words[[20, 21, 70]] = NO_WORD
    decoding = Decoding(smoothing=0.05, entry=0.1, skip=0.02, stay=0.01, gain=0.05)
    usual = [(0.3, 0.5, 0.9), (0.8, 0.1, 0.5)]
    found = explain([template(one) for one in columns], np.array(usual), words, decoding)
    expected = oracle.best_value(columns, usual, as_bits(words.tolist()), 0.05, 0.1, 0.02, 0.05, 0.01)
    assert len(found) > 5
    assert sum(one.value for one in found) == pytest.approx(expected, abs=1e-9)


@settings(deadline=None, max_examples=60)
@given(TEMPLATES, USUAL, st.lists(st.integers(0, 2**FEATURES - 1), min_size=1, max_size=14))
def test_rivals_are_the_best_explanation_by_the_other_classes(
    columns: list[list[tuple[float, ...]]], postures: list[tuple[float, ...]], words: list[int]
) -> None:
    decoding = Decoding(smoothing=0.05, entry=0.05, skip=0.05, stay=0.1, gain=0.1)
    templates, classes = [template(one) for one in columns], np.arange(len(columns)) % 2
    taken, usual = np.array(words, np.uint64), np.array(postures)
    found = explain(templates, usual, taken, decoding)
    sure = exclusive_shares(found, templates, classes, usual, taken, decoding)
    for one, confidence in zip(found, sure.tolist(), strict=True):
        others = [other for other, label in zip(columns, classes, strict=True) if label != classes[one.template]]
        within = as_bits(words[one.start : one.stop])
        rival = oracle.best_value(others, postures, within, 0.05, 0.05, 0.05, 0.1, 0.1)
        assert confidence == pytest.approx(min(max(1 - rival / one.value, 0.0), 1.0), abs=1e-9)


def test_of_templates_that_fit_equally_the_first_is_taken() -> None:
    same = template([(0.9, 0.5, 0.5)])
    words = np.array([1, 1], np.uint64)
    usual = EVEN
    decoding = Decoding(entry=0.05, stay=0.0, gain=0.0)
    (found,) = explain([same, same], usual, words, decoding)
    value = 2 * oracle.log_ratio([1, 0, 0], (0.9, 0.5, 0.5), HALF, decoding.smoothing, 0.0) - 0.05
    assert found == ExplainedSegment(0, 2, 0, pytest.approx(value))


def test_an_exclusive_share_is_what_the_next_best_class_lacks_of_the_value() -> None:
    columns = [(0.9, 0.5, 0.5), (0.9, 0.9, 0.5), (0.8, 0.5, 0.5), (0.1, 0.1, 0.1)]
    templates = [template([one]) for one in columns]
    words = np.array([0b011] * 6, np.uint64)
    usual = EVEN
    decoding = Decoding(entry=0.1, stay=0.0, gain=0.0)
    found = explain(templates, usual, words, decoding)
    assert [one.template for one in found] == [1]
    ratios = [oracle.log_ratio([1, 1, 0], one, HALF, decoding.smoothing, 0.0) for one in columns]
    values = 6 * np.array(ratios) - 0.1
    expected = 1 - values / values[1]
    # without class 0, which has templates 0 and 1, template 2 is next; where each is a class of its own, template 0
    for classes, rival in (([0, 0, 1, 2], 2), ([0, 1, 2, 3], 0)):
        shares = exclusive_shares(found, templates, np.array(classes), usual, words, decoding)
        assert shares == pytest.approx([expected[rival]])


def test_a_label_is_as_sure_as_it_stands_out_from_other_classes_and_from_the_background() -> None:
    clear, faint = template([(0.95, 0.95, 0.95)]), template([(0.6, 0.6, 0.6)])
    words = np.array([0b111] * 6, np.uint64)
    decoding = Decoding(entry=0.01, stay=0.0)
    for one in (clear, faint):
        found = explain([one], EVEN, words, decoding)
        (sure,) = margins(found, [one], np.array([0]), EVEN, words, decoding)
        # nothing else explains the frames, so the margin is 1
        assert sure == pytest.approx(1 - math.exp(-found[0].value / 6 / STANDING_OUT))
    both = [clear, template([(0.95, 0.95, 0.5)])]
    found = explain(both, EVEN, words, decoding)
    classes = np.array([0, 1])
    (sure,), (margin,) = (how(found, both, classes, EVEN, words, decoding) for how in (margins, exclusive_shares))
    assert 0 < sure < margin < 1
    assert margins([], both, classes, EVEN, words, decoding).tolist() == []


@pytest.mark.parametrize(
    ("values", "name"),
    [({"smoothing": 0.0}, "smoothing"), ({"entry": -1.0}, "entry"), ({"gain": float("nan")}, "gain")],
)
def test_parameters_are_checked(values: dict[str, float], name: str) -> None:
    with pytest.raises(ParameterError, match=f"{name} must be"):
        Decoding(**values)
