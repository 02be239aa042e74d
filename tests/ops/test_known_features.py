"""Known features: what is unknown costs nothing and is asked by nobody, and what is known is as before."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.errors import ParameterError
from kinedex.ops.ranges import TakeRanges
from kinedex.ops.templates.derived_templates import restricted_template
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import (
    ALL_KNOWN,
    MIN_KNOWN,
    NO_WORD,
    TakeWords,
    bits,
    compacted,
    is_applied,
    known_bits,
    known_share,
    pack,
)
from tests.oracles import known as naive

FEATURES = 10


def entries(mask: int, value: int) -> list[int | None]:
    return [value >> i & 1 if mask >> i & 1 else None for i in range(FEATURES)]


def seen(word: int, known: int) -> naive.Seen:
    return [word >> i & 1 if known >> i & 1 else None for i in range(FEATURES)]


@st.composite
def templates(draw: st.DrawFn) -> QuantisedTemplate:
    masks = draw(st.lists(st.integers(0, 2**FEATURES - 1), min_size=1, max_size=6))
    values = [draw(st.integers(0, 2**FEATURES - 1)) & mask for mask in masks]
    return QuantisedTemplate(np.array(masks, np.uint64), np.array(values, np.uint64))


@given(template=templates(), known=st.integers(0, 2**FEATURES - 1), seed=st.integers(0, 1000))
@settings(max_examples=60, deadline=None)
def test_a_restricted_template_costs_the_share_of_known_entries_that_is_contradicted(
    template: QuantisedTemplate, known: int, seed: int
) -> None:
    words = np.random.default_rng(seed).integers(0, 2**FEATURES, 30, dtype=np.uint64) & np.uint64(known)
    columns = [entries(*pair) for pair in zip(template.mask.tolist(), template.value.tolist(), strict=True)]
    take = [seen(word, known) for word in words.tolist()]
    restricted = restricted_template(template, known)
    assert (restricted is not None) == is_applied(template.mask.tolist(), known) == naive.is_applied(columns, take[0])
    assert known_share(template.mask.tolist(), known) == pytest.approx(naive.share(columns, take[0]))
    if restricted is not None:
        (curve,) = distance_curves([restricted], words, np.array([[0, len(words)]]))
        np.testing.assert_allclose(curve, naive.curve(columns, take), atol=1e-12)


@given(template=templates(), more=st.integers(0, 2**63))
def test_a_template_is_itself_where_all_that_it_fixes_is_known(template: QuantisedTemplate, more: int) -> None:
    known = int(np.bitwise_or.reduce(template.mask)) | more
    assert restricted_template(template, known) is template
    assert restricted_template(template, int(ALL_KNOWN)) is template


def test_a_worked_example() -> None:
    """Five entries in two columns; the take knows three of them, F1 in both columns and F2 in the second."""
    template = QuantisedTemplate(np.array([0b101, 0b111], np.uint64), np.array([0b001, 0b110], np.uint64))
    known = 0b011
    assert known_share(template.mask.tolist(), known) == 3 / 5 == MIN_KNOWN
    restricted = restricted_template(template, known)
    assert restricted is not None
    assert (restricted.mask.tolist(), restricted.value.tolist()) == ([0b001, 0b011], [0b001, 0b010])
    words = np.array([0b01, 0b11], np.uint64)
    # F1 is on as the first column asks; of the second column's two known entries the second frame contradicts one
    (curve,) = distance_curves([restricted], words, np.array([[0, 2]]))
    assert curve[1] == (0 + 1 / 2) / 2
    assert restricted_template(template, 0b001) is None  # two of five


def test_nothing_fixed_is_always_known() -> None:
    assert known_share([0, 0], 0) == 1
    assert is_applied([], 0)


@given(words=st.lists(st.integers(0, 2**FEATURES - 1)), known=st.integers(0, 2**FEATURES - 1))
def test_compacted_words_have_the_known_features_in_their_order(words: list[int], known: int) -> None:
    given_words = np.array([*words, NO_WORD], np.uint64)
    matrix = bits(given_words[:-1], FEATURES)[:, known_bits(known, FEATURES)]
    found = compacted(given_words, known, FEATURES)
    assert found[:-1].tolist() == pack(matrix).tolist()
    assert found[-1] == NO_WORD


def test_words_are_divided_by_what_their_takes_know() -> None:
    words = TakeWords(
        np.array([2, 5, 9]), np.array([0, 2, 2, 5]), np.arange(5, dtype=np.uint64), np.array([3, 7, 3], np.uint64)
    )
    assert words.masks == [7, 3]
    positions, own = words.knowing(3)
    assert (positions.tolist(), own.take_ids.tolist(), own.offsets.tolist()) == ([0, 2], [2, 9], [0, 2, 5])
    assert own.words.tolist() == [0, 1, 2, 3, 4]
    assert own.known is None
    whole = TakeWords(words.take_ids, words.offsets, words.words)
    assert whole.masks == [int(ALL_KNOWN)]
    assert whole.knowing(int(ALL_KNOWN))[1] is whole
    with pytest.raises(ParameterError, match="one mask for each take"):
        TakeWords(words.take_ids, words.offsets, words.words, np.zeros(2, np.uint64))


def test_ranges_of_some_takes_are_placed_among_all() -> None:
    some = TakeRanges(np.array([0, 1, 3]), np.array([[0, 2], [1, 3], [5, 6]]))
    other = TakeRanges(np.array([0, 1]), np.array([[4, 9]]))
    found = TakeRanges.placed([(np.array([1, 3]), some), (np.array([2]), other)], 5)
    assert [found.take(i).tolist() for i in range(5)] == [[], [[0, 2]], [[4, 9]], [[1, 3], [5, 6]], []]
    assert len(TakeRanges.placed([], 2)) == 2
