"""Tables that are printed and written: nothing gets lost, whatever columns and values are called."""

from __future__ import annotations

import csv
import io
import json

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rich.console import Console

from kinedex.console import tables
from kinedex.console.tables import PrintedTable, encode, rich_table
from kinedex.console.terminal import Terminal
from kinedex.ops.errors import KinedexError
from kinedex.storage import duckdb_sql


def asked(query: str) -> pa.Table:
    with duckdb_sql.connect() as connection:
        return duckdb_sql.rows(connection, query)


def printed(table: pa.Table) -> str:
    out = io.StringIO()
    Console(file=out, width=100).print(rich_table(table))
    return out.getvalue()


def test_columns_of_one_name_all_stay():
    table = asked("SELECT 1 AS x, 2 AS x, 3 AS x_1, 4 AS y")
    assert encode(table, "csv").decode() == "x,x,x_1,y\n1,2,3,4\n"
    assert json.loads(encode(table, "json")) == [{"x": 1, "x_2": 2, "x_1": 3, "y": 4}]
    assert list(json.loads(encode(asked("SELECT 1 AS x, 2 AS x, 3 AS x"), "json"))[0]) == ["x", "x_1", "x_2"]
    assert pq.read_table(pa.BufferReader(encode(table, "parquet"))).to_pylist() == [
        {"x": 1, "x_2": 2, "x_1": 3, "y": 4}
    ]
    assert printed(table).split()[-4:] == ["1", "2", "3", "4"]


def test_json_is_valid_whatever_the_numbers_are():
    query = (
        "SELECT 'nan'::DOUBLE AS nan, ['inf'::FLOAT, 1.5] AS list, {'low': '-inf'::DOUBLE} AS struct, "
        "sum(i) AS huge, (2::HUGEINT ** 100)::HUGEINT AS huger, 1.50::DECIMAL(4, 2) AS share, "
        "2.00::DECIMAL(4, 2) AS whole"
        ", true AS yes, NULL AS nothing, '\\x01\\xFF'::BLOB AS bytes, DATE '2012-03-04' AS day, MAP {'a': 1} AS map "
        "FROM range(4) AS r(i)"
    )
    text = encode(asked(query), "json").decode()
    (row,) = json.loads(text, parse_constant=lambda constant: pytest.fail(constant))
    assert row == {
        "nan": None, "list": [None, 1.5], "struct": {"low": None}, "huge": 6, "huger": 2**100, "share": 1.5,
        "whole": 2, "yes": True, "nothing": None, "bytes": "01ff", "day": "2012-03-04", "map": [["a", 1]],
    }  # fmt: skip
    (line,) = csv.DictReader(io.StringIO(encode(asked(query), "csv").decode()))
    assert (line["list"], line["struct"], line["huge"], line["nothing"]) == ("[null, 1.5]", '{"low": null}', "6", "")


def test_brackets_are_shown_as_they_are():
    shown = printed(asked("SELECT '[/x]' AS a, '[NULL]' AS \"[/b]\", ['[/c]'] AS \"[red]d\", '\\[e]' AS f"))
    for text in ("[/x]", "[NULL]", "[/b]", '["[/c]"]', "[red]d", "\\[e]"):
        assert text in shown


def test_a_value_that_python_does_not_have_is_named_with_the_way_out():
    for form in ("csv", "json"):
        with pytest.raises(KinedexError, match=r"column t holds a timestamp.*t::VARCHAR"):
            encode(asked("SELECT TIMESTAMP '290000-01-01' AS t"), form)
    assert "290000" in encode(asked("SELECT TIMESTAMP '290000-01-01'::VARCHAR AS t"), "csv").decode()


def test_an_unknown_format_and_a_table_without_rows():
    with pytest.raises(KinedexError, match="no output format 'jason'; did you mean 'json'"):
        encode(pa.table({}), "jason")
    assert json.loads(encode(asked("SELECT 1 AS x WHERE false"), "json")) == []
    assert encode(asked("SELECT 1 AS x WHERE false"), "csv") == b"x\n"
    assert "x" in printed(asked("SELECT 1 AS x WHERE false"))


