"""Named groups of patterns are columns of takes, and the store remembers how a source was ingested."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.storage.snapshot.manifest_files import read_newest
from kinedex.storage.store.store import open_store
from kinedex.storage.store.version_changes import list_versions
from tests.pipelines.archives import write_archive

PATTERNS = [r"(?P<style>[^/]+)/x_(?P<actor>[^/_]+)_(?P<class>[^/_]+)_(?P<frames>\d+)", r"(?P<place>[^/]+)/"]
FILES = ("angry/x_al_walk_1.amc", "sad/x_al_walk_2.amc", "yard/x_free.amc")


def ingest(store: Path, source: Path, patterns: list[str], accept: bool = False) -> None:
    run_pipeline("ingest", store, settings={"source": source, "ingest.patterns": patterns}, accept=accept)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_archive(tmp_path_factory.mktemp("archive"), dict.fromkeys(FILES, 40))


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, source: Path) -> Path:
    path = tmp_path_factory.mktemp("groups") / "store"
    ingest(path, source, PATTERNS)
    return path


def test_named_groups_are_columns_of_takes(store: Path) -> None:
    with open_store(store) as opened:
        takes = opened.takes()
        assert takes.select("name", "class", "style", "place").rows() == [
            ("x_al_walk_1", "walk", "angry", None),
            ("x_al_walk_2", "walk", "sad", None),
            ("x_free", None, None, "yard"),
        ]
        found = opened.sql("SELECT name FROM takes WHERE style = 'angry'").to_pylist()
        assert found == [{"name": "x_al_walk_1"}]
        # a group with the name of a column of every store stays in `groups`
        assert takes["frames"].to_list() == [10, 10, 10]
        assert '"frames": "1"' in takes["groups"][0]
        assert [name for name, one in opened.manifest.columns.items() if one.origin == "pattern"] == ["style", "place"]


def test_settings_and_pipelines_are_remembered(store: Path, source: Path) -> None:
    manifest = read_newest(store)
    remembered = manifest.sources[str(source.resolve())]
    assert remembered.stage == "ingest/ingest"
    assert remembered.settings["patterns"] == PATTERNS
    assert "strict" not in remembered.settings
    record = manifest.pipelines["ingest"]
    assert yaml.safe_load(record.yaml)["name"] == "ingest"
    assert record.settings == {"source": str(source), "ingest.patterns": PATTERNS}
    assert record.sources == (str(source.resolve()),)
    assert record.kinedex
    stages = [one.changes["stages_done"] for one in list_versions(store) if "stages_done" in one.changes]
    assert stages == [["ingest/ingest"], ["ingest/index"]]
    ingest(store, source, PATTERNS)
    assert read_newest(store) == manifest


def test_takes_of_other_patterns_lose_their_groups(tmp_path: Path, source: Path) -> None:
    store = tmp_path / "store"
    ingest(store, source, PATTERNS)
    ingest(store, source, [r"x_(?P<actor>[^/_]+)_"], accept=True)
    takes = open_store(store).takes()
    assert takes.select("actor", "class", "style").rows() == [
        ("al", None, None),
        ("al", None, None),
        (None, None, None),
    ]
