"""The store remembers the settings of a source, and takes nothing away from takes without a yes."""

from __future__ import annotations

import io
import shlex
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from typer.testing import CliRunner

from kinedex.commands.cli import app
from kinedex.console.terminal import Terminal
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.runner import Outcome, run_pipeline
from kinedex.pipelines.ingestion import file_batches
from kinedex.pipelines.ingestion.pattern_proposal import propose_patterns
from kinedex.storage.snapshot.manifest_files import read_newest
from kinedex.storage.store.store import open_store
from tests.pipelines.archives import write_archive

PATTERN = r"(?P<style>[^/]+)/x_(?P<actor>[^/_]+)_(?P<class>[^/_]+)_"
FILES = ("angry/x_al_walk_1.amc", "sad/x_al_walk_2.amc", "sad/x_free.amc")


def ingest(store: Path, source: Path, accept: bool = False, **settings: Any) -> tuple[Outcome, str]:
    """Ingest, and return the outcome with the messages."""
    shown = io.StringIO()
    terminal = Terminal(Console(file=shown, width=300))
    given = {"source": source, **{f"ingest.{name}": value for name, value in settings.items()}}
    return run_pipeline("ingest", store, settings=given, accept=accept, terminal=terminal), shown.getvalue()


def described(store: Path) -> list[tuple[object, ...]]:
    return open_store(store).takes().select("actor", "class", "style").rows()


@pytest.fixture
def source(tmp_path: Path) -> Path:
    return write_archive(tmp_path / "archive", dict.fromkeys(FILES, 30))


@pytest.fixture
def store(tmp_path: Path, source: Path) -> Path:
    ingest(tmp_path / "store", source, patterns=[PATTERN])
    return tmp_path / "store"


def test_a_second_ingest_uses_the_patterns_of_the_first(store: Path, source: Path) -> None:
    before = described(store)
    assert before == [("al", "walk", "angry"), ("al", "walk", "sad"), (None, None, None)]
    outcome, shown = ingest(store, source)
    assert outcome.ran == ()
    write_archive(source, {"sad/x_bo_walk_3.amc": 30}, 7)
    outcome, shown = ingest(store, source)
    assert described(store) == [*before[:2], ("bo", "walk", "sad"), (None, None, None)]
    assert f"as at the last ingest of this source: patterns '{PATTERN}'; `--set ingest.patterns=…`" in shown
    assert "1 of 4 paths matches no pattern, such as 'sad/x_free.amc': its take has" in shown
    assert outcome.summaries["ingest"]["unmatched"] == 1


def test_settings_stay_with_an_archive_that_was_moved(store: Path, source: Path) -> None:
    before = described(store)
    outcome, shown = ingest(store, source.rename(source.with_name("moved")))
    assert described(store) == before
    assert (outcome.summaries["ingest"]["read"], outcome.summaries["ingest"]["unchanged"]) == (0, 3)
    assert "as at the last ingest" in shown