MESSAGE = "/an/archive/of/motions/clips/wave/x_aa_wave_001_120.amc:17: bone 'lfemur' stands twice in one frame, again"
LOG = pa.table(
    {
        "run": ["r-1"] * 2,
        "message": [MESSAGE, f"[too] {MESSAGE}"],
        "file": [MESSAGE.split(":")[0], None],
        "line": [17, None],
    }
)


def shown(table: pa.Table, width: int, *, terminal: bool) -> list[str]:
    out = io.StringIO()
    console = Console(file=out, width=width, soft_wrap=True, force_terminal=terminal, color_system=None)
    console.print(PrintedTable(table))
    return [line.rstrip() for line in out.getvalue().splitlines()]


def test_in_a_pipe_a_row_is_a_line_however_long():
    rows = [line for line in shown(LOG, 60, terminal=False) if "r-1" in line]
    assert len(rows) == 2
    assert all(MESSAGE in row for row in rows)


def test_in_a_terminal_rows_that_would_be_tall_stand_one_below_another_and_are_whole():
    wide = shown(LOG, 250, terminal=True)
    assert wide[1].split() == ["run", "message", "file", "line"]
    narrow = shown(LOG, 70, terminal=True)
    assert [line for line in narrow if line.startswith("row")] == ["row 1", "row 2"]
    assert all(len(line) <= 70 for line in narrow)
    assert MESSAGE in " ".join(" ".join(narrow).split())
    assert f"file     {MESSAGE.split(':')[0]}" in narrow
    assert narrow[narrow.index("row 2") + 2].startswith("message  [too]")
    assert narrow[-1] == "line     –"
    few = shown(LOG.select(["run", "line"]), 70, terminal=True)
    assert few[1].split() == ["run", "line"]


def test_a_long_line_that_is_said_goes_on_below_between_two_words_in_a_terminal_only():
    for terminal, lines in ((True, 2), (False, 1)):
        out = io.StringIO()
        Terminal(Console(file=out, width=60, soft_wrap=True, force_terminal=terminal, color_system=None)).message(
            MESSAGE
        )
        message = out.getvalue().splitlines()
        assert len(message) == lines
        assert " ".join(out.getvalue().split()) == MESSAGE
        assert message[0].startswith("    /an/archive")
        assert all(line.startswith(" " * 8) for line in message[1:])


