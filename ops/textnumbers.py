"""Numbers in motion-capture text: compiled loops over bytes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]
U8 = npt.NDArray[np.uint8]

OK, BAD_NUMBER, TOO_FEW, TOO_MANY, UNKNOWN_NAME, TWICE, MISSING, NOT_NEXT, NO_FRAME = range(9)
"""What `parse_frames` can find: see `Fault`."""

_EXACT = 2**53  # integers up to here are exact in a double, and so are the powers of ten up to 22:
_POWERS = np.array([10.0**i for i in range(23)])  # one multiplication or division of the two rounds correctly

_NEWLINE, _RETURN, _SPACE, _TAB, _HASH = 10, 13, 32, 9, 35
_PLUS, _MINUS, _DOT, _ZERO, _NINE = 43, 45, 46, 48, 57


@dataclass(frozen=True)
class Fault:
    """The first thing wrong in a text: its code, the line (from 1), and the bytes or the index it is about."""

    code: int
    line: int
    start: int
    stop: int


@njit(cache=True)
def _number(data: U8, pos: int, end: int) -> tuple[float, int, int]:
    """Read a number at pos: (value, position after it, 0 good | 1 no number | 2 good, but needs exact conversion)."""
    negative = False
    if pos < end and (data[pos] == _MINUS or data[pos] == _PLUS):
        negative = data[pos] == _MINUS
        pos += 1
    mantissa, digits, exponent, seen = np.int64(0), 0, 0, 0
    while pos < end and _ZERO <= data[pos] <= _NINE:
        if digits < 18:
            mantissa = mantissa * 10 + (data[pos] - _ZERO)
            digits += mantissa > 0
        else:
            exponent += 1
            digits += 1
        seen += 1
        pos += 1
    if pos < end and data[pos] == _DOT:
        pos += 1
        while pos < end and _ZERO <= data[pos] <= _NINE:
            if digits < 18:
                mantissa = mantissa * 10 + (data[pos] - _ZERO)
                digits += mantissa > 0
                exponent -= 1
            else:
                digits += 1
            seen += 1
            pos += 1
    if seen == 0:
        return 0.0, pos, 1
    if pos < end and (data[pos] == 101 or data[pos] == 69):
        pos += 1
        down = False
        if pos < end and (data[pos] == _MINUS or data[pos] == _PLUS):
            down = data[pos] == _MINUS
            pos += 1
        power, seen = 0, 0
        while pos < end and _ZERO <= data[pos] <= _NINE:
            if power < 100000:
                power = power * 10 + (data[pos] - _ZERO)
            seen += 1
            pos += 1
        if seen == 0:
            return 0.0, pos, 1
        exponent += -power if down else power
    if pos < end and data[pos] > _SPACE:
        return 0.0, pos, 1
    value = float(mantissa)
    status = 0
    if mantissa == 0 and digits == 0:
        pass
    elif digits > 18 or mantissa > _EXACT or exponent < -22 or exponent > 22:
        status = 2
    elif exponent < 0:
        value /= _POWERS[-exponent]
    else:
        value *= _POWERS[exponent]
    return (-value if negative else value), pos, status


@njit(cache=True)
def _next_line(data: U8, pos: int, end: int) -> int:
    """The position after the end of the line that pos is in; "\\n", "\\r\\n" and "\\r" all end one."""
    while pos < end and data[pos] != _NEWLINE and data[pos] != _RETURN:
        pos += 1
    if pos < end and data[pos] == _RETURN and pos + 1 < end and data[pos + 1] == _NEWLINE:
        return pos + 2
    return pos + 1 if pos < end else end


@njit(cache=True)
def _token_end(data: U8, pos: int, end: int) -> int:
    while pos < end and data[pos] > _SPACE:
        pos += 1
    return pos


@njit(cache=True)
def _find_name(data: U8, pos: int, stop: int, names: U8, offsets: I64, guess: int) -> int:
    """The index of the name that stands at [pos, stop), tried at `guess` first; −1 where it is none of them."""
    count = len(offsets) - 1
    for k in range(-1, count):
        i = guess if k < 0 else k
        size = offsets[i + 1] - offsets[i]
        if size == stop - pos:
            same = True
            for b in range(size):
                if data[pos + b] != names[offsets[i] + b]:
                    same = False
                    break
            if same:
                return i
    return -1


@njit(cache=True)
def _first_absent(seen: I64, frame: int) -> int:
    for name in range(len(seen)):
        if seen[name] != frame:
            return name
    return -1


@njit(cache=True)
def _parse_frames(
    data: U8, pos: int, line: int, names: U8, offsets: I64, columns: I64, out: F64, slow: I64
) -> tuple[int, int, int, int, int, int, int]:
    """Returns (code, line, fault start, fault stop, frames, first number, numbers that need exact conversion)."""
    end = len(data)
    count = len(offsets) - 1
    seen = np.full(count, -1, np.int64)
    frame, first, number, present, guess, slows = -1, 0, 0, 0, 0, 0
    while pos < end:
        while pos < end and (data[pos] == _SPACE or data[pos] == _TAB):
            pos += 1
        if pos >= end:
            break
        byte = data[pos]
        if byte in (_NEWLINE, _RETURN, _HASH):
            pos = _next_line(data, pos, end)
            line += 1
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
            number = int(value)
            frame += 1
            if frame == 0:
                first = number
            present = 0
            guess = 0
            pos = after
        else:
            if frame < 0:
                return NO_FRAME, line, pos, stop, 0, first, slows
            name = _find_name(data, pos, stop, names, offsets, guess)
            if name < 0:
                return UNKNOWN_NAME, line, pos, stop, frame, first, slows
            if seen[name] == frame:
                return TWICE, line, pos, stop, frame, first, slows
            seen[name] = frame
            present += 1
            guess = name + 1 if name + 1 < count else 0
            pos = stop
            for column in range(columns[name], columns[name + 1]):
                while pos < end and (data[pos] == _SPACE or data[pos] == _TAB):
                    pos += 1
                if pos >= end or data[pos] == _NEWLINE or data[pos] == _RETURN:
                    return TOO_FEW, line, name, column - columns[name], frame, first, slows
                value, after, status = _number(data, pos, end)
                if status == 1:
                    return BAD_NUMBER, line, pos, _token_end(data, pos, end), frame, first, slows
                if status == 2:
                    if slows < len(slow):
                        slow[slows, 0], slow[slows, 1] = frame, column
                        slow[slows, 2], slow[slows, 3] = pos, line
                    slows += 1
                out[frame, column] = value
                pos = after
        while pos < end and (data[pos] == _SPACE or data[pos] == _TAB):
            pos += 1
        if pos < end and data[pos] != _NEWLINE and data[pos] != _RETURN:
            return TOO_MANY, line, pos, _token_end(data, pos, end), frame, first, slows
        pos = _next_line(data, pos, end)
        line += 1
    if frame >= 0 and present < count:
        return MISSING, line, _first_absent(seen, frame), 1, frame, first, slows
    return OK, line, 0, 0, frame + 1, first, slows


def count_lines(data: bytes | memoryview) -> int:
    """An upper bound of the lines in a text with "\\n", "\\r\\n" or "\\r" endings."""
    array = np.frombuffer(data, dtype=np.uint8)
    newlines = int(np.count_nonzero(array == _NEWLINE))
    return (newlines if newlines else int(np.count_nonzero(array == _RETURN))) + 1


def parse_frames(
    data: bytes, start: int, line: int, names: list[str], widths: list[int]
) -> tuple[F64, int, Fault | None]:
    """Parse frames of named rows of numbers, the body of an AMC file.

    A frame is a line with its number, then one line a name: the name and its numbers. Names may come in any order, each
    once a frame; frame numbers must follow each other. Blank lines and lines that begin with # are passed over.

    Parameters
    ----------
    data: the whole file. start: where the frames begin (byte). line: the line number there, from 1.
    names: the rows that every frame must have. widths: how many numbers each has.

    Returns
    -------
    values: float64 (frames, sum of widths), every number correctly rounded. first: the first frame's number.
    fault: None, or the first thing that is wrong; the frames before it are not to be used.
    """
    encoded = [name.encode("latin-1") for name in names]
    offsets = np.cumsum([0, *(len(name) for name in encoded)]).astype(np.int64)
    columns = np.cumsum([0, *widths]).astype(np.int64)
    array = np.frombuffer(data, dtype=np.uint8)
    rows = count_lines(memoryview(data)[start:]) // (len(names) + 1) + 2
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
    for frame, column, position, where in slow[:slows]:
        token = data[position : position + 400].split(None, 1)[0]
        value = float(token)
        if not np.isfinite(value):
            return out[:0], first, Fault(BAD_NUMBER, int(where), int(position), int(position) + len(token))
        out[frame, column] = value
    return out[:frames], first, None
