"""Numbers in motion-capture text: compiled loops over bytes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.errors import ParameterError

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]
U8 = npt.NDArray[np.uint8]
Text = bytes | bytearray | memoryview

OK, BAD_NUMBER, TOO_FEW, TOO_MANY, UNKNOWN_NAME, TWICE, MISSING, NOT_NEXT, NO_FRAME, FULL = range(10)
"""The faults that `parse_frames` and `parse_rows` report: see `Fault`."""

_EXACT = 2**53  # integers up to here are exact in a double, and so are the powers of ten up to 22:
_POWERS = np.array([10.0**i for i in range(23)])  # one multiplication or division of the two rounds correctly

_at = np.uint64
"""Makes an index unsigned: one that might be negative costs a check and an addition at every byte."""

_NEWLINE, _RETURN, _SPACE, _TAB, _HASH = 10, 13, 32, 9, 35
_PLUS, _MINUS, _DOT, _ZERO, _NINE = 43, 45, 46, 48, 57


@dataclass(frozen=True)
class Fault:
    """The first fault of a text.

    Parameters
    ----------
    code : int
        One of BAD_NUMBER … FULL, the last for a text with more rows than there is room for.
    line : int
        The line, from 1.
    start, stop : int
        The bytes or the index that it concerns, depending on the code.
    """

    code: int
    line: int
    start: int
    stop: int


@njit(cache=True, nogil=True, forceinline=True)
def _number(data: U8, pos: int, end: int) -> tuple[float, int, int]:
    """Read a number at pos.

    Returns
    -------
    value : float
    pos : int
        The position after the number.
    status : int
        0 for a number, 1 for none, 2 for a number that needs exact conversion.
    """
    begin = pos
    negative = False
    if pos < end and (data[_at(pos)] == _MINUS or data[_at(pos)] == _PLUS):
        negative = data[_at(pos)] == _MINUS
        pos += 1
    mantissa, fraction, first = np.int64(0), 0, pos
    while pos < end and _ZERO <= data[_at(pos)] <= _NINE:
        mantissa = mantissa * 10 + (data[_at(pos)] - _ZERO)
        pos += 1
    digits = pos - first
    if pos < end and data[_at(pos)] == _DOT:
        pos += 1
        first = pos
        while pos < end and _ZERO <= data[_at(pos)] <= _NINE:
            mantissa = mantissa * 10 + (data[_at(pos)] - _ZERO)
            pos += 1
        fraction = pos - first
        digits += fraction
    if digits == 0:
        return 0.0, pos, 1
    exponent = -fraction
    if pos < end and data[_at(pos)] > _SPACE:
        power, pos = _exponent(data, pos, end)
        if pos < 0:
            return 0.0, begin, 1
        exponent += power
    value = float(mantissa)
    status = 0
    if digits > 18 or mantissa > _EXACT or (mantissa > 0 and (exponent < -22 or exponent > 22)):
        status = 2  # the mantissa of more than 18 digits may have overflowed: only the text itself is exact
    elif mantissa == 0:
        pass
    elif exponent < 0:
        value /= _POWERS[_at(-exponent)]
    else:
        value *= _POWERS[_at(exponent)]
    return (-value if negative else value), pos, status


@njit(cache=True, nogil=True)
def _exponent(data: U8, pos: int, end: int) -> tuple[int, int]:
    """Read "e-05" at pos, up to the end of the token; return the power and the position behind it, or −1."""
    if data[_at(pos)] != 101 and data[_at(pos)] != 69:
        return 0, -1
    pos += 1
    down = False
    if pos < end and (data[_at(pos)] == _MINUS or data[_at(pos)] == _PLUS):
        down = data[_at(pos)] == _MINUS
        pos += 1
    power, first = np.int64(0), pos
    while pos < end and _ZERO <= data[_at(pos)] <= _NINE:
        if power < 100000:
            power = power * 10 + (data[_at(pos)] - _ZERO)
        pos += 1
    if pos == first or (pos < end and data[_at(pos)] > _SPACE):
        return 0, -1
    return int(-power if down else power), pos


@njit(cache=True, nogil=True)
def _next_line(data: U8, pos: int, end: int) -> int:
    r"""Return the position after the end of the line that pos is in; "\n", "\r\n" and "\r" all end one."""
    while pos < end and data[_at(pos)] != _NEWLINE and data[_at(pos)] != _RETURN:
        pos += 1
    if pos < end and data[_at(pos)] == _RETURN and pos + 1 < end and data[_at(pos + 1)] == _NEWLINE:
        return pos + 2
    return pos + 1 if pos < end else end


@njit(cache=True, nogil=True)
def _token_end(data: U8, pos: int, end: int) -> int:
    while pos < end and data[_at(pos)] > _SPACE:
        pos += 1
    return pos


@njit(inline="always")
def _skip_blanks(data, pos, end):  # type: ignore[no-untyped-def]
    while pos < end and (data[_at(pos)] == _SPACE or data[_at(pos)] == _TAB):
        pos += 1
    return pos


@njit(inline="always")
def _note_slow(slow, slows, row, column, pos, line):  # type: ignore[no-untyped-def]
    # Note a number that needs exact conversion, where there is room; return how many there are then.
    if slows < len(slow):
        slow[slows, 0], slow[slows, 1], slow[slows, 2], slow[slows, 3] = row, column, pos, line
    return slows + 1


@njit(cache=True, nogil=True, forceinline=True)
def _name_end(data: U8, pos: int, end: int, names: U8, start: int, stop: int) -> int:
    """Return the position after a name that is names[start:stop]; −1 where another one is at pos."""
    size = stop - start
    if pos + size > end or (pos + size < end and data[_at(pos + size)] > _SPACE):
        return -1
    for b in range(size):
        if data[_at(pos + b)] != names[_at(start + b)]:
            return -1
    return pos + size


@njit(cache=True, nogil=True)
def _find_name(data: U8, pos: int, end: int, names: U8, offsets: I64) -> int:
    """Return the index of the name at pos; −1 where it is none of them."""
    for i in range(len(offsets) - 1):
        if _name_end(data, pos, end, names, offsets[_at(i)], offsets[_at(i + 1)]) >= 0:
            return i
    return -1


@njit(cache=True, nogil=True)
def _first_absent(seen: I64, frame: int) -> int:
    for name in range(len(seen)):
        if seen[name] != frame:
            return name
    return -1


@njit(cache=True, nogil=True)
def _parse_frames(
    data: U8, pos: int, line: int, names: U8, offsets: I64, columns: I64, out: F64, slow: I64
) -> tuple[int, int, int, int, int, int, int]:
    """Return (code, line, fault start, fault stop, frames, first number, numbers that need exact conversion)."""
    end, count = len(data), len(offsets) - 1
    seen = np.full(count, -1, np.int64)
    frame, first, number, present, guess, slows = -1, 0, 0, 0, 0, 0
    while pos < end:
        pos = _skip_blanks(data, pos, end)
        if pos >= end:
            break
        byte = data[_at(pos)]
        if byte in (_NEWLINE, _RETURN, _HASH):
            pos, line = _next_line(data, pos, end), line + 1
            continue
        if _ZERO <= byte <= _NINE:
            value, after, status = _number(data, pos, end)
            if status == 1 or value != np.floor(value) or status == 2:
                return BAD_NUMBER, line, pos, _token_end(data, pos, end), frame + 1, first, slows
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
                return NO_FRAME, line, pos, _token_end(data, pos, end), 0, first, slows
            name, stop = guess, _name_end(data, pos, end, names, offsets[_at(guess)], offsets[_at(guess + 1)])
            if stop < 0:  # not the name behind the one before, as in nearly every file
                name, stop = _find_name(data, pos, end, names, offsets), _token_end(data, pos, end)
            if name < 0:
                return UNKNOWN_NAME, line, pos, stop, frame, first, slows
            if seen[_at(name)] == frame:
                return TWICE, line, pos, stop, frame, first, slows
            seen[_at(name)] = frame
            present += 1
            guess = name + 1 if name + 1 < count else 0
            pos = stop
            for column in range(columns[_at(name)], columns[name + 1]):
                pos = _skip_blanks(data, pos, end)
                if pos >= end or data[_at(pos)] == _NEWLINE or data[_at(pos)] == _RETURN:
                    return TOO_FEW, line, name, column - columns[_at(name)], frame, first, slows
                value, after, status = _number(data, pos, end)
                if status == 1:
                    return BAD_NUMBER, line, pos, _token_end(data, pos, end), frame, first, slows
                if status == 2:
                    slows = _note_slow(slow, slows, frame, column, pos, line)
                out[_at(frame), _at(column)] = value
                pos = after
        pos = _skip_blanks(data, pos, end)
        if pos < end and data[_at(pos)] != _NEWLINE and data[_at(pos)] != _RETURN:
            return TOO_MANY, line, pos, _token_end(data, pos, end), frame, first, slows
        pos, line = _next_line(data, pos, end), line + 1
    if frame >= 0 and present < count:
        return MISSING, line, _first_absent(seen, frame), 1, frame, first, slows
    return OK, line, 0, 0, frame + 1, first, slows


@njit(cache=True, nogil=True)
def _count_rows(data: U8, pos: int, numbered: bool) -> tuple[int, int]:
    """Return the numbers of rows and of lines that begin with a blank behind a byte.

    Sums of 128 bytes fit into a byte, so that the processor takes dozens of bytes at once.
    """
    end, rows, indented = len(data), 0, 0
    for start in range(pos + 1, end, 128):
        begun, blank = np.uint8(0), np.uint8(0)
        for i in range(start, min(start + 128, end)):
            before, byte = data[_at(i - 1)], data[_at(i)]
            begins = (before == _NEWLINE) | (before == _RETURN)
            indent = (byte == _SPACE) | (byte == _TAB)
            blank = np.uint8(blank + np.uint8(begins & indent))
            if numbered:
                row = (byte >= _ZERO) & (byte <= _NINE)
            else:
                row = (byte != _NEWLINE) & (byte != _RETURN) & (byte != _HASH) & (not indent)
            begun = np.uint8(begun + np.uint8(begins & row))
        rows += int(begun)
        indented += int(blank)
    return rows, indented


@njit(cache=True, nogil=True)
def _count_indented_rows(data: U8, pos: int, numbered: bool) -> int:
    end, count = len(data), 0
    while pos < end:
        pos = _skip_blanks(data, pos, end)
        if pos < end:
            byte = data[_at(pos)]
            if numbered:
                count += int(_ZERO <= byte <= _NINE)
            else:
                count += int(byte != _NEWLINE and byte != _RETURN and byte != _HASH)
        pos = _next_line(data, pos, end)
    return count


def count_rows(data: Text, start: int, numbered: bool) -> int:
    """Return the number of lines from a byte on that are neither blank nor a comment.

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
    if start < len(array) and array[start] in (_SPACE, _TAB):
        return int(_count_indented_rows(array, start, numbered))
    rows, indented = _count_rows(array, start, numbered)
    if indented:
        return int(_count_indented_rows(array, start, numbered))
    first = array[start] if start < len(array) else _NEWLINE
    own = _ZERO <= first <= _NINE if numbered else first not in (_NEWLINE, _RETURN, _HASH)
    return int(rows) + int(own)


