"""These kernels parse the numbers of motion-capture text files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit

from kinedex.ops.arrays import F64, I64, U8
from kinedex.ops.errors import ParameterError
from kinedex.ops.numerals import (
    HASH,
    NEWLINE,
    NINE,
    RETURN,
    SPACE,
    TAB,
    ZERO,
    next_line,
    read_number,
    skip_blanks,
    token_end,
    unsigned,
)

Text = bytes | bytearray | memoryview

OK, BAD_NUMBER, TOO_FEW, TOO_MANY, UNKNOWN_NAME, TWICE, MISSING, NOT_NEXT, NO_FRAME, FULL = range(10)
"""The error codes of `parse_frames` and `parse_rows`, see `Fault`."""


@dataclass(frozen=True)
class Fault:
    """The first syntax error of a text.

    Parameters
    ----------
    code : int
        One of BAD_NUMBER … FULL, the last for a text with more rows than `out` can hold.
    line : int
        The line, from 1.
    start, stop : int
        The byte range or the index of the error, depending on the code.
    """

    code: int
    line: int
    start: int
    stop: int


@njit(inline="always")
def _note_slow(slow, slows, row, column, pos, after, line):  # type: ignore[no-untyped-def]
    # Record a number that needs exact conversion if there is space; return the new count.
    if slows < len(slow):
        slow[slows, 0], slow[slows, 1], slow[slows, 2], slow[slows, 3] = row, column, pos, after
        slow[slows, 4] = line
    return slows + 1


@njit(cache=True, nogil=True, _nrt=False, forceinline=True)
def _name_end(data: U8, pos: int, end: int, names: U8, start: int, stop: int) -> int:
    """Return the position after the name names[start:stop] at `pos`; −1 if another name is there."""
    size = stop - start
    if pos + size > end or (pos + size < end and data[unsigned(pos + size)] > SPACE):
        return -1
    for b in range(size):
        if data[unsigned(pos + b)] != names[unsigned(start + b)]:
            return -1
    return pos + size


@njit(cache=True, nogil=True, _nrt=False)
def _find_name(data: U8, pos: int, end: int, names: U8, offsets: I64) -> int:
    """Return the index of the name at `pos`; −1 if it is none of them."""
    for i in range(len(offsets) - 1):
        if _name_end(data, pos, end, names, offsets[unsigned(i)], offsets[unsigned(i + 1)]) >= 0:
            return i
    return -1


@njit(cache=True, nogil=True, _nrt=False)
def _first_absent(seen: I64, frame: int) -> int:
    for name in range(len(seen)):
        if seen[name] != frame:
            return name
    return -1


@njit(cache=True, nogil=True, _nrt=False)
def _parse_frames(
    data: U8, pos: int, line: int, names: U8, offsets: I64, columns: I64, seen: I64, out: F64, slow: I64
) -> tuple[int, int, int, int, int, int, int]:
    """Return (code, line, fault start, fault stop, frames, first frame number, count of numbers to convert exactly)."""
    end, count = len(data), len(offsets) - 1
    seen[:] = -1  # the last frame in which each name was seen
    frame, first, number, present, guess, slows = -1, 0, 0, 0, 0, 0
    while pos < end:
        pos = skip_blanks(data, pos, end)
        if pos >= end:
            break
        byte = data[unsigned(pos)]
        if byte in (NEWLINE, RETURN, HASH):
            pos, line = next_line(data, pos, end), line + 1
            continue
        if ZERO <= byte <= NINE:
            value, after, status = read_number(data, pos, end)
            if status == 1 or value != np.floor(value) or status == 2:
                return BAD_NUMBER, line, pos, token_end(data, pos, end), frame + 1, first, slows
            if frame >= 0 and present < count:
                return MISSING, line, _first_absent(seen, frame), 0, frame, first, slows
            if frame >= 0 and int(value) != number + 1:
                return NOT_NEXT, line, number, int(value), frame, first, slows
            number, frame = int(value), frame + 1
            if frame == len(out):
                return FULL, line, 0, 0, frame, first, slows
            if frame == 0:
                first = number
            present, guess, pos = 0, 0, after
        else:
            if frame < 0:
                return NO_FRAME, line, pos, token_end(data, pos, end), 0, first, slows
            name, stop = guess, _name_end(data, pos, end, names, offsets[unsigned(guess)], offsets[unsigned(guess + 1)])
            if stop < 0:  # the name is not the next one in order, which it nearly always is
                name, stop = _find_name(data, pos, end, names, offsets), token_end(data, pos, end)
            if name < 0:
                return UNKNOWN_NAME, line, pos, stop, frame, first, slows
            if seen[unsigned(name)] == frame:
                return TWICE, line, pos, stop, frame, first, slows
            seen[unsigned(name)] = frame
            present += 1
            guess = name + 1 if name + 1 < count else 0
            pos = stop
            for column in range(columns[unsigned(name)], columns[name + 1]):
                pos = skip_blanks(data, pos, end)
                if pos >= end or data[unsigned(pos)] == NEWLINE or data[unsigned(pos)] == RETURN:
                    return TOO_FEW, line, name, column - columns[unsigned(name)], frame, first, slows
                value, after, status = read_number(data, pos, end)
                if status == 1:
                    return BAD_NUMBER, line, pos, token_end(data, pos, end), frame, first, slows
                if status == 2:
                    slows = _note_slow(slow, slows, frame, column, pos, after, line)
                out[unsigned(frame), unsigned(column)] = value
                pos = after
        pos = skip_blanks(data, pos, end)
        if pos < end and data[unsigned(pos)] != NEWLINE and data[unsigned(pos)] != RETURN:
            return TOO_MANY, line, pos, token_end(data, pos, end), frame, first, slows
        pos, line = next_line(data, pos, end), line + 1
    if frame >= 0 and present < count:
        return MISSING, line, _first_absent(seen, frame), 1, frame, first, slows
    return OK, line, 0, 0, frame + 1, first, slows


@njit(cache=True, nogil=True, _nrt=False)
def _count_rows(data: U8, pos: int, numbered: bool) -> tuple[int, int]:
    """Return the numbers of rows and of indented lines from the byte `pos` to the end.

    Counts over 128 bytes fit into a byte, so that the loop vectorises over dozens of bytes.
    """
    end, rows, indented = len(data), 0, 0
    for start in range(pos + 1, end, 128):
        begun, blank = np.uint8(0), np.uint8(0)
        for i in range(start, min(start + 128, end)):
            before, byte = data[unsigned(i - 1)], data[unsigned(i)]
            begins = (before == NEWLINE) | (before == RETURN)
            indent = (byte == SPACE) | (byte == TAB)
            blank = np.uint8(blank + np.uint8(begins & indent))
            if numbered:
                row = (byte >= ZERO) & (byte <= NINE)
            else:
                row = (byte != NEWLINE) & (byte != RETURN) & (byte != HASH) & (not indent)
            begun = np.uint8(begun + np.uint8(begins & row))
        rows += int(begun)
        indented += int(blank)
    return rows, indented


@njit(cache=True, nogil=True, _nrt=False)
def _count_indented_rows(data: U8, pos: int, numbered: bool) -> int:
    end, count = len(data), 0
    while pos < end:
        pos = skip_blanks(data, pos, end)
        if pos < end:
            byte = data[unsigned(pos)]
            if numbered:
                count += int(ZERO <= byte <= NINE)
            else:
                count += int(byte != NEWLINE and byte != RETURN and byte != HASH)
        pos = next_line(data, pos, end)
    return count


def count_rows(data: Text, start: int, numbered: bool) -> int:
    """Return the number of lines from the byte `start` to the end that are neither blank nor a comment.

    Parameters
    ----------
    data : bytes or memoryview
        A text.
    start : int
        The first byte.
    numbered : bool
        Count only lines that begin with a digit: the frames of `parse_frames`, not the rows of `parse_rows`.
    """
    array = np.frombuffer(data, dtype=np.uint8)
    if start < len(array) and array[start] in (SPACE, TAB):
        return int(_count_indented_rows(array, start, numbered))
    rows, indented = _count_rows(array, start, numbered)
    if indented:
        return int(_count_indented_rows(array, start, numbered))
    first = array[start] if start < len(array) else NEWLINE
    own = ZERO <= first <= NINE if numbered else first not in (NEWLINE, RETURN, HASH)
    return int(rows) + int(own)


@njit(cache=True, nogil=True, _nrt=False)
def _row_starts(data: U8, pos: int, numbered: bool, out: I64) -> None:
    end, count = len(data), 0
    while pos < end:
        line = pos
        pos = skip_blanks(data, pos, end)
        if pos < end:
            byte = data[unsigned(pos)]
            if numbered:
                row = ZERO <= byte <= NINE
            else:
                row = byte != NEWLINE and byte != RETURN and byte != HASH
            if row:
                out[unsigned(count)] = line
                count += 1
        pos = next_line(data, pos, end)


def row_starts(data: Text, start: int, numbered: bool) -> I64:
    """Return the byte offsets of the lines that `count_rows` counts.

    Parameters
    ----------
    data : bytes
        A text.
    start : int
        The first byte, the beginning of a line.
    numbered : bool
        Find only lines that begin with a digit.

    Returns
    -------
    int64 array (rows,)
        Offsets in `data`, ascending; blanks at the beginning of a line belong to it.
    """
    found = np.empty(count_rows(data, start, numbered), np.int64)
    _row_starts(np.frombuffer(data, dtype=np.uint8), start, numbered, found)
    return found


@lru_cache(maxsize=16)
def _named_columns(names: tuple[str, ...], widths: tuple[int, ...]) -> tuple[U8, I64, I64]:
    """Return the bytes of all names, and the offsets of each name and of its columns."""
    encoded = [name.encode("latin-1") for name in names]
    offsets = np.cumsum([0, *(len(name) for name in encoded)]).astype(np.int64)
    columns = np.cumsum([0, *widths]).astype(np.int64)
    return np.frombuffer(b"".join(encoded), dtype=np.uint8), offsets, columns


def parse_frames(
    data: Text, start: int, line: int, names: list[str], widths: list[int], out: F64 | None = None
) -> tuple[F64, int, Fault | None]:
    """Parse frames of named rows of numbers, the body of an AMC file.

    A frame is a line with its number, then one line for each name: the name and its numbers. Names may come in any
    order, each once a frame; frame numbers must follow each other. Blank lines and lines that begin with # are skipped.

    Parameters
    ----------
    data : bytes or memoryview
        A text that ends with its last frame.
    start : int
        The byte where the frames begin.
    line : int
        The number of the line there, from 1.
    names : list of str
        The rows that every frame must have.
    widths : list of int
        The number of values of each row.
    out : float64 array (at least frames, sum of widths), optional
        The array to fill; a new one by default.

    Returns
    -------
    values : float64 array (frames, sum of widths)
        Every number correctly rounded; empty where there is a fault.
    first : int
        The number of the first frame.
    fault : Fault or None
        The first fault, if any.
    """
    letters, offsets, columns = _named_columns(tuple(names), tuple(widths))
    array = np.frombuffer(data, dtype=np.uint8)
    if out is None:
        shortest = 2 + len(letters) + len(names) + 2 * int(columns[-1])
        most = min(count_rows(data, start, True), (len(data) - start) // shortest + 1)
        out = np.empty((most, int(columns[-1])))
    slow, seen = np.empty((1024, 5), dtype=np.int64), np.empty(len(names), np.int64)
    while True:
        code, at, a, b, frames, first, slows = _parse_frames(
            array, start, line, letters, offsets, columns, seen, out, slow
        )
        if slows <= len(slow):
            break
        slow = np.empty((slows, 5), dtype=np.int64)
    if code != OK:
        return out[:0], first, Fault(code, at, a, b)
    fault = _convert_exactly(data, out, slow[:slows])
    if fault is not None:
        return out[:0], first, fault
    return out[:frames], first, None


@njit(cache=True, nogil=True, _nrt=False)
def _parse_rows(data: U8, pos: int, line: int, out: F64, slow: I64) -> tuple[int, int, int, int, int, int]:
    """Return (code, line, fault start, fault stop, rows, count of numbers to convert exactly)."""
    end = len(data)
    columns = out.shape[1]
    row, slows = 0, 0
    while pos < end:
        pos = skip_blanks(data, pos, end)
        if pos >= end:
            break
        if data[unsigned(pos)] == NEWLINE or data[unsigned(pos)] == RETURN or data[unsigned(pos)] == HASH:
            pos, line = next_line(data, pos, end), line + 1
            continue
        if row == len(out):
            return FULL, line, row, 0, row, slows
        for column in range(columns):
            pos = skip_blanks(data, pos, end)
            if pos >= end or data[unsigned(pos)] == NEWLINE or data[unsigned(pos)] == RETURN:
                return TOO_FEW, line, row, column, row, slows
            value, after, status = read_number(data, pos, end)
            if status == 1:
                return BAD_NUMBER, line, pos, token_end(data, pos, end), row, slows
            if status == 2:
                slows = _note_slow(slow, slows, row, column, pos, after, line)
            out[unsigned(row), unsigned(column)] = value
            pos = after
        pos = skip_blanks(data, pos, end)
        if pos < end and data[unsigned(pos)] != NEWLINE and data[unsigned(pos)] != RETURN:
            return TOO_MANY, line, pos, token_end(data, pos, end), row, slows
        row += 1
        pos, line = next_line(data, pos, end), line + 1
    return OK, line, 0, 0, row, slows


def parse_rows(data: Text, start: int, line: int, columns: int, out: F64 | None = None) -> tuple[F64, Fault | None]:
    """Parse lines with equal counts of numbers, the body of a BVH file.

    Blank lines and lines that begin with # are skipped.

    Parameters
    ----------
    data : bytes or memoryview
        A text that ends with its last row.
    start : int
        The byte where the rows begin.
    line : int
        The number of the line there, from 1.
    columns : int
        The number of values of a line, at least one.
    out : float64 array (at least rows, columns), optional
        The array to fill; a new one by default.

    Returns
    -------
    values : float64 array (rows, columns)
        Every number correctly rounded; empty where there is a fault.
    fault : Fault or None
        The first fault, if any: BAD_NUMBER and TOO_MANY with the bytes concerned, TOO_FEW with the row (from 0) as
        `start` and the number of its values as `stop`.

    Raises
    ------
    ParameterError
        If `columns` is not positive.
    """
    if columns < 1:
        raise ParameterError("columns", "at least 1", columns)
    array = np.frombuffer(data, dtype=np.uint8)
    if out is None:
        # A number takes at least a digit and a space, so the memory is limited to a few times the file size.
        out = np.empty((min(count_rows(data, start, False), (len(data) - start) // (2 * columns) + 1), columns))
    slow = np.empty((1024, 5), dtype=np.int64)
    while True:
        code, at, a, b, found, slows = _parse_rows(array, start, line, out, slow)
        if slows <= len(slow):
            break
        slow = np.empty((slows, 5), dtype=np.int64)
    fault = None if code == OK else Fault(code, at, a, b)
    if fault is None:
        fault = _convert_exactly(data, out, slow[:slows])
    return (out[:0] if fault else out[:found]), fault


def _convert_exactly(data: Text, out: F64, slow: I64) -> Fault | None:
    """Fill in the numbers that need exact conversion; return a fault if one is out of range."""
    if not len(slow):
        return None
    whole = bytes(data)
    values = np.array([float(whole[start:stop]) for start, stop in slow[:, 2:4].tolist()])
    if not np.isfinite(values).all():
        _, _, start, stop, line = slow[np.isfinite(values).argmin()].tolist()
        return Fault(BAD_NUMBER, line, start, stop)
    out[slow[:, 0], slow[:, 1]] = values
    return None
