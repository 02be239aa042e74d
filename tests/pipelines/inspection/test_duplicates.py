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
KINDS = ("half the rate", "trimmed to two thirds", "exported as C3D: whole millimetres, Z up, turned",
         "moved and turned, in centimetres", "in place", "mirrored", "trimmed, half the rate, mirrored")  # fmt: skip


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of two dances, copies of one file, and of one motion with what may happen to it."""
    folder = tmp_path_factory.mktemp("duplicates")
    source = write_archive(folder / "in", {"x_dance.amc": 900, "x_other.amc": 960})
    shutil.copyfile(source / "x_dance.amc", source / "x_same.amc")
    body = read_body(source / "x_dance.amc", source / "x.asf", load_mappings("auto", JOINTS), JOINTS)
    places = np.ascontiguousarray(body.positions.transpose(2, 0, 1), np.float32)
    for kind, make in planted(places, body.rate_hz, np.random.default_rng(0)):
        if kind in KINDS:
            make().write(source, f"copy{KINDS.index(kind)}")
    run_pipeline("ingest", folder / "store", assignments={"source": str(source)}, terminal=context(folder).terminal)
    return folder / "store"


def test_copies_are_listed_kept_and_counted(store: Path) -> None:
    result = CliRunner().invoke(app, ["duplicates", str(store), "--json"])
    assert result.exit_code == 0, result.output
    rows = json.loads(result.stdout)["duplicates"]
    assert [row["take"] for row in rows if row["same"] == "file"] == ["x_same"]
    pairs = {frozenset((row["take"], row["of_take"])): row for row in rows if row["same"] == "motion"}
    names = set(open_store(store).take_ids)
    assert not any("x_other" in pair for pair in pairs)
    assert {frozenset((name, "x_dance")) for name in names if name.startswith("copy")} <= set(pairs)
    image = pairs[frozenset(("copy5", "x_dance"))]
    assert (image["mirrored"], image["share"]) == (True, 1.0)
    cut = pairs[frozenset(("copy1", "x_dance"))]
    assert (cut["take"], cut["of_take"], cut["start"], cut["mirrored"]) == ("copy1", "x_dance", 0, False)
    assert cut["shift_seconds"] == pytest.approx(0.6 * (900 - 600) / 120, abs=0.01)
    kept = open_store(store).sql("SELECT take, of_take FROM duplicates ORDER BY take, of_take").to_pylist()
    assert kept == [{"take": row["take"], "of_take": row["of_take"]} for row in rows]
    table = CliRunner().invoke(app, ["duplicates", str(store)])
    assert "of 10 takes, 1 come from a copy of a file, 7 hold the motion of another take" in table.output


def test_one_take_of_each_group_is_never_a_copy(store: Path) -> None:
    CliRunner().invoke(app, ["duplicates", str(store)])
    copies = open_store(store).sql("SELECT DISTINCT take FROM duplicates").column("take").to_pylist()
    assert set(open_store(store).take_ids) - set(copies) == {
        "copy0",
        "x_other",
    }  # the longest, of equal length the first by name


def test_ingest_reports_copies_of_files(store: Path) -> None:
    line = copies_line(open_store(store))
    assert line is not None
    assert line.startswith("1 take of 10 comes from a copy of another take's file: 'x_same' (as 'x_dance')")
