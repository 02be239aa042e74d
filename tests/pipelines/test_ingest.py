"""Ingest: what comes in, what is excluded with a message, what is not done twice, and what a killed run leaves."""

from __future__ import annotations

import os
import random
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinedex.catalog.skeletons.mappings import load_skeleton
from kinedex.ops.body import features, kinematics
from kinedex.ops.errors import ConfigError, KinedexError
from kinedex.pipelines.ingestion import read_passes
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.formats.motion.acclaim import AmcFile
from kinedex.storage.formats.motion.asf import read_asf
from kinedex.storage.index.builder import build_index
from kinedex.storage.index.generations import Generation, current_generation, read_generation
from kinedex.storage.snapshot.manifest_files import versions
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from tests import killed_runs
from tests.pipelines.archives import context, human_amc, write_archive

TAKES = {"a/x_1.amc": 50, "a/x_2.amc": 33, "b/x_3.amc": 121}


def bring_in(store: Path, source: Path, **params: object) -> dict[str, object]:
    return Ingest().run(context(store), Ingest.parameters(source=str(source), **params))  # type: ignore[arg-type]


def indexed(store: Path) -> Generation | None:
    """Return the index generation of a store; None where it is stale."""
    opened = open_store(store)
    found = current_generation(opened.path, opened.manifest)
    return None if found is None else read_generation(found)


def test_every_fourth_source_frame_becomes_a_frame_with_the_word_of_the_source_rate(tmp_path: Path) -> None:
    source = write_archive(tmp_path / "source", TAKES)
    assert bring_in(tmp_path / "store", source)["read"] == 3
    store = open_store(tmp_path / "store")
    assert store.takes()["name"].to_list() == ["x_1", "x_2", "x_3"]
    assert store.takes()["frames"].to_list() == [13, 9, 31]
    skeleton = read_asf(source / "x.asf")
    nodes, matrices = kinematics.forward(skeleton.nodes, AmcFile(source / "b/x_3.amc", skeleton).channels())
    joints = store.feature_set.joints
    mapping = load_skeleton("acclaim", joints)
    positions = mapping.apply("", skeleton.bones, nodes, joints)
    words = features.words(positions, kinematics.quaternions(matrices), 120.0, store.feature_set.rules)
    take_id = store.takes("name = 'x_3'")["take_id"][0]
    np.testing.assert_array_equal(store.words([take_id]).words, words[::4])
    rows = store.frames("x_3")
    hand = rows.column("rwrist").combine_chunks()
    np.testing.assert_allclose(hand.field("y").to_numpy(), positions[joints.index("rwrist"), 1, ::4], atol=1e-6)
    assert len(np.unique(words)) > 3


