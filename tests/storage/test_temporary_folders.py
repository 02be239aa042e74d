"""Temporary folders: removed at the end, and those of killed processes by the next process."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from kinedex.storage import temporary_folders
from kinedex.storage.temporary_folders import temporary_folder

HOLDS = """
import sys, time
from kinedex.storage.temporary_folders import temporary_folder
with temporary_folder() as folder:
    (folder / "walk.bvh").write_text("HIERARCHY")
    print(folder, flush=True)
    time.sleep(60)
"""


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    temporary_folders._remove_abandoned.cache_clear()
    return tmp_path


def test_a_folder_is_empty_and_goes_with_all_that_is_in_it(place: Path) -> None:
    with temporary_folder() as folder, temporary_folder() as other:
        assert folder != other
        assert os.listdir(folder) == []
        (folder / "deep").mkdir()
        (folder / "deep/file").write_text("1")
    assert os.listdir(place) == []


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_the_folder_of_a_killed_process_is_removed_by_the_next_and_that_of_a_running_one_stays(place: Path) -> None:
    environment = os.environ | {"TMPDIR": str(place)}
    command = [sys.executable, "-c", HOLDS]
    running, killed = (subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(2))
    try:
        kept, left = (Path(one.stdout.readline().strip()) for one in (running, killed) if one.stdout is not None)
        killed.send_signal(signal.SIGKILL)
        killed.wait(timeout=60)
        assert (left / "walk.bvh").is_file()
        with temporary_folder():
            assert not left.exists()
            assert (kept / "walk.bvh").is_file()
    finally:
        running.kill()
        running.wait(timeout=60)
    temporary_folders._remove_abandoned.cache_clear()
    with temporary_folder():
        pass
    assert os.listdir(place) == []


@pytest.mark.skipif(sys.platform == "win32", reason="links")
def test_a_link_in_place_of_a_lock_removes_nothing(place: Path) -> None:
    (place / "mine").mkdir()
    (place / "mine/walk.bvh").write_text("1")
    (place / f"{temporary_folders.PREFIX}x").symlink_to(place / "mine")
    (place / f"{temporary_folders.PREFIX}x.lock").symlink_to(place / "mine/walk.bvh")
    with temporary_folder():
        pass
    assert (place / "mine/walk.bvh").is_file()
