"""Ctrl-C, time limits and row limits of SQL: statements end, also those that DuckDB does not stop."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from kinedex.ops.errors import ParameterError
from kinedex.storage import interruption
from kinedex.storage.ctrl_c import ctrl_c_in_statements
from kinedex.storage.duckdb_sql import connect, rows
from kinedex.storage.index.builder import build_index
from kinedex.storage.interruption import TimeLimitError, abandoned_statements
from kinedex.storage.sql import queries
from kinedex.storage.store.store import Store, open_store
from tests.storage.made_up import make_store

SECONDS = 60
"""Bound of every wait of these tests."""

MANY_ROWS = "SELECT count(*) FROM range(1000000) AS a, range(1000000) AS b"
ONE_FUNCTION = "SELECT damerau_levenshtein(repeat('a', 30000), repeat('b', 30000 + i::INT)) FROM range(100) AS t(i)"
BRIEF_FUNCTION = "SELECT levenshtein(repeat('a', 20000), repeat('b', 20000 + i::INT)) FROM range(2) AS t(i)"
NUMBERS = "SELECT * FROM range(3000000)"

# the console command, which writes a line when a statement begins
COMMAND = """
import signal, sys
from kinedex.storage import interruption
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell that runs the tests in the background ignores it
run = interruption._Run._run
def announced(self):
    print("started", file=sys.stderr, flush=True)
    run(self)
interruption._Run._run = announced
from kinedex.commands.cli import main
main()
"""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = make_store(tmp_path_factory.mktemp("bounded") / "store", {"a": 30, "b": 40})
    build_index(open_store(path, at="newest"))
    return path


@pytest.fixture
def store(path: Path) -> Iterator[Store]:
    with open_store(path) as store:
        yield store


@contextmanager
def command(path: Path, *arguments: str, **streams: int) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, "-c", COMMAND, "sql", str(path), *arguments],
        stdin=streams.get("stdin", subprocess.DEVNULL),
        stdout=streams.get("stdout", subprocess.PIPE),
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    bound = threading.Timer(SECONDS, process.kill)
    bound.start()
    try:
        with process:
            yield process
    finally:
        bound.cancel()


@pytest.mark.skipif(os.name == "nt", reason="Windows sends no SIGINT to one process")
@pytest.mark.parametrize(("statement", "times"), [(MANY_ROWS, 1), (ONE_FUNCTION, 1), (ONE_FUNCTION, 2)])
def test_ctrl_c_ends_the_command_without_a_traceback(path: Path, statement: str, times: int) -> None:
    with command(path, statement) as process:
        assert process.stderr is not None
        assert process.stderr.readline() == "started\n"
        for _ in range(times):
            process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=240)
    assert (process.returncode, out, err) == (130, "", "kinedex: the statement was stopped\n")


def test_ctrl_c_while_the_thread_of_a_statement_starts(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    start = threading.Thread.start
    started = []

    def interrupted(thread: threading.Thread) -> None:
        start(thread)
        started.append(thread)
        raise KeyboardInterrupt

    with monkeypatch.context() as changed:
        changed.setattr(threading.Thread, "start", interrupted)
        with pytest.raises(KeyboardInterrupt, match="the statement was stopped"):
            store.sql(MANY_ROWS, timeout=SECONDS)
    started[0].join(SECONDS)
    assert not interruption.is_running()
    assert store.sql("SELECT 1 AS x", timeout=SECONDS).num_rows == 1


@pytest.mark.skipif(os.name == "nt", reason="Windows has no pseudo-terminals")
def test_ctrl_c_in_the_prompt_ends_the_statement_and_not_the_prompt(path: Path) -> None:
    import pty

    terminal, end = pty.openpty()
    with command(path, stdin=end, stdout=end) as process:
        os.close(end)
        assert process.stderr is not None
        os.write(terminal, f"{ONE_FUNCTION};\n".encode())
        assert process.stderr.readline() == "started\n"
        process.send_signal(signal.SIGINT)
        shown = read_until(terminal, b"stopped")
        os.write(terminal, b"SELECT 41 + 1 AS answer;\n")
        shown += read_until(terminal, b"1 row\r\n")
        os.write(terminal, b".quit\n")
        _, err = process.communicate(timeout=240)
    os.close(terminal)
    assert process.returncode == 0
    assert "Traceback" not in err
    assert b" 42 " in shown


@pytest.mark.skipif(os.name == "nt", reason="Windows sends no SIGINT to one process")
def test_ctrl_c_in_a_statement_of_the_program_is_a_keyboard_interrupt(store: Store) -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    try:
        with pytest.raises(KeyboardInterrupt), ctrl_c_in_statements(), connect() as connection:
            rows(connection, MANY_ROWS)
    finally:
        timer.join()
        signal.signal(signal.SIGINT, before)


def read_until(terminal: int, text: bytes) -> bytes:
    found = b""
    while text not in found:
        ready, _, _ = select.select([terminal], [], [], SECONDS)
        assert ready, f"nothing more after {found!r}"
        found += os.read(terminal, 4096)
    return found


@pytest.mark.parametrize("statement", [MANY_ROWS, ONE_FUNCTION])
def test_a_time_limit_ends_the_command_with_a_code_of_its_own(path: Path, statement: str) -> None:
    with command(path, "--timeout", "0.1s", statement) as process:
        _, err = process.communicate(timeout=240)
    assert process.returncode == 124
    assert "did not end within 0.1 s" in err


def test_a_store_answers_after_a_statement_that_did_not_stop(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interruption, "GRACE", 0.01)
    before = store.sql("SELECT name FROM takes ORDER BY name")
    with pytest.raises(TimeLimitError, match=r"within 0\.05 s"):
        store.sql(BRIEF_FUNCTION, timeout=0.05)
    assert store.sql("SELECT name FROM takes ORDER BY name") == before
    for done in list(interruption._abandoned.values()):
        assert done.wait(SECONDS)
    assert abandoned_statements() == 0
    assert store.sql("SELECT 1 AS x", timeout=SECONDS).num_rows == 1


def test_rows_beyond_a_limit_are_counted_and_not_returned(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    found = store.answer("SELECT * FROM range(100000) ORDER BY 1", max_rows=3)
    assert found.table.column(0).to_pylist() == [0, 1, 2]
    assert (found.rows, found.counted) == (100_000, True)
    assert store.answer("SELECT 1 AS x WHERE false", max_rows=3).table.column_names == ["x"]
    monkeypatch.setattr(queries, "COUNTED", 1000)
    endless = store.answer(NUMBERS, max_rows=3)
    assert (endless.table.num_rows, endless.counted) == (3, False)
    assert store.answer("SELECT 1", max_rows=0).rows == 1


@pytest.mark.parametrize(("argument", "value"), [("timeout", 0.0), ("timeout", -1.0), ("max_rows", -1)])
def test_limits_below_zero_are_refused(store: Store, argument: str, value: float) -> None:
    with pytest.raises(ParameterError, match=argument):
        store.answer("SELECT 1", **{argument: value})  # type: ignore[arg-type]
