"""The ranges in which a template could label anything: with them an explanation is what it is without."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.annotation import decoding as module
from kinedex.ops.annotation import promising_ranges as grouping
from kinedex.ops.annotation.background import background
from kinedex.ops.annotation.decoding import Decoding, exclusive_shares, explain, frames_of
from kinedex.ops.annotation.promising_ranges import loose_ranges, promising_ranges, template_groups
from kinedex.ops.templates.templates import Template
from kinedex.ops.words import NO_WORD
from tests.ops.annotation.test_decoding import TEMPLATES, USUAL, WORDS, as_bits, template
from tests.oracles import decoding as oracle
from tests.plain_python import slow_as_python


def ranges_of(templates: list[Template], usual: np.ndarray, words: np.ndarray, decoding: Decoding) -> np.ndarray:
    return promising_ranges(template_groups(templates, usual, decoding), usual, words, decoding)


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Templates are compared in groups of a few, and blocks are single frames."""
    monkeypatch.setattr(module, "BLOCK_FRAMES", 1)
    monkeypatch.setattr(grouping, "_GROUP_COLUMNS", 7)


@settings(deadline=None, max_examples=150)
@given(
    TEMPLATES,
    USUAL,
    WORDS,
    st.sampled_from([0.0, 0.1, 0.5]),
    st.sampled_from([0.0, 0.05, 0.3]),
    st.sampled_from([0.0, 0.1]),
    st.sampled_from([-0.2, 0.0, 0.3]),
)
def test_nothing_outside_is_ever_needed(
    columns: list[list[tuple[float, ...]]],
    postures: list[tuple[float, ...]],
    words: list[int],
    entry: float,
    skip: float,
    stay: float,
    gain: float,
) -> None:
    decoding = Decoding(0.05, entry, skip, stay, gain)
    templates, usual, taken = [template(one) for one in columns], np.array(postures), np.array(words, np.uint64)
    promising = ranges_of(templates, usual, taken, decoding)
    found = explain(templates, usual, taken, decoding, promising=promising)
    whole = explain(templates, usual, taken, decoding)
    assert sum(one.value for one in found) == pytest.approx(sum(one.value for one in whole), abs=1e-9)
    classes = np.arange(len(columns)) % 2
    assert exclusive_shares(whole, templates, classes, usual, taken, decoding) == pytest.approx(
        exclusive_shares(whole, templates, classes, usual, taken, decoding, promising=promising), abs=1e-6
    )
    frames = frames_of(taken, usual, decoding)
    loose = loose_ranges(template_groups(templates, usual, decoding), frames, decoding)
    assert explain(templates, usual, frames, decoding, loose=loose) == whole  # to the last bit
    assert np.array_equal(
        exclusive_shares(whole, templates, classes, usual, frames, decoding, promising=loose),
        exclusive_shares(whole, templates, classes, usual, taken, decoding),
    )
    half = [np.array([[0, len(words) // 2]]) for _ in columns]
    some, limited = (explain(templates, usual, taken, decoding, half, promising=one) for one in (promising, None))
    assert sum(one.value for one in some) == pytest.approx(sum(one.value for one in limited), abs=1e-9)
    for index, own in enumerate(columns):
        ranges = promising[promising[:, 0] == index, 1:].tolist()
        alone = oracle.best_value([own], postures, as_bits(words), 0.05, entry, skip, gain, stay)
        assert (alone > 1e-9) <= bool(ranges)  # where a template adds anything, it has a range
        for start, stop in ranges:
            value = oracle.best_value([own], postures, as_bits(words[start:stop]), 0.05, entry, skip, gain, stay)
            assert value > -1e-9
        assert all(one[1] < other[0] for one, other in itertools.pairwise(ranges))


def archive(seed: int, frames: int) -> tuple[list[Template], np.ndarray, np.ndarray]:
    """Return templates of 3 to 40 columns, usual postures, and a take of words that change slowly and show some."""
    random = np.random.default_rng(seed)
    flips = random.random((frames, 40)) < 0.01
    on = np.cumsum(flips, axis=0) % 2 == 1
    templates = []
    for length in random.integers(3, 40, 30).tolist():
        start = int(random.integers(0, frames - 2 * length))
        shown = on[start : start + length].astype(float)
        templates.append(Template(np.abs(shown - (random.random(shown.shape) < 0.04)), np.ones(length)))
        slow = np.repeat(on[start : start + length], random.integers(1, 4, length), axis=0)
        place = int(random.integers(0, frames - len(slow)))
        on[place : place + len(slow)] = slow ^ (random.random(slow.shape) < 0.02)
    words = (on.astype(np.uint64) << np.arange(40, dtype=np.uint64)).sum(axis=1).astype(np.uint64)
    words[random.integers(0, frames, 3)] = NO_WORD
    return templates, background([words], 40), words


@slow_as_python
@pytest.mark.parametrize("seed", range(4))
def test_a_long_take_is_explained_as_without_them(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grouping, "_GROUP_COLUMNS", 200)
    templates, usual, words = archive(seed, 1500)
    decoding = Decoding()
    promising = ranges_of(templates, usual, words, decoding)
    share = (promising[:, 2] - promising[:, 1]).sum() / len(words) / len(templates)
    assert 0.0 < share < 0.5
    loose = loose_ranges(template_groups(templates, usual, decoding), frames_of(words, usual, decoding), decoding)
    assert share < (loose[:, 2] - loose[:, 1]).sum() / len(words) / len(templates) < 0.8
    whole = explain(templates, usual, words, decoding)
    assert len(whole) > 5
    classes = np.arange(len(templates)) % 3
    sure = exclusive_shares(whole, templates, classes, usual, words, decoding)
    for frames in (1, 32):
        monkeypatch.setattr(module, "BLOCK_FRAMES", frames)
        found = explain(templates, usual, words, decoding, promising=promising)
        # of explanations of the same value, rounding may choose another one
        assert sum(one.value for one in found) == pytest.approx(sum(one.value for one in whole), abs=1e-9)
        some = exclusive_shares(whole, templates, classes, usual, words, decoding, promising=promising)
        assert some == pytest.approx(sure, abs=1e-9)
        assert explain(templates, usual, words, decoding, loose=loose) == whole
        assert np.array_equal(
            exclusive_shares(whole, templates, classes, usual, words, decoding, promising=loose), sure
        )


def test_no_template_or_no_frame_has_no_range() -> None:
    usual = np.full((1, 40), 0.5)
    assert ranges_of([], usual, np.array([1], np.uint64), Decoding()).shape == (0, 3)
    one = Template(np.ones((3, 40)), np.ones(3))
    assert ranges_of([one], usual, np.empty(0, np.uint64), Decoding()).shape == (0, 3)
    assert ranges_of([one], usual, np.full(9, NO_WORD), Decoding()).shape == (0, 3)
    assert ranges_of([one], usual, np.zeros(9, np.uint64), Decoding()).shape == (0, 3)
    shown = np.array([0] * 9 + [2**40 - 1] * 3 + [0] * 9, np.uint64)
    assert ranges_of([one], usual, shown, Decoding()).tolist() == [[0, 9, 12]]
