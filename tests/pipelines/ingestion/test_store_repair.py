"""Every kind of damage has a command as its remedy: once it has run, verify is clean, and the content is as before."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from kinedex.commands.cli import app
from kinedex.ops.errors import KinedexError, Remedy
from kinedex.storage.repair.quarantine import quarantines
from kinedex.storage.snapshot.manifest import Manifest
from kinedex.storage.snapshot.manifest_files import manifest_path, versions
from kinedex.storage.snapshot.parts import publish_part
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.pipelines.archives import write_archive

PIPELINE = """name: study
stages:
  ingest: {params: {source: "SOURCE", patterns: ['x_(?P<actor>[a-z]+)_(?P<class>[a-z]+)_']}}
  index: {}
  learn_templates: {}
  annotate: {params: {tau: 0.5}}
  evaluate: {params: {ground_truth: none}}
  report: {}
"""
TAKES = {"x_aa_wave_1.amc": 80, "x_bb_wave_2.amc": 100, "x_aa_bow_1.amc": 72, "long/x_cc.amc": 240}


def kinedex(*words: str | Path, code: int = 0) -> str:
    done = CliRunner().invoke(app, [*map(str, words)], prog_name="kinedex", catch_exceptions=False)
    assert done.exit_code == code, done.output
    return done.stdout


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A source and a store with all kinds of files, made once."""
    root = tmp_path_factory.mktemp("repair")
    write_archive(root / "source", TAKES)
    (root / "study.yaml").write_text(PIPELINE.replace("SOURCE", str(root / "source")))
    kinedex("run", root / "study.yaml", "--store", root / "store", "--executor", "serial")
    with open_store(root / "store") as store, StoreWriter.open(store.path, store.feature_set) as writer:
        hit = {"run": "r", "saved_as": "mine", "query": "q", "take_id": 1, "take": "x_cc", "start": 0, "stop": 9}
        hits = pa.Table.from_pylist([hit], schema=result_schema("hits"))
        writer.put_results("hits", hits, stage="search/mine", run="r")
        for start in (0, 8):
            writer.put_labels(labels(start))
            writer.commit()
    return root


def labels(start: int) -> pa.Table:
    rows = [{"id": f"{start + n}", "take": "x_cc", "class": "wave", "start": n, "stop": n + 5, "origin": "drawn"}
            for n in range(8)]  # fmt: skip
    return pa.Table.from_pylist(rows)


@pytest.fixture
def store(archive: Path, tmp_path: Path) -> Path:
    """A copy of the store that a test may damage."""
    return Path(shutil.copytree(archive / "store", tmp_path / "store"))


def content(path: Path) -> dict[str, Any]:
    """Everything that the newest version of a store answers, but for ids and times of runs."""
    with open_store(path) as store:
        rows = store.take_rows.to_pylist()
        found: dict[str, Any] = {"takes": rows, "labels": store.labels(history=True).to_pylist()}
        found |= {f"frames {row['name']}": store.frames(row["name"]).to_pylist() for row in rows}
        found |= {
            kind: store.result(kind).drop_columns(["run"]).to_pylist()
            for kind in store.manifest.results
            if kind != "hits"
        }
        found["runs"] = store.sql("SELECT * FROM word_runs ORDER BY ALL").to_pylist()
    return found


@pytest.fixture(scope="module")
def before(archive: Path) -> dict[str, Any]:
    """The content of the store before anything was damaged."""
    return content(archive / "store")


def damaged(path: Path, how: str) -> None:
    data = bytearray(path.read_bytes())
    if how == "gone":
        path.unlink()
    elif how == "other schema":
        pq.write_table(pa.table({"other": [1]}), path)
    else:
        middle = len(data) // 2
        if how == "flip":
            data[middle] ^= 16
        elif how == "zeros":
            data[middle - 8 : middle + 8] = bytes(16)
        elif how == "short":
            del data[middle:]
        path.write_bytes(data)


