"""Export from the page: the plan, its sizes, and the job that writes what was planned."""

from __future__ import annotations

import csv
import json
import shutil
import time
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

import kinedex
from kinedex.explorer.exports import export_command
from kinedex.explorer.jobs import Job, jobs_of
from kinedex.pipelines.export.request import ClipOptions, IntervalSource
from tests.explorer.conftest import Connect
from tests.pipelines.labelled import clip, write_store

Json = dict[str, Any]
SECONDS = 120


def ended(client: TestClient, id: str) -> Json:
    """Return a job when it has ended."""
    deadline = time.monotonic() + SECONDS
    while time.monotonic() < deadline:
        (job,) = (one for one in client.get("/api/jobs").json()["jobs"] if one["id"] == id)
        if job["state"] not in ("waiting", "running"):
            found: Json = job
            return found
        time.sleep(0.1)
    raise AssertionError("the job did not end")


def plan(client: TestClient, **asked: object) -> Json:
    answer = client.post("/api/export/plan", json=asked)
    assert answer.status_code == 200, answer.text
    found: Json = answer.json()
    return found


def test_the_name_of_a_take_is_no_option_of_the_command(connect: Connect) -> None:
    archive = connect().app.app.state.archive  # type: ignore[attr-defined]
    name = "--output=/elsewhere/"
    words = export_command(archive, IntervalSource("takes", takes=(name,)), ClipOptions(), "here")
    assert words.count(name) == 1
    assert words[words.index("--") + 1 :] == (name,)


def test_what_is_written_is_what_was_planned(connect: Connect, tmp_path: Path) -> None:
    client = connect()
    folder = tmp_path / "a set"
    how = {"form": "npz", "split": "actor", "shares": [0.5, 0.5]}
    asked = {"filters": [{"column": "actor", "values": ["al", "bo"]}], "how": how, "folder": str(folder)}
    shown = plan(client, **asked)
    assert not folder.exists()
    assert (shown["clips"], shown["takes"], shown["files"]) == (11, 11, 13)
    assert sum(row["clips"] for row in shown["rows"]) == 11
    assert {row["split"] for row in shown["rows"]} == {"train", "test"}
    assert [row["split"] for row in shown["rows"]] == sorted((row["split"] for row in shown["rows"]), reverse=True)
    started = client.post("/api/export", json={**asked, "planned": shown["state"]})
    assert started.status_code == 200, started.text
    job = ended(client, started.json()["id"])
    assert job["state"] == "done", client.get(f"/api/jobs/{job['id']}/log").json()["text"]
    assert job["command"] == shown["command"]
    written = client.get(f"/api/export/{job['id']}").json()
    assert written["folder"].rstrip("/") == str(folder)
    assert written["files"] == shown["files"] == sum(path.is_file() for path in folder.rglob("*"))
    assert written["bytes"] == pytest.approx(shown["bytes"], rel=0.05)
    record = json.loads((folder / "dataset.json").read_text())
    assert {name: one["clips"] for name, one in record["splits"].items()} == {
        name: one["clips"] for name, one in shown["splits"].items()
    }
    assert plan(client, **asked)["earlier"]
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    shutil.rmtree(folder)
    exec(shown["python"])
    after = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    record_file = folder / "dataset.json"
    by_python = json.loads(after.pop(record_file))
    assert json.loads(before.pop(record_file)) | {"command": by_python["command"]} == by_python
    assert record["command"] == shown["command"]
    assert after == before


def test_nothing_is_written_once_the_store_has_changed(connect: Connect, tmp_path: Path) -> None:
    path = write_store(tmp_path / "store", [clip("walk", "al", 1)])
    client = connect(path)
    asked = {"folder": str(tmp_path / "set")}
    seen = plan(client, **asked)["state"]
    jobs = jobs_of(client.app.app.state.archive)  # type: ignore[attr-defined]
    long = jobs.add(Job("long", ("sql", str(path), "SELECT count(*) FROM range(100000000000)", "--timeout", "100s")))
    waiting = client.post("/api/export", json={**asked, "planned": seen})
    assert waiting.status_code == 200
    kinedex.open_store(path).labels.add(
        [{"take": clip("walk", "al", 1)["name"], "class": "step", "start": 0, "stop": 5}]
    )
    late = client.post("/api/export", json={**asked, "planned": seen})
    assert late.status_code == 409
    jobs.stop(long, force=True)
    job = ended(client, waiting.json()["id"])
    assert job["state"] == "failed"
    assert "the store has changed since this was planned" in job["problem"]
    assert not (tmp_path / "set").exists()


def test_hits_that_show_a_mirror_image_are_marked(connect: Connect, tmp_path: Path) -> None:
    client = connect()
    folder = tmp_path / "hits"
    hits = [{"take": "al_long", "start": 2, "stop": 12, "mirrored": one} for one in (False, True)]
    hits[1]["start"] = 4
    asked = {"hits": hits, "folder": str(folder)}
    assert ended(client, client.post("/api/export", json=asked).json()["id"])["state"] == "done"
    rows = csv.DictReader((folder / "metadata.csv").open(encoding="utf-8"))
    assert [(row["start"], row["mirrored"], row["mirror_image"]) for row in rows] == [
        ("2", "false", "false"),
        ("4", "false", "true"),
    ]


