"""Doubtful files in the explorer: causes, nodes and their names, the body that they make, and kept mappings."""

from __future__ import annotations

import gzip
import shlex
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient
from typer.testing import CliRunner

from kinedex.catalog.skeletons.recognition.landmarks import load_landmarks
from kinedex.catalog.skeletons.recognition.named_points import nodes_of_landmarks
from kinedex.commands.cli import app
from kinedex.storage.store.store import open_store
from tests.c3d_files import LABELS, standing_markers, write_c3d, z_up
from tests.explorer.conftest import Connect

POINTS = 1000 * z_up(standing_markers(60))
NONSENSE = {label: f"X<{i:02d}>" for i, label in enumerate(LABELS)}
NAMED = {NONSENSE[label]: name for label, name in nodes_of_landmarks(load_landmarks().read(LABELS)).items()}
"""The landmark that each marker without a telling label is."""


def kinedex(*words: str | Path) -> str:
    done = CliRunner().invoke(app, [*map(str, words)], prog_name="kinedex", catch_exceptions=False)
    assert done.exit_code in (0, 3), done.output
    return done.output


@pytest.fixture
def trials(tmp_path: Path) -> Path:
    """A store of a folder with two trials whose labels say nothing, and two of a known marker set, one with a gap."""
    source = tmp_path / "trials"
    source.mkdir()
    for name in ("one", "two"):
        write_c3d(source / f"{name}.c3d", POINTS, tuple(NONSENSE.values()))
    write_c3d(source / "known.c3d", POINTS)
    points = POINTS.copy()
    points[0, :, 20:23] = np.nan
    write_c3d(source / "gap.c3d", points)
    kinedex("ingest", tmp_path / "store", source, "--executor", "serial", "--set", "patterns=['.']")
    return tmp_path / "store"


@pytest.fixture
def client(connect: Connect, trials: Path) -> TestClient:
    return connect(trials)


def ask(client: TestClient, path: str, body: object, status: int = 200) -> dict[str, Any]:
    answer = client.post(path, json=body)
    assert answer.status_code == status, answer.text
    found: dict[str, Any] = answer.json()
    return found


def file_of(trials: Path, name: str = "one.c3d") -> dict[str, str]:
    return {"source_root": str(trials.parent / "trials"), "source": name}


def test_causes_lead_to_files(client: TestClient) -> None:
    found = client.get("/api/doubts")
    assert found.status_code == 200, found.text
    causes = found.json()["causes"]
    cause = "no human body is recognised among its points"
    assert causes[0] == {"kind": "refused", "cause": cause, "files": 2, "accepted": 0}
    assert {"kind": "warned", "cause": "gaps closed along straight lines", "files": 1, "accepted": 0} in causes
    rows = ask(client, "/api/doubts/files", {"kind": "refused", "cause": cause})["rows"]
    assert [(row["source"], row["take"]) for row in rows] == [("one.c3d", None), ("two.c3d", None)]


def test_a_warning_is_accepted_by_the_command_that_is_shown(client: TestClient, trials: Path) -> None:
    cause = {"kind": "warned", "cause": "gaps closed along straight lines"}
    assert ask(client, "/api/doubts/accept", cause)["changed"] == 1
    assert ask(client, "/api/doubts/files", cause)["rows"][0]["accepted"]
    back = ask(client, "/api/doubts/accept", cause | {"revoke": True, "takes": ["gap"]})
    assert not open_store(trials).sql("FROM doubts WHERE accepted").num_rows
    kinedex(*shlex.split(back["command"].replace(" --revoke", ""))[1:])
    assert open_store(trials).sql("FROM doubts WHERE accepted").num_rows == 1


def test_nodes_are_where_the_file_has_them(client: TestClient, trials: Path) -> None:
    found = ask(client, "/api/files/nodes", {"file": file_of(trials)})
    assert [one["node"] for one in found["nodes"]] == list(NONSENSE.values())
    assert np.allclose(found["frames"][0], POINTS[:, :, 0], atol=1e-2)
    assert found["parents"] is None
    assert "no human body" in found["refused"]
    assert {one["reason"] for one in found["nodes"]} == {"no known name"}
    again = ask(client, "/api/files/nodes", {"file": file_of(trials), "named": {"X<00>": "lasis"}})
    assert again["nodes"][0] | {"joints": []} == {
        "node": "X<00>", "name": "lasis", "reason": "named by you", "joints": [],
    }  # fmt: skip


def test_a_trial_has_the_body_beside_those_of_the_folder(client: TestClient, trials: Path) -> None:
    body = {"file": file_of(trials), "named": NAMED, "name": "mine"}
    found = ask(client, "/api/files/trial", body)
    assert found["fault"] is None
    known = open_store(trials).sql("SELECT * FROM takes WHERE name = 'known'").to_pylist()[0]
    by_name = {one["figure"]: one for one in found["figures"]}
    assert by_name["asymmetry"]["value"] == pytest.approx(known["asymmetry"], abs=1e-6)
    assert by_name["asymmetry"]["around"][1] == pytest.approx(known["asymmetry"], abs=1e-6)
    assert found["around"] == {"folder": str(trials.parent / "trials"), "takes": 2}
    for word in found["words"]:
        if word["percent"] is not None and word["around"] is not None:
            assert word["percent"] == pytest.approx(word["around"], abs=6.0), word
    assert set(found["estimated"]) == set(known["estimated_joints"].split())
    assert "<" in found["yaml"]


