"""The takes of an archive by filters and SQL, block by block, their totals, and what is to be looked at."""

from __future__ import annotations

import base64
import math
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from starlette.testclient import TestClient

import kinedex
from kinedex.explorer import selections
from kinedex.explorer.selections import Filter, Selection, condition_of, packed_ids
from kinedex.storage.store.store import open_store
from tests.explorer.conftest import Connect
from tests.pipelines.labelled import long_take, write_store


@pytest.fixture(scope="module")
def client(connect: Connect) -> TestClient:
    return connect()


def ask(client: TestClient, path: str, **body: Any) -> dict[str, Any]:
    answer = client.post(path, json=body)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def names(client: TestClient, **body: Any) -> list[str]:
    found: list[str] = ask(client, "/api/takes", **body)["names"]
    return found


def test_the_store_describes_itself(client: TestClient, store: Path) -> None:
    facts = client.get("/api/store").json()
    assert (facts["takes"], facts["classes"], facts["read_only"]) == (11, ["kick", "walk"], False)
    assert len(facts["joints"]) == len(facts["parents"]) == 24
    assert [one["bit"] for one in facts["features"]] == list(range(40))
    assert facts["name"] == store.name
    assert {"name": "seconds", "type": "DOUBLE", "numeric": True} in facts["columns"]


FILTERS: list[tuple[dict[str, Any], str]] = [
    ({"column": "class", "values": ["kick"]}, "\"class\" = 'kick'"),
    ({"column": "class", "values": [None, "walk"]}, '"class" IS NULL OR "class" = \'walk\''),
    ({"column": "class", "values": []}, "false"),
    ({"column": "seconds", "min": 0.7}, "seconds >= 0.7"),
    ({"column": "frames", "min": 20, "max": 25}, "frames BETWEEN 20 AND 25"),
    ({"column": "name", "contains": "KICK"}, "name LIKE '%kick%'"),
    ({"column": "folder", "values": ["al"]}, "source LIKE 'al/%'"),
    ({"column": "take_id", "chosen": "UEA"}, "take_id IN (1, 3, 9)"),
    ({"column": "take_id", "chosen": ""}, "false"),
]


@pytest.mark.parametrize(("one", "where"), FILTERS)
def test_a_filter_finds_what_sql_finds(client: TestClient, store: Path, one: dict[str, Any], where: str) -> None:
    expected = open_store(store).sql(f"SELECT name FROM takes WHERE {where} ORDER BY name").column(0).to_pylist()
    assert names(client, filters=[one]) == expected
    assert names(client, where=where) == expected
    assert names(client, where=f"{where} -- a remark") == expected


