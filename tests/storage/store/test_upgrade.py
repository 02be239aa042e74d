"""Upgrade: a store of each older format is read, and becomes one of the present format with the same answers.

The stores are real ones: see `tests/storage/stores/README.md`.
"""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pytest
import xxhash
import yaml

from kinedex.ops.errors import StoreError
from kinedex.storage.durable_files import sync_file
from kinedex.storage.index.builder import build_index
from kinedex.storage.index.generations import current_generation
from kinedex.storage.snapshot.manifest import Manifest
from kinedex.storage.snapshot.manifest_files import read_newest, versions
from kinedex.storage.snapshot.schemas import FORMAT_VERSION, RESULT_KINDS
from kinedex.storage.store import upgrade as upgrading
from kinedex.storage.store.garbage_collection import collect_garbage
from kinedex.storage.store.store import open_store
from kinedex.storage.store.upgrade import PROGRESS, upgrade
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, add
from tests.storage.stores import unpacked

FORMATS = (3, 4)
"""The formats of all stores that open or upgrade."""

JACK = "SYN_al_jumpingJack1Reps_001_120"


class _Killed(BaseException):
    """The end of the process, at a chosen moment."""


@pytest.fixture
def old(tmp_path: Path) -> Path:
    return unpacked(3, tmp_path)


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


@pytest.mark.parametrize("number", FORMATS)
def test_a_store_of_every_format_is_read_upgraded_and_written(tmp_path: Path, number: int) -> None:
    path = unpacked(number, tmp_path)
    assert read_newest(path).format_version == number
    before = answers(path)
    assert len(before["by SQL"]) == 1
    upgrade(path)
    assert read_newest(path).format_version == FORMAT_VERSION
    assert answers(path) == before
    assert open_store(path).sql("SELECT count(DISTINCT take_id) AS n FROM word_runs").to_pylist() == [{"n": 3}]
    with StoreWriter.open(path, open_store(path).feature_set) as writer:
        writer.drop_takes([min(writer.store.manifest.live_takes)])
        writer.commit()
    build_index(open_store(path, at="newest"))
    assert verify(open_store(path)) == []


def test_the_store_of_format_4_has_a_label(tmp_path: Path) -> None:
    (label,) = open_store(unpacked(4, tmp_path)).labels().to_pylist()
    assert (label["take"], label["class"], label["start"], label["stop"]) == (JACK, "jumpingJack1Reps", 2, 30)


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
    assert all(files(old)[name] == content for name, content in before.items() if name != "lock")


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
    again = replace(done, before=4, parts=0, bytes=0, takes_parts=0, columns=(), index_built=False)
    assert upgrade(old) == again


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
    ((folder, source),) = manifest.sources.items()
    assert folder == before.stages["old/ingest"].summary["params"]["source"]
    assert source.stage == "old/ingest"
    assert source.settings["patterns"] == before.stages["old/ingest"].summary["params"]["patterns"]
    record = manifest.pipelines["old"]
    assert record.sources == (folder,)
    stages = yaml.safe_load(record.yaml)["stages"]
    assert list(stages) == ["ingest", "index", "learn_templates", "annotate"]
    assert stages["annotate"]["params"]["tau"] == 0.3
    assert manifest.changes["upgraded_from"] == 3


def test_the_old_version_stays_until_it_is_collected(old: Path) -> None:
    upgrade(old)
    assert versions(old) == [*range(1, 23)]
    collect_garbage(old, keep=1)
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
    assert [str(one) for one in verify(store) if one.fault] == []


def test_an_index_of_an_older_kinedex_is_built_again(old: Path) -> None:
    with pytest.raises(StoreError, match="of an older kinedex") as missing:
        open_store(old).index_path()
    assert missing.value.remedy is not None
    assert missing.value.remedy.command == ("kinedex", "upgrade", str(old))
    (finding,) = verify(open_store(old))
    assert (finding.remedy, finding.fault) == (missing.value.remedy, False)
    assert upgrade(old).index_built
    assert verify(open_store(old, at="newest")) == []
    assert open_store(old).sql("SELECT count(*) > 0 AS found FROM word_runs").to_pylist() == [{"found": True}]


def test_the_new_version_has_its_index_from_the_first_moment(old: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def dies(path: Path, made: Manifest) -> None:
        assert current_generation(path, made) is not None
        raise _Killed

    before = answers(old)
    with monkeypatch.context() as patched:
        patched.setattr(upgrading, "publish", dies)
        with pytest.raises(_Killed):
            upgrade(old)
    assert read_newest(old).format_version == 3
    assert answers(old) == before
    assert [str(one) for one in verify(open_store(old)) if one.fault] == []
    assert not upgrade(old).index_built
    assert verify(open_store(old)) == []


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
