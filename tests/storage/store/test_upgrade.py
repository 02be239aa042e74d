"""Upgrade: a store that kinedex wrote in format 3 is read, and becomes one of format 4 with the same answers.

`format-3.tar.xz` is a store of three synthetic clips, made by the kinedex of commit 51b0a6f with the pipeline `old`
(ingest with named groups, index, learn_templates, annotate), of which one clip was replaced. Its index is left out.
"""

from __future__ import annotations

import json
import os
import tarfile
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pytest
import xxhash
import yaml

from kinedex.ops.errors import StoreError
from kinedex.storage.disk import sync_file
from kinedex.storage.index.builder import build_index
from kinedex.storage.index.generations import current_generation
from kinedex.storage.snapshot.manifest_files import read_newest, versions
from kinedex.storage.snapshot.schemas import RESULT_KINDS
from kinedex.storage.store import upgrade as upgrading
from kinedex.storage.store.garbage_collection import collect
from kinedex.storage.store.store import open_store
from kinedex.storage.store.upgrade import PROGRESS, upgrade
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, add, make_store
from tests.storage.old_formats import as_format_3

ARCHIVE = Path(__file__).with_name("format-3.tar.xz")
JACK = "SYN_al_jumpingJack1Reps_001_120"


@pytest.fixture
def old(tmp_path: Path) -> Path:
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(tmp_path, filter="data")
    return tmp_path / "store"


def answers(path: Path) -> dict[str, list[dict[str, object]]]:
    """All that a store answers: rows of takes, of frames and of results."""
    with open_store(path, at="newest") as store:
        columns = [name for name in store.take_rows.column_names if name not in ("style", "rate")]
        found = {"takes": store.take_rows.select(columns).to_pylist()}
        found |= {f"frames of {take}": store.frames(take).to_pylist() for take in store.take_ids}
        found |= {kind: store.result(kind).to_pylist() for kind in RESULT_KINDS}
        found["by SQL"] = store.sql("SELECT take, class, start, stop, cost FROM annotations ORDER BY ALL").to_pylist()
        return found


def files(path: Path) -> dict[str, bytes]:
    return {str(file.relative_to(path)): file.read_bytes() for file in path.rglob("*") if file.is_file()}


def test_format_3_is_read_and_left_as_it_is(old: Path) -> None:
    before = files(old)
    store = open_store(old, at="newest")
    assert store.manifest.format_version == 3
    assert store.takes(where="class IS NULL")["name"].to_list() == [JACK]
    assert store.sql("SELECT count(*) AS n FROM frames").to_pylist() == [{"n": 75}]
    assert store.sql("SELECT count(known) AS n FROM takes").to_pylist() == [{"n": 0}]
    assert store.result("templates").num_rows == 4
    assert store.labels().num_rows == 0
    assert [str(one) for one in verify(store) if one.fault] == []
    with pytest.raises(StoreError, match="format 3, which is only read") as refused:
        StoreWriter.open(old, BODY)
    assert refused.value.remedy is not None
    assert refused.value.remedy.command == ("kinedex", "upgrade", str(old))
    assert {name for name in files(old).keys() - before.keys() if "lease" not in name} <= {"lock"}
    assert all(before[name] == content for name, content in files(old).items() if name in before)


def test_an_upgrade_keeps_every_answer(old: Path) -> None:
    before, content = answers(old), read_newest(old).content_digest()
    done = upgrade(old)
    assert (done.before, done.version, done.parts, done.takes_parts) == (3, 22, 9, 2)
    assert set(done.columns) == {"style", "rate"}
    manifest = read_newest(old)
    assert (manifest.format_version, manifest.version) == (4, 22)
    assert answers(old) == before
    assert manifest.content_digest() == content
    assert verify(open_store(old, at="newest")) == []
    for part in manifest.parts:
        assert part.xxh3 == xxhash.xxh3_128((old / part.path).read_bytes()).hexdigest()
    assert upgrade(old) == replace(done, before=4, parts=0, bytes=0, takes_parts=0, columns=())


def test_named_groups_become_columns(old: Path) -> None:
    upgrade(old)
    store = open_store(old, at="newest")
    assert store.sql("SELECT name FROM takes WHERE style = 'jumpingJack1Reps'").to_pylist() == [{"name": JACK}]
    assert store.takes(where="rate = '120'").height == 2
    assert store.takes()["style"].to_list() == ["jumpingJack1Reps", None, None]


def test_records_of_stages_make_sources_and_pipelines(old: Path) -> None:
    before = read_newest(old)
    upgrade(old)
    manifest = read_newest(old)
    assert manifest.stages == before.stages
    assert manifest.sources["/archive"].stage == "old/ingest"
    assert (
        manifest.sources["/archive"].settings["patterns"] == before.stages["old/ingest"].summary["params"]["patterns"]
    )
    record = manifest.pipelines["old"]
    assert record.sources == ("/archive",)
    stages = yaml.safe_load(record.yaml)["stages"]
    assert list(stages) == ["ingest", "index", "learn_templates", "annotate"]
    assert stages["annotate"]["params"]["tau"] == 0.3
    assert manifest.changes["upgraded_from"] == 3