def test_a_trial_that_makes_no_body_says_why(client: TestClient, trials: Path) -> None:
    body = {"file": file_of(trials), "named": {}, "name": "mine"}
    found = ask(client, "/api/files/trial", body)
    assert found["fault"]
    assert not found["frames"]
    wrong = ask(client, "/api/files/trial", body | {"named": {"X<00>": "nose of it"}}, 400)
    assert "no joint or landmark 'nose of it'" in wrong["error"]["message"]
    for name in ("../../mine", "-o", "", "a/b", ".hidden"):
        assert ask(client, "/api/files/trial", body | {"name": name}, 422)


def test_a_kept_mapping_brings_all_alike_in(client: TestClient, trials: Path) -> None:
    body = {"file": file_of(trials), "named": NAMED, "name": "mine"}
    tried = ask(client, "/api/files/trial", body)
    answer = ask(client, "/api/files/mapping", body)
    assert (answer["name"], answer["replaced"]) == ("mine", False)
    wait_for(client, answer["job"]["id"])
    store = open_store(trials)
    rows = store.sql("SELECT name, skeleton FROM takes ORDER BY name").to_pylist()
    assert {row["name"]: row["skeleton"] for row in rows} == {
        "gap": "recognised markers", "known": "recognised markers", "one": "mine", "two": "mine",
    }  # fmt: skip
    assert not store.sql("FROM doubts WHERE kind = 'refused'").num_rows
    assert store.manifest.mappings == {"mine": tried["yaml"]}


def test_a_mapping_for_one_file_leaves_the_others(client: TestClient, trials: Path) -> None:
    answer = ask(
        client, "/api/files/mapping", {"file": file_of(trials), "named": NAMED, "name": "m", "only_this": True}
    )
    wait_for(client, answer["job"]["id"])
    rows = open_store(trials).sql("SELECT source FROM doubts WHERE kind = 'refused'").to_pylist()
    assert [row["source"] for row in rows] == ["two.c3d"]


def test_the_commands_that_are_shown_do_the_same(client: TestClient, trials: Path, monkeypatch) -> None:
    body = {"file": file_of(trials), "named": NAMED, "name": "mine", "only_this": True}
    found = ask(client, "/api/files/trial", body)
    monkeypatch.chdir(trials.parent)
    for command in found["commands"]:
        kinedex(*shlex.split(command)[1:])
    store = open_store(trials)
    assert store.manifest.mappings == {"mine": found["yaml"]}
    assert store.sql("SELECT skeleton FROM takes WHERE name = 'one'").to_pylist() == [{"skeleton": "mine"}]


def test_the_persons_of_a_file_are_shown_one_by_one(connect: Connect, trials: Path) -> None:
    source = trials.parent / "trials"
    labels = [f"{person}:{label}" for person in ("Ann", "Bob") for label in LABELS]
    write_c3d(source / "pair.c3d", np.concatenate([POINTS, POINTS + 900.0]), tuple(labels))
    kinedex("ingest", trials, source, "--executor", "serial")
    client = connect(trials)
    found = ask(client, "/api/files/nodes", {"file": file_of(trials, "pair.c3d")})
    assert (found["persons"], found["person"]) == (["Ann", "Bob"], "Ann")
    assert [one["node"] for one in found["nodes"]] == [f"Ann:{label}" for label in LABELS]
    assert np.allclose(found["frames"][0], POINTS[:, :, 0], atol=1e-2)
    bob = {"file": file_of(trials, "pair.c3d") | {"person": "Bob"}, "named": {"Bob:LKNE": "lkneemed"}, "name": "mine"}
    assert np.allclose(ask(client, "/api/files/nodes", {"file": bob["file"]})["frames"][0], POINTS[:, :, 0] + 900.0)
    tried = ask(client, "/api/files/trial", bob)
    assert tried["fault"] is None
    assert "--person Bob" in tried["commands"][0]


def test_a_packed_file_alone_comes_in_by_its_mapping(connect: Connect, trials: Path) -> None:
    source = trials.parent / "trials"
    with gzip.open(source / "packed.c3d.gz", "wb") as packed:
        packed.write((source / "one.c3d").read_bytes())
    kinedex("ingest", trials, source, "--executor", "serial")
    body = {"file": file_of(trials, "packed.c3d.gz"), "named": NAMED, "name": "mine", "only_this": True}
    assert ask(connect(trials), "/api/files/trial", body)["fault"] is None


def test_only_files_of_the_store_are_read_and_read_only_writes_nothing(connect: Connect, trials: Path) -> None:
    other = write_c3d(trials.parent / "secret.c3d", POINTS)
    client = connect(trials, read_only=True)
    for name in ("../secret.c3d", str(other), "three.c3d"):
        assert ask(client, "/api/files/nodes", {"file": file_of(trials, name)}, 404)
    body = {"file": file_of(trials), "named": NAMED, "name": "mine"}
    assert ask(client, "/api/files/trial", body)["fault"] is None
    assert ask(client, "/api/files/mapping", body, 403)
    cause = {"kind": "warned", "cause": "gaps closed along straight lines"}
    assert ask(client, "/api/doubts/accept", cause, 403)
    assert not open_store(trials).manifest.mappings


def wait_for(client: TestClient, job: str) -> None:
    """Wait until a job is done."""
    for _ in range(600):
        found = next(one for one in client.get("/api/jobs").json()["jobs"] if one["id"] == job)
        if found["finished"]:
            assert found["state"] == "done", found["problem"]
            return
        time.sleep(0.05)
    raise AssertionError("the job does not end")