def remedy_of(store: Path, read: Callable[[Path], object] | None = None) -> Remedy:
    """Return the remedy of the damage: that of the error of a reading, or that of a finding of verify."""
    fault = None
    try:
        with open_store(store, at="newest") as opened:
            findings = [one for one in verify(opened) if one.fault]
    except KinedexError as found:
        fault = found
    if fault is not None:
        assert fault.remedy is not None, fault
        assert str(fault).endswith(fault.remedy.text)
        return fault.remedy
    assert findings
    if read is not None:
        with pytest.raises(KinedexError) as raised:
            read(store)
        assert raised.value.remedy is not None, raised.value
        assert raised.value.remedy.command == findings[0].remedy.command
    assert {one.remedy.command for one in findings} == {findings[0].remedy.command}
    return findings[0].remedy


def carry_out(remedy: Remedy) -> str:
    program, *words = remedy.command
    assert program == "kinedex"
    return kinedex(*words, "--executor", "serial")


def faults(store: Path) -> list[str]:
    with open_store(store, at="newest") as opened:
        return [str(one) for one in verify(opened) if one.fault]


def part_of(store: Path, kind: str) -> Path:
    manifest = open_store(store).manifest
    parts = {"frames": manifest.frames, "takes": manifest.takes, "labels": manifest.labels} | manifest.results
    return store / parts[kind][-1].path  # type: ignore[index]


KINDS = {
    "frames": lambda path: open_store(path).frames("x_cc"),
    "takes": lambda path: open_store(path).takes(),
    "templates": lambda path: open_store(path).result("templates"),
    "annotations": lambda path: open_store(path).result("annotations"),
    "annotated_takes": lambda path: open_store(path).result("annotated_takes"),
    "distance_curves": lambda path: open_store(path).result("distance_curves"),
    "skeleton_files": lambda path: open_store(path).result("skeleton_files"),
}


@pytest.mark.parametrize(
    ("kind", "how"),
    [(kind, how) for kind in ("frames", "takes") for how in ("flip", "zeros", "short", "gone", "other schema")],
)
def test_takes_come_back_from_their_sources_and_the_index(
    store: Path, before: dict[str, Any], kind: str, how: str
) -> None:
    version = versions(store)[-1]
    damaged(part_of(store, kind), how)
    carry_out(remedy_of(store, KINDS[kind]))
    assert faults(store) == []
    assert content(store) == before
    assert quarantines(store) == []
    assert versions(store)[-1] == version, "the part has its content back: nothing else changes"


@pytest.mark.parametrize(
    ("kind", "how"),
    [("templates", "zeros"), ("annotations", "gone"), ("annotated_takes", "short"), ("distance_curves", "flip"),
     ("skeleton_files", "zeros")],
)  # fmt: skip
def test_results_come_back_by_a_run_of_their_pipeline(store: Path, before: dict[str, Any], kind: str, how: str) -> None:
    damaged(part_of(store, kind), how)
    carry_out(remedy_of(store, KINDS[kind]))
    assert faults(store) == []
    assert content(store) == before
    assert quarantines(store) == []


def test_a_changed_report_is_written_again(store: Path) -> None:
    (report,) = (store / "results" / "reports").rglob("*.html")
    damaged(report, "zeros")
    carry_out(remedy_of(store))
    assert faults(store) == []
    assert b"\0" not in report.read_bytes()


@pytest.mark.parametrize(
    ("file", "how"),
    [("index.duckdb", "flip"), ("index.duckdb", "gone"), ("generation.json", "short"), ("generation.json", "flip"),
     ("shard-000001.slices", "flip"), ("shard-000001.slices", "short")],
)  # fmt: skip
def test_a_damaged_index_is_built_again(store: Path, before: dict[str, Any], file: str, how: str) -> None:
    with open_store(store) as opened:
        damaged(opened.index_path().parent / file, how)
    carry_out(remedy_of(store))
    assert faults(store) == []
    assert content(store) == before


def test_a_missing_and_a_stale_index_are_built(store: Path, before: dict[str, Any]) -> None:
    for damage in (lambda: shutil.rmtree(store / "index"), lambda: drop(store, "x_aa_bow_1")):
        damage()
        with pytest.raises(KinedexError, match=r"the index is (missing|stale)") as raised:
            open_store(store, at="newest").index_path()
        assert raised.value.remedy is not None
        carry_out(raised.value.remedy)
        open_store(store, at="newest").index_path()
        if len(open_store(store).take_ids) == len(TAKES):
            assert content(store) == before