@pytest.mark.parametrize("form", ["csv", "parquet", "glb", "c3d"])
def test_sizes_are_those_of_a_sample(connect: Connect, tmp_path: Path, form: str) -> None:
    from kinedex.pipelines.engine.display import no_progress
    from kinedex.pipelines.engine.executors import make_executor
    from kinedex.pipelines.export.data_set import export_data_set
    from kinedex.pipelines.export.request import ClipOptions, IntervalSource

    client = connect()
    shown = plan(client, how={"form": form})
    assert "estimated from 6 clips" in shown["estimate"]
    store = client.app.app.state.archive.store()  # type: ignore[attr-defined]
    target = tmp_path / "set"
    export_data_set(
        store, IntervalSource(), ClipOptions(form), target, executor=make_executor("serial", None), progress=no_progress
    )
    written = sum(path.stat().st_size for path in target.rglob("*") if path.is_file())
    assert written == pytest.approx(shown["bytes"], rel=0.1)


def test_hits_are_clips_with_names_that_stay_inside(connect: Connect, tmp_path: Path) -> None:
    client = connect()
    folder = tmp_path / "hits"
    hits = [{"take": "al_long", "start": 2, "stop": 12, "class": "../../out'; --"}]
    asked = {"hits": hits, "folder": str(folder)}
    shown = plan(client, **asked)
    assert shown["rows"][0]["class"] == "../../out'; --"
    job = ended(client, client.post("/api/export", json=asked).json()["id"])
    assert job["state"] == "done", job
    (row,) = csv.DictReader((folder / "metadata.csv").open(encoding="utf-8"))
    assert (folder / row["file"]).resolve().parent == folder / "clips"
    assert [path.name for path in tmp_path.iterdir()] == ["hits"]
    over = client.post("/api/export/plan", json={"hits": [{"take": "al_long", "start": 2, "stop": 12_000}]})
    assert over.status_code == 400
    assert "is no interval of this take" in over.text


def test_folders_are_new_and_outside_of_the_store(connect: Connect, store: Path, tmp_path: Path) -> None:
    client = connect()
    (tmp_path / "mine.txt").write_text("mine")
    (tmp_path / "link").symlink_to(store)
    before = sorted(store.iterdir())
    for folder, problem in [
        (store / "out", "in the store"),
        (tmp_path / "link" / "out", "in the store"),
        (store.parent, "in the store or around it"),
        (tmp_path, "is not empty"),
        (tmp_path / "mine.txt", "is a file"),
        ("clips", "absolute"),
        ("s3://bucket/clips", "files of this machine alone"),
        ("", "missing"),
    ]:
        answer = client.post("/api/export", json={"folder": str(folder)})
        assert answer.status_code == 400, folder
        assert problem in answer.json()["error"]["message"]
    assert sorted(store.iterdir()) == before
    assert not (tmp_path / "out").exists()


def test_a_server_that_is_read_only_plans_and_writes_nothing(connect: Connect, tmp_path: Path) -> None:
    client = connect(read_only=True)
    asked = {"folder": str(tmp_path / "set")}
    assert plan(client, **asked)["clips"] == 11
    assert client.post("/api/export", json=asked).status_code == 403
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize(
    ("asked", "status", "problem"),
    [
        ({"how": {"form": "doc"}}, 400, "no export format 'doc'"),
        ({"what": {"kind": "sql", "name": "SELECT 1 AS one"}}, 400, "no column 'take'"),
        ({"what": {"kind": "sql", "name": "COPY takes TO 'x.csv'"}}, 400, ""),
        ({"what": {"kind": "sql"}}, 400, "write a query"),
        ({"what": {"kind": "annotations", "min_confidence": 2}}, 422, "a number from 0 to 1"),
        ({"how": {"split": "actr"}}, 400, "actor"),
        ({"how": {"margin": -1}}, 422, "margin"),
        ({"how": {"margin": "1"}}, 422, "margin"),
        ({"how": {"surprise": 1}}, 422, "surprise"),
        ({"surprise": 1}, 422, "surprise"),
    ],
)
def test_bad_requests_are_explained(connect: Connect, asked: Json, status: int, problem: str) -> None:
    answer = connect().post("/api/export/plan", json=asked)
    assert (answer.status_code, problem in answer.text) == (status, True), answer.text


def test_a_store_that_cannot_be_written_names_the_way_out(connect: Connect, store: Path, tmp_path: Path) -> None:
    refusing = tmp_path / "store"
    shutil.copytree(store, refusing, ignore=shutil.ignore_patterns("jobs", "journal"))
    for name in ("jobs", "labels/journal"):  # where a folder is needed
        (refusing / name).parent.mkdir(exist_ok=True)
        (refusing / name).write_text("in the way")
    client = connect(refusing)
    draw = {"do": "draw", "id": "0" * 32, "class": "hop", "start": 3, "stop": 9}
    take = client.post("/api/takes", json={"limit": 1}).json()["names"][0]
    answer = client.post("/api/labels/decide", json={"take": take, "annotator": "ann", "changes": [draw]})
    assert answer.status_code == 507  # pages keep a decision then
    assert "cannot be written" in answer.json()["error"]["message"]
    job = client.post("/api/export", json={"folder": str(tmp_path / "clips")}).json()["id"]
    found = jobs_of(client.app.app.state.archive).find(job)  # type: ignore[attr-defined]
    deadline = time.monotonic() + 60
    while found.finished is None and time.monotonic() < deadline:
        time.sleep(0.05)
    assert found.state == "failed"
    assert f"{refusing / 'jobs'}: cannot be written" in str(found.problem)
    (refusing / "labels" / "journal").unlink()
    answer = client.post("/api/labels/decide", json={"take": take, "annotator": "ann", "changes": [draw]})
    assert answer.json()["made"] == ["0" * 32]
