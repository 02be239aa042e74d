"""Tables that are printed and written: nothing gets lost, whatever columns and values are called."""

from __future__ import annotations

import csv
import io
import json

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rich.console import Console

from ops.errors import KinedexError
from pipelines.tables import encode, rich_table
from storage import duck


def asked(query: str) -> pa.Table:
    with duck.connect() as connection:
        return duck.query(connection, query)


def printed(table: pa.Table) -> str:
    out = io.StringIO()
    Console(file=out, width=100).print(rich_table(table, title="[what] was asked"))
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
    for text in ("[/x]", "[NULL]", "[/b]", '["[/c]"]', "[red]d", "\\[e]", "[what] was asked"):
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