def drop(path: Path, take: str) -> None:
    with open_store(path) as store, StoreWriter.open(path, store.feature_set) as writer:
        writer.drop_takes([store.take_id(take)])
        writer.commit()


@pytest.mark.parametrize("how", ["flip", "short"])
def test_a_damaged_newest_manifest_gives_way_to_the_version_before(store: Path, how: str) -> None:
    newest = versions(store)[-1]
    with open_store(store) as opened:
        kept = opened.labels(history=True).to_pylist()[:8]
    damaged(manifest_path(store, newest), how)
    said = carry_out(remedy_of(store))
    assert f"version {newest} is lost" in said
    assert ("labels 8" in said) == (how == "flip"), "a manifest that was cut short does not state its changes"
    assert "1 part that only it names" in said
    assert open_store(store).manifest.version == newest - 1
    assert open_store(store).labels(history=True).to_pylist() == kept
    assert faults(store) == []
    (quarantine,) = quarantines(store)
    names = sorted(one.file.split("/")[0] for one in quarantine.files)
    assert names == ["labels", "manifest"]
    assert all((quarantine.folder / one.file).is_file() for one in quarantine.files)
    with open_store(store) as opened:
        assert [one.kind for one in verify(opened)] == ["quarantine"]


def test_a_damaged_older_manifest_lies_in_the_quarantine_afterwards(store: Path, before: dict[str, Any]) -> None:
    damaged(manifest_path(store, versions(store)[1]), "flip")
    carry_out(next(one for one in verify(open_store(store)) if one.kind == "manifest").remedy)
    assert content(store) == before
    assert [len(one.files) for one in quarantines(store)] == [1]
    damaged(manifest_path(store, versions(store)[0]), "short")
    carry_out(next(one for one in verify(open_store(store)) if one.kind == "manifest").remedy)
    assert content(store) == before


def test_a_flipped_bit_of_labels_and_saved_hits_is_put_back(store: Path, before: dict[str, Any]) -> None:
    for kind in ("labels", "hits"):
        sound = part_of(store, kind).read_bytes()
        damaged(part_of(store, kind), "flip")
        assert "one bit was flipped" in carry_out(remedy_of(store))
        assert part_of(store, kind).read_bytes() == sound
    assert content(store) == before
    assert quarantines(store) == []


def test_labels_come_back_from_older_versions_and_damaged_parts_are_kept(store: Path) -> None:
    file = part_of(store, "labels")
    damaged(file, "zeros")
    bad = file.read_bytes()
    said = carry_out(remedy_of(store))
    assert "restored 8 labels" in said
    assert "8 are lost" in said
    assert faults(store) == []
    assert [one["id"] for one in open_store(store).labels(history=True).to_pylist()] == [str(n) for n in range(8)]
    (quarantine,) = quarantines(store)
    assert [(one.held, (quarantine.folder / one.file).read_bytes()) for one in quarantine.files] == [("16 labels", bad)]


def test_saved_hits_that_nothing_makes_again_are_kept_aside(store: Path) -> None:
    file = part_of(store, "hits")
    damaged(file, "zeros")
    assert "results of search/mine are lost" in carry_out(remedy_of(store))
    assert faults(store) == []
    assert [one.stage for one in quarantines(store)[0].files] == ["search/mine"]