@njit(cache=True, nogil=True)
def _row_starts(data: U8, pos: int, numbered: bool, out: I64) -> None:
    end, count = len(data), 0
    while pos < end:
        line = pos
        pos = _skip_blanks(data, pos, end)
        if pos < end:
            byte = data[_at(pos)]
            if numbered:
                row = _ZERO <= byte <= _NINE
            else:
                row = byte != _NEWLINE and byte != _RETURN and byte != _HASH
            if row:
                out[_at(count)] = line
                count += 1
        pos = _next_line(data, pos, end)


def row_starts(data: Text, start: int, numbered: bool) -> I64:
    """Return the bytes at which the lines begin that `count_rows` counts.

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
        Places in `data`, ascending; blanks at the beginning of a line belong to it.
    """
    found = np.empty(count_rows(data, start, numbered), np.int64)
    _row_starts(np.frombuffer(data, dtype=np.uint8), start, numbered, found)
    return found


@lru_cache(maxsize=16)
def _named_columns(names: tuple[str, ...], widths: tuple[int, ...]) -> tuple[U8, I64, I64]:
    """Return the letters of all names, and where each name and its columns begin and end."""
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
        Where the numbers are put; memory of their own by default.

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
    slow = np.empty((1024, 4), dtype=np.int64)
    while True:
        code, at, a, b, frames, first, slows = _parse_frames(array, start, line, letters, offsets, columns, out, slow)
        if slows <= len(slow):
            break
        slow = np.empty((slows, 4), dtype=np.int64)
    if code != OK:
        return out[:0], first, Fault(code, at, a, b)
    fault = _convert_exactly(data, out, slow[:slows])
    if fault is not None:
        return out[:0], first, fault
    return out[:frames], first, None


