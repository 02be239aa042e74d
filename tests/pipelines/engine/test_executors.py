"""Executors: order kept, a bounded number of tasks in flight, and workers that die."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.pipelines.engine import executors
from kinedex.pipelines.engine.executors import DaskExecutor, ProcessExecutor, SerialExecutor, make_executor
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.storage.store.store import open_store
from tests.pipelines.archives import write_archive


def square(number: int) -> int:
    time.sleep(0.02 * (number % 3))
    return number * number


def die_once(task: tuple[str, int]) -> int:
    folder, number = task
    mark = Path(folder) / f"died-{number}"
    if number == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def always_die(number: int) -> int:
    if number == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


@pytest.fixture(scope="module")
def pool() -> Iterator[ProcessExecutor]:
    executor = ProcessExecutor(2)
    yield executor
    executor.close()


def test_results_come_in_the_order_of_the_items(pool: ProcessExecutor) -> None:
    expected = [number * number for number in range(12)]
    assert list(SerialExecutor().map(square, range(12))) == expected
    assert list(pool.map(square, range(12))) == expected
    assert list(pool.map(square, [5])) == [25]
    assert list(pool.map(square, [])) == []


def hears_ctrl_c(_: int) -> bool:
    return signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="signals cannot be blocked here")
def test_ctrl_c_is_for_the_parent_alone() -> None:
    executor = ProcessExecutor(2)
    assert list(executor.map(hears_ctrl_c, [1, 2])) == [False, False]
    assert list(executor.map(hears_ctrl_c, [3])) == [False]  # a single task goes to workers that are there
    executor.close()
    assert list(executor.map(hears_ctrl_c, [4])) == [True]


def test_only_two_tasks_a_worker_are_taken_ahead(pool: ProcessExecutor) -> None:
    taken = []

    def items() -> Iterator[int]:
        for number in range(40):
            taken.append(number)
            yield number

    results = pool.map(square, items())
    next(results)
    assert len(taken) <= 2 * pool.workers + 1
    assert list(results) == [number * number for number in range(1, 40)]


def test_a_workers_death_costs_its_tasks_another_try(tmp_path: Path) -> None:
    executor = ProcessExecutor(2)
    tasks = [(str(tmp_path), number) for number in range(10)]
    assert list(executor.map(die_once, tasks)) == [number * number for number in range(10)]
    executor.close()


def test_a_task_that_always_kills_its_worker_is_named(tmp_path: Path) -> None:
    executor = ProcessExecutor(2)
    done: list[int] = []
    with pytest.raises(KinedexError, match=r"died 3 times on the same task \(2\)"):
        done.extend(executor.map(always_die, range(6)))
    assert done == [0, 1]
    executor.close()


ORPHANS = """
import os, time
from kinedex.pipelines.engine.executors import ProcessExecutor

def who(_):
    time.sleep(0.2)
    return os.getpid()

if __name__ == "__main__":
    executor = ProcessExecutor(2)
    print(*set(executor.map(who, range(4))), flush=True)
    time.sleep(60)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc, which is not here")
def test_workers_do_not_outlive_their_parent(tmp_path: Path) -> None:
    script = tmp_path / "orphans.py"
    script.write_text(ORPHANS)
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[3])}
    parent = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True, env=environment)
    assert parent.stdout is not None
    workers = [int(pid) for pid in parent.stdout.readline().split()]
    assert workers
    parent.kill()
    parent.wait(timeout=240)
    deadline = time.monotonic() + 120
    while any(alive(pid) for pid in workers):
        assert time.monotonic() < deadline, "workers live on without their parent"
        time.sleep(0.1)


def alive(pid: int) -> bool:
    """Return true while a process runs; a zombie does not run."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.slow
def test_a_dask_cluster_does_the_same_and_must_see_the_store(tmp_path: Path) -> None:
    executor = DaskExecutor(2)
    try:
        executor.check(tmp_path / "store")
        assert list((tmp_path / "store").iterdir()) == []
        assert list(executor.map(square, range(9))) == [number * number for number in range(9)]
    finally:
        executor.close()


def test_a_scheduler_that_does_not_answer_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executors, "ANSWER_SECONDS", 0.5)
    with pytest.raises(KinedexError, match="no Dask scheduler answers there"):
        DaskExecutor(1, "tcp://127.0.0.1:9")


def answers(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=1).close()
    except OSError:
        return False
    return True


class Cluster:
    """A Dask scheduler and workers as somebody else would start them: processes of their own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{port}"
        self.processes = [self._start("scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")]
        deadline = time.monotonic() + 120
        while not answers(port):
            assert time.monotonic() < deadline, "the scheduler does not start"
            time.sleep(0.2)

    def add_worker(self) -> subprocess.Popen[bytes]:
        folder = ("--local-directory", str(self.folder))
        self.processes.append(
            self._start("worker", self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard", *folder)
        )
        return self.processes[-1]

    def _start(self, *words: str) -> subprocess.Popen[bytes]:
        environment = os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[3])}
        with open(self.folder / f"{words[0]}.log", "ab") as log:
            return subprocess.Popen([sys.executable, "-m", "dask", *words], stdout=log, stderr=log, env=environment)

    def close(self) -> None:
        for process in reversed(self.processes):
            process.kill()
            process.wait(timeout=240)


