"""Rows of numbers: what is read is what Python reads, and what is wrong is named with its line."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops import textnumbers as t
from kinedex.ops.errors import ParameterError

NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


def naive(text: bytes, columns: int) -> list[list[float]] | tuple[int, int]:
    """The rows, or code and line of the first fault."""
    rows = []
    for number, line in enumerate(re.split(rb"\r\n|\r|\n", text), 1):
        tokens = [token for token in re.split(rb"[ \t]+", line) if token]
        if not tokens or tokens[0].startswith(b"#"):
            continue
        for i, token in enumerate(tokens):
            if i == columns:
                return t.TOO_MANY, number
            found = NUMBER.fullmatch(token.decode("latin-1"))
            if not found:
                return t.BAD_NUMBER, number
        if len(tokens) < columns:
            return t.TOO_FEW, number
        rows.append([float(token) for token in tokens])
    huge = next((i for i, row in enumerate(rows) if not np.isfinite(row).all()), None)
    return rows if huge is None else (t.BAD_NUMBER, -1)


FAR_FROM_THE_END = b"\n" + b" " * 50


@given(
    st.lists(st.sampled_from([*b"0123456789", *b"  \t\n\r.-+e#x", *b"15 "]), max_size=120).map(bytes),
    st.integers(1, 3),
    st.sampled_from([b"", FAR_FROM_THE_END]),
)
def test_rows_are_what_python_makes_of_the_lines(text: bytes, columns: int, rest: bytes) -> None:
    text += rest
    values, fault = t.parse_rows(text, 0, 1, columns)
    expected = naive(text, columns)
    if isinstance(expected, list):
        assert fault is None
        np.testing.assert_array_equal(values, np.array(expected).reshape(len(expected), columns))
    else:
        assert fault is not None
        code, line = expected
        assert fault.code == code
        assert line in (fault.line, -1)
        assert len(values) == 0


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=30))
def test_every_number_is_rounded_as_python_rounds_it(numbers: list[float]) -> None:
    text = " ".join(repr(number) for number in numbers) + "\r\n" + "\t".join(f"{number:.20e}" for number in numbers)
    values, fault = t.parse_rows(text.encode(), 0, 1, len(numbers))
    assert fault is None
    np.testing.assert_array_equal(values, [numbers, numbers])


@given(st.lists(st.from_regex(NUMBER, fullmatch=True).filter(lambda text: len(text) < 60), min_size=1, max_size=30))
def test_numbers_of_any_form_are_those_of_python(texts: list[str]) -> None:
    numbers = [float(text) for text in texts]
    values, fault = t.parse_rows(" ".join(texts).encode() + FAR_FROM_THE_END, 0, 1, len(texts))
    if np.isfinite(numbers).all():
        assert fault is None
        np.testing.assert_array_equal(values, [numbers])
        np.testing.assert_array_equal(np.signbit(values), [np.signbit(numbers)])
    else:
        assert fault is not None


@pytest.mark.parametrize("digits", range(1, 26))
def test_numbers_of_every_length(digits: int) -> None:
    written = ("1234567890" * 3)[:digits]
    texts = [f"{sign}{written[:dot]}.{written[dot:]}" for sign in ("", "-", "+") for dot in range(digits + 1)]
    values, fault = t.parse_rows(" ".join(texts).encode() + FAR_FROM_THE_END, 0, 1, len(texts))
    assert fault is None
    np.testing.assert_array_equal(values, [[float(text) for text in texts]])


@pytest.mark.parametrize("end", ["", "e2", "E-3", "8", "e", "x", ".", "-", "\x80", "\x0b", "\x00"])
@pytest.mark.parametrize("before", [0, 1, 6, 7, 8])
def test_what_stands_behind_digits_counts(before: int, end: str) -> None:
    for after in (*range(9), 15):
        for sign in ("", "-"):
            token = f"{sign}{'7654321' * 2:.{before}}.{'1234567' * 3:.{after}}{end}"
            text = f"1 {token} 2\n".encode("latin-1")
            for rest in (b"", FAR_FROM_THE_END):
                values, fault = t.parse_rows(text + rest, 0, 1, 3)
                assert (fault is None) == bool(NUMBER.fullmatch(token)), token
                if fault is None:
                    np.testing.assert_array_equal(values, [[1.0, float(token), 2.0]])


NAMES = ["r", "root", "lowerba", "lowerbac", "lowerback", "lowerbackbone"]


@given(st.lists(st.permutations(NAMES), min_size=1, max_size=5), st.sampled_from([b"", FAR_FROM_THE_END]))
def test_frames_of_named_rows_in_any_order(orders: list[list[str]], rest: bytes) -> None:
    lines = [
        line
        for frame, order in enumerate(orders, 7)
        for line in (str(frame), *(f"{name} {frame}.{len(name)} {len(name)}" for name in order))
    ]
    values, first, fault = t.parse_frames("\n".join(lines).encode() + rest, 0, 1, NAMES, [2] * len(NAMES))
    assert fault is None
    assert first == 7
    for frame, row in enumerate(values, 7):
        assert row.tolist() == [float(x) for name in NAMES for x in (f"{frame}.{len(name)}", len(name))]


@pytest.mark.parametrize("name", ["lowerbac", "lowerbacks", "lowerbackbones", "Root", "roo"])
@pytest.mark.parametrize("rest", [b"", FAR_FROM_THE_END])
def test_a_name_that_is_only_like_one_is_unknown(name: str, rest: bytes) -> None:
    text = f"1\nroot 1\nlowerback 2\n2\nroot 1\n{name} 2\n".encode()
    _, _, fault = t.parse_frames(text + rest, 0, 1, ["root", "lowerback"], [1, 1])
    assert fault is not None
    assert (fault.code, fault.line, text[fault.start : fault.stop]) == (t.UNKNOWN_NAME, 6, name.encode())


def test_a_number_of_a_thousand_digits_is_one_number() -> None:
    values, fault = t.parse_rows(b"0." + b"1" * 1000 + b" 2\n" + b"9" * 300 + b" 3", 0, 1, 2)
    assert fault is None
    np.testing.assert_array_equal(values, [[0.1111111111111111, 2.0], [1e300, 3.0]])


@pytest.mark.parametrize(
    ("text", "code", "line", "about"),
    [
        (b"1 2\n\n# 3\n4 x5\n", t.BAD_NUMBER, 4, b"x5"),
        (b"1 2\r\n3 4 5", t.TOO_MANY, 2, b"5"),
        (b"1 2\n3 1e999\n", t.BAD_NUMBER, 2, b"1e999"),
        (b"1 nan\n", t.BAD_NUMBER, 1, b"nan"),
        (b"1 0x1\n", t.BAD_NUMBER, 1, b"0x1"),
        (b"1 2,5\n", t.BAD_NUMBER, 1, b"2,5"),
    ],
)
def test_a_fault_has_its_line_and_its_bytes(text: bytes, code: int, line: int, about: bytes) -> None:
    _, fault = t.parse_rows(text, 0, 1, 2)
    assert fault is not None
    assert (fault.code, fault.line, text[fault.start : fault.stop]) == (code, line, about)


def test_a_short_line_says_which_row_it_is_and_how_many_numbers_it_has() -> None:
    _, fault = t.parse_rows(b"header\n1 2 3\n4 5 6\n7 8", 7, 2, 3)
    assert fault == t.Fault(t.TOO_FEW, 4, 2, 2)


def test_memory_is_bounded_by_the_size_of_the_text_and_not_by_its_lines() -> None:
    values, fault = t.parse_rows(b"\n" * 200_000, 0, 1, 1_000_000)
    assert fault is None
    assert values.base is not None
    assert values.base.nbytes < 32 * 1_000_000
    with pytest.raises(ParameterError, match="columns must be at least 1"):
        t.parse_rows(b"", 0, 1, 0)
