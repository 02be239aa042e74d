"""This module decompresses LZF, a format of point clouds that consists of literal bytes and copies of earlier bytes."""

from __future__ import annotations

import numpy as np
from numba import njit

from kinedex.ops.arrays import U8
from kinedex.ops.errors import ParameterError

MAX_RATIO = 88
"""Maximum expansion ratio: the instruction for the longest copy takes three bytes and produces 264."""

_TRUNCATED, _TOO_LONG, _TOO_EARLY = -1, -2, -3
_REASONS = {
    _TRUNCATED: "data that do not end within a run",
    _TOO_LONG: "data that unpack to as many bytes as their header claims, not more",
    _TOO_EARLY: "data that copy only what came before",
}


def decompress(data: bytes, size: int) -> U8:
    """Decompress LZF data.

    Parameters
    ----------
    data : bytes
        The packed bytes.
    size : int
        The number of decompressed bytes.

    Returns
    -------
    uint8 array (size,)
        The bytes.

    Raises
    ------
    ParameterError
        The data are damaged, or unpack to a different number of bytes. A size that the data cannot expand to is
        rejected before memory is allocated.
    """
    if not 0 <= size <= MAX_RATIO * len(data):
        raise ParameterError("size", f"0 to {MAX_RATIO * len(data)} for {len(data)} packed bytes", size)
    unpacked = np.empty(size, np.uint8)
    written = _decompress(np.frombuffer(data, np.uint8), unpacked)
    if written < 0:
        raise ParameterError("data", _REASONS[written], f"{len(data)} bytes")
    if written != size:
        raise ParameterError("data", f"of {size} bytes when unpacked", f"{written} bytes")
    return unpacked


@njit(cache=True, nogil=True)
def _decompress(data: U8, unpacked: U8) -> int:
    """Decompress data, and return the number of bytes, or a negative error code."""
    end, room = len(data), len(unpacked)
    i = o = 0
    while i < end:
        control = int(data[i])
        i += 1
        if control < 32:  # a literal run of control + 1 bytes
            count = control + 1
            if i + count > end:
                return _TRUNCATED
            if o + count > room:
                return _TOO_LONG
            for k in range(count):
                unpacked[o + k] = data[i + k]
            i += count
            o += count
            continue
        count = control >> 5
        if count == 7:
            if i >= end:
                return _TRUNCATED
            count += int(data[i])
            i += 1
        if i >= end:
            return _TRUNCATED
        start = o - ((control & 31) << 8) - int(data[i]) - 1
        i += 1
        count += 2
        if start < 0:
            return _TOO_EARLY
        if o + count > room:
            return _TOO_LONG
        for k in range(count):  # byte by byte: a copy may overlap itself
            unpacked[o + k] = unpacked[start + k]
        o += count
    return o
