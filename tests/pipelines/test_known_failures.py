"""Failures that a run remembers: only new ones count, and every run names what is new, changed and gone."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from kinedex.commands.cli import app
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.engine.known_failures import SourceFiles, source_files
from kinedex.pipelines.labels.unmatched_labels import UnmatchedLabels
from kinedex.storage.lock import NO_WAIT
from kinedex.storage.store.store import open_store
from tests.pipelines.archives import human_amc, write_archive


def kinedex(*words: str | Path) -> Result:
    return CliRunner().invoke(app, [*map(str, words)], prog_name="kinedex", catch_exceptions=False)


class Nights:
    """An archive with a broken file, and a store that reads it night after night."""

    def __init__(self, folder: Path) -> None:
        self.archive = write_archive(folder / "archive", {"x_1.amc": 60, "x_2.amc": 60})
        self.broken = self.write("x_broken.amc", "no motion at all\n")
        self.store = folder / "store"

    def write(self, name: str, text: str) -> Path:
        (self.archive / name).write_text(text)
        return self.archive / name

    def night(self, code: int) -> dict[str, Any]:
        done = kinedex(
            "ingest", self.store, self.archive, "--executor", "serial", "--known-failures", "remember", "--json"
        )
        assert done.exit_code == code, done.output
        found: dict[str, Any] = json.loads(done.stdout)["files"]
        return found


@pytest.fixture
def nights(tmp_path: Path) -> Nights:
    return Nights(tmp_path)


def names(found: list[Any]) -> list[str]:
    return [Path(one["file"] if isinstance(one, dict) else one).name for one in found]


def test_only_new_failures_end_with_3(nights: Nights) -> None:
    found = nights.night(3)
    assert names(found["new"]) == ["x_1.amc", "x_2.amc", "x_broken.amc"]
    assert names(found["failed"]) == ["x_broken.amc"]
    assert "x_broken.amc" in found["failed"][0]["reason"]
    version = open_store(nights.store).manifest.version
    found = nights.night(0)
    assert {key: names(value) for key, value in found.items()} == {
        "new": [], "changed": [], "gone": [], "failed": [], "accepted": ["x_broken.amc"],
    }  # fmt: skip
    assert open_store(nights.store).manifest.version == version
    nights.write("x_other.amc", "nor here\n")
    found = nights.night(3)
    assert (names(found["failed"]), names(found["accepted"])) == (["x_other.amc"], ["x_broken.amc"])
    assert names(nights.night(0)["accepted"]) == ["x_broken.amc", "x_other.amc"]


def test_a_file_that_is_broken_in_another_way_fails_anew_and_a_repaired_one_is_forgotten(nights: Nights) -> None:
    nights.night(3)
    nights.write("x_broken.amc", "still no motion\n")
    assert names(nights.night(3)["failed"]) == ["x_broken.amc"]
    nights.write("x_broken.amc", human_amc(60, 5))
    found = nights.night(0)
    assert (found["failed"], found["accepted"], names(found["changed"])) == ([], [], ["x_broken.amc"])
    assert open_store(nights.store).result("known_failures").num_rows == 0
    nights.write("x_broken.amc", "still no motion\n")
    assert names(nights.night(3)["failed"]) == ["x_broken.amc"]


def test_changed_and_gone_files_are_named_once(nights: Nights) -> None:
    nights.night(3)
    nights.write("x_1.amc", human_amc(80, 7))
    (nights.archive / "x_2.amc").unlink()
    found = nights.night(0)
    assert (names(found["changed"]), names(found["gone"]), found["new"]) == (["x_1.amc"], ["x_2.amc"], [])
    assert nights.night(0)["gone"] == []


def test_the_end_of_a_run_names_the_files(nights: Nights) -> None:
    words = ("ingest", nights.store, nights.archive, "--executor", "serial")
    done = kinedex(*words, "--known-failures", "remember")
    assert done.exit_code == 3
    assert f"3 files new: {nights.archive / 'x_1.amc'}" in done.stdout
    assert f"failed: {nights.broken}" in done.stdout
    done = kinedex(*words, "--known-failures", "remember")
    assert done.exit_code == 0
    assert f"1 file accepted, since they failed before: {nights.broken}" in done.stdout
    assert kinedex(*words).exit_code == 3
    assert kinedex(*words, "--known-failures", "report").exit_code == 3
    done = kinedex(*words, "--known-failures", "forget", "--json")
    assert done.exit_code == 2
    assert json.loads(done.stdout)["error"]["message"].endswith("expected remember or report")


def test_a_pipeline_can_remember_by_itself(nights: Nights, tmp_path: Path) -> None:
    file = tmp_path / "nightly.yaml"
    file.write_text(
        f"name: nightly\nknown_failures: remember\nstages:\n  ingest: {{params: {{source: {nights.archive}}}}}\n"
    )
    words = ("run", file, "--store", nights.store, "--executor", "serial")
    assert kinedex(*words).exit_code == 3
    assert kinedex(*words).exit_code == 0
    assert kinedex(*words, "--known-failures", "report").exit_code == 3
    file.write_text(file.read_text().replace("remember", "keep"))
    assert "known_failures" in kinedex(*words).stderr


def test_labels_that_match_no_take_are_remembered(nights: Nights, tmp_path: Path) -> None:
    nights.night(3)
    labels = tmp_path / "labels.csv"
    labels.write_text("take,class,start,stop\nx_9,hop,0,10\n")
    lost = UnmatchedLabels(str(labels), 1, 1, ("x_9",))
    pipeline = load_pipeline("ingest", None, {"source": str(nights.archive)})

    def night(*unmatched: UnmatchedLabels) -> SourceFiles:
        state: dict[str, str | None] = {}
        return source_files(nights.store, pipeline, state, unmatched, remember=True, run="r", wait=NO_WAIT)

    found = night(lost)
    assert [one.error for one in found.failed] == ["UnmatchedLabels"]
    assert (night(lost).failed, len(night(lost).accepted)) == ((), 2)
    # another take is gone, while the file of labels is as it was
    assert len(night(UnmatchedLabels(str(labels), 2, 2, ("x_9", "x_1"))).failed) == 1
    labels.write_text("take,class,start,stop\nx_9,hop,0,20\n")
    assert len(night(lost).failed) == 1
