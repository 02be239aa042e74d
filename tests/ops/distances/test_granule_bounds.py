"""Bounds by granules: no distance curve is ever below them, with weights, invalid frames and takes of any length."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.arrays import U64
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.distances.pruning import GRANULE, granule_bounds, granule_words
from kinedex.ops.search.bit_slices import GRANULES, slice_words
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import NO_WORD
from tests.plain_python import slow_as_python

FEATURES = 6


def words_that_stay(rng: np.random.Generator, frames: int, change: float) -> U64:
    drawn = rng.integers(0, 1 << FEATURES, frames + 1, dtype=np.uint64)
    return drawn[np.cumsum(rng.random(frames) < change)]


@slow_as_python
@settings(max_examples=60, deadline=None)
@given(
    lengths=st.lists(st.integers(0, 150), min_size=1, max_size=4),
    columns=st.integers(1, 60),
    change=st.sampled_from([0.05, 0.3, 1.0]),
    wildcards=st.sampled_from([0.0, 0.3, 0.9]),
    weighted=st.booleans(),
    seed=st.integers(0, 2**32),
)
def test_no_path_that_ends_in_a_granule_costs_less_than_its_bound(
    lengths: list[int], columns: int, change: float, wildcards: float, weighted: bool, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    takes = [words_that_stay(rng, length, change) for length in lengths]
    for take in takes:
        take[rng.random(len(take)) < 0.02] = NO_WORD
    fixed = (rng.random((columns, FEATURES)) >= wildcards) @ (1 << np.arange(FEATURES, dtype=np.uint64))
    mask = fixed.astype(np.uint64)
    long = max(takes, key=len)
    source = long[long != NO_WORD]
    asked = source[:columns] if len(source) >= columns and rng.random() < 0.5 else words_that_stay(rng, columns, change)
    weights = rng.choice([0.5, 1.0, 3.0], FEATURES) if weighted else None
    template = QuantisedTemplate(mask, asked & mask, weights)

    offsets = np.cumsum([0, *lengths])
    words = np.concatenate(takes)
    slices = slice_words(words, offsets, FEATURES)
    first = int(rng.integers(len(lengths)))
    edges = GRANULES * (slices.first[first:] - slices.first[first])
    bounds = granule_bounds(template, granule_words(slices, first, len(lengths)), edges)
    ranges = np.stack([offsets[:-1], offsets[1:]], axis=1)
    curve = distance_curves([template], words, ranges[ranges[:, 0] < ranges[:, 1]])[0]
    for place, take in enumerate(range(first, len(lengths))):
        own = curve[offsets[take] : offsets[take + 1]]
        of_frames = np.repeat(bounds[edges[place] : edges[place + 1]], GRANULE)[: len(own)]
        assert (of_frames <= own).all()


def test_a_template_shorter_than_a_block_bounds_nothing() -> None:
    slices = slice_words(np.zeros(30, np.uint64), np.array([0, 30]), FEATURES)
    template = QuantisedTemplate(np.full(3, 63, np.uint64), np.full(3, 63, np.uint64))
    assert not granule_bounds(template, granule_words(slices, 0, 1), np.array([0, 8])).any()
