"""Quality of takes: figures in the columns of a store, warnings in plain words, no clash with other columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import kinedex
from kinedex.catalog.quality_figures import FIGURES
from kinedex.pipelines.inspection.motion_file import inspect_file
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.store.store import open_store
from tests.bodies import standing
from tests.bvh_files import bvh_text, dance, mixamo
from tests.oracles.features import JOINTS
from tests.pipelines.archives import context


def bring_in(store: Path, source: Path, **params: object) -> dict[str, object]:
    return Ingest().run(context(store), Ingest.parameters(source=str(source), **params))  # type: ignore[arg-type]


def write_walk(path: Path, turn: np.ndarray | None = None, scale: float = 1.0) -> None:
    """A file of positions: the standing figure swings its limbs for two seconds, perhaps turned or scaled."""
    body = standing(60)
    swing = 0.15 * np.sin(2 * np.pi * np.arange(60) / 30)
    for joint, share in (("lankle", 1), ("rankle", -1), ("lwrist", -1), ("rwrist", 1)):
        body[JOINTS.index(joint), 2] += share * swing
    body = np.einsum("ab,jbt->jat", np.eye(3) if turn is None else turn, body) * scale
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez(path, positions=body.transpose(2, 0, 1), names=np.array(JOINTS), fps=30.0)


def test_a_store_has_the_figures_as_columns_and_sql_asks_for_them(tmp_path: Path) -> None:
    write_walk(tmp_path / "source" / "right.npz")
    write_walk(tmp_path / "source" / "lying.npz", np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]))
    bring_in(tmp_path / "store", tmp_path / "source")
    store = open_store(tmp_path / "store")
    columns = store.manifest.columns
    assert {name for name, one in columns.items() if one.origin == "quality"} == {
        "recognition_confidence", "estimated_joints", "file_up", "filled_frames", "filled_from",
        *(figure.name for figure in FIGURES),
    }  # fmt: skip
    assert columns["height_m"].unit == "m"
    rows = {row["name"]: row for row in store.takes().to_dicts()}
    assert rows["right"]["height_m"] == pytest.approx(1.85, abs=0.1)
    assert rows["right"]["up_axis"] == "y"
    assert rows["right"]["left_right"] > 0.3
    assert rows["lying"]["up_axis"] == "z"
    found = store.sql("SELECT name FROM takes WHERE up_axis <> 'y' AND height_m BETWEEN 1.5 AND 2").to_pylist()
    assert found == [{"name": "lying"}]
    assert "the body stands along z, not along y" in " ".join(rows["lying"]["warnings"])
    assert not [warning for warning in rows["right"]["warnings"] if "stands along" in warning]


def test_a_take_of_a_file_has_the_figures_of_the_store(tmp_path: Path) -> None:
    write_walk(tmp_path / "source" / "walk.npz")
    bring_in(tmp_path / "store", tmp_path / "source")
    (row,) = open_store(tmp_path / "store").takes().to_dicts()
    take = kinedex.read(tmp_path / "source" / "walk.npz")
    assert {figure.name: take.info[figure.name] for figure in FIGURES} == {
        figure.name: row[figure.name] for figure in FIGURES
    }
    assert take.info["warnings"] == row["warnings"]


def test_a_column_of_the_user_keeps_its_name(tmp_path: Path) -> None:
    write_walk(tmp_path / "source" / "tall_1.npz")
    bring_in(tmp_path / "store", tmp_path / "source", patterns=[r"(?P<height_m>[a-z]+)_\d"])
    store = open_store(tmp_path / "store")
    assert store.manifest.columns["height_m"].origin == "pattern"
    (row,) = store.takes().to_dicts()
    assert (row["height_m"], row["up_axis"]) == ("tall", "y")


def test_a_store_without_the_columns_gets_them_by_the_next_ingest_of_changed_files(tmp_path: Path) -> None:
    (tmp_path / "source").mkdir()
    (tmp_path / "source" / "a.bvh").write_text(bvh_text(mixamo(), dance(mixamo(), 9)))
    bring_in(tmp_path / "store", tmp_path / "source")
    assert bring_in(tmp_path / "store", tmp_path / "source")["read"] == 0


def test_inspect_prints_figures_limits_and_what_is_off(tmp_path: Path) -> None:
    write_walk(tmp_path / "big.npz", scale=2.54)
    found = inspect_file(tmp_path / "big.npz")
    texts = [text for _, text in found.lines]
    assert "height_m 4.51 m, expected 0.8 to 2.3 m: OFF" in texts
    assert any("left is on the left" in text for text in texts)
    assert any(text.startswith("height_m is 4.51 m, expected 0.8 to 2.3 m (height") for text in texts)


@pytest.mark.parametrize("executor", ["serial", "processes"])
def test_a_file_that_contradicts_its_folder_is_warned_of_whatever_order_files_come_in(
    tmp_path: Path, executor: str
) -> None:
    def take_in(store: Path) -> list[tuple[str, list[str]]]:
        Ingest().run(context(store, executor=executor), Ingest.parameters(source=str(tmp_path / "day")))
        return sorted((row["name"], row["warnings"]) for row in open_store(store).takes().to_dicts())

    write_walk(tmp_path / "day" / "small.npz", scale=0.55)
    write_walk(tmp_path / "day" / "walk0.npz")
    first = take_in(tmp_path / "store")
    assert "unlike the files beside it" not in str(first)
    for number in range(1, 8):
        write_walk(tmp_path / "day" / f"walk{number}.npz", scale=1 + number / 500)
    found = take_in(tmp_path / "store")
    warned = {name: warnings for name, warnings in found if "unlike the files beside it" in str(warnings)}
    assert list(warned) == ["small"]
    assert "its body is 0.98 m high, theirs 1.79 m" in warned["small"][-1]
    assert found == take_in(tmp_path / "another")
