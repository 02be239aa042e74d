"""Ingest under fire: defects, lack of memory, dead workers, full disks, vanishing files, links, odd names, strict."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from kinedex.commands.cli import app
from kinedex.ops.errors import KinedexError, StoreError
from kinedex.pipelines.engine.executors import SerialExecutor, WorkerDied
from kinedex.pipelines.ingestion import file_batches as reading
from kinedex.pipelines.ingestion import read_passes
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.formats.motion.reader import Body
from kinedex.storage.formats.motion.reader_table import read_body
from kinedex.storage.index.builder import build_index
from kinedex.storage.store.compaction import FANOUT
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import verify
from tests.pipelines.archives import context, human_amc, write_archive

ROOT = Path(__file__).resolve().parents[2]
TAKES = {f"x_{number}.amc": 9 + number for number in range(5)}


@pytest.fixture
def source(tmp_path: Path) -> Path:
    return write_archive(tmp_path / "source", TAKES)


@pytest.fixture
def store(tmp_path: Path) -> Path:
    return tmp_path / "store"


@pytest.fixture
def a_batch_per_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(read_passes, "MEGABYTE", 1)


def bring_in(store: Path, source: Path, executor: SerialExecutor | None = None, **params: Any) -> dict[str, object]:
    place = context(store)
    if executor is not None:
        place = replace(place, executor=executor)
    return Ingest().run(place, Ingest.parameters(source=str(source), **params))


def log(store: Path) -> list[dict[str, Any]]:
    return open_store(store).result("ingest_log").to_pylist()


def names(store: Path | Store) -> list[str]:
    return (store if isinstance(store, Store) else open_store(store)).takes()["name"].to_list()


def meet(monkeypatch: pytest.MonkeyPatch, bad: str, fault: BaseException) -> None:
    """Let the reader meet an error in one file."""

    def read(path: Path, *rest: Any) -> Body:
        if path.name == bad:
            raise fault
        return read_body(path, *rest)

    monkeypatch.setattr(reading, "read_body", read)


@pytest.mark.parametrize(
    ("fault", "error", "text"),
    [
        (IndexError("list index out of range"), "IndexError", "this is a defect of kinedex"),
        (ZeroDivisionError("division by zero"), "ZeroDivisionError", "please report it"),
        (MemoryError(), "MemoryError", "not enough memory for this file of 0.0 MB; run with fewer workers"),
        (PermissionError(13, "Permission denied"), "PermissionError", "cannot be read: Permission denied"),
        (RecursionError("maximum recursion depth exceeded"), "RecursionError", "recursion depth"),
        (KinedexError("rate must be positive"), "KinedexError", "x_2.amc: rate must be positive"),
    ],
)
def test_whatever_one_file_brings_about_is_logged_and_the_others_come_in(
    store: Path, source: Path, monkeypatch: pytest.MonkeyPatch, fault: Exception, error: str, text: str
) -> None:
    meet(monkeypatch, "x_2.amc", fault)
    summary = bring_in(store, source)
    assert (summary["takes"], summary["read"], summary["left_out"]) == (4, 4, 1)
    (row,) = log(store)
    assert (row["source"], row["error"], row["file"]) == ("x_2.amc", error, str(source / "x_2.amc"))
    assert text in row["message"]
    assert str(source / "x_2.amc") in row["message"]
    monkeypatch.undo()
    assert bring_in(store, source)["read"] == 1
    assert log(store) == []


def test_a_stop_by_the_user_is_a_stop(store: Path, source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    meet(monkeypatch, "x_2.amc", KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        bring_in(store, source)
    assert list(store.rglob(".tmp-*")) == []


class DyingExecutor(SerialExecutor):
    """Workers that die whenever they read a file of this name."""

    def map(self, function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        for item in items:
            if any(task.name == "x_3" for task in getattr(item, "tasks", ())):
                raise WorkerDied("a worker process died 3 times")
            yield function(item)


def test_a_file_that_kills_every_worker_is_found_and_logged_and_the_rest_comes_in(store: Path, source: Path) -> None:
    assert bring_in(store, source, DyingExecutor())["left_out"] == 1
    assert names(store) == ["x_0", "x_1", "x_2", "x_4"]
    (row,) = log(store)
    assert (row["source"], row["error"]) == ("x_3.amc", "WorkerDied")
    assert "needs more memory than there is: run with fewer workers" in row["message"]
    assert verify(open_store(store, at="newest")) == []


def test_a_file_that_vanishes_after_the_listing_is_logged(
    store: Path, source: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    really = read_passes.run_batches

    def vanish(*rest: Any) -> Any:
        (source / "x_1.amc").unlink()
        return really(*rest)

    monkeypatch.setattr(read_passes, "run_batches", vanish)
    assert bring_in(store, source)["takes"] == 4
    (row,) = log(store)
    assert "x_1.amc: cannot be read: No such file or directory" in row["message"]


def test_strict_stops_at_the_first_failure_keeps_what_came_before_and_logs_it(
    store: Path, source: Path, a_batch_per_file: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in (2, 4):
        (source / f"x_{number}.amc").write_text("no motion")
    opened: list[str] = []

    def read(path: Path, *rest: Any) -> Body:
        opened.append(path.stem)
        return read_body(path, *rest)

    monkeypatch.setattr(reading, "read_body", read)
    with pytest.raises(KinedexError, match=r"x_2\.amc:1: .*\n\(strict: stopped at this file"):
        bring_in(store, source, strict=True)
    assert opened == [*names(store), "x_2"] == ["x_0", "x_1", "x_2"]
    assert [row["source"] for row in log(store)] == ["x_2.amc"]
    (source / "x_2.amc").write_text(human_amc(9, seed=2))
    (source / "x_4.amc").write_text(human_amc(9, seed=4))
    assert bring_in(store, source, strict=True)["read"] == 3
    assert log(store) == []


def test_strict_stops_inside_a_batch_and_before_anything_is_read_or_pruned(store: Path, source: Path) -> None:
    (source / "x_2.amc").write_text("no motion")
    with pytest.raises(KinedexError, match=r"x_2\.amc:1"):
        bring_in(store, source, strict=True)
    assert names(store) == ["x_0", "x_1"]
    (source / "x_0.amc").unlink()
    (source / "y_3.amc").write_text(human_amc(9, seed=2))
    with pytest.raises(KinedexError, match="no ASF skeleton whose whole name begins 'y_3'"):
        bring_in(store, source, strict=True, prune=True)
    assert names(store) == ["x_0", "x_1"]
    assert [row["source"] for row in log(store)] == ["y_3.amc"]


@pytest.mark.parametrize("moment", [1, 2, 3])
def test_a_disk_that_fills_up_ends_the_run_with_a_clear_error_and_the_next_run_goes_on(
    store: Path, source: Path, a_batch_per_file: None, monkeypatch: pytest.MonkeyPatch, moment: int
) -> None:
    # the first batch flushes its frames part, its takes part and its manifest, each with its folder
    left = 6 + moment - 1
    really = os.fsync

    def fsync(descriptor: int) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        really(descriptor)

    context(store).writer().close()
    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(StoreError, match=r"cannot be written: No space left on device.*`kinedex gc"):
        bring_in(store, source)
    monkeypatch.undo()
    assert names(store) == ["x_0"]
    assert list(store.rglob(".tmp-*")) == []
    assert bring_in(store, source)["takes"] == 5
    assert verify(open_store(store, at="newest")) == []


def on_a_small_disk(disk: str, source: str) -> None:
    """Ingest onto a disk that is too small, and again once it is larger; prints what happens, for the test below."""

    def mount(*options: str) -> int:
        return subprocess.run(["mount", *options, disk], check=False, timeout=240).returncode

    def kinedex(*words: str) -> None:
        try:
            app([*words])
        except SystemExit as end:
            print(f"code {end.code} of {words[0]}", flush=True)

    store = f"{disk}/store"
    if mount("-t", "tmpfs", "-o", "size=400k", "none"):
        sys.exit(77)
    kinedex("ingest", store, source, "--executor", "serial", "--set", "ingest.batch_mb=1")
    print(*Path(store).rglob(".tmp-*"))
    kinedex("verify", store)
    mount("-o", "remount,size=100m")
    kinedex("ingest", store, source, "--executor", "serial")
    kinedex("verify", store)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("unshare") is None, reason="no unshare here, which lets a test mount a small disk")
def test_a_disk_that_is_really_full_costs_nothing_but_time(tmp_path: Path) -> None:
    source = write_archive(tmp_path / "source", {f"x_{number:02}.amc": 900 for number in range(8)})
    (tmp_path / "disk").mkdir()
    run = "import sys; from tests.pipelines import test_ingest_faults as t; t.on_a_small_disk(*sys.argv[1:])"
    words = ["unshare", "-rm", sys.executable, "-c", run, tmp_path / "disk", source]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=ROOT, timeout=240)
    if done.returncode == 77 or "unshare failed" in done.stderr:
        pytest.skip("this machine lets nobody mount a small disk")
    codes = [line for line in done.stdout.splitlines() if line.startswith("code")]
    assert codes == [f"code {code}" for code in ("1 of ingest", "0 of verify", "0 of ingest", "0 of verify")], (
        done.stderr
    )
    assert "cannot be written: No space left on device; nothing was committed" in done.stderr
    assert "the same command again: it goes on where it was" in done.stderr
    assert ".tmp-" not in done.stdout
    before, after = (line for line in done.stdout.splitlines() if line.endswith("all sound"))
    assert 0 < int(before.split(" takes")[0].split()[-1]) < 8
    assert "8 takes" in after


def test_a_name_that_is_not_utf_8_comes_in_is_known_again_and_can_be_asked_for(store: Path, source: Path) -> None:
    for name, text in ((b"x_caf\xe9.amc", human_amc(9, seed=3)), (b"x_th\xe9.amc", "no motion")):
        try:
            with open(os.fsencode(source) + b"/" + name, "w") as file:
                file.write(text)
        except OSError:
            pytest.skip("this file system takes UTF-8 names only")
    summary = bring_in(store, source)
    assert (summary["takes"], summary["left_out"]) == (6, 1)
    (row,) = log(store)
    assert row["source"] == r"x_th\xe9.amc"
    assert r"x_th\xe9.amc:1" in row["message"]
    opened = open_store(store)
    build_index(opened)
    found = opened.sql("SELECT source FROM takes WHERE name = ?", [r"x_caf\xe9"]).to_pylist()
    assert found == [{"source": r"x_caf\xe9.amc"}]
    assert bring_in(store, source)["unchanged"] == 6


def test_a_link_out_of_the_source_is_logged_and_not_followed(store: Path, source: Path, tmp_path: Path) -> None:
    outside = write_archive(tmp_path / "outside", {"x_9.amc": 5})
    (source / "x_9.amc").symlink_to(outside / "x_9.amc")
    assert bring_in(store, source)["takes"] == 5
    (row,) = log(store)
    assert (row["source"], row["file"]) == ("x_9.amc", str(source / "x_9.amc"))
    assert f"is a link to {outside / 'x_9.amc'}, outside the source" in row["message"]


def test_takes_are_not_pruned_because_their_folder_cannot_be_read(
    store: Path, source: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (source / "away").mkdir()
    (source / "x_4.amc").rename(source / "away/x_4.amc")
    bring_in(store, source)
    (source / "x_3.amc").unlink()
    really = os.scandir

    def scandir(path: str) -> Any:
        if str(path).endswith("/away"):
            raise PermissionError(13, "Permission denied", str(path))
        return really(path)

    monkeypatch.setattr(os, "scandir", scandir)
    summary = bring_in(store, source, prune=True)
    assert (summary["dropped"], summary["left_out"]) == (1, 1)
    assert names(store) == ["x_0", "x_1", "x_2", "x_4"]
    assert log(store)[0]["message"] == f"{source}/away: the folder cannot be read: Permission denied"


def test_the_parts_of_many_batches_are_compacted_at_the_end_and_a_few_more_files_cost_a_few(
    store: Path, tmp_path: Path, a_batch_per_file: None
) -> None:
    source = write_archive(tmp_path / "source", {f"x_{number:02}.amc": 33 for number in range(FANOUT)})
    bring_in(store, source)
    first = open_store(store)
    assert len(first.manifest.frames) == len(first.manifest.takes) == 1
    build_index(first)
    assert verify(first) == []
    write_archive(source, {"x_90.amc": 33, "x_91.amc": 33})
    assert bring_in(store, source)["read"] == 2
    later = open_store(store, at="newest")
    assert first.manifest.frames[0] in later.manifest.frames
    assert len(later.manifest.frames) == 3
