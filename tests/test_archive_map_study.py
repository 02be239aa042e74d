"""The study of the map of an archive: its tables, over motions that differ clearly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import coo_array

from studies.archive_map import modularity, same_class, shared_neighbours, tables
from tests.pipelines.labelled import POSES, write_store


def test_the_tables_show_classes_that_are_apart(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    takes: list[dict[str, object]] = [
        {
            "name": f"{name}_{number:02d}",
            "class": name,
            "words": np.repeat(POSES[name], random.integers(3, 9, len(POSES[name]))),
        }
        for name in ("kick", "walk", "wave")
        for number in range(12)
    ]
    takes.append({"name": "unnamed", "class": None, "words": POSES["rest"]})
    printed = tables(write_store(tmp_path / "motions", takes))
    assert "motions: 36 takes of 3 classes" in printed
    assert "same class among the ten nearest: 1.00 by the numbers, 1.00 on the map" in printed
    assert "| as shown | 1.00 | 3 | 0.00 |" in printed
    assert "| Ward of the numbers, modularity, 10 neighbours | 1.00 | 3 | 0.00 |" in printed


def test_neighbours_of_the_same_class_are_counted() -> None:
    places = np.array([[0.0], [1.0], [10.0], [11.0]])
    assert same_class(places, ["a", "a", "b", "b"]) == 4 / 12


def test_modularity_is_the_weight_within_clusters_beyond_that_of_chance() -> None:
    random = np.random.default_rng(5)
    weights = random.random((9, 9)) * (random.random((9, 9)) < 0.5)
    weights += weights.T
    clusters = random.integers(0, 3, 9)
    degree, whole = weights.sum(axis=1), weights.sum()
    expected = sum(
        weights[i, j] - degree[i] * degree[j] / whole for i in range(9) for j in range(9) if clusters[i] == clusters[j]
    )
    assert modularity(coo_array(weights), clusters) == pytest.approx(expected / whole)


def test_edges_weigh_the_share_of_common_neighbours() -> None:
    points = np.array([[0.0], [1.0], [2.1], [10.0], [11.0], [12.1]])
    near = [{1, 2}, {0, 2}, {1, 0}, {4, 5}, {3, 5}, {4, 3}]
    expected = np.zeros((6, 6))
    for i, one in enumerate(near):
        for j, other in enumerate(near):
            if j in one or i in other:
                expected[i, j] = len(one & other) / len(one | other)
    np.testing.assert_allclose(shared_neighbours(points, 2).toarray(), expected)
