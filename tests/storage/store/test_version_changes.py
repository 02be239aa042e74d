"""The manifest of a version records its changes and its command, and all versions are listed."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pytest

from kinedex.ops.errors import StoreError
from kinedex.storage.index.builder import build_index
from kinedex.storage.snapshot import manifest
from kinedex.storage.snapshot.manifest import LONGEST, PipelineRecord, StageRecord, kinedex_version, running_command
from kinedex.storage.snapshot.manifest_files import manifest_path, read_newest, read_version, versions
from kinedex.storage.snapshot.schemas import FORMAT_VERSION, TakeColumn
from kinedex.storage.store.compaction import compact
from kinedex.storage.store.store import open_store
from kinedex.storage.store.version_changes import described, list_versions, versions_table
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, add, make_store
from tests.storage.stores import unpacked


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return make_store(tmp_path / "store", {"bd_walk": 50, "mm_run": 40})


def test_changes_of_each_version_are_recorded(path: Path) -> None:
    with StoreWriter.open(path, BODY) as writer:
        ids = add(writer, {"bd_walk": 20, "tr_new": 10}, edition=1)
        writer.commit()
        writer.drop_takes([ids["tr_new"]])
        writer.declare_columns({"style": TakeColumn("VARCHAR", "pattern")})
        writer.commit()
        writer.record_stage(StageRecord("p/s", "f", "r", "t", 1.0))
        writer.put_results("hits", pa.table({}), stage="p/s", run="r")
        writer.commit()
        writer.forget_stage("p/s")
        writer.commit()
        for number in range(8):
            add(writer, {f"x{number}": 5})
            writer.commit()
        compact(writer)
        assert writer.commit().version == writer.manifest.version
    changes = {number: read_version(path, number).changes for number in versions(path)}
    assert changes[1] == {}
    assert changes[2] == {"takes_added": 2}
    assert changes[3] == {"takes_added": 1, "takes_replaced": 1}
    assert changes[4] == {"takes_dropped": 1, "columns": ["style"]}
    assert changes[5] == {"stages_done": ["p/s"]}
    assert changes[6] == {"stages_begun": ["p/s"]}
    assert changes[15]["parts_compacted"] > 8
    assert described(changes[3]) == "1 take added, 1 take replaced"
    assert described({"takes_added": 3000, "labels": 1, "stages_done": ["a/b"], "mended": 2}) == (
        "3,000 takes added, 1 label, a/b done, mended: 2"
    )
    for number in versions(path):
        manifest = read_version(path, number)
        assert (manifest.kinedex, manifest.command) == (kinedex_version(), running_command())


def test_all_versions_are_listed_also_damaged_ones(path: Path) -> None:
    build_index(open_store(path, at="newest"))
    with StoreWriter.open(path, BODY) as writer:
        add(writer, {"tr_new": 10})
        writer.commit()
    manifest_path(path, 1).write_text("{")
    found = list_versions(path)
    assert [one.version for one in found] == [1, 2, 3]
    assert "not valid JSON" in found[0].problem
    assert [(one.takes, one.index, one.format, one.command) for one in found[1:]] == [
        (2, True, FORMAT_VERSION, running_command()),
        (3, False, FORMAT_VERSION, running_command()),
    ]
    assert versions_table(found).column("index").to_pylist() == [None, "yes", "no"]
    with pytest.raises(StoreError, match="does not exist"):
        list_versions(path / "none")


def test_versions_of_an_older_format_are_listed(tmp_path: Path) -> None:
    newest = list_versions(unpacked(3, tmp_path))[-1]
    assert (newest.version, newest.takes, newest.index, newest.format, newest.command) == (21, 3, False, 3, "")


def test_settings_of_sources_and_pipelines_are_kept(path: Path) -> None:
    record = PipelineRecord("name: p\n", "/p.yaml", {"a": 1}, ("/archive",), "kinedex run", "0.1", "r1", "t")
    with StoreWriter.open(path, BODY) as writer:
        writer.record_source("/archive", "p/ingest", {"patterns": ["(?P<class>x)"]})
        writer.record_pipeline("p", record)
        writer.commit()
        version = writer.manifest.version
        writer.record_source("/archive", "p/ingest", {"patterns": ["(?P<class>x)"]})
        assert writer.commit().version == version
    manifest = read_newest(path)
    assert manifest.sources["/archive"].settings == {"patterns": ["(?P<class>x)"]}
    assert manifest.pipelines == {"p": record}


@pytest.mark.parametrize(
    ("argv", "command"),
    [
        (["/usr/bin/kinedex", "ingest", "my store", "d"], "kinedex ingest 'my store' d"),
        (["/x/kinedex/__main__.py", "gc", "s"], "kinedex gc s"),
        ([""], "python"),
        (["-c", "1"], "python -c 1"),
        ([], "python"),
    ],
)
def test_the_command_is_recorded_as_it_is_typed(monkeypatch: pytest.MonkeyPatch, argv: list[str], command: str) -> None:
    monkeypatch.setattr(manifest.sys, "argv", argv)
    assert running_command() == command
    monkeypatch.setattr(manifest.sys, "argv", ["kinedex", "x" * 5000])
    assert len(running_command()) == LONGEST
