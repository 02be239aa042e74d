"""Layouts and clusters of made-up points: alike is close, the same in every run, and nothing is left out."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest

from kinedex.ops.maps.layout import map_clusters, map_layout, outline, traits, typical
from kinedex.ops.packages import MissingPackageError

GROUPS = 3
_random = np.random.default_rng(5)
CENTRES = 6 * _random.normal(size=(GROUPS, 8))
OWN = np.repeat(np.arange(GROUPS), 25)
NUMBERS = CENTRES[OWN] + _random.normal(size=(len(OWN), 8))


def test_points_that_are_alike_are_clusters_and_come_out_the_same_again() -> None:
    seen: list[tuple[int, int]] = []
    layout = map_layout(NUMBERS, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(50 * (i + 1), 1000) for i in range(len(seen))]
    assert len(seen) > 2
    assert (layout.positions == map_layout(NUMBERS).positions).all()
    assert np.abs(layout.positions).max() == pytest.approx(1, abs=0.02)
    clusters = map_clusters(layout)
    assert {(int(own), int(number)) for own, number in zip(OWN, clusters, strict=True) if number >= 0} == {
        (own, int(np.bincount(clusters[(own == OWN) & (clusters >= 0)]).argmax())) for own in range(GROUPS)
    }, "no cluster holds two groups"
    assert (clusters >= 0).mean() > 0.9
    assert (np.diff(np.bincount(clusters[clusters >= 0])) <= 0).all(), "the largest is the first"


def test_of_many_points_the_rest_lies_beside_the_most_similar() -> None:
    layout = map_layout(NUMBERS, most=40)
    assert len(layout.chosen) == 40
    assert layout.nearest[layout.chosen].tolist() == list(range(40))
    distances = ((NUMBERS[:, None] - NUMBERS[layout.chosen]) ** 2).sum(axis=2)
    assert (layout.nearest == distances.argmin(axis=1)).all()
    beside = np.abs(layout.positions - layout.positions[layout.chosen][layout.nearest]).max()
    assert 0 < beside < 0.05
    assert len(np.unique(layout.positions, axis=0)) == len(NUMBERS)
    clusters = map_clusters(layout)
    assert (clusters == clusters[layout.chosen][layout.nearest]).all()


@pytest.mark.parametrize("count", [0, 1, 2, 4])
def test_few_points_and_equal_points_have_a_map_too(count: int) -> None:
    for numbers in (NUMBERS[:count], np.zeros((3 * count, 8))):
        layout = map_layout(numbers)
        assert np.isfinite(layout.positions).all()
        assert len(np.unique(layout.positions, axis=0)) == len(numbers)
        assert (map_clusters(layout) == -1).all() or len(numbers) >= 8


def test_an_outline_holds_its_points_and_the_middle_is_typical() -> None:
    square = np.array([[0, 0], [2, 0], [2, 2], [0, 2], [1, 1], [1.2, 1]], np.float32)
    assert {tuple(corner) for corner in outline(square).tolist()} == {(0, 0), (2, 0), (2, 2), (0, 2)}
    assert len(outline(square[:2])) == 2
    assert outline(np.array([[0, 0], [1, 1], [2, 2]], np.float32)).tolist() == [[0, 0], [2, 2]]
    assert typical(square, np.ones(6, bool)).tolist()[:2] == [4, 5]


def test_rare_features_that_are_only_here_come_before_frequent_ones() -> None:
    shares = np.array([[0.3, 0.9, 0.5], [0.3, 0.7, 0.5], [0.0, 0.1, 0.5], [0.0, 0.9, 0.5], [0.0, 0.6, np.nan]])
    found = traits(shares, np.array([True, True, False, False, False]))
    assert [one.feature for one in found] == [0, 1]
    assert found[1].share == pytest.approx(0.8)
    assert found[1].rest == pytest.approx(1.6 / 3, abs=1e-6)


def test_a_missing_package_is_named_with_the_command_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "sklearn.manifold", None)
    wanted = "a map of an archive needs the package scikit-learn, which is not installed: install it with `pip install"
    with pytest.raises(MissingPackageError, match=re.escape(f"{wanted} 'kinedex[map]'`")):
        map_layout(NUMBERS)
