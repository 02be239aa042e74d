"""Matches that the explorer keeps from one edit of a template to the next are those of the same question."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.explorer import class_annotation
from kinedex.explorer.class_annotation import CachingMethod
from kinedex.ops.cache import Cache
from kinedex.pipelines.annotation.methods import whole_takes
from kinedex.pipelines.annotation.template_methods import ThesisMethod
from tests.pipelines.annotation.test_batches import annotator, laid_out
from tests.pipelines.labelled import motion

TAKE = np.concatenate([motion(name) for name in ("kick", "rest", "walk", "kick", "rest")])


@pytest.fixture
def both(monkeypatch: pytest.MonkeyPatch) -> tuple[ThesisMethod, CachingMethod]:
    monkeypatch.setattr(class_annotation, "MATCHES", Cache(1_000_000, lambda held: held.nbytes))
    method = annotator("kick", "walk").method
    assert isinstance(method, ThesisMethod)
    return method, CachingMethod(method, ("store", 1))


def test_cached_matches_are_those_of_the_ranges_that_are_asked_for(
    both: tuple[ThesisMethod, CachingMethod],
) -> None:
    """Matches of whole takes do not answer for a part of the takes, nor those of a part for another part."""
    method, cached = both
    words = laid_out([TAKE])
    whole = whole_takes(words)
    start, half = np.array([[0, 20]]), np.array([[20, len(TAKE)]])
    for ranges in (whole, start, half, whole, start):
        found = cached.matches(words, [ranges, ranges]).parts()
        expected = method.matches(words, [ranges, ranges]).parts()
        for mine, theirs in zip(found, expected, strict=True):
            for one, other in zip(mine, theirs, strict=True):
                np.testing.assert_array_equal(one, other)
