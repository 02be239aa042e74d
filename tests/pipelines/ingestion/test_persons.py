"""Files of several persons: a take for each, named after file and person, of which one may be refused."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import kinedex
from kinedex.catalog import plugins
from kinedex.catalog.skeletons.mappings import Mappings, load_skeleton
from kinedex.console.terminal import Terminal
from kinedex.ops.errors import KinedexError, SourceError
from kinedex.pipelines.ingestion import read_passes
from kinedex.pipelines.ingestion.store_repair import repair_store
from kinedex.pipelines.inspection.mapping_proposal import propose_mapping
from kinedex.pipelines.inspection.motion_file import inspect_file
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.formats.motion import reader_table
from kinedex.storage.formats.motion.reader import Body, MotionFile, Reader, ReadSettings
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from tests.bvh_files import write_duet
from tests.pipelines.archives import context

READ: list[tuple[str, str]] = []
"""The files and persons that were read, in order."""


class CrowdReader(Reader):
    """Reads .crowd files, JSON objects: person → number of frames; one with a negative number is refused."""

    format = "positions"
    endings = (".crowd",)
    reads_whole = True

    def persons(self, file: MotionFile, mappings: Mappings) -> tuple[str, ...]:
        return tuple(json.loads(file.data or file.path.read_bytes()))

    def read(self, file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings) -> Body:
        READ.append((file.path.stem, file.person))
        crowd = json.loads(file.data or file.path.read_bytes())
        frames = crowd[file.person] if file.person else next(iter(crowd.values()))
        if frames < 0:
            raise SourceError(file.path, "has no frames", line=1)
        heights = np.arange(len(joints))[:, None, None] + np.zeros((len(joints), 3, frames))
        upright = np.repeat([[1.0], [0.0], [0.0], [0.0]], frames, axis=1)
        return Body(heights, upright, 30.0, "1 m", "crowd", (), ())


@pytest.fixture(autouse=True)
def plugin(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    class Distribution:
        name, version = "crowd-files", "1.0"

    class Point(EntryPoint):
        dist = Distribution()

    points = {"crowd": Point("crowd", f"{__name__}:CrowdReader", "kinedex.readers")}
    monkeypatch.setattr(plugins, "_installed", lambda group, path: points if group == "kinedex.readers" else {})
    reader_table._readers_by_ending.cache_clear()
    READ.clear()
    yield
    reader_table._readers_by_ending.cache_clear()


def write(path: Path, **crowd: int) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(crowd))
    return path


def bring_in(store: Path, source: Path, **params: object) -> tuple[dict[str, object], str]:
    output = io.StringIO()
    place = replace(context(store), terminal=Terminal(Console(file=output, width=400)))
    summary = Ingest().run(place, Ingest.parameters(source=str(source), **params))  # type: ignore[arg-type]
    return summary, output.getvalue()


def takes(store: Path) -> dict[str, tuple[str | None, int | None, int]]:
    rows = open_store(store).take_rows.to_pylist()
    return {row["name"]: (row.get("person"), row.get("persons"), row["frames"]) for row in rows}


@pytest.fixture
def source(tmp_path: Path) -> Path:
    write(tmp_path / "source/pair.crowd", bob=5, eve=7)
    write(tmp_path / "source/one.crowd", al=4)
    return tmp_path / "source"


@pytest.fixture
def store(tmp_path: Path) -> Path:
    return tmp_path / "store"


def test_each_person_of_a_file_becomes_a_take(source: Path, store: Path) -> None:
    summary, output = bring_in(store, source)
    assert takes(store) == {"one": (None, None, 4), "pair-bob": ("bob", 2, 5), "pair-eve": ("eve", 2, 7)}
    assert (summary["takes"], summary["read"], summary["left_out"]) == (3, 2, 0)
    assert "1 file of several persons, 2 in all: a take each, such as 'pair-bob' of pair.crowd" in output
    with open_store(store) as opened:
        assert opened.manifest.columns["person"].origin == "file"
        query = "SELECT name FROM takes WHERE persons = 2 AND person = 'eve'"
        assert opened.sql(query).to_pylist() == [{"name": "pair-eve"}]
    READ.clear()
    again, _ = bring_in(store, source)
    assert (again["read"], again["unchanged"], READ) == (0, 2, [])
    assert verify(open_store(store, at="newest")) == []


def test_a_person_that_is_refused_costs_no_other_and_is_tried_again(source: Path, store: Path) -> None:
    write(source / "pair.crowd", bob=5, eve=-1, kim=6)
    summary, output = bring_in(store, source)
    assert set(takes(store)) == {"one", "pair-bob", "pair-kim"}
    assert (summary["read"], summary["left_out"]) == (2, 1)
    (row,) = open_store(store).result("ingest_log").to_pylist()
    assert row["message"] == f"{source}/pair.crowd:1: person 'eve': has no frames"
    assert row["message"] in output
    assert bring_in(store, source)[0]["left_out"] == 1
    before = open_store(store).take_ids
    write(source / "pair.crowd", bob=5, eve=3, kim=6)
    assert bring_in(store, source)[0]["left_out"] == 0
    assert takes(store)["pair-eve"] == ("eve", 3, 3)
    assert before.items() <= open_store(store).take_ids.items()


def test_persons_who_left_a_file_stay_until_pruned(source: Path, store: Path) -> None:
    bring_in(store, source)
    write(source / "pair.crowd", bob=9, kim=6)
    write(source / "one.crowd", al=4, cy=4)
    for _ in range(2):
        summary, output = bring_in(store, source)
        assert set(takes(store)) == {"one", "one-al", "one-cy", "pair-bob", "pair-eve", "pair-kim"}
        assert "2 takes of persons whom their files do not hold any more: kept" in output
        assert summary["dropped"] == 0
    assert takes(store)["pair-bob"] == ("bob", 2, 9)
    assert bring_in(store, source, prune=True)[0]["dropped"] == 2
    assert set(takes(store)) == {"one-al", "one-cy", "pair-bob", "pair-kim"}
    write(source / "one.crowd", al=8)
    assert bring_in(store, source, prune=True)[0]["dropped"] == 2
    assert takes(store)["one"] == (None, None, 8)
    (source / "pair.crowd").unlink()
    assert bring_in(store, source, prune=True)[0]["dropped"] == 2
    assert set(takes(store)) == {"one"}


def test_a_file_that_moves_or_is_touched_takes_its_persons_along(source: Path, store: Path) -> None:
    bring_in(store, source)
    before = open_store(store).take_ids
    (source / "sub").mkdir()
    (source / "pair.crowd").rename(source / "sub/pair.crowd")
    os.utime(source / "one.crowd", ns=(1, 1))
    READ.clear()
    assert bring_in(store, source)[0]["unchanged"] == 2
    assert READ == []
    assert open_store(store).take_ids == before
    source.rename(source.with_name("moved"))
    assert bring_in(store, source.with_name("moved"))[0]["unchanged"] == 2
    rows = open_store(store).take_rows.to_pylist()
    assert {(row["source_root"], row["source"]) for row in rows} == {
        (str(source.with_name("moved")), path) for path in ("one.crowd", "sub/pair.crowd")
    }


def test_no_two_takes_have_one_name(source: Path, store: Path) -> None:
    write(source / "pair-bob.crowd", al=3)
    write(source / "sub/pair.crowd", bob=8, eve=8)
    bring_in(store, source)
    names = {"one", "pair-bob", "pair.crowd-bob", "pair-eve", "sub/pair-bob", "sub/pair-eve"}
    assert set(takes(store)) == names
    assert takes(store)["pair-bob"][2] == 3
    assert bring_in(store, source)[0]["unchanged"] == 4
    write(source / "pair-eve.crowd", al=2)
    bring_in(store, source)
    assert set(takes(store)) == {*names, "pair-eve.crowd"}


def test_an_ingest_that_was_stopped_between_two_persons_reads_the_file_again(
    source: Path, store: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(read_passes, "MEGABYTE", 1)
    really = CrowdReader.read

    def read(self: CrowdReader, file: MotionFile, *rest: object) -> Body:
        if file.person == "eve":
            raise KeyboardInterrupt
        return really(self, file, *rest)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr(CrowdReader, "read", read)
        with pytest.raises(KeyboardInterrupt):
            bring_in(store, source)
    assert set(takes(store)) == {"one", "pair-bob"}
    assert bring_in(store, source)[0]["read"] == 1
    assert set(takes(store)) == {"one", "pair-bob", "pair-eve"}


def test_strict_stops_at_a_person(source: Path, store: Path) -> None:
    write(source / "pair.crowd", bob=-1, eve=4)
    with pytest.raises(KinedexError, match="person 'bob': has no frames"):
        bring_in(store, source, strict=True)
    assert set(takes(store)) == {"one"}


def test_persons_that_cannot_be_distinguished_are_refused(source: Path, store: Path) -> None:
    (source / "pair.crowd").write_text('{"bob": 5, " ": 5}')
    assert bring_in(store, source)[0]["left_out"] == 1
    (row,) = open_store(store).result("ingest_log").to_pylist()
    assert "holds 2 persons that their names do not distinguish" in row["message"]


def test_a_group_of_the_patterns_named_person_stays_what_it_is(source: Path, store: Path) -> None:
    summary, _ = bring_in(store, source, patterns=["(?P<person>[a-z]+)[.]crowd"])
    assert summary["left_out"] == 1
    assert takes(store) == {"one": ("one", None, 4)}
    (row,) = open_store(store).result("ingest_log").to_pylist()
    assert "named groups of `patterns`; give the groups other names" in row["message"]
    bring_in(store, source, prune=True)
    bring_in(store.with_name("other"), source)
    with pytest.raises(KinedexError, match="the named group 'person' of `patterns` has the name of a column"):
        bring_in(store.with_name("other"), source, patterns=["(?P<person>[a-z]+)[.]crowd"])


def test_repair_reads_the_person_of_a_take_again(source: Path, store: Path) -> None:
    bring_in(store, source)
    before = takes(store)
    (part,) = open_store(store).manifest.frames[-1:]
    content = bytearray((store / part.path).read_bytes())
    content[len(content) // 2 : len(content) // 2 + 9] = b"otherwise"
    (store / part.path).write_bytes(content)
    READ.clear()
    outcome = repair_store(store, Terminal(Console(file=io.StringIO())))
    assert outcome.remaining == []
    assert ("pair", "eve") in READ
    assert takes(store) == before
    assert verify(open_store(store, at="newest")) == []


def test_inspect_lists_all_persons_and_describes_one(source: Path) -> None:
    write(source / "pair.crowd", bob=50, eve=-1, kim=6)
    found = inspect_file(source / "pair.crowd")
    lines = [text for _, text in found.lines]
    assert "3: bob, eve, kim; each becomes a take" in lines
    assert "eve cannot be read: has no frames" in lines
    assert any(line.startswith("kim: mapping crowd, 0.20 s") for line in lines)
    assert ("person", "bob") in found.lines
    assert "50 frames, 1.67 s" in lines
    assert "6 frames, 0.20 s" in [text for _, text in inspect_file(source / "pair.crowd", person="kim").lines]
    fault = inspect_file(source / "pair.crowd", person="eva").fault
    assert "holds no person 'eva'; did you mean 'eve'? (it holds 'bob', 'eve', 'kim')" in str(fault)


def test_read_asks_for_a_person(source: Path) -> None:
    take = kinedex.read(source / "pair.crowd", person="eve")
    assert (take.name, len(take)) == ("pair-eve", 7)
    assert kinedex.read(source / "one.crowd").name == "one"
    with pytest.raises(SourceError, match="holds 2 persons, 'bob', 'eve'; give one of them as the person"):
        kinedex.read(source / "pair.crowd")
    with pytest.raises(SourceError, match="holds one person, who has no name"):
        kinedex.read(source / "one.crowd", person="al")


def test_a_bvh_file_of_two_roots_is_two_takes(tmp_path: Path) -> None:
    (tmp_path / "source").mkdir()
    path = write_duet(tmp_path / "source/duet.bvh", 20)
    bring_in(tmp_path / "store", tmp_path / "source")
    found = takes(tmp_path / "store")
    assert {name: found[name][:2] for name in found} == {"duet-Ann": ("Ann", 2), "duet-Ben": ("Ben", 2)}
    store = open_store(tmp_path / "store", at="newest")
    words = [store.words([take]).words for take in store.take_ids.values()]
    np.testing.assert_array_equal(words[0], words[1])
    np.testing.assert_array_equal(kinedex.read(path, person="Ben").words(), words[0])
    text = propose_mapping(path, "ben", "Ben")
    (tmp_path / "ben.yaml").write_text(text)
    assert load_skeleton(tmp_path / "ben.yaml", store.feature_set.joints).name == "ben"