@pytest.mark.parametrize(
    "columns",
    [
        {
            "name": ["a", "bb  b", "çé日本"],
            "n": [1, 22, None],
            "x": [0.5, None, 1 / 3],
            "header": [None, "q", ""],
        },
        {"": ["", "", ""], "b": [True, None, False]},
        {"x" * 30: ["y" * 50], "z": [[1, 2]]},
        {"two\nlines": ["a\nb", "c"], "n": [1, 2]},
    ],
)
def test_a_table_in_a_pipe_has_the_lines_that_rich_lays_out(
    columns: dict[str, list[object]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def text() -> str:
        console = Console(file=io.StringIO(), width=160, soft_wrap=True, force_terminal=False)
        console.print(PrintedTable(pa.table(columns)))
        return console.file.getvalue()

    plain = text()
    monkeypatch.setattr(tables, "_is_plain", lambda text: False)
    assert plain == text()


@pytest.mark.parametrize("end", ["b", "b ", "b\N{NO-BREAK SPACE}"])
def test_a_long_text_in_a_pipe_pads_no_other_row(end: str) -> None:
    table = pa.table({"n": [1, 22], "message": ["y" * 3000, "short"], "end": ["a", end]})
    lines = shown(table, 160, terminal=False)
    assert max(len(line) for line in lines if "y" not in line) < 90
    assert [line.split() for line in lines[1:]] == [
        ["n", "message", "end"], ["─" * 71], ["1", "y" * 3000, "a"], ["22", "short", "b"], [],
    ]  # fmt: skip


WIDE = pa.table({"take_id": range(9), "name": ["a name"] * 9, **{f"column_{n}": ["some text"] * 9 for n in range(20)}})


def test_a_wide_table_on_a_terminal_has_the_first_columns_and_names_the_others() -> None:
    lines = shown(WIDE, 80, terminal=True)
    assert lines[1].split() == ["name", *(f"column_{n}" for n in range(6))]
    assert len([line for line in lines if "a name" in line]) == 9
    remark = " ".join(" ".join(lines).split())
    assert "15 more columns that would not fit: take_id, column_6, column_7" in remark
    assert remark.endswith("a wider terminal shows more, `| less -S` and --format json show all")
    assert all(len(line) <= 80 for line in lines)
    assert shown(WIDE.slice(0, 2), 80, terminal=True)[0] == "row 1"  # few rows are blocks, which have everything
    assert shown(WIDE, 400, terminal=True)[1].split()[0] == "take_id"
    many = pa.table({f"c{n}": ["x"] * 9 for n in range(60)})  # each would have no width at all
    assert shown(many, 80, terminal=True)[1].split()[:2] == ["c0", "c1"]


@pytest.mark.parametrize("rows", [1, 40])
def test_names_of_columns_are_not_broken_on_a_narrow_terminal(rows: int) -> None:
    columns = {"name": ["a_take_of_some_length_001"], "class": ["armCirclesRight"], "clip": ["001"], "state": ["done"]}
    columns |= {"started_at": ["2026-11-27T17:02:36Z"], "source_rate_hz": ["120"], "results": ["newest version"]}
    lines = shown(pa.table({name: cells * rows for name, cells in columns.items()}), 80, terminal=True)
    if rows == 1:
        assert lines[0] == "row 1"
        assert any(line.split() == ["source_rate_hz", "120"] for line in lines)
    else:
        assert lines[1].split()[:3] == ["name", "class", "clip"]
        assert "would not fit" in "\n".join(lines)
    assert all(len(line) <= 80 for line in lines)


HITS = pa.table(
    {
        "template": ["armCirclesRight1Reps"] * 9,
        "rank": range(9),
        "take": ["SYN_al_armCirclesRight1Reps_001_120"] * 9,
        "start": range(100, 109),
        "stop": range(200, 209),
        "start_seconds": [10.25] * 9,
        "stop_seconds": [11.75] * 9,
        "cost": [0.0123] * 9,
    }
)


def test_a_name_is_not_broken_and_what_people_read_first_is_shown() -> None:
    for width, names in {
        80: ["template", "take", "start", "cost"],
        90: ["template", "take", "start", "stop", "cost"],
        160: HITS.column_names,
    }.items():
        lines = shown(HITS, width, terminal=True)
        assert lines[1].split() == names
        assert len([line for line in lines if "SYN_al_armCirclesRight1Reps_001_120" in line]) == 9
    search = HITS.select(["take", "start", "stop", "start_seconds", "stop_seconds"])
    assert shown(search, 70, terminal=True)[1].split() == ["take", "start", "stop", "start_seconds"]
    assert shown(search.slice(0, 2), 70, terminal=True)[0] == "row 1"


def test_long_texts_and_paths_of_a_table_with_few_columns_are_not_left_out() -> None:
    table = pa.table({"run": ["r-1"] * 9, "message": [MESSAGE] * 9, "file": [MESSAGE.split(":")[0]] * 9})
    narrow = "".join(shown(table, 60, terminal=True))
    assert "would not fit" not in narrow
    assert "file" in narrow


def test_the_header_of_an_empty_table_is_not_broken() -> None:
    lines = shown(HITS.slice(0, 0), 40, terminal=True)
    assert lines[1].split() == ["template", "take", "start", "stop", "cost"]
    assert all(len(line) <= 40 for line in lines)
    assert "would not fit" in " ".join(lines)
