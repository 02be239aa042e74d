"""A file that contradicts the others of its capture session is named, with both figures."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.catalog.capture_sessions import SESSION, session_lines, session_warnings, with_session_warnings

Row = dict[str, Any]

USUAL: Row = {
    "source_root": "/archive", "format": "trc", "skeleton_source": None, "source_rate_hz": 120.0, "file_up": "y",
    "estimated_joints": "", "height_m": 1.75, "thigh_share": 0.24, "shank_share": 0.24, "upper_arm_share": 0.17,
    "forearm_share": 0.15, "tempo_hz": 1.0, "speed_m_s": 1.0, "warnings": [],
}  # fmt: skip


def session(files: int, *changes: Row) -> list[Row]:
    """Files of one folder, of which the first have other figures."""
    rows = [USUAL | {"take_id": i, "source": f"day/{i}.trc"} for i in range(files)]
    return [row | (changes[i] if i < len(changes) else {}) for i, row in enumerate(rows)]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"source_rate_hz": 240.0}, "it is read at 240 Hz, they at 120 Hz"),
        ({"file_up": "z"}, "z is taken as its vertical axis, y as theirs"),
        ({"height_m": 0.79}, "its body is 0.79 m high, theirs 1.75 m"),
        ({"height_m": 3.85}, "its body is 3.85 m high, theirs 1.75 m"),
        ({"forearm_share": 0.2}, "its forearms are 0.35 m long, theirs 0.26 m"),
        ({"estimated_joints": "ltoes"}, "ltoes estimated, held by them"),
        ({"tempo_hz": 2.0, "speed_m_s": 2.0}, "its hands and feet turn 2 times a second, theirs 1 times"),
        ({"tempo_hz": 0.5, "speed_m_s": 0.5}, "its hands and feet turn 0.5 times a second, theirs 1 times"),
    ],
)
def test_one_file_among_others_that_agree_is_named_with_both_figures(change: Row, sentence: str) -> None:
    for files in (5, 9):
        found = session_warnings(session(files, change))
        assert list(found) == [0]
        ((warning),) = found[0]
        assert warning.startswith(SESSION + sentence)
    assert session_warnings(session(4, change)) == {}  # three others decide nothing


@pytest.mark.parametrize("column", ["source_root", "format", "skeleton_source", "person"])
def test_only_files_of_one_folder_format_skeleton_and_person_are_a_session(column: str) -> None:
    rows = [row | {"format": "amc"} for row in session(9)]
    assert session_warnings([rows[0] | {"height_m": 0.79, column: "other"}, *rows[1:]]) == {}
    rows = session(9, {"height_m": 0.79, "source": "another day/0.trc"})
    assert session_warnings(rows) == {}


def test_a_session_of_several_people_has_children_and_giants_but_no_body_of_half_the_size() -> None:
    heights = [1.05, 1.5, 1.55, 1.62, 1.7, 1.78, 1.85, 1.95, 2.05]
    rows = session(9, *({"height_m": height} for height in heights))
    assert session_warnings(rows) == {}
    for scale in (0.45, 2.2):
        changed = [*rows[:5], rows[5] | {"height_m": rows[5]["height_m"] * scale}, *rows[6:]]
        assert list(session_warnings(changed)) == [5]


def test_an_even_split_decides_nothing() -> None:
    rows = session(8, *([{"source_rate_hz": 60.0, "file_up": "z", "height_m": 1.2}] * 4))
    assert session_warnings(rows) == {}


def test_motions_of_several_kinds_may_have_any_tempo() -> None:
    tempos = [0.6, 0.9, 1.0, 1.3, 1.7, 2.4, 3.0]
    rows = session(7, *({"tempo_hz": tempo, "speed_m_s": tempo} for tempo in tempos))
    assert session_warnings(rows) == {}


@given(st.lists(st.none() | st.floats(0.5, 2.5), min_size=5, max_size=12))
def test_unknown_figures_contradict_nothing_and_nobody(heights: list[float | None]) -> None:
    rows = session(len(heights), *({"height_m": height, "file_up": None} for height in heights))
    found = session_warnings(rows)
    assert not any(heights[take] is None for take in found)
    assert len(found) <= len(heights) / 4


def test_the_order_of_the_takes_changes_nothing() -> None:
    rows = session(9, {"height_m": 0.8}, {"file_up": "z"})
    assert session_warnings(rows) == session_warnings(rows[::-1])


def test_warnings_of_a_session_come_and_go_with_its_files() -> None:
    rows = session(9, {"height_m": 0.8, "warnings": ["a gap"]})
    (changed,) = with_session_warnings(rows)
    assert changed["warnings"][0] == "a gap"
    assert changed["warnings"][1].startswith(SESSION)
    assert with_session_warnings([changed, *rows[1:]]) == []
    (again,) = with_session_warnings([changed, *rows[1:4]])
    assert again["warnings"] == ["a gap"]
    (line,) = session_lines({"a": ["other"], "b": changed["warnings"]})
    assert line.startswith("1 take unlike the files beside it: such as 'b': its body is 0.80 m high")
    assert session_lines({"a": ["other"]}) == []


def test_a_static_trial_and_its_motions_are_one_session() -> None:
    motions = [row | {"skeleton_source": "day/static.trc"} for row in session(9)]
    assert list(session_warnings([motions[0] | {"height_m": 0.79, "skeleton_source": None}, *motions[1:]])) == [0]