def test_a_choice_of_many_takes_is_looked_up_in_bits(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    listed = names(client, filters=[{"column": "take_id", "chosen": "UEA"}])
    monkeypatch.setattr(selections, "FEW_IDS", 0)
    looked_up = ask(client, "/api/takes", filters=[{"column": "take_id", "chosen": "UEA"}])
    assert looked_up["names"] == listed
    assert len(listed) == 3
    assert "get_bit" in looked_up["command"]
    fault = client.post("/api/takes", json={"filters": [{"column": "take_id", "chosen": "<b>"}]})
    assert fault.status_code == 422
    assert "chosen must be the bits of ids in base64url" in fault.json()["error"]["message"]


def test_filters_and_sql_hold_together_in_the_order_asked_for(client: TestClient) -> None:
    sort = [{"column": "actor", "descending": True}, {"column": "frames"}]
    found = ask(client, "/api/takes", filters=[{"column": "class", "values": [None]}], where="frames > 5", sort=sort)
    assert found["names"] == ["bo_long", "al_long"]
    assert found["total"] == 2
    assert found["hours"] == pytest.approx((open_store_seconds(found)) / 3600)


def open_store_seconds(found: dict[str, Any]) -> float:
    place = found["columns"].index("seconds")
    return float(sum(row[place] for row in found["rows"]))


def test_blocks_join_to_the_whole(client: TestClient) -> None:
    sort = [{"column": "seconds", "descending": True}]
    whole = ask(client, "/api/takes", sort=sort)
    blocks = [ask(client, "/api/takes", sort=sort, offset=offset, limit=4) for offset in (0, 4, 8, 12)]
    assert [name for block in blocks for name in block["names"]] == whole["names"]
    assert {block["total"] for block in blocks} == {11}
    assert client.post("/api/takes", json={"limit": 501}).status_code == 422


def test_the_command_and_the_python_lines_find_the_same(client: TestClient, store: Path) -> None:
    quoted = "it's; DROP TABLE takes"
    found = ask(client, "/api/takes", filters=[{"column": "name", "contains": quoted}], columns=["name", "class"])
    assert found["total"] == 0
    words = shlex.split(found["command"])
    assert words[:3] == ["kinedex", "sql", str(store)]
    found = ask(client, "/api/takes", columns=["name", "folder"], filters=[{"column": "class", "values": ["kick"]}])
    space: dict[str, Any] = {}
    lines = found["python"].splitlines()
    exec("\n".join([*lines[:-1], f"rows = {lines[-1]}"]), space)
    assert [list(row.values()) for row in space["rows"].to_pylist()] == found["rows"]
    with kinedex.open_store(store) as opened:
        assert opened.sql(shlex.split(found["command"])[3]).num_rows == found["total"]


WRONG = [
    ({"where": "clas = 1"}, "clas"),
    ({"where": "1 = 1); DELETE FROM takes; --"}, ""),
    ({"where": "(SELECT count(*) FROM read_csv('/etc/passwd')) > 0"}, ""),
    ({"filters": [{"column": "clas", "values": []}]}, "did you mean 'class'"),
    ({"sort": [{"column": "lenght"}]}, "takes have no column 'lenght'"),
    ({"columns": ['name" FROM takes; --']}, "takes have no column"),
]


@pytest.mark.parametrize(("body", "message"), WRONG)
def test_what_does_not_fit_is_a_clear_error(client: TestClient, body: dict[str, Any], message: str) -> None:
    answer = client.post("/api/takes", json=body)
    assert answer.status_code == 400
    assert message in answer.json()["error"]["message"]


LONG = f"name <> '{'x' * 200}' AND\n  sec > > 3 OR name <> '{'y' * 200}'"

FAULTS = [
    ("seconds > 3 ORDER BY x", 'at or near "ORDER": character 13, “ORDER BY x”'),
    ("seconds >", "syntax error at the end"),
    ("seconds > 3)", "syntax error at the end"),
    ("class = 'kick", "unterminated string literal: character 9, “'kick”"),
    ("seconds > 'x' AND true", "character 11, “'x' AND true”"),
    ("class::DOUBLE > 1", "Could not convert string"),
    (LONG, 'at or near ">": line 2, character 9, “> 3 OR'),
    ("secnds > 3", 'column "secnds" not found; the nearest are "seconds"'),
    ("sound(seconds) > 3", "no function or macro is named 'sound'"),
]


@pytest.mark.parametrize(("where", "expected"), FAULTS)
def test_the_fault_of_a_condition_is_told_in_its_own_words(client: TestClient, where: str, expected: str) -> None:
    asked = {"where": where, "filters": [{"column": "class", "values": ["kick", "walk"]}]}
    others: list[tuple[str, dict[str, Any]]] = [
        ("/api/takes", {"sort": [{"column": "frames"}]}),
        ("/api/totals", {"by": ["class"]}),
        ("/api/values", {"column": "actor"}),
        ("/api/map/takes", {"column": "class"}),
    ]
    for path, more in others:
        answer = client.post(path, json={**asked, **more})
        message = answer.json()["error"]["message"]
        assert answer.status_code == 400
        assert expected in message
        assert "SELECT" not in message
        assert "WHERE" not in message
        assert "views and macros" not in message


def test_a_fault_beside_a_sound_condition_is_not_blamed_on_it(client: TestClient) -> None:
    answer = client.post("/api/takes", json={"where": "seconds > 0", "columns": ["nothing"]})
    assert "takes have no column 'nothing'" in answer.json()["error"]["message"]


@given(st.sets(st.integers(0, 300)))
def test_ids_are_packed_as_filters_read_them(ids: set[int]) -> None:
    text = packed_ids(np.array(sorted(ids), np.int64))
    octets = base64.urlsafe_b64decode(text + "=" * (-len(text) % 4))
    assert {8 * place + bit for place, octet in enumerate(octets) for bit in range(8) if octet >> (7 - bit) & 1} == ids


def test_names_of_columns_and_values_are_quoted() -> None:
    known = ['a "b"', "order", "plain"]
    filters = tuple(Filter(column=name, values=("x'y",)) for name in known)
    assert condition_of(Selection(filters=filters), known) == (
        " WHERE (\"a \"\"b\"\"\" IN ('x''y')) AND (\"order\" IN ('x''y')) AND (plain IN ('x''y'))"
    )


def test_totals_are_hours_by_one_column_or_two(client: TestClient) -> None:
    found = ask(client, "/api/totals", by=["class"])
    assert {group["values"][0]: group["takes"] for group in found["groups"]} == {"kick": 4, "walk": 4, None: 3}
    hours = [group["hours"] for group in found["groups"]]
    assert hours == sorted(hours, reverse=True)
    assert (found["takes"], found["total"]) == (11, 3)
    assert found["hours"] == pytest.approx(sum(hours))
    pairs = ask(client, "/api/totals", by=["actor", "class"], where="class IS NOT NULL", limit=3)
    assert (len(pairs["groups"]), pairs["total"], pairs["takes"]) == (3, 4, 8)
    assert ask(client, "/api/totals", by=["class"], where="false")["groups"] == []


@pytest.mark.parametrize("column", ["class", "actor", "folder", "frames"])
def test_groups_have_the_order_of_the_takes(client: TestClient, column: str) -> None:
    groups = ask(client, "/api/totals", by=[column], order="value")["groups"]
    takes = ask(client, "/api/takes", sort=[{"column": column}], columns=[column])["rows"]
    assert [row for one in groups for row in [one["values"]] * one["takes"]] == takes


def test_the_folder_is_what_stands_before_the_last_slash(tmp_path: Path, connect: Connect) -> None:
    sources = [
        "a.bvh",
        "x/a.bvh",
        "x/y/a.bvh",
        "x/y.z/.bvh",
        "x//a.bvh",
        "x\\y\\a.bvh",
        "a line\nbreak/a.bvh",
        "ü'\"/a.bvh",
    ]
    takes = [{**long_take(f"t{i}", "al", "rest"), "source": source} for i, source in enumerate(sources)]
    client = connect(write_store(tmp_path / "store", takes))
    folders = [source.rpartition("/")[0] or "." for source in sources]
    assert [row for (row,) in ask(client, "/api/takes", columns=["folder"])["rows"]] == folders
    for one in set(folders):
        expected = [f"t{i}" for i, folder in enumerate(folders) if folder == one]
        assert names(client, filters=[{"column": "folder", "values": [one]}]) == expected


def test_nan_and_no_value_are_one_group(tmp_path: Path, connect: Connect) -> None:
    rates = {"a": 60.0, "b": math.nan, "c": None, "d": 30.0, "e": math.nan}
    takes = [{**long_take(name, "al", "rest"), "source_rate_hz": rate} for name, rate in rates.items()]
    client = connect(write_store(tmp_path / "store", takes))
    column = "source_rate_hz"
    groups = ask(client, "/api/totals", by=[column], order="value")["groups"]
    assert [(one["values"], one["takes"]) for one in groups] == [([30.0], 1), ([60.0], 1), ([None], 3)]
    assert names(client, sort=[{"column": column}]) == ["d", "a", "b", "c", "e"]
    assert names(client, filters=[{"column": column, "values": [None]}]) == ["b", "c", "e"]
    assert names(client, filters=[{"column": column, "min": 40}]) == ["a"]
    values = ask(client, "/api/values", column=column)
    assert (values["empty"], values["distinct"], values["min"], values["max"]) == (3, 2, 30.0, 60.0)


def test_values_have_counts_and_numbers_a_histogram(client: TestClient) -> None:
    classes = ask(client, "/api/values", column="class")
    assert classes["values"] == [{"value": "kick", "takes": 4}, {"value": "walk", "takes": 4}]
    assert (classes["empty"], classes["distinct"], "bins" in classes) == (3, 2, False)
    assert ask(client, "/api/values", column="name", contains="LONG")["distinct"] == 2
    frames = ask(client, "/api/values", column="frames")
    assert sum(one["takes"] for one in frames["bins"]) == 11
    assert frames["bins"][0]["from"] == frames["min"]
    assert ask(client, "/api/values", column="frames", where="false")["bins"] == []
    assert len(ask(client, "/api/values", column="source_rate_hz")["bins"]) == 1, "all takes have one rate"


def test_what_is_to_be_looked_at_is_counted(client: TestClient) -> None:
    found = client.get("/api/quality").json()
    assert found["warnings"] == [{"warning": "the source has <gaps>", "takes": 1}]
    assert found["invalid"] == {"takes": 1, "frames": 2}
    block = ask(client, "/api/takes", where="name = 'odd'")
    assert block["warnings"] == [["the source has <gaps>"]]
    assert client.get("/api/flags").json()["total"] == len(client.get("/api/flags").json()["flags"])


def test_duplicates_and_excluded_files_name_the_command(client: TestClient) -> None:
    found = client.get("/api/duplicates").json()
    assert (found["searched"], found["rows"]) == (False, [])
    assert found["command"].startswith("kinedex duplicates ")
    assert client.get("/api/excluded").json()["total"] == 0
