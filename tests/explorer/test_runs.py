"""The server side of the Runs page: pipelines, plans, starts, the history, reports in a sandbox, and metrics."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import pytest

from kinedex.console.terminal import Terminal
from kinedex.explorer.jobs import Job, Jobs, jobs_of
from kinedex.explorer.open_archive import Archive
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.storage.store.store import open_store
from tests.explorer.conftest import Connect
from tests.pipelines.labelled import clip, long_take, write_store

PIPELINE = """
name: own
description: Templates alone.
stages:
  learn_templates: {params: {where: "${train}"}}
settings: {train: class IS NOT NULL, needed: }
"""


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store on which a pipeline of its own has run twice, the second time with nothing to do but one stage."""
    folder = tmp_path_factory.mktemp("runs")
    takes = [clip(name, actor, 1) for name in ("kick", "walk") for actor in ("al", "bo")]
    path = write_store(folder / "a store", [*takes, long_take("al_long", "al", "walk", "kick")])
    (folder / "own.yaml").write_text(PIPELINE)
    run_pipeline(folder / "own.yaml", path, terminal=Terminal())
    return path


def own(path: Path) -> str:
    return str(path.parent / "own.yaml")


def test_pipelines_are_the_shipped_ones_and_those_that_the_store_has_run(connect: Connect, archive: Path) -> None:
    found = {one["id"]: one for one in connect(archive).get("/api/pipelines").json()["pipelines"]}
    assert {"annotate", "ingest", own(archive)} <= set(found)
    annotate = found["annotate"]
    assert annotate["shipped"]
    assert {"name": "source", "default": None, "last": None} in annotate["settings"]
    assert found[own(archive)]["name"] == "own"
    assert [one["name"] for one in found[own(archive)]["settings"]] == ["train", "needed"]
    assert all(one["problem"] is None for one in found.values())


def test_a_plan_has_its_reasons_and_names_the_setting_that_is_wrong(connect: Connect, archive: Path) -> None:
    client = connect(archive, read_only=True)
    plan = client.post("/api/runs/plan", json={"pipeline": own(archive)}).json()
    assert [(one["stage"], one["reason"]) for one in plan["stages"]] == [("learn_templates", None)]
    changed = {"pipeline": own(archive), "settings": {"train": "actor = 'al'"}}
    (step,) = client.post("/api/runs/plan", json=changed).json()["stages"]
    assert step["reason"].startswith("its parameters changed")
    for settings, name in (
        ({}, "source"),
        ({"source": "/nowhere at all"}, "source"),
        ({"source": ".", "nothing": "1"}, "nothing"),
        ({"source": ".", "patterns": "7"}, "patterns"),
        ({"source": ".", "annotate.tau": "much"}, "annotate.tau"),
    ):
        problem = client.post("/api/runs/plan", json={"pipeline": "annotate", "settings": settings}).json()["problem"]
        assert problem["setting"] == name, problem
    assert client.post("/api/runs/plan", json={"pipeline": "/etc/passwd"}).status_code == 404


def test_a_run_is_started_with_its_settings_as_single_words(
    connect: Connect, archive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    added: list[Job] = []
    monkeypatch.setattr(Jobs, "add", lambda _self, job: added.append(job) or job)
    client = connect(archive)
    text = "actor = 'al'; $(touch /tmp/x) --force"
    started = client.post("/api/runs", json={"pipeline": own(archive), "settings": {"train": text}})
    assert started.status_code == 200, started.text
    (job,) = added
    assert job.words[:6] == ("run", own(archive), "--store", str(archive), "--set", f"train={text}")
    assert (job.title, job.steps) == ("Run own", 1)
    for settings in ({"--force": "1"}, {"train": "a\0b"}, {"nothing": "1"}):
        refused = client.post("/api/runs", json={"pipeline": own(archive), "settings": settings})
        assert refused.status_code in (400, 422), settings
    assert len(added) == 1
    read_only = connect(archive, read_only=True)
    assert read_only.post("/api/runs", json={"pipeline": own(archive)}).status_code == 403


def test_a_run_with_nothing_to_do_ends(connect: Connect, archive: Path) -> None:
    opened = Archive(archive)
    jobs = jobs_of(opened)
    job = jobs.add(Job("Run own", ("run", own(archive), "--store", str(archive), "--executor", "serial"), 1))
    deadline = time.monotonic() + 60
    while job.finished is None and time.monotonic() < deadline:
        time.sleep(0.05)
    jobs.end()
    assert job.state == "done", job.problem
    assert job.done == 1


def test_the_history_names_what_ran_and_why(connect: Connect, archive: Path) -> None:
    found = connect(archive).get("/api/runs").json()
    assert found["total"] == len(found["runs"])
    run = found["runs"][-1]
    assert (run["pipeline"], run["state"], run["current"]) == ("own", "finished", True)
    assert run["version"] <= open_store(archive).manifest.version
    assert [(one["stage"], one["state"], one["reason"]) for one in run["stages"]] == [
        ("learn_templates", "ran", "has not run yet")
    ]
    assert connect(archive).get("/api/runs/metrics").json()["rows"] == []


def test_reports_of_the_store_alone_are_served_in_a_sandbox(
    connect: Connect, archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = tmp_path / "store"
    shutil.copytree(archive, copy)
    folder = copy / "results" / "reports" / "own"
    folder.mkdir(parents=True)
    (folder / "report.html").write_text("<script>1</script>")
    (folder / "other.html").write_text("written by nobody")
    (tmp_path / "secret.html").write_text("secret")
    (folder / "link.html").symlink_to(tmp_path / "secret.html")
    names = ["own/report.html", "own/link.html", "../../../secret.html"]
    monkeypatch.setattr("kinedex.explorer.runs.report_names", lambda _archive: {("own/learn_templates", "1"): names})
    client = connect(copy)
    answer = client.get("/api/reports/own/report.html")
    assert answer.status_code == 200, answer.text
    assert answer.headers["content-type"].startswith("text/html")
    policy = answer.headers["content-security-policy"]
    assert policy.startswith("sandbox allow-scripts; default-src 'none'")
    assert "allow-same-origin" not in policy
    assert answer.headers["cross-origin-opener-policy"] == "unsafe-none"
    for name in ("own/other.html", "own/link.html", "..%2f..%2f..%2fsecret.html", "own/none.html"):
        assert client.get(f"/api/reports/{name}").status_code == 404, name
    assert connect(copy, token=None).get("/api/reports/own/report.html").status_code == 401