def test_values_are_taken_away_with_a_yes_alone(store: Path, source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(file_batches, "read_body", None)  # no file is read for other patterns
    manifest, before = read_newest(store), described(store)
    with pytest.raises(KinedexError) as refused:
        ingest(store, source, patterns=[r"x_(?P<actor>[^/_]+)_"])
    assert "2 of 3 takes below" in str(refused.value)
    assert "\n    class: 2 takes, such as 'walk' of x_al_walk_1, 'walk' of x_al_walk_2\n    style: 2" in str(
        refused.value
    )
    assert str(refused.value).endswith("to accept it, call again with accept=True")
    assert (read_newest(store), described(store)) == (manifest, before)
    outcome, shown = ingest(store, source, accept=True, patterns=[r"x_(?P<actor>[^/_]+)_"])
    assert described(store) == [("al", None, None), ("al", None, None), (None, None, None)]
    assert outcome.summaries["ingest"]["read"] == 0
    assert "2 takes described anew by patterns or metadata; no file was read for it" in shown
    ingest(store, source, patterns=[PATTERN])
    assert described(store) == before
    warnings = open_store(store).takes()["warnings"].to_list()
    assert [any("no pattern" in one for one in those) for those in warnings] == [False, False, True]


def test_the_command_of_the_refusal_works(store: Path, source: Path) -> None:
    runner = CliRunner()
    plain = ["--executor", "serial", "--workers", "1"]
    refused = runner.invoke(app, ["ingest", str(store), str(source), *plain, "--set", "ingest.patterns=[]"])
    assert refused.exit_code == 1
    command = shlex.split(refused.stderr.splitlines()[-1])
    assert (command[0], command[-1]) == ("kinedex", "--accept")
    assert runner.invoke(app, command[1:]).exit_code == 0
    assert described(store) == [(None, None, None)] * 3


def test_paths_without_a_pattern_lead_to_a_proposal_only_where_there_is_one(tmp_path: Path) -> None:
    files = [f"x_{actor}_{kind}_{n}.amc" for actor in ("al", "bo", "cy") for kind in ("walk", "run") for n in (1, 2)]
    source = write_archive(tmp_path / "archive", dict.fromkeys([*files, "free.amc"], 30))
    _, shown = ingest(tmp_path / "store", source, patterns=["^x_(?P<actor>al)_(?P<class>[^_]+)_"])
    assert "9 of 13 paths match no pattern" in shown
    assert f"`kinedex init {source} -o my.yaml` proposes patterns" in shown
    proposed = [one.pattern for one in propose_patterns([*files, "free.amc"])]
    _, shown = ingest(tmp_path / "store", source, accept=True, patterns=proposed)
    assert "1 of 13 paths matches no pattern, such as 'free.amc'" in shown
    assert f"kinedex init {source}" not in shown
    assert "`kinedex init` has no pattern for it: add one to `patterns` of the stage ingest" in shown


def test_a_motion_beside_a_strangers_skeleton_is_refused_until_a_setting_gives_it_one(tmp_path: Path) -> None:
    source, store = write_archive(tmp_path / "archive", {"x_1.amc": 20, "01_14.amc": 20}), tmp_path / "store"
    (source / "03.asf").write_text((source / "x.asf").read_text())
    ingest(store, source)
    assert open_store(store).takes()["name"].to_list() == ["x_1"]
    (row,) = open_store(store).result("ingest_log").to_pylist()
    assert "no ASF skeleton whose whole name begins '01_14': found only 03.asf, x.asf" in row["message"]
    assert """`--set 'ingest.skeleton_files={"01_14.amc": "03.asf"}'`""" in row["message"]
    ingest(store, source, skeleton_files={"01_14.amc": "03.asf"})
    outcome, shown = ingest(store, source)
    assert "excluded" not in shown
    assert outcome.ran == ()
    takes = open_store(store).takes().sort("name")
    assert takes.select("name", "skeleton_source").rows() == [("01_14", "03.asf"), ("x_1", "x.asf")]
    assert "its skeleton" not in str(takes["warnings"].to_list())


def test_the_only_skeleton_of_a_folder_is_taken_with_a_warning(tmp_path: Path) -> None:
    source, store = write_archive(tmp_path / "archive", {"walk.amc": 20}), tmp_path / "store"
    (source / "x.asf").rename(source / "Skeleton.asf")
    ingest(store, source)
    (warnings,) = open_store(store).takes()["warnings"].to_list()
    assert "its skeleton Skeleton.asf is taken because there is no other" in str(warnings)


def test_only_patterns_that_a_user_gave_are_missed(tmp_path: Path) -> None:
    source = write_archive(tmp_path / "archive", {"x_free.amc": 30, "angry/x_al_walk_1.amc": 30})
    ingest(tmp_path / "store", source)
    assert takes_that_miss(tmp_path / "store") == []
    ingest(tmp_path / "store", source, patterns=[PATTERN])
    assert takes_that_miss(tmp_path / "store") == ["x_free"]


def takes_that_miss(store: Path) -> list[str]:
    rows = open_store(store).takes().select("name", "warnings").rows()
    return [name for name, warnings in rows if "its path matches no pattern of the config" in warnings]
