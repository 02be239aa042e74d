"""The lock of writers: a second one fails at once or waits, reports for whom, and stops cleanly."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from kinedex.ops.errors import StoreError
from kinedex.storage.index.builder import build_index
from kinedex.storage.lock import Lock, Wait
from kinedex.storage.store.garbage_collection import collect_garbage
from kinedex.storage.store.store import open_store
from tests.storage.made_up import make_store

SECONDS = 60.0
"""Everything here ends within this time."""


def released_later(lock: Lock) -> None:
    threading.Timer(0.3, lock.release).start()


def test_builds_and_collections_wait_for_writers_and_report_for_whom(tmp_path: Path) -> None:
    store = make_store(tmp_path / "store", {"a": 20})
    (store / "index").mkdir(exist_ok=True)
    reports: list[str] = []
    wait = Wait(SECONDS, reports.append)
    released_later(Lock(store / "index" / "lock", "this"))
    build_index(open_store(store), threads=1, wait=wait)
    released_later(Lock(store / "lock", "this"))
    collect_garbage(store, wait=wait)
    assert len(reports) == 2
    assert reports[0].startswith(f"waiting for process {os.getpid()} on ")
    assert f"which writes {store}: 0 s of at most 60 s" in reports[1]


def test_reports_are_repeated_as_a_sign_of_life(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kinedex.storage.lock.REPORT_SECONDS", 0.1)
    reports: list[str] = []
    lock = Lock(tmp_path / "lock", "this")
    with pytest.raises(StoreError, match=r"this one must wait; `--wait 10m` waits for it") as raised:
        Lock(tmp_path / "lock", "this one", Wait(0.5, reports.append, "--wait 10m"))
    assert raised.value.remedy is not None
    assert len(reports) >= 3
    lock.release()


def test_a_process_that_has_ended_is_not_named_as_the_holder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kinedex.storage.lock._NAMED_SECONDS", 0.05)
    lock = Lock(tmp_path / "lock", "this")
    ended = subprocess.run(
        [sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, check=True, timeout=240
    )
    holder = json.loads((tmp_path / "lock").read_text()) | {"pid": int(ended.stdout)}
    (tmp_path / "lock").write_text(json.dumps(holder))
    with pytest.raises(StoreError, match="is being written by another process; this one must wait"):
        Lock(tmp_path / "lock", "this one")
    lock.release()


def test_ctrl_c_ends_a_command_that_waits(tmp_path: Path) -> None:
    store = make_store(tmp_path / "store", {"a": 20})
    command = [sys.executable, "-u", "-m", "kinedex", "gc", str(store), "--wait", "10m"]
    with Lock(store / "lock", "this"):
        waiting = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            assert waiting.stdout is not None
            assert waiting.stdout.readline().startswith(f"waiting for process {os.getpid()} on ")
            waiting.send_signal(signal.SIGINT)
            _, errors = waiting.communicate(timeout=SECONDS)
        finally:
            waiting.kill()
    assert waiting.returncode == 130
    assert errors.startswith("kinedex: stopped")
    assert "Traceback" not in errors


def test_a_run_that_has_begun_waits_rather_than_loses_its_work(tmp_path: Path) -> None:
    from kinedex.pipelines.engine.runner import run_pipeline
    from tests.pipelines.archives import write_archive

    store, locks = tmp_path / "store", []

    class Screen:
        """A display that lets another writer in while the run reads its files."""

        def message(self, text: str) -> None:
            self.said = [*getattr(self, "said", []), text]
            if "waiting for" in text:
                released_later(locks[-1])

        def heading(self, text: str) -> None:
            if "index" in text:
                locks.append(Lock(store / "lock", "this"))

        def __getattr__(self, name: str) -> object:
            from kinedex.console.terminal import Terminal

            return getattr(Terminal(), name)

    screen = Screen()
    source = write_archive(tmp_path / "source", {"x_1.amc": 30})
    run_pipeline("ingest", store, settings={"source": str(source)}, terminal=screen)  # type: ignore[arg-type]
    assert any("waiting for process" in line for line in screen.said)
    locks.append(Lock(store / "lock", "this"))
    with pytest.raises(StoreError.__base__, match="must wait; `wait_seconds=600` waits for it"):
        run_pipeline("ingest", store, settings={"source": str(source)}, force=["index"])
    locks[-1].release()
