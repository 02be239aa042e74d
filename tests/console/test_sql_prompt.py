"""The SQL prompt: statements over several lines, dot commands, and mistakes that do not end it."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from kinedex.console.sql_prompt import completer, run_prompt
from kinedex.pipelines.stages.index import Index
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.store.store import Store, open_store
from tests.pipelines.archives import context, write_archive


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    folder = tmp_path_factory.mktemp("prompt")
    source = write_archive(folder / "source", {"x_1.amc": 40})
    Ingest().run(context(folder / "store"), Ingest.parameters(source=str(source)))
    Index().run(context(folder / "store", "index"), Index.parameters())
    return open_store(folder / "store")


def typed(store: Store, *lines: str | type[BaseException]) -> str:
    waiting = list(lines)

    def read(_: str) -> str:
        if not waiting:
            raise EOFError
        line = waiting.pop(0)
        if isinstance(line, str):
            return line
        raise line

    printed = io.StringIO()
    run_prompt(store, Console(file=printed, width=140), read, max_rows=200)
    return printed.getvalue()


def test_a_statement_ends_with_a_semicolon(store: Store) -> None:
    assert "x_1" in typed(store, "SELECT name", "FROM takes", ";")
    assert "1 row\n" in typed(store, "SELECT name FROM takes;")
    assert "0 rows" in typed(store, "SELECT name FROM takes WHERE false;")


def test_a_semicolon_in_a_text_or_a_comment_ends_nothing(store: Store) -> None:
    assert "a;b" in typed(store, "SELECT 'a;", "x' AS t, -- not yet;", "'a;b' AS u;")
    printed = typed(store, "SELECT 40 + 1 AS x; SELECT 40 + 2 AS y; -- both", "SELECT 40 +", "3;")
    assert all(number in printed for number in ("41", "42", "43"))
    assert "syntax error" not in typed(store, ";", "", " ;;", "/* a", "comment; */ SELECT 1;")


def test_ctrl_c_drops_what_was_typed_and_stops_what_runs(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    printed = typed(store, "SELECT 'never',", KeyboardInterrupt, "SELECT 42;")
    assert "42" in printed
    assert "never" not in printed
    monkeypatch.setattr(Store, "answer", interrupted)
    assert "stopped" in typed(store, "SELECT 1; SELECT 2;")


def interrupted(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


def test_dot_commands_list_views_and_columns(store: Store) -> None:
    assert "word_runs" in typed(store, ".tables")
    assert "source_rate_hz" in typed(store, ".schema takes")
    assert ".quit" in typed(store, ".help")
    assert "stored_" not in typed(store, ".tables")
    assert "runs_where" in typed(store, ".tables;")
    assert "min_seconds: shortest duration that counts (default 0)" in typed(store, ".schema runs_where")
    printed = typed(store, ".help vocabulary", ".help pattern")
    assert "SELECT feature_set, count(*) AS words FROM vocabulary" in printed
    assert "pattern(poses_in_order, within_seconds := 1)" in printed


def test_names_are_completed() -> None:
    complete = completer(["takes", "timeline", "take_id"])
    assert [complete("take", n) for n in range(3)] == ["take_id", "takes", None]


def test_a_mistake_is_said_and_the_prompt_goes_on(store: Store) -> None:
    printed = typed(
        store, "SELECT nam FROM takes;", ".tabels", ".schema nothing", "DROP TABLE takes;", "SELECT 41 + 1;"
    )
    assert "nam" in printed
    assert "did you mean '.tables'?" in printed
    assert "no view or macro 'nothing'" in printed
    assert "42" in printed


def test_long_answers_say_that_there_is_more(store: Store) -> None:
    assert "1,000 rows; the first 200 are shown" in typed(store, "SELECT * FROM range(1000);")


def test_quit_leaves(store: Store) -> None:
    after_quit = "SELECT 'an answer after the prompt was left' AS sentence;"
    assert "an answer after" in typed(store, after_quit)
    assert "an answer after" not in typed(store, ".quit", after_quit)