def test_a_take_whose_source_is_gone_or_changed_is_lost_with_its_reason(
    archive: Path, store: Path, before: dict[str, Any], tmp_path: Path
) -> None:
    moved = [archive / "source" / "x_aa_wave_1.amc", archive / "source" / "x_bb_wave_2.amc"]
    texts = [path.read_text() for path in moved]
    times = [path.stat().st_mtime_ns for path in moved]
    try:
        moved[0].unlink()
        moved[1].write_text(texts[1].replace("root 0 17", "root 0 18"))
        damaged(part_of(store, "frames"), "zeros")
        dry = json.loads(kinedex("repair", store, "--dry-run", "--json"))
        assert sorted(one["name"] for one in dry["lost_takes"]) == ["x_aa_wave_1", "x_bb_wave_2"]
        assert faults(store), "a dry run changes nothing"
        assert not (store / "quarantine").exists()
        done = json.loads(kinedex("repair", store, "--json", "--executor", "serial"))
    finally:
        for path, text, time in zip(moved, texts, times, strict=True):
            path.write_text(text)
            os.utime(path, ns=(time, time))
    assert sorted((one["name"], one["why"].split()[-1]) for one in done["lost_takes"]) == [
        ("x_aa_wave_1", "there"),
        ("x_bb_wave_2", "read"),
    ]
    assert faults(store) == []
    with open_store(store) as opened:
        assert sorted(opened.take_ids) == ["x_aa_bow_1", "x_cc"]
        for name in opened.take_ids:
            assert opened.frames(name).to_pylist() == before[f"frames {name}"]
    (quarantine,) = quarantines(store)
    assert [one.file.split("/")[0] for one in quarantine.files] == ["frames"]
    assert {one.name for one in quarantine.takes} == {"x_aa_wave_1", "x_bb_wave_2"}
    kinedex("ingest", store, archive / "source", "--executor", "serial")
    assert sorted(open_store(store).take_ids) == sorted(Path(one).stem for one in TAKES)
    kinedex("gc", store)
    assert quarantines(store) != [], "garbage collection leaves the quarantine alone"


def test_ingest_reads_takes_of_a_damaged_part_again(archive: Path, store: Path, before: dict[str, Any]) -> None:
    damaged(part_of(store, "frames"), "zeros")
    said = kinedex("run", archive / "study.yaml", "--store", store, "--executor", "serial")
    assert "4 takes in damaged parts of the store: 4 to read again" in said
    assert faults(store) == []
    after = content(store)
    assert {name: after[name] for name in after if name.startswith("frames")} == {
        name: before[name] for name in before if name.startswith("frames")
    }


@pytest.mark.parametrize("step", ["_frames", "_results", "_runs"])
def test_a_repair_that_was_killed_goes_on(
    store: Path, before: dict[str, Any], step: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for kind in ("frames", "takes", "annotations"):
        damaged(part_of(store, kind), "zeros")
    remedy = remedy_of(store)

    class Killed(BaseException):
        pass

    def killed(*_: object) -> None:
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(f"kinedex.pipelines.ingestion.store_repair._Work.{step}", killed)
        with pytest.raises(Killed):
            carry_out(remedy)
    open_store(store)
    carry_out(remedy)
    assert faults(store) == []
    assert content(store) == before


def test_content_that_does_not_fit_though_its_checksums_do_is_made_again(store: Path, before: dict[str, Any]) -> None:
    with open_store(store) as opened:
        old = opened.manifest.frames[0]
        table = pq.read_table(store / old.path)
        temporary = store / "frames" / ".tmp-test.parquet"
        pq.write_table(table.slice(0, table.num_rows - 1), temporary)
        part = publish_part(store, temporary, "frames", table.num_rows - 1, old.take_ids)
        rewrite(opened, frames=(part,))
    carry_out(remedy_of(store))
    assert faults(store) == []
    after = content(store)
    assert {name: after[name] for name in after if name != "runs"} == {
        name: before[name] for name in before if name != "runs"
    }


def rewrite(store: Store, **changes: Any) -> Manifest:
    from dataclasses import replace

    from kinedex.storage.snapshot.manifest_files import publish

    manifest = replace(store.manifest, version=store.manifest.version + 1, **changes)
    publish(store.path, manifest)
    return manifest


def test_a_sound_store_stays_as_it_is(store: Path) -> None:
    files = {path: path.stat().st_mtime_ns for path in store.rglob("*") if path.is_file() and path.name != "lock"}
    assert "nothing is damaged" in kinedex("repair", store, "--executor", "serial")
    assert {
        path: path.stat().st_mtime_ns for path in store.rglob("*") if path.is_file() and path.name != "lock"
    } == files
