"""These kernels parse numbers in text, and find the ends of tokens and lines.

None of them stores a reference to an array, which avoids reference counting at every byte (`_nrt`).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from kinedex.ops.arrays import U8
from kinedex.ops.bits import lowest_bit

_EXACT = 2**53  # integers up to here are exact in a double, and so are the powers of ten up to 22:
_POWERS = np.array([10.0**i for i in range(23)])  # one multiplication or division of the two rounds correctly
_TENS = np.array([10**i for i in range(8)])

unsigned = np.uint64
"""Convert an index to unsigned: a signed one costs a check for negative values and an addition at every byte."""

NEWLINE, RETURN, SPACE, TAB, HASH = 10, 13, 32, 9, 35
PLUS, MINUS, DOT, ZERO, NINE = 43, 45, 46, 48, 57

_8, _10, _16, _32, _56, _100, _10000 = (np.uint64(number) for number in (8, 10, 16, 32, 56, 100, 10_000))
_TOPS, _REST = np.uint64(0x8080_8080_8080_8080), np.uint64(0x7F7F_7F7F_7F7F_7F7F)
_ZEROS = np.uint64(0x3030_3030_3030_3030)
_TO_TOP_FROM_10 = np.uint64(0x7676_7676_7676_7676)
_TO_TOP_FROM_33 = np.uint64(0x5F5F_5F5F_5F5F_5F5F)
_PAIRS, _FOURS, _EIGHT = np.uint64(0x00FF_00FF_00FF_00FF), np.uint64(0x0000_FFFF_0000_FFFF), np.uint64(0xFFFF_FFFF)


@njit(cache=True, nogil=True, _nrt=False, forceinline=True)
def _eight(data: U8, pos: int) -> np.uint64:
    """Return eight bytes as a number, the first byte lowest; compilers make one instruction of it."""
    at = unsigned(pos)
    low = unsigned(data[at]) | unsigned(data[at + unsigned(1)]) << _8 | unsigned(data[at + unsigned(2)]) << _16
    low |= unsigned(data[at + unsigned(3)]) << unsigned(24)
    high = unsigned(data[at + unsigned(4)]) | unsigned(data[at + unsigned(5)]) << _8
    high |= unsigned(data[at + unsigned(6)]) << _16 | unsigned(data[at + unsigned(7)]) << unsigned(24)
    return low | high << _32


@njit(cache=True, nogil=True, _nrt=False, forceinline=True)
def _before_blank(eight: np.uint64) -> int:
    """Return the number of bytes before the first blank or end of line; 8 if there is none."""
    return lowest_bit(~(((eight & _REST) + _TO_TOP_FROM_33) | eight) & _TOPS) >> 3


@njit(cache=True, nogil=True, _nrt=False, forceinline=True)
def _digits(eight: np.uint64) -> int:
    """Return the number of leading digits of eight bytes from which the code of "0" was subtracted."""
    # can be wrong only after the first byte that is no digit
    return lowest_bit(((eight + _TO_TOP_FROM_10) | eight) & _TOPS) >> 3


@njit(cache=True, nogil=True, _nrt=False, forceinline=True)
def _whole(eight: np.uint64, digits: int) -> np.int64:
    """Return the number that the first 0 to 7 digits encode, by combining digits to pairs, fours and eight."""
    eight = (eight << (_56 - _8 * unsigned(digits))) << _8
    eight = (eight * _10 + (eight >> _8)) & _PAIRS
    eight = (eight * _100 + (eight >> _16)) & _FOURS
    return np.int64((eight * _10000 + (eight >> _32)) & _EIGHT)


@njit(cache=True, nogil=True, _nrt=False, forceinline=True)
def _plain_number(data: U8, pos: int) -> tuple[float, int]:
    """Parse a number such as -29.3102, with at most seven digits on either side; return it and its end, or −1.

    At least 18 more bytes of text must follow. The end of the token is computed independently of the digits, so that
    the processor can begin with the next token in parallel.
    """
    first, second = _before_blank(_eight(data, pos)), _before_blank(_eight(data, pos + 8))
    stop = pos + first + (second & -(first >> 3))
    negative = data[unsigned(pos)] == MINUS
    at = pos + int(negative)
    whole = _eight(data, at) ^ _ZEROS
    before = _digits(whole)
    fraction = _eight(data, at + before + 1) ^ _ZEROS
    after = _digits(fraction)
    value = 0.0
    if stop == pos + 16 or before == 8 or before + after == 0:
        stop = -1
    elif data[unsigned(at + before)] == DOT and after < 8 and at + before + 1 + after == stop:
        mantissa = _whole(whole, before) * _TENS[unsigned(after)] + _whole(fraction, after)
        value = float(mantissa) / _POWERS[unsigned(after)]
    elif before > 0 and at + before == stop:
        value = float(_whole(whole, before))
    else:
        stop = -1
    return (-value if negative else value), stop


@njit(cache=True, nogil=True, _nrt=False, forceinline=True)
def read_number(data: U8, pos: int, end: int) -> tuple[float, int, int]:
    """Parse the number at `pos`, with a fast path for plain numbers.

    Returns
    -------
    value : float
        The number.
    pos : int
        The position after the number.
    status : int
        0 for a number, 1 for none, 2 for a number that needs exact conversion.
    """
    if pos + 18 <= end:
        value, stop = _plain_number(data, pos)
        if stop >= 0:
            return value, stop, 0
    return _any_number(data, pos, end)


@njit(cache=True, nogil=True, _nrt=False)
def _any_number(data: U8, pos: int, end: int) -> tuple[float, int, int]:
    """Parse the number at `pos` in any notation.

    Returns
    -------
    value : float
        The number.
    pos : int
        The position after the number.
    status : int
        0 for a number, 1 for none, 2 for a number that needs exact conversion.
    """
    begin = pos
    negative = False
    if pos < end and (data[unsigned(pos)] == MINUS or data[unsigned(pos)] == PLUS):
        negative = data[unsigned(pos)] == MINUS
        pos += 1
    mantissa, fraction, first = np.int64(0), 0, pos
    while pos < end and ZERO <= data[unsigned(pos)] <= NINE:
        mantissa = mantissa * 10 + (data[unsigned(pos)] - ZERO)
        pos += 1
    digits = pos - first
    if pos < end and data[unsigned(pos)] == DOT:
        pos += 1
        first = pos
        while pos < end and ZERO <= data[unsigned(pos)] <= NINE:
            mantissa = mantissa * 10 + (data[unsigned(pos)] - ZERO)
            pos += 1
        fraction = pos - first
        digits += fraction
    if digits == 0:
        return 0.0, pos, 1
    exponent = -fraction
    if pos < end and data[unsigned(pos)] > SPACE:
        power, pos = _exponent(data, pos, end)
        if pos < 0:
            return 0.0, begin, 1
        exponent += power
    value = float(mantissa)
    status = 0
    if digits > 18 or mantissa > _EXACT or (mantissa > 0 and (exponent < -22 or exponent > 22)):
        status = 2  # a mantissa of more than 18 digits may have overflowed, so the text must be converted exactly
    elif mantissa == 0:
        pass
    elif exponent < 0:
        value /= _POWERS[unsigned(-exponent)]
    else:
        value *= _POWERS[unsigned(exponent)]
    return (-value if negative else value), pos, status


@njit(cache=True, nogil=True, _nrt=False)
def _exponent(data: U8, pos: int, end: int) -> tuple[int, int]:
    """Parse an exponent such as "e-05" up to the end of the token; return it and the position after it, or −1."""
    if data[unsigned(pos)] != 101 and data[unsigned(pos)] != 69:
        return 0, -1
    pos += 1
    down = False
    if pos < end and (data[unsigned(pos)] == MINUS or data[unsigned(pos)] == PLUS):
        down = data[unsigned(pos)] == MINUS
        pos += 1
    power, first = np.int64(0), pos
    while pos < end and ZERO <= data[unsigned(pos)] <= NINE:
        if power < 100000:
            power = power * 10 + (data[unsigned(pos)] - ZERO)
        pos += 1
    if pos == first or (pos < end and data[unsigned(pos)] > SPACE):
        return 0, -1
    return int(-power if down else power), pos


@njit(cache=True, nogil=True, _nrt=False)
def next_line(data: U8, pos: int, end: int) -> int:
    r"""Return the position after the end of the line that pos is in; "\n", "\r\n" and "\r" all end one."""
    while pos < end and data[unsigned(pos)] != NEWLINE and data[unsigned(pos)] != RETURN:
        pos += 1
    if pos < end and data[unsigned(pos)] == RETURN and pos + 1 < end and data[unsigned(pos + 1)] == NEWLINE:
        return pos + 2
    return pos + 1 if pos < end else end


@njit(cache=True, nogil=True, _nrt=False)
def token_end(data: U8, pos: int, end: int) -> int:
    while pos < end and data[unsigned(pos)] > SPACE:
        pos += 1
    return pos


@njit(cache=True, nogil=True, _nrt=False, forceinline=True)
def skip_blanks(data: U8, pos: int, end: int) -> int:
    """Return the position of the next byte that is not blank."""
    while pos < end and (data[unsigned(pos)] == SPACE or data[unsigned(pos)] == TAB):
        pos += 1
    return pos
