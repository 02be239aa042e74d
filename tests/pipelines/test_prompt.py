"""The SQL prompt: statements over several lines, dot commands, and mistakes that do not end it."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from pipelines.prompt import run_prompt
from pipelines.stages import index, ingest
from storage.store import Store, open_store
from tests.pipelines.archives import context, write_archive


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    folder = tmp_path_factory.mktemp("prompt")
    source = write_archive(folder / "source", {"x_1.amc": 40})
    ingest.run(context(folder / "store"), ingest.Params(source=str(source)))
    index.run(context(folder / "store", "index"), index.Params())
    return open_store(folder / "store")


def typed(store: Store, *lines: str) -> str:
    waiting = list(lines)

    def read(_: str) -> str:
        if not waiting:
            raise EOFError
        return waiting.pop(0)

    said = io.StringIO()
    run_prompt(store, Console(file=said, width=140), read)
    return said.getvalue()


def test_a_statement_ends_with_a_semicolon(store: Store) -> None:
    assert "x_1" in typed(store, "SELECT name", "FROM takes", ";")
    assert "1 rows" in typed(store, "SELECT name FROM takes;")


def test_dot_commands_list_views_and_columns(store: Store) -> None:
    assert "word_runs" in typed(store, ".tables")
    assert "source_rate_hz" in typed(store, ".schema takes")
    assert ".quit" in typed(store, ".help")


def test_a_mistake_is_said_and_the_prompt_goes_on(store: Store) -> None:
    said = typed(store, "SELECT nam FROM takes;", ".tabels", ".schema nothing", "DROP TABLE takes;", "SELECT 41 + 1;")
    assert "nam" in said
    assert "did you mean '.tables'?" in said
    assert "no view 'nothing'" in said
    assert "42" in said


def test_long_answers_say_that_there_is_more(store: Store) -> None:
    assert "1,000 rows, of which the first 200 are shown" in typed(store, "SELECT * FROM range(1000);")


def test_quit_leaves(store: Store) -> None:
    assert "42" not in typed(store, ".quit", "SELECT 42;")
