"""The demos: they keep out of stores that are not theirs, and end with the command that repeats them."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from kinedex.commands.cli import app
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.snapshot.manifest_files import versions
from tests.pipelines.archives import context, write_archive

DEMOS = ([], ["--tracking"], ["--depth"], ["--inertial"])


def kinedex(*words: str | Path) -> Result:
    return CliRunner().invoke(app, [*map(str, words)], prog_name="kinedex", catch_exceptions=False)


def ingested(store: Path, source: Path) -> Path:
    write_archive(source, {"x_al_hop_1.amc": 60})
    Ingest().run(context(store), Ingest.parameters(source=str(source)))
    return store


@pytest.mark.parametrize("options", DEMOS)
def test_a_demo_refuses_a_store_that_no_demo_made(options: list[str], tmp_path: Path) -> None:
    store = ingested(tmp_path / "mine", tmp_path / "recorded")
    before = versions(store)
    done = kinedex("demo", store, *options)
    assert done.exit_code == 1
    assert f"{store} holds 1 take of {tmp_path / 'recorded'}, and none of" in done.stderr
    assert f"such as {tmp_path / 'mine-demo'}" in done.stderr
    assert versions(store) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine", "recorded"]


def test_a_demo_with_data_of_its_own_refuses_a_store_of_other_data(tmp_path: Path) -> None:
    store = ingested(tmp_path / "mine", tmp_path / "recorded")
    write_archive(tmp_path / "others", {"x_al_hop_2.amc": 60})
    done = kinedex("demo", store, "--data", tmp_path / "others")
    assert done.exit_code == 1
    assert f"none of {tmp_path / 'others'}" in done.stderr
    done = kinedex("demo", store, "--data", tmp_path / "recorded", "--executor", "serial")
    assert "no take to learn from" in done.stderr  # it has gone on to the stages


@pytest.mark.slow
@pytest.mark.parametrize("options", DEMOS)
def test_a_demo_ends_with_the_line_that_repeats_it(options: list[str], tmp_path: Path) -> None:
    minutes = "3" if options == ["--inertial"] else "1"  # sensors need takes of some length
    done = kinedex("demo", tmp_path / "a store", *options, "--minutes", minutes, "--executor", "serial")
    assert done.exit_code == 0, done.output
    line = done.stdout.splitlines()[-1].partition(": ")[2]
    words = shlex.split(line)
    assert words[:2] == ["kinedex", "run"]
    again = kinedex(*words[1:])
    assert again.exit_code == 0, again.output
    assert "everything was done already" in again.stdout