def die_if_told(task: tuple[str, int]) -> int:
    """Kill this very process at one task, once."""
    time.sleep(0.05)
    return die_once(task)


@pytest.mark.slow
def test_workers_that_were_started_elsewhere_find_a_store_by_its_relative_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_archive(tmp_path / "archive", {"x_bd_1.amc": 40})
    (tmp_path / "only.yaml").write_text("name: only\nstages: {ingest: {params: {source: archive}}}\n")
    cluster = Cluster(tmp_path)
    try:
        cluster.add_worker()
        monkeypatch.chdir(tmp_path)
        run_pipeline("only.yaml", "store", executor="dask", scheduler=cluster.address)
    finally:
        cluster.close()
    assert open_store(tmp_path / "store").takes()["name"].to_list() == ["x_bd_1"]


@pytest.mark.slow
def test_a_running_cluster_does_the_work_and_outlives_a_workers_death(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(executors, "PATIENCE_SECONDS", 0.5)
    cluster = Cluster(tmp_path)
    try:
        with pytest.raises(KinedexError, match=r"has no workers \(any more\); start some with `dask worker tcp://"):
            DaskExecutor(1, cluster.address)
        monkeypatch.setattr(executors, "PATIENCE_SECONDS", 60.0)
        monkeypatch.setattr(executors, "ANSWER_SECONDS", 60.0)
        cluster.add_worker()
        cluster.add_worker()
        executor = DaskExecutor(1, cluster.address)
        executor.check(tmp_path / "store")
        tasks = [(str(tmp_path), number) for number in range(8)]
        assert list(executor.map(die_if_told, tasks)) == [number * number for number in range(8)]
        assert (tmp_path / "died-3").exists()
        assert [process.poll() for process in cluster.processes].count(-signal.SIGKILL) == 1
        monkeypatch.setattr(executors, "PATIENCE_SECONDS", 0.5)
        (tmp_path / "died-3").unlink()
        with pytest.raises(KinedexError, match="has no workers"):
            list(executor.map(die_if_told, tasks))
        executor.close()
    finally:
        cluster.close()


@pytest.mark.slow
def test_a_worker_that_dies_with_a_finished_result_does_not_stop_the_run_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(executors, "PATIENCE_SECONDS", 60.0)
    monkeypatch.setattr(executors, "ANSWER_SECONDS", 60.0)
    cluster = Cluster(tmp_path)
    try:
        worker = cluster.add_worker()
        executor = DaskExecutor(1, cluster.address)
        wait = executor._wait

        def wait_and_kill(future: object) -> None:
            wait(future)  # type: ignore[arg-type]
            if worker.poll() is None:
                worker.kill()
                worker.wait(timeout=240)
                monkeypatch.setattr(executors, "PATIENCE_SECONDS", 1.0)

        monkeypatch.setattr(executor, "_wait", wait_and_kill)
        with pytest.raises(KinedexError, match=r"has no workers|did not arrive"):
            list(executor.map(square, [3]))
        cluster.add_worker()
        monkeypatch.setattr(executors, "PATIENCE_SECONDS", 30.0)
        assert list(executor.map(square, [3, 4])) == [9, 16]
        executor.close()
    finally:
        cluster.close()


@pytest.mark.slow
def test_a_cluster_that_loses_its_workers_ends_in_an_error_in_every_moment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cluster = Cluster(tmp_path)
    try:
        for seconds in (0.0, 0.05, 0.2, 0.7):
            monkeypatch.setattr(executors, "PATIENCE_SECONDS", 60.0)
            monkeypatch.setattr(executors, "ANSWER_SECONDS", 60.0)
            worker = cluster.add_worker()
            executor = DaskExecutor(1, cluster.address)
            monkeypatch.setattr(executors, "PATIENCE_SECONDS", 1.0)
            killer = threading.Timer(seconds, worker.kill)
            killer.start()
            with pytest.raises(KinedexError, match=r"has no workers|did not arrive"):
                list(executor.map(square, range(1000)))
            killer.join()
            worker.wait(timeout=240)
            executor.close()
    finally:
        cluster.close()


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="processes cannot be stopped here")
def test_a_scheduler_that_hangs_ends_in_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executors, "ANSWER_SECONDS", 60.0)
    cluster = Cluster(tmp_path)
    try:
        cluster.add_worker()
        executor = DaskExecutor(1, cluster.address)
        results = executor.map(square, range(1000))
        assert next(results) == 0
        monkeypatch.setattr(executors, "PATIENCE_SECONDS", 1.0)
        cluster.processes[0].send_signal(signal.SIGSTOP)
        with pytest.raises(KinedexError, match=r"has no workers|did not arrive"):
            list(results)
        cluster.processes[0].send_signal(signal.SIGCONT)
        executor.close()
    finally:
        cluster.close()


@pytest.mark.parametrize(
    ("kind", "workers", "scheduler", "message"),
    [
        ("threads", 1, None, "executor must be one of"),
        ("serial", 0, None, "workers must be"),
        ("serial", 1, "x", "dask"),
    ],
)
def test_wrong_executors_are_refused(kind: str, workers: int, scheduler: str | None, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        make_executor(kind, workers, scheduler)
