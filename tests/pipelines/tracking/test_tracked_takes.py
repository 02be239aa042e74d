"""Tracks are takes: replaced whole, passed over by ingests, and known to every command that changes a store."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from kinedex.commands.cli import app
from kinedex.ops.errors import KinedexError
from kinedex.ops.words import NO_WORD
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.pipelines.tracking.recorded_takes import put_takes
from kinedex.pipelines.tracking.tracked_takes import observed_frames, stabilised_name
from kinedex.storage.index.builder import build_index
from kinedex.storage.snapshot.schemas import TRACK_FORMAT
from kinedex.storage.store.garbage_collection import collect_garbage
from kinedex.storage.store.merge import merge_store
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.take_removal import planned_removal, remove_takes
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.pipelines.archives import context, write_archive
from tests.pipelines.tracking.tracks import fitted_track, joints_of


def kinedex(*arguments: object) -> str:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert done.exit_code == 0, done.output
    return done.output


def ingest(folder: Path, **params: object) -> dict[str, object]:
    return Ingest().run(context(folder / "store"), Ingest.parameters(source=str(folder / "source"), **params))


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a source of two takes, and a store that has a track beside them."""
    folder = tmp_path_factory.mktemp("tracks")
    write_archive(folder / "source", {"x_aa_one.amc": 240, "x_bb_two.amc": 160})
    ingest(folder)
    store = open_store(folder / "store", at="newest")
    put(folder / "store", fitted_track(store, "x_aa_one", "walk_tracked", folder / "source"))
    build_index(open_store(folder / "store", at="newest"))
    return folder


@pytest.fixture
def folder(archive: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    shutil.copytree(archive, tmp_path, dirs_exist_ok=True)
    return tmp_path


def put(path: Path, *tracks: object) -> Store:
    opened = open_store(path, at="newest")
    with StoreWriter.open(path, opened.feature_set) as writer:
        put_takes(writer, tracks)  # type: ignore[arg-type]
        writer.commit()
    return open_store(path, at="newest")


def row_of(store: Store, take: str) -> dict[str, object]:
    return next(row for row in store.take_rows.to_pylist() if row["name"] == take)


def test_a_track_has_frames_words_and_a_row_like_any_take(archive: Path) -> None:
    store = open_store(archive / "store")
    row = row_of(store, "walk_tracked")
    assert (row["format"], row["recording"], row["cameras"]) == (TRACK_FORMAT, "walk", ["c1", "c2"])
    assert row["frames"] == row_of(store, "x_aa_one")["frames"] == 60
    assert row["class"] is None
    assert row["invalid_frames"] == 0
    assert row["checksum"] == "ab" * 32
    gaps = np.linalg.norm(joints_of(store, "walk_tracked") - joints_of(store, "x_aa_one"), axis=1)
    assert np.median(gaps) < 0.03
    ids = store.take_ids
    words = store.words([ids["walk_tracked"], ids["x_aa_one"]])
    assert np.mean(words.take(0) == words.take(1)) < 1.0
    assert not np.any(words.take(1) == NO_WORD)
    assert store.sql("SELECT count(*) FROM word_runs JOIN takes USING (take_id) WHERE format = 'track'").to_pylist()[0]
    assert "walk_tracked" in kinedex("takes", archive / "store")


def test_frames_unseen_for_long_are_invalid(folder: Path) -> None:
    seen = np.ones(60, bool)
    seen[10:20] = seen[30:50] = seen[58:] = False
    valid = observed_frames(seen, 30.0)
    assert np.array_equal(np.flatnonzero(~valid), np.arange(30, 50))
    store = open_store(folder / "store")
    path = folder / "store"
    store = put(path, fitted_track(store, "x_aa_one", "walk_tracked", folder, valid=valid, recipe="again"))
    assert row_of(store, "walk_tracked")["invalid_frames"] == 20
    words = store.words([store.take_ids["walk_tracked"]]).take(0)
    assert np.array_equal(np.flatnonzero(words == NO_WORD), np.arange(30, 50))


def test_a_track_is_replaced_whole_under_its_id(folder: Path) -> None:
    before = open_store(folder / "store")
    after = put(folder / "store", fitted_track(before, "x_bb_two", "walk_tracked", folder))
    assert after.take_ids == before.take_ids
    assert row_of(after, "walk_tracked")["frames"] == 40
    assert [one.kind for one in verify(after)] == ["index"]


def test_an_ingest_passes_tracks_over(folder: Path) -> None:
    put(folder / "store", fitted_track(open_store(folder / "store"), "x_aa_one", "gone_tracked", folder / "source"))
    before = row_of(open_store(folder / "store", at="newest"), "gone_tracked")
    done = ingest(folder, prune=True, patterns=[r"x_(?P<actor>[a-z]+)_"])
    assert (done["unchanged"], done["dropped"]) == (2, 0)
    assert row_of(open_store(folder / "store", at="newest"), "gone_tracked") == before


def test_a_file_never_takes_the_name_of_a_track_nor_a_track_that_of_a_file(folder: Path) -> None:
    (folder / "source" / "more").mkdir()
    shutil.copy(folder / "source" / "x_bb_two.amc", folder / "source" / "more" / "walk_tracked.amc")
    shutil.copy(folder / "source" / "x.asf", folder / "source" / "more" / "walk.asf")
    ingest(folder)
    store = open_store(folder / "store", at="newest")
    assert len(store.take_ids) == 4
    assert row_of(store, "walk_tracked")["format"] == TRACK_FORMAT
    with pytest.raises(KinedexError, match=r"a take 'x_bb_two' already, from .*name the recording otherwise"):
        put(folder / "store", fitted_track(store, "x_aa_one", "x_bb_two", folder))


def test_removal_merge_gc_and_export_know_tracks(folder: Path, tmp_path: Path) -> None:
    path = folder / "store"
    store = open_store(path)
    for form in ("trc", "bvh", "c3d", "csv"):
        kinedex("export", path, "-o", tmp_path / form, "--format", form, "--where", "format = 'track'")
        assert list((tmp_path / form).rglob(f"walk_tracked.{form}"))
    other = tmp_path / "other"
    with StoreWriter.open(other, store.feature_set) as writer:
        merge_store(writer, store, "b-")
    assert row_of(open_store(other, at="newest"), "b-walk_tracked")["cameras"] == ["c1", "c2"]
    shown = json.loads(kinedex("takes", "remove", path, "walk_tracked", "--json"))
    assert (shown["tracks"], shown["files"], shown["returning"]) == (["walk_tracked"], [], [])
    assert "makes its take again" in kinedex("takes", "remove", path, "walk_tracked")
    with StoreWriter.open(path, store.feature_set) as writer:
        remove_takes(writer, planned_removal(writer.store, ["walk_tracked"]))
    after = open_store(path, at="newest")
    assert "walk_tracked" not in after.take_ids
    assert not after.manifest.removed_files
    collect_garbage(path)
    assert [one.kind for one in verify(open_store(path, at="newest"))] == ["index"]


def test_names() -> None:
    assert stabilised_name("walk_tracked") == "walk_stabilised"
    assert stabilised_name("walk") == "walk_stabilised"
