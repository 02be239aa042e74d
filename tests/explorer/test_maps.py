"""The map of an archive: computed by a process of its own, kept, stopped when nobody waits, and said when it fails."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import signal
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

import kinedex
from kinedex.explorer import map_processes
from kinedex.explorer.map_processes import MapRun, Maps
from kinedex.explorer.maps import cluster_title
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.inspection import archive_map as service
from kinedex.pipelines.inspection.archive_map import ArchiveMap, Cluster, archive_map, window_seconds, windows
from kinedex.storage.store.store import open_store
from tests.explorer.conftest import Connect, run


@pytest.fixture(scope="module")
def client(connect: Connect) -> TestClient:
    return connect()


def lines(client: TestClient, unit: str) -> list[dict[str, Any]]:
    answer = client.get(f"/api/map?unit={unit}")
    assert answer.status_code == 200, answer.text
    return [json.loads(line) for line in answer.text.splitlines()]


def test_the_map_of_the_page_is_that_of_the_library(client: TestClient, store: Path) -> None:
    *steps, last = lines(client, "takes")
    assert all(set(step) == {"done", "total"} for step in steps)
    found = last["answer"]
    table = kinedex.open_store(store).map()
    assert found["names"] == table["take"].to_list()
    assert np.abs(np.array([found["x"], found["y"]]) - table.select("x", "y").to_numpy().T).max() < 1e-4
    assert [one if one >= 0 else None for one in found["cluster"]] == table["cluster"].to_list()
    assert found["stops"] == [open_store(store).take_frames[take] for take in found["takes"]]
    assert found["remarks"] == []
    assert lines(client, "takes") == [last], "it is kept"
    assert "store.map()" in found["python"]


def test_values_of_takes_say_which_fit(client: TestClient, store: Path) -> None:
    rows = open_store(store).sql('SELECT "class", actor, frames FROM takes ORDER BY take_id').to_pylist()
    body = {"column": "class", "filters": [{"column": "actor", "values": ["al"]}]}
    found = client.post("/api/map/takes", json=body).json()
    texts = {-1: None, **dict(enumerate(found["values"]))}
    expected = [row["class"] if row["actor"] == "al" else "hidden" for row in rows]
    assert [texts.get(code, "hidden") for code in found["codes"]] == expected
    assert found["values"] == client.post("/api/map/takes", json={"column": "class"}).json()["values"]
    numbers = client.post("/api/map/takes", json=body | {"column": "frames"}).json()
    assert numbers["fits"] == [int(row["actor"] == "al") for row in rows]
    assert numbers["numbers"] == [row["frames"] for row in rows]


def test_without_scikit_learn_the_error_has_the_command(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setitem(__import__("sys").modules, "sklearn", None)
    answer = client.get("/api/map?unit=takes")
    assert answer.status_code == 400
    assert "pip install 'kinedex[map]'" in answer.json()["error"]["message"]
    assert client.get("/api/map?unit=frames").status_code == 422


def wait_long(pipe: Any, *_: object) -> None:
    """Stand for a computation that takes long: it has reported one step."""
    pipe.send((50, 1000))
    time.sleep(300)


def end_at_once(*_: object) -> None:
    """Stand for a process that the system kills."""
    raise SystemExit(3)


async def _next(stream: AsyncIterator[Any]) -> Any:
    async with asyncio.timeout(120):
        found = await anext(stream)
        while found == (0, 0):
            found = await anext(stream)
        return found


def test_a_computation_ends_when_the_last_who_waits_has_gone(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_processes, "_compute", wait_long)

    async def follow() -> None:
        maps, opened = Maps(), open_store(store)
        first, second = maps.find(opened, "takes"), maps.find(opened, "takes")
        assert await _next(first) == await _next(second) == (50, 1000)
        (run,) = maps._running.values()
        assert run.waiting == 2
        await first.aclose()
        assert run.reader.is_alive()
        await second.aclose()
        run.reader.join(60)
        assert not run.reader.is_alive()
        assert run._process.exitcode == -signal.SIGTERM
        assert maps._running == {}

    run(follow())


def _fault(start: Callable[[], MapRun]) -> str:
    run = start()
    end = time.monotonic() + 120
    while not run.done and time.monotonic() < end:
        time.sleep(0.05)
    assert isinstance(run.fault, KinedexError)
    return str(run.fault)


def test_a_process_that_fails_or_is_killed_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nowhere: Any = SimpleNamespace(path=tmp_path / "nowhere", manifest=SimpleNamespace(version=1))
    assert "nowhere" in _fault(lambda: MapRun(nowhere, "takes"))
    monkeypatch.setattr(map_processes, "_compute", end_at_once)
    assert "ended without a result (exit code 3)" in _fault(lambda: MapRun(nowhere, "takes"))


def test_windows_cover_every_frame_once_and_are_longer_where_there_are_many(
    store: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = np.array([10, 1, 401, 119])
    owner, bounds = windows(frames, 40.0)
    assert np.bincount(owner).tolist() == [1, 1, 10, 3]
    assert bounds[0] == 0
    assert bounds[-1] == frames.sum()
    assert np.isin(np.cumsum(frames), bounds).all()
    lengths = np.diff(bounds)
    assert lengths[owner == 2].min() >= lengths[owner == 2].max() - 1
    monkeypatch.setattr(service, "MAX_POINTS", 8)
    assert window_seconds(frames, 10.0) == 8.0
    assert window_seconds(np.full(9, 5), 10.0) == 4.0, "there are no fewer windows than takes"
    opened = open_store(store)
    found = archive_map(opened, "windows")
    assert sum(found.stops - found.starts) == sum(opened.take_frames.values())


def test_remarks_say_what_is_not_as_expected() -> None:
    none = np.zeros(7, np.int64)
    places = np.zeros((7, 2), np.float32)
    found = ArchiveMap(none, none, none, places, none, (), 5, 8.0)
    assert found.remarks == (
        "Windows are of 8 s: of 4 s there would be more than 100,000.",
        "5 of 7 windows, drawn at random, were laid out; each of the others lies beside the one of these whose words "
        "are most like its own.",
    )


@pytest.mark.parametrize(
    ("classes", "title"),
    [
        ([("kick", 6), ("walk", 4)], "kick"),
        ([("kick", 4), ("walk", 4), (None, 3)], "kick and walk"),
        ([(None, 8), ("kick", 2)], "no class"),
        ([("a", 3), ("b", 2), ("c", 2), ("d", 2), ("e", 2)], "mixed, a first"),
    ],
)
def test_a_cluster_is_called_by_its_classes(classes: list[tuple[str | None, int]], title: str) -> None:
    takes = sum(count for _, count in classes)
    assert cluster_title(Cluster(takes, takes, 1.0, (), tuple(classes), (), np.zeros((0, 2), np.float32))) == title
