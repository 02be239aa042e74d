"""Numbers in motion-capture text: compiled loops over bytes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from kinedex.ops.errors import ParameterError

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]
U8 = npt.NDArray[np.uint8]

OK, BAD_NUMBER, TOO_FEW, TOO_MANY, UNKNOWN_NAME, TWICE, MISSING, NOT_NEXT, NO_FRAME = range(9)
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
        One of BAD_NUMBER … NO_FRAME.
    line : int
        The line, from 1.
    start, stop : int
        The bytes or the index that it concerns, depending on the code.
    """

    code: int
    line: int
    start: int
    stop: int


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def _find_name(data: U8, pos: int, stop: int, names: U8, offsets: I64, guess: int) -> int:
    """Return the index of the name at [pos, stop), compared with `guess` first; −1 where it is none of them."""
    count = len(offsets) - 1
    for k in range(-1, count):
        i = guess if k < 0 else k
        size = offsets[_at(i + 1)] - offsets[_at(i)]
        if size == stop - pos:
            same = True
            for b in range(size):
                if data[_at(pos + b)] != names[_at(offsets[i] + b)]:
                    same = False
                    break
            if same:
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
        stop = _token_end(data, pos, end)
        if _ZERO <= byte <= _NINE:
            value, after, status = _number(data, pos, end)
            if status == 1 or value != np.floor(value) or status == 2:
                return BAD_NUMBER, line, pos, stop, frame + 1, first, slows
            if frame >= 0 and present < count:
                return MISSING, line, _first_absent(seen, frame), 0, frame, first, slows
            if frame >= 0 and int(value) != number + 1:
                return NOT_NEXT, line, number, int(value), frame, first, slows
            number, frame = int(value), frame + 1
            if frame == len(out):
                return MISSING, line, 0, 0, frame, first, slows
            if frame == 0:
                first = number
            present, guess, pos = 0, 0, after
        else:
            if frame < 0:
                return NO_FRAME, line, pos, stop, 0, first, slows
            name = _find_name(data, pos, stop, names, offsets, np.int64(guess))
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
def _count_line_ends(data: U8) -> int:
    count = 0
    for byte in data:
        count += int(byte == _NEWLINE) + int(byte == _RETURN)
    return count


def count_lines(data: bytes, start: int = 0) -> int:
    r"""Return an upper bound of the lines from a byte on; "\n", "\r\n" and "\r" end them, also mixed.

    "\r\n" counts twice: memory that is asked for and never touched costs less than to look at pairs of bytes.

    Parameters
    ----------
    data : bytes
    start : int
        The first byte.
    """
    return int(_count_line_ends(np.frombuffer(data, dtype=np.uint8)[start:])) + 1


@njit(cache=True, nogil=True)
def _count_rows(data: U8, pos: int, numbered: bool) -> int:
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


def count_rows(data: bytes, start: int, numbered: bool) -> int:
    """Return the number of lines from a byte on that are neither blank nor a comment.

    Parameters
    ----------
    data : bytes
        A text.
    start : int
        The first byte.
    numbered : bool
        Count only lines that begin with a digit: the frames of `parse_frames`, not the rows of `parse_rows`.
    """
    return int(_count_rows(np.frombuffer(data, dtype=np.uint8), start, numbered))


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


def row_starts(data: bytes, start: int, numbered: bool) -> I64:
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


def parse_frames(
    data: bytes, start: int, line: int, names: list[str], widths: list[int]
) -> tuple[F64, int, Fault | None]:
    """Parse frames of named rows of numbers, the body of an AMC file.

    A frame is a line with its number, then one line for each name: the name and its numbers. Names may come in any
    order, each once a frame; frame numbers must follow each other. Blank lines and lines that begin with # are skipped.

    Parameters
    ----------
    data : bytes
        The whole file.
    start : int
        The byte where the frames begin.
    line : int
        The number of the line there, from 1.
    names : list of str
        The rows that every frame must have.
    widths : list of int
        The number of values of each row.

    Returns
    -------
    values : float64 array (frames, sum of widths)
        Every number correctly rounded; empty where there is a fault.
    first : int
        The number of the first frame.
    fault : Fault or None
        The first fault, if any.
    """
    encoded = [name.encode("latin-1") for name in names]
    offsets = np.cumsum([0, *(len(name) for name in encoded)]).astype(np.int64)
    columns = np.cumsum([0, *widths]).astype(np.int64)
    array = np.frombuffer(data, dtype=np.uint8)
    rows = count_lines(data, start) // (len(names) + 1) + 2
    out = np.empty((rows, int(columns[-1])))
    slow = np.empty((1024, 4), dtype=np.int64)
    letters = np.frombuffer(b"".join(encoded), dtype=np.uint8)
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
            return TOO_MANY, line, pos, _token_end(data, pos, end), row, slows
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


def parse_rows(data: bytes, start: int, line: int, columns: int) -> tuple[F64, Fault | None]:
    """Parse lines of equally many numbers, the body of a BVH file.

    Blank lines and lines that begin with # are skipped.

    Parameters
    ----------
    data : bytes
        The whole file.
    start : int
        The byte where the rows begin.
    line : int
        The number of the line there, from 1.
    columns : int
        The number of values of a line, at least one.

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
    # A number takes a byte and a space at least, so that no count of lines can ask for more than a few file sizes.
    rows = min(count_lines(data, start), (len(data) - start) // (2 * columns) + 1) + 1
    out = np.empty((rows, columns))
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


def _convert_exactly(data: bytes, out: F64, slow: I64) -> Fault | None:
    """Fill in the numbers that the kernel could not round itself; return a fault where one is out of range."""
    for row, column, position, where in slow:
        # A number of hundreds of digits is one token all the same.
        stop = _token_end(np.frombuffer(data, dtype=np.uint8), int(position), len(data))
        value = float(data[position:stop])
        if not np.isfinite(value):
            return Fault(BAD_NUMBER, int(where), int(position), stop)
        out[_at(row), _at(column)] = value
    return None