@njit(cache=True, nogil=True)
def _parse_rows(data: U8, pos: int, line: int, out: F64, slow: I64) -> tuple[int, int, int, int, int, int]:
    """Return (code, line, fault start, fault stop, rows, numbers that need exact conversion)."""
    end = len(data)
    columns = out.shape[1]
    row, slows = 0, 0
    while pos < end:
        pos = _skip_blanks(data, pos, end)
        if pos >= end:
            break
        if data[_at(pos)] == _NEWLINE or data[_at(pos)] == _RETURN or data[_at(pos)] == _HASH:
            pos, line = _next_line(data, pos, end), line + 1
            continue
        if row == len(out):
            return FULL, line, row, 0, row, slows
        for column in range(columns):
            pos = _skip_blanks(data, pos, end)
            if pos >= end or data[_at(pos)] == _NEWLINE or data[_at(pos)] == _RETURN:
                return TOO_FEW, line, row, column, row, slows
            value, after, status = _number(data, pos, end)
            if status == 1:
                return BAD_NUMBER, line, pos, _token_end(data, pos, end), row, slows
            if status == 2:
                slows = _note_slow(slow, slows, row, column, pos, line)
            out[_at(row), _at(column)] = value
            pos = after
        pos = _skip_blanks(data, pos, end)
        if pos < end and data[_at(pos)] != _NEWLINE and data[_at(pos)] != _RETURN:
            return TOO_MANY, line, pos, _token_end(data, pos, end), row, slows
        row += 1
        pos, line = _next_line(data, pos, end), line + 1
    return OK, line, 0, 0, row, slows


