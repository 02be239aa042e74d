"""Templates in the mirror, one after the other, and laid along each other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from kinedex.ops.errors import ParameterError
from kinedex.ops.templates.derived_templates import consistency, contrast, joined, mirrored
from kinedex.ops.templates.templates import Template, learn, quantise
from kinedex.ops.words import rearrange

SWAP = np.array([1, 0, 2, 4, 3])
VALUES = st.sampled_from([0.0, 0.25, 0.5, 1.0])


@st.composite
def templates(draw: st.DrawFn, features: int = 5) -> Template:
    columns = draw(st.integers(1, 6))
    values = draw(arrays.arrays(np.float64, (columns, features), elements=VALUES))
    return Template(values, draw(arrays.arrays(np.float64, columns, elements=st.sampled_from([0.75, 1.0, 1.25]))))


@given(templates())
def test_mirrored_twice_is_the_same(template: Template):
    weighted = Template(template.values, template.weights, np.arange(5.0))
    there = mirrored(weighted, SWAP)
    assert there.feature_weights is not None
    assert there.feature_weights.tolist() == [1, 0, 2, 4, 3]
    back = mirrored(there, SWAP)
    assert np.array_equal(back.values, weighted.values)
    assert back.feature_weights.tolist() == list(range(5))
    assert mirrored(template, SWAP).feature_weights is None


@given(st.lists(st.lists(st.integers(0, 31), min_size=2, max_size=8), min_size=1, max_size=4))
def test_mirrored_clips_teach_the_mirrored_template(clips: list[list[int]]):
    words = [np.array(clip, np.uint64) for clip in clips]
    learned = learn("hard", words, 5).template
    other = learn("hard", [rearrange(word, SWAP) for word in words], 5).template
    assert np.array_equal(other.values, mirrored(learned, SWAP).values)


@given(st.lists(templates(), min_size=1, max_size=3), st.integers(0, 4))
def test_joined_templates_stand_one_after_the_other_with_wildcards_between(parts: list[Template], gap: int):
    whole = joined(parts, gap)
    assert len(whole) == sum(len(part) for part in parts) + gap * (len(parts) - 1)
    place = 0
    for part in parts:
        assert np.array_equal(whole.values[place : place + len(part)], part.values)
        assert np.array_equal(whole.weights[place : place + len(part)], part.weights)
        place += len(part)
        assert np.all(whole.values[place : place + gap] == 0.5) or part is parts[-1]
        place += gap


def test_features_that_the_clips_disagree_about_are_less_consistent():
    template = Template(np.array([[1.0, 0.5, 0.0], [1.0, 1.0, 0.25]]), np.array([1.0, 3.0]))
    assert consistency(template).tolist() == [1, 0.75, (1 + 3 * 0.5) / 4]


@given(templates(), templates())
def test_a_contrast_is_where_fixed_entries_side_by_side_differ(one: Template, other: Template):
    first, second = quantise(one, 0.1), quantise(other, 0.1)
    there = contrast(one, other, 0.1)
    assert there.path[0].tolist() == [0, 0]
    assert there.path[-1].tolist() == [len(one) - 1, len(other) - 1]
    assert not contrast(one, one, 0.1).against.any()
    for (k, m), row, compared in zip(there.path, there.against, there.compared, strict=True):
        a, b = first.values(5)[k], second.values(5)[m]
        assert compared.tolist() == ((a != 0.5) & (b != 0.5)).tolist()
        assert row.tolist() == np.where(compared, a - b, 0).tolist()


def test_what_two_templates_contradict_each_other_in_is_told_by_sign():
    still = Template(np.zeros((3, 5)), np.ones(3))
    kick = Template(np.array([[0, 0, 0, 0, 0], [1, 0, 0.5, 0, 0], [0, 0, 0, 0, 0]], float), np.ones(3))
    found = contrast(kick, still, 0)
    assert found.against.sum(axis=0).tolist() == [1, 0, 0, 0, 0]
    assert not found.compared[1, 2]


def test_a_feature_without_weight_is_a_wildcard():
    template = Template(np.array([[1.0, 0.0]]), np.ones(1), np.array([0.0, 2.0]))
    quantised = quantise(template, 0)
    assert (quantised.mask.tolist(), quantised.value.tolist()) == ([0b10], [0])


def test_wrong_input_is_refused_in_words():
    template = Template(np.zeros((1, 2)), np.ones(1))
    with pytest.raises(ParameterError, match="order must be a permutation of 2 features"):
        mirrored(template, np.array([0, 0]))
    with pytest.raises(ParameterError, match="at least one template"):
        joined([], 3)
    with pytest.raises(ParameterError, match="0 or more columns"):
        joined([template], -1)
    with pytest.raises(ParameterError, match="of the same features"):
        joined([template, Template(np.zeros((1, 3)), np.ones(1))], 1)