def test_the_old_version_stays_until_it_is_collected(old: Path) -> None:
    upgrade(old)
    assert versions(old) == [20, 21, 22]
    collect(old, keep=1)
    assert versions(old) == [22]
    assert verify(open_store(old, at="newest")) == []


def test_an_upgraded_store_is_written(old: Path) -> None:
    upgrade(old)
    with StoreWriter.open(old, BODY) as writer:
        add(writer, {"new": 12})
        writer.put_labels(pa.Table.from_pylist(
            [{"take": JACK, "class": "jack", "start": 2, "stop": 9, "origin": "drawn"}]
        ))  # fmt: skip
        writer.commit()
    store = open_store(old, at="newest")
    assert store.takes()["style"].to_list() == ["jumpingJack1Reps", None, None, None]
    assert store.labels().num_rows == 1
    assert verify(store) == []


def test_the_index_stays_valid(tmp_path: Path) -> None:
    path = make_store(tmp_path / "store", {"bd_walk": 50, "mm_run": 40})
    build_index(open_store(path, at="newest"))
    as_format_3(path)
    generation = current_generation(path, read_newest(path))
    assert generation is not None
    upgrade(path)
    assert current_generation(path, read_newest(path)) == generation
    rows = open_store(path, at="newest").sql("SELECT name, session FROM takes ORDER BY name").to_pylist()
    assert rows == [{"name": "bd_walk", "session": "1"}, {"name": "mm_run", "session": "1"}]


def test_an_index_of_an_older_kinedex_is_built_again(old: Path) -> None:
    (old / "index" / "gen-000021").mkdir(parents=True)
    (old / "index" / "gen-000021" / "generation.json").write_text('{"index_version": 4}')
    with pytest.raises(StoreError, match="of an older kinedex") as missing:
        open_store(old).index_path()
    assert missing.value.remedy is not None
    assert missing.value.remedy.command == ("kinedex", "upgrade", str(old))
    (finding,) = verify(open_store(old))
    assert (finding.remedy, finding.fault) == (missing.value.remedy, False)
    assert upgrade(old).index_built
    assert verify(open_store(old, at="newest")) == []
    assert open_store(old).sql("SELECT count(*) > 0 AS found FROM word_runs").to_pylist() == [{"found": True}]


def test_a_dry_run_changes_nothing(old: Path) -> None:
    before = files(old)
    planned = upgrade(old, dry_run=True)
    assert files(old) == before
    assert (planned.before, planned.version, planned.takes_parts) == (3, 21, 2)


@pytest.mark.parametrize("folder", ["frames", "takes", "results/templates"])
@pytest.mark.parametrize("missing", [False, True])
def test_a_damaged_part_stops_the_upgrade(old: Path, folder: str, missing: bool) -> None:
    part = sorted((old / folder).glob("part-*"))[0]
    if missing:
        part.unlink()
    else:
        content = bytearray(part.read_bytes())
        content[len(content) // 2] ^= 1
        part.write_bytes(content)
    with pytest.raises(StoreError, match=f"1 of 9 parts are damaged or missing: {folder}/{part.name}") as stopped:
        upgrade(old)
    assert stopped.value.remedy is not None
    assert stopped.value.remedy.command == ("kinedex", "upgrade", str(old), "--keep-damaged")
    assert read_newest(old).format_version == 3
    done = upgrade(old, keep_damaged=True)
    assert done.damaged == (f"{folder}/{part.name}",)
    assert read_newest(old).format_version == 4
    assert any(finding.fault for finding in verify(open_store(old, at="newest")))


class _Killed(BaseException):
    """The end of the process, at a chosen moment."""


@pytest.mark.parametrize("moment", range(12))
def test_a_killed_upgrade_goes_on(old: Path, monkeypatch: pytest.MonkeyPatch, moment: int) -> None:
    before = answers(old)
    calls = 0
    with monkeypatch.context() as patched:

        def dies(function):
            def called(*arguments, **named):
                nonlocal calls
                calls += 1
                if calls > moment:
                    raise _Killed
                return function(*arguments, **named)

            return called

        for name in ("sync_file", "write_part", "publish"):
            patched.setattr(upgrading, name, dies(getattr(upgrading, name)))
        with pytest.raises((_Killed, BaseExceptionGroup)):
            upgrade(old)
    assert read_newest(old).format_version == 3
    assert answers(old) == before
    known = upgrading._known_sums(old)
    upgrade(old)
    assert len(known) <= 9
    assert answers(old) == before
    assert not (old / "manifest" / PROGRESS).exists()
    assert verify(open_store(old, at="newest")) == []


def test_sums_of_a_killed_upgrade_are_reused(old: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise StoreError("no space")

    with monkeypatch.context() as patched:
        patched.setattr(upgrading, "publish", full)
        with pytest.raises(StoreError, match="no space"):
            upgrade(old)
    written = old / "manifest" / PROGRESS
    lines = [json.loads(line) for line in written.read_text().splitlines() if line]
    assert len(lines) == 9
    changed = old / lines[0]["path"]
    os.utime(changed, ns=(1, 1))
    written.write_text(written.read_text() + '{"path": "torn')
    computed = []
    monkeypatch.setattr(upgrading, "sync_file", lambda path: computed.append(path) or sync_file(path))
    upgrade(old)
    assert computed == [changed]
