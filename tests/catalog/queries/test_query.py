"""Queries written in Python mean what query files mean, and their errors name the parameter."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.queries.query import Query
from kinedex.catalog.queries.query_reader import parse_queries, read_queries
from kinedex.catalog.queries.query_writer import write_queries
from kinedex.ops.errors import ConfigError, KinedexError
from tests.catalog.queries.test_queries import any_query

BODY = load_feature_set("body40")
SQUAT = Query(
    [{"off": ["rknee_bent"]}, {"on": ("F20", "body_low"), "name": "down"}, {"off": [20]}],
    gaps=["0.1 to 1.5 s", (3, None)],
    name="squat",
    target="squat1Reps",
)
KICK = Query([{"on": ["rfoot_raised"]}, {"after": "within 1 s", "on": ["rfoot_fast"]}], name="kick", mirror="both")


def test_a_query_in_python_is_that_of_a_file() -> None:
    text = """
squat:
  class: squat1Reps
  keyframes: [{off: [rknee_bent]}, {name: down, on: [rknee_bent, body_low]}, {off: [rknee_bent]}]
  gaps: [0.1 to 1.5 s, {range: [3, null]}]
"""
    assert parse_queries(text, BODY) == (SQUAT.resolve(),)
    assert (SQUAT.name, SQUAT.target, KICK.target) == ("squat", "squat1Reps", "kick")
    assert len(KICK.resolve().chains) == 2


def test_the_papers_notation_works_too() -> None:
    one = Query(
        [{"set": "lower", "pattern": "1" * 12}, {"set": "mix", "pattern": "0" * 13}], distances=[7], stiffness=[0.5]
    )
    other = Query(
        [{"set": "lower", "pattern": "1" * 12}, {"set": "mix", "pattern": "0" * 13}], [(4, 14)], positions=[2, 9]
    )
    assert one.resolve().bounds == other.resolve().bounds == [(4, 14)]
    assert other.resolve().positions == (2, 9)


def test_seconds_become_frames_at_the_rate_of_the_store() -> None:
    assert KICK.resolve().gaps[0].high == 30
    assert KICK.resolve(rate_hz=120).gaps[0].high == 120


def test_queries_are_combined() -> None:
    both = Query(
        sequence=[SQUAT, {"then": KICK, "within": "2 s"}],
        name="both",
        takes="actor = 'bk'",
        margins=(3, 4),
        description="x",
    )
    found = both.resolve()
    assert [len(chain.keyframes) for chain in found.chains] == [6, 6]
    assert (found.takes, found.margins, found.description) == ("actor = 'bk'", (3, 4), "x")
    either = Query(any_of=[SQUAT, KICK, {"keyframes": [{"on": [1]}]}, {"file": "example", "query": "turn"}])
    assert len(either.resolve().chains) == 5
    with pytest.raises(KinedexError, match="'both' has a filter `takes`"):
        Query(any_of=[both])


@pytest.mark.parametrize(
    "query", [SQUAT, KICK, Query(any_of=[SQUAT, KICK], name="on"), Query([{"on": [1]}], name="yes")]
)
def test_yaml_reads_back_as_the_same_query(query: Query, tmp_path: Path) -> None:
    again = Query.from_yaml(query.to_yaml())
    assert again == query
    assert hash(again) == hash(query)
    assert again.resolve() == query.resolve()
    query.save(tmp_path / "q.yaml")
    assert Query.load(tmp_path / "q.yaml") == query
    assert Query.load(tmp_path / "q.yaml", query.name) != Query([{"on": [2]}])


def test_the_text_looks_as_people_write_it() -> None:
    assert KICK.to_yaml() == (
        "kick:\n  keyframes:\n  - on: [rfoot_raised]\n  - after: within 1 s\n    on: [rfoot_fast]\n  mirror: both\n"
    )


@settings(max_examples=60, deadline=None)
@given(any_query())
def test_any_query_of_a_file_can_be_read_and_written(query: Any) -> None:
    read = Query.from_yaml(write_queries([query], BODY))
    assert read.resolve() == query
    assert Query.from_yaml(read.to_yaml()) == read


def test_queries_of_a_file_are_written_out_with_what_they_refer_to(tmp_path: Path) -> None:
    (tmp_path / "parts.yaml").write_text(KICK.to_yaml() + "low: {part: true, keyframes: [{on: [body_low]}]}")
    text = "q: {class: c, sequence: [a, {then: {file: parts.yaml, query: kick}, within: 1 s}]}\n"
    text += "a: {part: true, any_of: [{file: parts.yaml, query: low}, {any_of: [b]}]}\n"
    (tmp_path / "mine.yaml").write_text(text + "b: {part: true, keyframes: [{on: [1]}]}")
    (made,) = read_queries(tmp_path / "mine.yaml", BODY)
    query = Query.load(tmp_path / "mine.yaml")
    assert query.resolve() == made
    assert Query.from_yaml(query.to_yaml()).resolve() == made
    assert [one.name for one in Query.load_all("example")] == [one.name for one in read_queries("example", BODY)]
    for one, other in zip(Query.load_all("example"), read_queries("example", BODY), strict=True):
        assert one.resolve() == other


WRONG: list[tuple[dict[str, Any], str]] = [
    ({}, "a query has one of keyframes, sequence or any_of, got none of them"),
    (
        {"keyframes": [{"on": ["rkne_bent"]}]},
        r"keyframes\[0\].on\[0\]: no feature 'rkne_bent'; did you mean 'rknee_bent'",
    ),
    ({"keyframes": [{"on": [1]}, {"onn": [2]}]}, r"keyframes\[1\].onn: no such key; did you mean 'on'"),
    ({"keyframes": [{"on": [1]}, {"on": [2]}]}, "keyframes: 2 keyframes need 1 gaps"),
    ({"keyframes": [{"on": [1]}, {"on": [2]}], "gaps": ["soon"]}, r"gaps\[0\]: 'soon' is no gap; written so"),
    ({"keyframes": [{"on": [1]}, {"on": [2]}], "gaps": [(5, 3)]}, r"gaps\[0\].range: must have low <= high"),
    ({"keyframes": [{"on": [1]}], "takes": 3}, "takes: must be a valid string, got 3"),
    ({"keyframes": [{"on": [1]}], "target": 3}, "target: must be a valid string, got 3"),
    ({"keyframes": [{"on": [1]}], "margins": (1, -2)}, r"margins\[1\]: must be greater than or equal to 0"),
    ({"keyframes": {"on": [1]}}, "keyframes: must be a valid list"),
    ({"any_of": [{"file": "none.yaml", "query": "b"}]}, r"any_of\[0\].file: none.yaml: no such file"),
    ({"sequence": [KICK, KICK]}, r"sequence\[1\]: a step gives the query that follows as `then`"),
]


@pytest.mark.parametrize(("parameters", "message"), WRONG)
def test_an_error_names_the_query_and_its_parameter(parameters: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=f"^Query 'q': {message}"):
        Query(name="q", **parameters)


def test_a_query_is_asked_for_by_its_name(tmp_path: Path) -> None:
    with pytest.raises(KinedexError, match=r"example has \d+ queries; pass `name`: squat, "):
        Query.load("example")
    with pytest.raises(KinedexError, match=r"example has no query 'squatt'; did you mean 'squat'"):
        Query.load("example", "squatt")
    with pytest.raises(KinedexError, match=r"ends in \.yaml"):
        KICK.save(tmp_path / "q.txt")
    with pytest.raises(KinedexError, match="cannot be written"):
        KICK.save(tmp_path / "none" / "q.yaml")
