"""The pose database of a store: a later build reads what has changed, and gives what a whole build gives."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.reconstruction import stored_poses
from kinedex.pipelines.reconstruction.stored_poses import (
    PoseDatabase,
    build_pose_database,
    listed_takes,
    read_pose_database,
)
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.pipelines.stages.pose_database import BuildPoseDatabase as Stage
from kinedex.storage.snapshot.manifest import ResultPart
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import verify
from tests.pipelines.archives import context, human_amc, write_archive
from tests.pipelines.counted_bars import CountedBars

TAKES = {f"x_{actor}_{name}_1.amc": 120 for actor in ("al", "bo") for name in ("hop", "sway", "turn")}
PATTERNS = [r"x_(?P<actor>[a-z]+)_(?P<class>\w+)_(?P<clip>\d)"]
DISTANCE = 0.12


def ingest(folder: Path) -> None:
    Ingest().run(context(folder / "store"), Ingest.parameters(source=str(folder / "source"), patterns=PATTERNS))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A store of six takes of two actors, and its pose database; chains that bend do not change its mean bones."""
    made = tmp_path_factory.mktemp("poses")
    write_archive(made / "source", TAKES)
    ingest(made)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stored_poses, "BONE_DIGITS", 1)
        run(made)
        yield made


def run(folder: Path, **params: object) -> dict[str, object]:
    given = {"distance_m": DISTANCE, **params}
    return Stage().run(context(folder / "store", "pose_database"), Stage.parameters(**given))


def stored(folder: Path) -> tuple[Store, PoseDatabase]:
    store = open_store(folder / "store", at="newest")
    made = read_pose_database(store, "test/pose_database")
    assert made is not None
    return store, made


def assert_equal_to_a_whole_build(folder: Path) -> None:
    store, made = stored(folder)
    whole = build_pose_database(store, listed_takes(store, "class IS NOT NULL", ""), DISTANCE, None, print)
    assert made.origins == whole.origins
    assert made.directions.tobytes() == whole.directions.tobytes()
    assert made.mean_bones.tolist() == whole.mean_bones.tolist()
    total = len(whole.directions)
    assert all((one.stands_for >= -1).all() and (one.stands_for < total).all() for one in made.takes)
    assert verify(store) == []


def test_the_database_is_whole_and_in_sql(folder: Path) -> None:
    assert_equal_to_a_whole_build(folder)
    store, made = stored(folder)
    assert 10 < len(made.directions) < 700
    rows = store.sql("SELECT count(*), max(pose) + 1, min(len(directions)) FROM poses").to_pylist()[0]
    assert list(rows.values()) == [len(made.directions), len(made.directions), 72]
    names = store.sql("SELECT take, poses, len(stands_for) AS frames FROM pose_takes ORDER BY take").to_pylist()
    assert [row["take"] for row in names] == sorted(row["take"] for row in names)
    assert all(row["frames"] == len(one.stands_for) for row, one in zip(names, made.takes, strict=True))


def test_a_build_says_how_many_takes_there_are(folder: Path) -> None:
    store, _ = stored(folder)
    takes, bars = listed_takes(store, "class IS NOT NULL", ""), CountedBars()
    build_pose_database(store, takes, DISTANCE, None, print, bars)
    assert bars.seen == [("measuring takes", 6, 6), ("comparing poses of takes", 6, 6)]


def test_nothing_is_read_where_nothing_has_changed(folder: Path) -> None:
    before = stored(folder)[1].directions.tobytes()
    assert run(folder)["read"] == 0
    assert stored(folder)[1].directions.tobytes() == before


def test_another_distance_reads_all(folder: Path) -> None:
    assert run(folder, distance_m=0.2)["read"] == 6
    assert run(folder)["read"] == 6
    assert_equal_to_a_whole_build(folder)


def test_new_changed_and_removed_takes_give_what_a_whole_build_gives(folder: Path) -> None:
    source = folder / "source"
    read = []
    for name, text in (
        ("x_al_aa_1.amc", human_amc(100, 77)),  # before all others
        ("x_bo_zz_1.amc", human_amc(100, 78)),  # after all others
        ("x_al_sway_1.amc", human_amc(90, 79)),
        ("x_al_copy_1.amc", (source / "x_bo_hop_1.amc").read_text()),  # its poses take the place of later ones
    ):
        (source / name).write_text(text)
        ingest(folder)
        read.append(run(folder)["read"])
        assert_equal_to_a_whole_build(folder)
    assert read[1] == 1
    (source / "x_al_copy_1.amc").unlink()
    made = Ingest.parameters(source=str(source), patterns=PATTERNS, prune=True)
    Ingest().run(context(folder / "store"), made)
    assert run(folder)["read"] >= 1
    assert_equal_to_a_whole_build(folder)


def test_a_filter_without_takes_names_the_way_out(folder: Path) -> None:
    with pytest.raises(KinedexError, match=r"where: no take fits 'class = 'none''.*--set pose_database.where=true"):
        run(folder, where="class = 'none'")


@pytest.mark.parametrize(("word", "first", "dropped"), [("not numbered from 0 on", 1, 0), ("there are", 0, 1)])
def test_verify_finds_poses_that_do_not_fit_their_takes(
    folder: Path, monkeypatch: pytest.MonkeyPatch, word: str, first: int, dropped: int
) -> None:
    store, _ = stored(folder)
    rows = store.result("poses").combine_chunks()
    numbers = pa.array(np.arange(first, first + rows.num_rows, dtype=np.int32))
    wrong = rows.set_column(1, rows.schema.field("pose"), numbers).slice(0, rows.num_rows - dropped)
    pieces = store.result_pieces

    def damaged(kind: str, parts: Iterable[ResultPart]) -> Iterator[pa.Table]:
        return iter([wrong]) if kind == "poses" else pieces(kind, parts)

    monkeypatch.setattr(store, "result_pieces", damaged)
    assert [word in one.problem for one in verify(store)] == [True]


def test_verify_finds_frames_whose_poses_do_not_stand_for_themselves(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, made = stored(folder)
    pieces = store.result_pieces

    def damaged(kind: str, parts: Iterable[ResultPart]) -> Iterator[pa.Table]:
        for rows in pieces(kind, parts):
            place = rows.schema.get_field_index("stands_for")
            moved = pa.array([[0] * len(one.stands_for) for one in made.takes], pa.list_(pa.int32()))
            yield rows if place < 0 else rows.set_column(place, rows.schema.field(place), moved)

    monkeypatch.setattr(store, "result_pieces", damaged)
    assert any("others stand for them" in one.problem for one in verify(store))
