"""Ingest: takes of one name, takes that were named otherwise before, and sources of which nothing comes in."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from kinedex.ops.errors import KinedexError, NewStoreError
from kinedex.pipelines.ingestion.known_files import TakeNames
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from tests.pipelines.archives import context, write_archive
from tests.pipelines.test_ingest import TAKES, bring_in


def names(store: Path) -> dict[str, str]:
    takes = open_store(store).takes()
    return dict(zip(takes["source"], takes["name"], strict=True))


def test_new_takes_of_equal_stems_are_named_by_their_paths_and_a_line_reports_it(tmp_path: Path) -> None:
    paths = {f"{folder}/x_{number}.amc": 5 for folder in "ab" for number in (1, 2)}
    source, store = write_archive(tmp_path / "source", {**paths, "b/x_3.amc": 5, "x_1.amc": 7}), tmp_path / "store"
    place = context(store)
    assert Ingest().run(place, Ingest.parameters(source=str(source)))["left_out"] == 0
    assert names(store) == {path: path.removesuffix(".amc") for path in paths} | {"b/x_3.amc": "x_3", "x_1.amc": "x_1"}
    message = " ".join(place.terminal.console.file.getvalue().split())  # type: ignore[attr-defined]
    assert "4 new takes named by the path of the file, since others have its stem: 'a/x_1' for a/x_1.amc" in message
    assert bring_in(store, source)["unchanged"] == 6


def test_a_file_that_comes_later_renames_no_take(tmp_path: Path) -> None:
    source, store = write_archive(tmp_path / "source", {"b/x_1.amc": 9}), tmp_path / "store"
    bring_in(store, source)
    write_archive(source, {"a/x_1.amc": 13, "c/x_1.amc": 9}, first_seed=7)
    shutil.copy(source / "b/x_1.amc", source / "x_d_1.amc")
    (source / "e").mkdir()
    shutil.copy(source / "b/x_1.amc", source / "e/x_1.amc")
    assert bring_in(store, source)["read"] == 4
    expected = {"b/x_1.amc": "x_1", "a/x_1.amc": "a/x_1", "c/x_1.amc": "c/x_1", "x_d_1.amc": "x_d_1",
                "e/x_1.amc": "e/x_1"}  # fmt: skip
    assert names(store) == expected
    # and where the others are gone, the last one keeps the name that it has
    for path in ("b/x_1.amc", "c/x_1.amc", "e/x_1.amc"):
        (source / path).unlink()
    assert bring_in(store, source, prune=True)["dropped"] == 3
    assert names(store) == {"a/x_1.amc": "a/x_1", "x_d_1.amc": "x_d_1"}
    assert bring_in(store, source)["unchanged"] == 2
    assert verify(open_store(store, at="newest")) == []


def test_files_of_one_stem_in_two_formats_are_named_with_their_endings() -> None:
    names = TakeNames("stem", {"z": "", "b/y": ""})
    paths = ["a/x.bvh", "a/x.c3d", "b/x.bvh", "y.bvh", "b/y.bvh", "z.bvh", "w.bvh"]
    assert names.add_files(paths, {"w.bvh": "old"}) == {
        "a/x.bvh": "a/x.bvh", "a/x.c3d": "a/x.c3d", "b/x.bvh": "b/x", "y.bvh": "y", "b/y.bvh": "b/y.bvh",
        "z.bvh": "z.bvh", "w.bvh": "old",
    }  # fmt: skip


def test_a_file_for_which_no_name_is_free_is_refused(tmp_path: Path) -> None:
    source, store = write_archive(tmp_path / "source", {"x_1.amc.amc": 5, "x_1.amc": 5, "a/x_1.amc": 5}), tmp_path / "s"
    bring_in(store, source, name="file")
    assert set(names(store).values()) == {"x_1.amc.amc", "x_1.amc", "a/x_1.amc"}
    other = write_archive(tmp_path / "other", {"x_1.amc": 6}, first_seed=9)
    with pytest.raises(KinedexError, match="the only file could not be read"):
        bring_in(store, other, name="file")
    (row,) = open_store(store).result("ingest_log").to_pylist()
    assert "put it into a folder of its own below the source" in row["message"]
    (other / "sub").mkdir()
    (other / "x_1.amc").rename(other / "sub/x_1.amc")
    assert bring_in(store, other, name="file")["read"] == 1


def test_takes_that_another_pipeline_has_named_are_not_read_again_under_other_names(tmp_path: Path) -> None:
    source, store = write_archive(tmp_path / "source", TAKES), tmp_path / "store"
    bring_in(store, source, name="path")
    before = open_store(store).manifest.version
    with pytest.raises(NewStoreError, match=r"3 takes of this source are in the store under other names, such as "
                                            r"'a/x_1' \(here 'x_1'\).*with the pipeline.*a new store"):  # fmt: skip
        bring_in(store, source)
    assert open_store(store).manifest.version == before
    (source / "a/x_1.amc").unlink()
    summary = bring_in(store, source, prune=True)
    assert (summary["dropped"], summary["read"], summary["takes"]) == (3, 2, 2)
    assert open_store(store).takes()["name"].to_list() == ["x_2", "x_3"]
    assert verify(open_store(store, at="newest")) == []


def test_a_source_of_which_nothing_comes_in_ends_the_run_and_prunes_nothing(tmp_path: Path) -> None:
    source, store = write_archive(tmp_path / "source", TAKES), tmp_path / "store"
    bring_in(store, source)
    (source / "a/x_1.amc").unlink()
    for path in ("a/x_2.amc", "b/x_3.amc"):
        (source / path).write_text("no motion")
    with pytest.raises(KinedexError, match=r"none of the 2 files could be read; the reasons are above"):
        bring_in(store, source, prune=True)
    opened = open_store(store)
    assert opened.result("ingest_log").num_rows == 2
    assert opened.takes().height == 3


def test_an_ingest_of_a_copy_drops_no_take_of_the_original(tmp_path: Path) -> None:
    source, store = write_archive(tmp_path / "source", TAKES), tmp_path / "store"
    bring_in(store, source)
    copy = shutil.copytree(source, tmp_path / "copy")
    (source / "a/x_1.amc").unlink()
    (copy / "a/x_1.amc").unlink()
    assert bring_in(store, copy, prune=True)["dropped"] == 0
    assert open_store(store).takes().height == 3
