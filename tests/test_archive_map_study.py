"""The study of the map of an archive: its tables, over motions that differ clearly."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studies.archive_map import same_class, tables
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


def test_neighbours_of_the_same_class_are_counted() -> None:
    places = np.array([[0.0], [1.0], [10.0], [11.0]])
    assert same_class(places, ["a", "a", "b", "b"]) == 4 / 12
