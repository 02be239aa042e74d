"""`kinedex duplicates`: copies of files and of motion in a store, on the command line and in SQL."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.commands.cli import app
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.inspection.duplicates import copies_line
from kinedex.storage.formats.motion.reader_table import read_body
from kinedex.storage.store.store import open_store
from studies.planted_copies import planted
from tests.pipelines.archives import context, write_archive

JOINTS = load_feature_set().joints
CHANGES = {
    "the same frames": "same frames", "half the rate": "shifted, resampled", "five sixths of the rate": "resampled",
    "shifted by 13 ms": "shifted", "trimmed to two thirds": "trimmed", "trimmed to a third": "trimmed",
    "exported as C3D: whole millimetres, Z up, turned": "same frames",
    "moved and turned, in centimetres": "same frames", "in place": "same frames", "noise of 1 mm": "same frames",
    "noise of 3 mm": "same frames", "larger by a tenth": "another body", "another body": "another body",
    "clock of 1000/1001": "resampled", "film at 24 of 25 frames a second": "another clock, resampled",
    "mirrored": "mirrored", "trimmed, half the rate, mirrored": "trimmed, mirrored, resampled",
    "trimmed, five sixths of the rate, turned, noise of 2 mm": "trimmed, shifted, resampled",
}  # fmt: skip
KINDS = tuple(CHANGES)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of two dances, copies of one file, and of one motion with what may happen to it."""
    folder = tmp_path_factory.mktemp("duplicates")
    source = write_archive(folder / "in", {"x_dance.amc": 900, "x_other.amc": 960})
    shutil.copyfile(source / "x_dance.amc", source / "x_same.amc")
    body = read_body(source / "x_dance.amc", source / "x.asf", load_mappings("auto", JOINTS), JOINTS)
    places = np.ascontiguousarray(body.positions.transpose(2, 0, 1), np.float32)
    for kind, make in planted(places, body.rate_hz, np.random.default_rng(0)):
        make().write(source, f"copy{KINDS.index(kind):02}")
    run_pipeline("ingest", folder / "store", assignments={"source": str(source)}, terminal=context(folder).terminal)
    return folder / "store"


def test_copies_are_listed_kept_and_counted(store: Path) -> None:
    result = CliRunner().invoke(app, ["duplicates", str(store), "--json"])
    assert result.exit_code == 0, result.output
    rows = json.loads(result.stdout)["duplicates"]
    assert [row["take"] for row in rows if row["same"] == "file"] == ["x_same"]
    pairs = {frozenset((row["take"], row["of_take"])): row for row in rows if row["same"] == "motion"}
    assert not any("x_other" in pair for pair in pairs)
    found = {kind: pairs[frozenset((f"copy{k:02}", "x_dance"))] for k, kind in enumerate(KINDS)}
    assert {kind: row["changes"] for kind, row in found.items()} == CHANGES
    assert all(row["share"] > 0.98 for row in found.values())
    assert [kind for kind, row in found.items() if row["mirrored"]] == [kind for kind in KINDS if "mirrored" in kind]
    kept = open_store(store).sql("SELECT take, of_take FROM duplicates ORDER BY take, of_take").to_pylist()
    assert kept == [{"take": row["take"], "of_take": row["of_take"]} for row in rows]
    table = CliRunner().invoke(app, ["duplicates", str(store)])
    assert "of 21 takes, 1 come from a copy of a file, 18 hold the motion of another take" in table.output
    assert "pairs by change: " in table.output


def test_copies_say_how_far_they_are_apart_and_how_much_later_they_begin(store: Path) -> None:
    CliRunner().invoke(app, ["duplicates", str(store)])
    rows = open_store(store).sql("SELECT * FROM duplicates WHERE of_take = 'x_dance' OR take = 'x_dance'").to_pylist()
    copies = {KINDS[int(name[4:])]: row for row in rows for name in (row["take"], row["of_take"]) if name[:4] == "copy"}
    cut = copies["trimmed to two thirds"]
    assert (cut["of_take"], cut["start"]) == ("x_dance", 0)
    assert cut["shift_seconds"] == pytest.approx(0.6 * 300 / 120, abs=0.002)
    assert abs(copies["shifted by 13 ms"]["shift_seconds"]) == pytest.approx(0.4 / 30, abs=0.002)
    assert copies["the same frames"]["distance_mm"] < 0.01
    assert copies["exported as C3D: whole millimetres, Z up, turned"]["distance_mm"] == pytest.approx(0.5, abs=0.05)
    assert copies["noise of 1 mm"]["distance_mm"] == pytest.approx(np.sqrt(3), abs=0.1)
    assert copies["noise of 3 mm"]["distance_mm"] == pytest.approx(3 * np.sqrt(3), abs=0.3)
    film = copies["film at 24 of 25 frames a second"]
    assert {round(film["pace"], 3), round(1 / film["pace"], 3)} == {0.96, 1.042}


def test_one_take_of_each_group_is_never_a_copy(store: Path) -> None:
    CliRunner().invoke(app, ["duplicates", str(store)])
    copies = open_store(store).sql("SELECT DISTINCT take FROM duplicates").column("take").to_pylist()
    film = f"copy{KINDS.index('film at 24 of 25 frames a second'):02}"
    assert set(open_store(store).take_ids) - set(copies) == {film, "x_other"}  # the longest


def test_ingest_reports_copies_of_files(store: Path) -> None:
    line = copies_line(open_store(store))
    assert line is not None
    assert line.startswith("1 take of 21 comes from a copy of another take's file: 'x_same' (as 'x_dance')")