def test_a_second_run_reads_nothing_and_a_changed_file_only(tmp_path: Path) -> None:
    source, store = write_archive(tmp_path / "source", TAKES), tmp_path / "store"
    bring_in(store, source)
    before = open_store(store).takes()
    again = bring_in(store, source)
    assert (again["read"], again["unchanged"]) == (0, 3)
    os.utime(source / "a/x_1.amc", ns=(1, 1))
    assert bring_in(store, source)["read"] == 0
    (source / "a/x_2.amc").write_text(human_amc(45, seed=99))
    assert bring_in(store, source)["read"] == 1
    after = open_store(store).takes()
    assert after["take_id"].to_list() == before["take_id"].to_list()
    assert after["frames"].to_list() == [13, 12, 31]
    assert verify(open_store(store, at="newest")) == []


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the motion and skeleton files that are opened, in order."""
    names: list[str] = []
    really = Path.open

    def record(path: Path, *how: Any, **more: Any) -> Any:
        if path.suffix in (".amc", ".asf", ".trc"):
            names.append(path.name)
        return really(path, *how, **more)

    monkeypatch.setattr(Path, "open", record)
    return names


def test_files_are_read_once_and_only_those_that_are_not_as_they_were(tmp_path: Path, opened: list[str]) -> None:
    source, store = (
        write_archive(tmp_path / "source", {f"x_{number}.amc": 9 for number in range(4)}),
        tmp_path / "store",
    )
    opened.clear()
    bring_in(store, source)
    assert sorted(opened) == ["x.asf", "x.asf", "x_0.amc", "x_1.amc", "x_2.amc", "x_3.amc"]
    os.utime(source / "x_1.amc")
    text = (source / "x_2.amc").read_text()
    (source / "x_2.amc").write_text(text[:-1] + " \n")
    opened.clear()
    assert bring_in(store, source)["unchanged"] == 3
    assert opened == ["x_1.amc", "x_2.amc"]
    opened.clear()
    assert bring_in(store, source)["unchanged"] == 4
    assert opened == []


def test_a_file_that_was_touched_or_has_moved_is_read_once_to_see_that_it_is_the_same(
    tmp_path: Path, opened: list[str]
) -> None:
    source, store = write_archive(tmp_path / "source", TAKES), tmp_path / "store"
    bring_in(store, source)
    build_index(open_store(store, at="newest"))
    before = open_store(store).takes()
    (source / "c").mkdir()
    (source / "a/x_1.amc").rename(source / "c/x_1.amc")
    os.utime(source / "a/x_2.amc", ns=(1, 1))
    opened.clear()
    assert bring_in(store, source)["unchanged"] == 3
    assert sorted(opened) == ["x_1.amc", "x_2.amc"]
    opened.clear()
    assert bring_in(store, source)["unchanged"] == 3
    assert opened == []
    after = open_store(store).takes()
    changed = ["source", "source_mtime_ns"]
    assert after.drop(changed).equals(before.drop(changed))
    assert after["source"].to_list() == ["c/x_1.amc", "a/x_2.amc", "b/x_3.amc"]
    assert after["source_mtime_ns"][1] == 1
    assert indexed(store) is not None
    assert verify(open_store(store, at="newest")) == []


def test_of_two_copies_of_a_file_the_take_stays_that_of_the_first(tmp_path: Path) -> None:
    source, copy = write_archive(tmp_path / "source", TAKES), write_archive(tmp_path / "copy", TAKES)
    bring_in(tmp_path / "store", source)
    assert bring_in(tmp_path / "store", copy)["unchanged"] == 3
    assert set(open_store(tmp_path / "store").takes()["source_root"]) == {str(source)}


def test_what_is_added_to_a_large_store_costs_work_for_itself(tmp_path: Path, opened: list[str]) -> None:
    """Hundreds of takes stay as they lie: neither they nor their parts nor their shards are read or made again."""
    source, store = write_archive(tmp_path / "source", {}), tmp_path / "store"
    text = human_amc(8, seed=0)
    for number in range(300):
        (source / f"x_{number:03}.amc").write_text(text)
    bring_in(store, source)
    build_index(open_store(store, at="newest"))
    before = open_store(store).manifest
    old = indexed(store)
    for number in range(10):
        (source / f"x_new{number}.amc").write_text(text)
    opened.clear()
    assert bring_in(store, source)["read"] == 10
    build_index(open_store(store, at="newest"))
    assert sorted(opened) == [f"x_new{number}.amc" for number in range(10)]
    after = open_store(store).manifest
    assert set(before.frames) < set(after.frames)
    assert set(before.takes) < set(after.takes)
    assert [part.rows for part in after.takes if part not in before.takes] == [10]
    new = [part for part in after.frames if part not in before.frames]
    assert [len(part.live) for part in new] == [10]
    now = indexed(store)
    assert old is not None
    assert now is not None
    assert set(old.shards) < set(now.shards)


def test_a_changed_skeleton_reads_its_takes_again(tmp_path: Path) -> None:
    source, store = write_archive(tmp_path / "source", TAKES), tmp_path / "store"
    bring_in(store, source)
    text = (source / "x.asf").read_text()
    (source / "x.asf").write_text(text.replace("length 7.0", "length 7.5"))  # of the same size
    assert bring_in(store, source)["read"] == 3
    (source / "x.asf").write_text(text.replace("length 7.0", "length 7.25"))
    assert bring_in(store, source)["read"] == 3


def test_a_skeleton_that_was_touched_is_read_once_to_see_that_it_is_the_same(tmp_path: Path, opened: list[str]) -> None:
    source, store = write_archive(tmp_path / "source", TAKES), tmp_path / "store"
    other = write_archive(tmp_path / "other", {"y_1.amc": 9})
    (other / "x.asf").rename(other / "y.asf")
    bring_in(store, source)
    bring_in(store, other)
    os.utime(source / "x.asf", ns=(1, 1))
    for root, expected in ((source, ["x.asf"]), (other, []), (source, [])):
        opened.clear()
        assert bring_in(store, root)["read"] == 0
        assert opened == expected
    rows = open_store(store).result("skeleton_files").to_pylist()
    assert sorted((row["source"], row["source_mtime_ns"] == 1) for row in rows) == [("x.asf", True), ("y.asf", False)]


def test_a_file_that_is_gone_stays_until_pruned(tmp_path: Path) -> None:
    source, store = write_archive(tmp_path / "source", TAKES), tmp_path / "store"
    bring_in(store, source)
    (source / "a/x_1.amc").unlink()
    assert bring_in(store, source)["takes"] == 3
    assert bring_in(store, source, prune=True)["dropped"] == 1
    assert open_store(store).takes()["name"].to_list() == ["x_2", "x_3"]
    assert verify(open_store(store, at="newest")) == []


def break_files(source: Path) -> None:
    text = (source / "a/x_1.amc").read_text()
    (source / "bad").mkdir()
    (source / "bad/x_cut.amc").write_text(text[: len(text) // 2])
    (source / "bad/x_bone.amc").write_text(text.replace("lfemur", "# lfemur", 1))
    (source / "bad/x_word.amc").write_text(text.replace("root 0 17", "root 0 l7", 1))
    (source / "bad/x_empty.amc").write_text("")
    (source / "bad/y_alone.amc").write_text(text)


@pytest.mark.parametrize("executor", ["serial", "processes"])
def test_broken_files_are_logged_with_file_and_line_and_the_rest_comes_in(tmp_path: Path, executor: str) -> None:
    source, store = write_archive(tmp_path / "source", TAKES), tmp_path / "store"
    break_files(source)
    summary = Ingest().run(context(store, executor=executor), Ingest.parameters(source=str(source)))
    assert (summary["takes"], summary["left_out"]) == (3, 5)
    opened = open_store(store)
    log = {row["source"]: row for row in opened.result("ingest_log").to_pylist()}
    assert set(log) == {f"bad/{name}.amc" for name in ("x_cut", "x_bone", "x_word", "x_empty", "y_alone")}
    assert log["bad/x_word.amc"]["line"] == 4
    assert "not a number: 'l7'" in log["bad/x_word.amc"]["message"]
    assert "lacks bone 'lfemur'" in log["bad/x_bone.amc"]["message"]
    assert "empty" in log["bad/x_empty.amc"]["message"]
    assert "no ASF skeleton whose whole name begins 'y_alone'" in log["bad/y_alone.amc"]["message"]
    assert log["bad/x_cut.amc"]["line"] > 4
    assert all(str(source) in row["file"] for row in log.values())
    assert verify(opened) == []


def test_a_mended_file_comes_in_and_leaves_the_log(tmp_path: Path) -> None:
    source, store = write_archive(tmp_path / "source", TAKES), tmp_path / "store"
    break_files(source)
    bring_in(store, source)
    (source / "bad/x_cut.amc").write_text(human_amc(20, seed=7))
    summary = bring_in(store, source)
    assert (summary["takes"], summary["read"], summary["left_out"]) == (4, 1, 4)
    assert "bad/x_cut.amc" not in open_store(store).result("ingest_log").column("source").to_pylist()


def test_a_stranger_of_the_same_name_does_not_replace_a_take(tmp_path: Path) -> None:
    store = tmp_path / "store"
    bring_in(store, write_archive(tmp_path / "one", {"x_1.amc": 9}))
    summary = bring_in(store, write_archive(tmp_path / "two", {"x_1.amc": 13, "x_2.amc": 5}, first_seed=5))
    assert summary["left_out"] == 1
    assert open_store(store).takes()["frames"].to_list() == [3, 2]


def test_an_archive_that_moved_is_the_same_archive(tmp_path: Path) -> None:
    store, source = tmp_path / "store", write_archive(tmp_path / "old", TAKES)
    bring_in(store, source)
    ids = dict(open_store(store).takes().select("name", "take_id").rows())
    source.rename(tmp_path / "new")
    (tmp_path / "new" / "a" / "x_1.amc").unlink()
    (tmp_path / "new" / "a" / "x_2.amc").write_text(human_amc(45, seed=99))
    summary = bring_in(store, tmp_path / "new", prune=True)
    assert (summary["left_out"], summary["dropped"], summary["takes"]) == (0, 1, 2)
    takes = open_store(store).takes()
    assert set(takes["source_root"]) == {str(tmp_path / "new")}
    assert dict(takes.select("name", "take_id").rows()) == {name: ids[name] for name in ("x_2", "x_3")}
    assert bring_in(store, tmp_path / "new")["read"] == 0


def test_a_source_without_motions_and_a_pattern_that_is_none_are_refused(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(KinedexError, match="no motion files"):
        bring_in(tmp_path / "store", tmp_path / "empty")
    with pytest.raises(ValueError, match="is no regular expression"):
        Ingest.parameters(source="x", patterns=["(?P<actor"])
    with pytest.raises(ConfigError, match="did you mean 'acclaim'"):
        bring_in(tmp_path / "store", write_archive(tmp_path / "source", TAKES), skeleton="aclaim")


def test_what_a_path_says_becomes_columns(tmp_path: Path) -> None:
    source, store = write_archive(tmp_path / "source", {"kick/x_bd_01.amc": 5, "x_odd.amc": 5}), tmp_path / "store"
    bring_in(store, source, patterns=[r"(?P<class>[^/]+)/x_(?P<actor>\w+)_(?P<clip>\d+)"])
    rows = open_store(store).takes().select("name", "actor", "class", "clip", "warnings").rows()
    assert rows[0][:4] == ("x_bd_01", "bd", "kick", "01")
    assert rows[1][:4] == ("x_odd", None, None, None)
    assert [row[4].count("its path matches no pattern of the config") for row in rows] == [0, 1]


def bring_in_bit_by_bit(store: Path, source: Path) -> None:
    read_passes.MEGABYTE = 1 << 12
    bring_in(store, source, batch_mb=4)


@pytest.mark.slow
def test_killed_at_any_moment_and_run_again_it_ends_with_exactly_the_takes_it_should_have(tmp_path: Path) -> None:
    takes = {f"x_{number:02}.amc": 20 + number for number in range(24)}
    source, store = write_archive(tmp_path / "source", takes), tmp_path / "store"
    moments = random.Random(1)
    killed_runs.start(bring_in_bit_by_bit, tmp_path / "first", source).join()
    begin = time.monotonic()
    killed_runs.start(bring_in_bit_by_bit, tmp_path / "whole", source).join()
    whole = time.monotonic() - begin
    for _ in range(6):
        process = killed_runs.start(bring_in_bit_by_bit, store, source)
        time.sleep(moments.uniform(0, 1.0) * whole)
        process.kill()
        process.join()
        if versions(store):
            # a killed run leaves unfinished files, which are no fault
            assert not any(finding.fault for finding in verify(open_store(store, at="newest")))
    last = killed_runs.start(bring_in_bit_by_bit, store, source)
    last.join()
    assert last.exitcode == 0
    done, expected = open_store(store), open_store(tmp_path / "whole")
    assert done.takes()["name"].to_list() == sorted(Path(name).stem for name in takes)
    assert done.takes()["frames"].to_list() == expected.takes()["frames"].to_list()
    names = dict(done.takes().select("take_id", "name").rows())
    for take_id, name in names.items():
        other = expected.takes(f"name = '{name}'")["take_id"][0]
        np.testing.assert_array_equal(done.words([take_id]).words, expected.words([other]).words)
    assert verify(done) == []
