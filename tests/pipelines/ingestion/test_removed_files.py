"""Takes that a person removed stay away, whatever is ingested, until their files are admitted again."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow as pa
import pytest
from typer.testing import CliRunner

from kinedex.commands.cli import app
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.store.result_changes import record_labels
from kinedex.storage.store.store import open_store
from kinedex.storage.store.take_removal import planned_removal
from tests.pipelines.archives import context, write_archive


def kinedex(*arguments: object, code: int = 0) -> str:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert done.exit_code == code, done.output
    return done.output


@pytest.fixture
def store(tmp_path: Path) -> Path:
    write_archive(tmp_path / "source", {"x_aa_one.amc": 60, "x_aa_two.amc": 50, "x_bb_three.amc": 40})
    ingest(tmp_path / "store")
    return tmp_path / "store"


def ingest(store: Path) -> dict[str, object]:
    return Ingest().run(context(store), Ingest.parameters(source=str(store.parent / "source")))


def source_digest(store: Path) -> str:
    parameters = Ingest.parameters(source=str(store.parent / "source"))
    return Ingest().external_digest(parameters, open_store(store, at="newest"))


def test_a_removed_take_stays_away_until_its_file_is_admitted_again(store: Path) -> None:
    label = {"take": "x_aa_one", "class": "walk", "start": 3, "stop": 9, "origin": "drawn"}
    record_labels(store, pa.Table.from_pylist([label]))
    listed = kinedex("takes", "remove", store, "x_aa_one")
    assert "1 take would be removed; the store keeps 1 label" in listed
    assert "nothing was changed: --accept removes them" in listed
    assert "3 takes" in kinedex("takes", store)
    before = source_digest(store)

    assert "1 take removed; the store keeps 1 label" in kinedex("takes", "remove", store, "x_aa_one", "--accept")
    opened = open_store(store)
    assert list(opened.take_ids) == ["x_aa_two", "x_bb_three"]
    assert opened.index_path().is_file()
    after = source_digest(store)
    assert after != before  # so that a run ingests again once the file is admitted
    assert ingest(store)["passed_over"] == 1
    assert open_store(store, at="newest").labels().num_rows == 1

    assert "1 file is passed over by ingests" in kinedex("takes", "readmit", store)
    assert "did you mean 'x_aa_one.amc'" in kinedex("takes", "readmit", store, "x_aa_on.amc", code=1)
    assert "is read by the next ingest" in kinedex("takes", "readmit", store, "x_aa_one.amc")
    assert ingest(store)["takes"] == 3


def test_a_removal_needs_takes_that_are_there(store: Path) -> None:
    opened = open_store(store, at="newest")
    with pytest.raises(KinedexError, match="name the takes to remove"):
        planned_removal(opened)
    with pytest.raises(KinedexError, match="did you mean 'x_aa_one'"):
        planned_removal(opened, ["x_aa_on"])
    with pytest.raises(KinedexError, match="selects none"):
        planned_removal(opened, where="frames < 3")
    document = json.loads(kinedex("takes", "remove", store, "--where", "name LIKE 'x_aa%'", "--json"))
    assert (document["takes"], document["removed"]) == (["x_aa_one", "x_aa_two"], False)
    kinedex("takes", "remove", store, "--where", "true", "--accept")
    with pytest.raises(KinedexError, match="kinedex takes readmit"):
        ingest(store)


def test_takes_are_listed_with_a_bound_and_without_warnings(store: Path) -> None:
    listed = kinedex("takes", store, "--limit", "2")
    assert "x_bb_three" not in listed
    assert "3 takes, 0.0 minutes; the first 2 are shown, --limit 0 shows all; 3 takes have warnings" in listed
    assert "warnings" in kinedex("takes", "list", store, "--columns", "name,warnings")


def test_merge_and_use_answer_on_the_command_line(store: Path, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    write_archive(tmp_path / "other" / "source", {"x_cc_four.amc": 45})
    ingest(tmp_path / "other" / "store")
    said = kinedex("merge", store, tmp_path / "other" / "store", "--prefix", "lab-")
    assert "1 take from" in said
    assert "has 4 takes now" in said
    assert "results do not come along" in said
    assert open_store(store).take_frames[4] > 0
    assert "no pipeline has made results" in kinedex("use", store)
    assert "no pipeline 'annotate'; it has no results of pipelines" in kinedex("use", store, "annotate", code=1)
