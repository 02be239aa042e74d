"""Learning again from the page: a job of the command line, what it changed, and the way back."""

from __future__ import annotations

import os
import shutil
import time
import uuid
from pathlib import Path
from typing import Any

import pytest
import yaml
from starlette.testclient import TestClient

import kinedex
from kinedex.explorer.jobs import Job, Jobs
from kinedex.explorer.learning import LearnRequest, classes_with, learning_stages
from kinedex.explorer.open_archive import Archive
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.stages import annotate
from kinedex.storage.index.builder import build_index
from kinedex.storage.store.store import open_store
from tests.explorer.conftest import Connect
from tests.pipelines.labelled import long_take, write_store

Json = dict[str, Any]
SECONDS = 120


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of takes without a class, in one of which a person has labelled a walk and a kick."""
    names = ("ann", "bob", "cat")
    takes = [long_take(f"{one}_take", one, "rest", "walk", "rest", "kick", "rest") for one in names]
    path = write_store(tmp_path_factory.mktemp("learning") / "store", takes)
    build_index(open_store(path, at="newest"))
    rows = [{"take": "ann_take", "class": "walk", "start": 5, "stop": 25}]
    rows += [{"take": "ann_take", "class": "kick", "start": 30, "stop": 55}]
    kinedex.open_store(path).labels.add(rows, annotator="ann")
    return path


def fail(*_: object) -> None:
    raise KinedexError("the power is gone")


def wait_for(client: TestClient, id: str) -> Json:
    """Return a job when it has ended."""
    deadline = time.monotonic() + SECONDS
    while time.monotonic() < deadline:
        (job,) = (one for one in client.get("/api/jobs").json()["jobs"] if one["id"] == id)
        if job["state"] not in ("waiting", "running"):
            found: Json = job
            return found
        time.sleep(0.1)
    raise AssertionError("the job did not end")


def test_few_labels_alone_annotate_an_archive_and_it_can_be_undone(
    connect: Connect, archive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = connect(archive)
    facts = client.get("/api/learn").json()
    assert (facts["based_on"], facts["examples"], facts["method"], facts["last"]) == (None, "labels", "best", None)
    stages = learning_stages(open_store(archive), LearnRequest())
    assert stages["annotate"]["params"]["each_example"]
    assert stages["learn_templates"]["params"]["methods"] == ["soft"]
    thesis = learning_stages(open_store(archive), LearnRequest(method="thesis"))
    assert not thesis["annotate"]["params"]["each_example"]
    numeric = learning_stages(open_store(archive), LearnRequest(method="numeric"))["annotate"]["params"]
    assert (numeric["method"], numeric["each_example"], numeric["store_curves"]) == ("numeric", False, False)
    started = client.post("/api/learn", json={})
    assert started.status_code == 200, started.text
    assert client.post("/api/learn", json={}).status_code == 409
    job = wait_for(client, started.json()["id"])
    log = client.get(f"/api/jobs/{job['id']}/log").json()["text"]
    assert job["state"] == "done", log
    assert (job["done"], job["total"], job["share"]) == (2, 2, 1.0)
    assert "learn_templates" in log
    changes = client.get("/api/learn/changes").json()
    assert changes["takes"] == 3
    assert {row["class"] for row in changes["rows"]} == {"walk", "kick"}
    assert {row["change"] for row in changes["rows"]} == {"added"}
    assert client.get("/api/labels").json()["learned"]["since"] == 0
    found = kinedex.open_store(archive).results("annotations")
    assert found.filter(found["take"] == "cat_take").height == 2
    # a run that ends in the middle leaves what was there, and the page shows it
    kinedex.open_store(archive).labels.add([{"take": "bob_take", "class": "kick", "start": 30, "stop": 55}])
    monkeypatch.setattr(annotate, "annotate_stored", fail)
    with pytest.raises(KinedexError, match="the power is gone"):
        run_pipeline(archive / "jobs" / "learn-again.yaml", archive)
    assert kinedex.open_store(archive).results("annotations").equals(found)
    assert client.get("/api/learn").json()["based_on"] == "learn-again/annotate"
    assert client.post("/api/labels/queue", json={}).json()["total"] == found.height
    client.post("/api/learn/undo", json={})
    undone = client.get("/api/jobs").json()["jobs"][-1]
    assert undone["command"].endswith(f"learn-again --at {changes['last']['before']} --wait 10m")
    assert wait_for(client, undone["id"])["state"] == "done"
    assert kinedex.open_store(archive).results("annotations").height == 0
    assert client.get("/api/learn").json()["last"]["undone"]
    assert client.post("/api/learn/undo", json={}).status_code == 400


def test_the_share_of_a_job_that_is_done_follows_the_time_that_its_stages_take() -> None:
    job = Job("learn", (), 2, weights=(1.0, 20.0), done=1, part=0.5)
    assert job.shown()["share"] == pytest.approx(11 / 21)
    assert Job("run", (), 2, done=1, part=0.5).shown()["share"] == 0.75
    assert Job("export", (), part=0.5).shown()["share"] == 0.5
    assert Job("begin", ()).shown()["share"] is None


def test_a_job_that_waits_or_runs_is_stopped(archive: Path) -> None:
    opened = Archive(archive)
    jobs = Jobs(opened)
    first = jobs.add(
        Job("first", ("sql", str(archive), "SELECT count(*) FROM range(100000000000)", "--timeout", "100s"))
    )
    second = jobs.add(Job("second", ("takes", "list", str(archive))))
    deadline = time.monotonic() + SECONDS
    while not (jobs.log_file(first).is_file() and first.state == "running") and time.monotonic() < deadline:
        time.sleep(0.05)
    jobs.stop(second)
    assert second.state == "stopped"
    jobs.end()
    assert first.state == "stopped"
    assert first.finished is not None


@pytest.mark.skipif(os.name == "nt", reason="there is no group of processes to end")
def test_a_job_that_ignores_the_stop_is_ended_by_force(archive: Path, tmp_path: Path) -> None:
    jobs = Jobs(Archive(archive))
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)  # reading it waits for ever, and a wait of the system hears no Ctrl-C in all libraries
    job = jobs.add(Job("waits", ("labels", "import", str(archive), str(pipe))))
    deadline = time.monotonic() + SECONDS
    while not (jobs._process is not None and jobs.log_file(job).is_file()) and time.monotonic() < deadline:
        time.sleep(0.05)
    jobs.stop(job, force=True)
    while job.finished is None and time.monotonic() < deadline:
        time.sleep(0.05)
    assert (job.state, job.problem) == ("stopped", None)
    jobs.end()


def test_jobs_go_on_when_the_store_is_gone(archive: Path, tmp_path: Path) -> None:
    path = Path(shutil.copytree(archive, tmp_path / "store"))
    jobs = Jobs(Archive(path))
    words = ("use", str(path), "own")
    first = jobs.add(Job("removes the store", words, check=lambda: shutil.rmtree(path)))
    second = jobs.add(Job("comes later", words))
    deadline = time.monotonic() + SECONDS
    while second.finished is None and time.monotonic() < deadline:
        time.sleep(0.05)
    assert [(job.state, job.version) for job in (first, second)] == [("failed", None)] * 2
    jobs.end()


def test_a_job_that_fails_names_its_problem(connect: Connect, archive: Path) -> None:
    jobs = Jobs(Archive(archive))
    job = jobs.add(Job("wrong", ("use", str(archive), f"none-{uuid.uuid4().hex}")))
    deadline = time.monotonic() + SECONDS
    while job.finished is None and time.monotonic() < deadline:
        time.sleep(0.05)
    assert job.state == "failed"
    assert job.problem is not None
    assert "no pipeline" in job.problem
    jobs.end()
    assert connect(archive, read_only=True).post("/api/learn", json={}).status_code == 403


def test_a_class_file_gets_the_classes_that_people_have_labelled() -> None:
    classes = {"kick": ["kick*"], "squat": {"description": "down", "subclasses": ["squat1Reps"]}}
    assert classes_with(classes, ["kickLeft", "squat1Reps"]) is None
    text = classes_with(classes, ["squat", "walk [slow]"])
    assert text is not None
    assert yaml.safe_load(text) == {
        "kick": {"subclasses": ["kick*"]},
        "squat": {"description": "down", "subclasses": ["squat1Reps", "squat"]},
        "walk [slow]": {"description": "labelled by people", "subclasses": ["walk [[]slow]"]},
    }


def test_a_process_that_waits_runs_the_next_job_that_learns(archive: Path) -> None:
    jobs = Jobs(Archive(archive))
    jobs.prepare()
    spare = jobs._spare
    assert spare is not None
    jobs.prepare()
    assert jobs._spare is spare  # one is enough
    other = jobs.add(Job("takes", ("takes", "list", str(archive))))
    first = jobs.add(Job("learn", ("takes", "list", str(archive)), learns=True))
    second = jobs.add(Job("learn", ("takes", "lust", str(archive)), learns=True))
    deadline = time.monotonic() + SECONDS
    while second.finished is None and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not spare.waits  # it has run the first one
    assert (other.state, first.state, second.state) == ("done", "done", "failed")
    shown, known = (jobs.log_file(one).read_text().splitlines() for one in (first, other))
    assert shown == known
    assert "ann_take" in "\n".join(known)
    assert "unexpected extra argument" in str(second.problem)
    jobs.prepare()
    jobs.end()
    jobs.prepare()
    assert jobs._spare is None  # the server has ended