def parse_rows(data: Text, start: int, line: int, columns: int, out: F64 | None = None) -> tuple[F64, Fault | None]:
    """Parse lines of equally many numbers, the body of a BVH file.

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
        Where the numbers are put; memory of their own by default.

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
        # A number takes a byte and a space at least, so that no count of lines can ask for more than a few file sizes.
        out = np.empty((min(count_rows(data, start, False), (len(data) - start) // (2 * columns) + 1), columns))
    slow = np.empty((1024, 4), dtype=np.int64)
    while True:
        code, at, a, b, found, slows = _parse_rows(array, start, line, out, slow)
        if slows <= len(slow):
            break
        slow = np.empty((slows, 4), dtype=np.int64)
    fault = None if code == OK else Fault(code, at, a, b)
    if fault is None:
        fault = _convert_exactly(data, out, slow[:slows])
    return (out[:0] if fault else out[:found]), fault


def _convert_exactly(data: Text, out: F64, slow: I64) -> Fault | None:
    """Fill in the numbers that the kernel could not round itself; return a fault where one is out of range."""
    for row, column, position, where in slow:
        # A number of hundreds of digits is one token all the same.
        stop = _token_end(np.frombuffer(data, dtype=np.uint8), int(position), len(data))
        value = float(bytes(data[position:stop]))
        if not np.isfinite(value):
            return Fault(BAD_NUMBER, int(where), int(position), stop)
        out[_at(row), _at(column)] = value
    return None
