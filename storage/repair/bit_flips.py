"""Restore a small file with one flipped bit by trying each bit against the checksum."""

from __future__ import annotations

import hashlib

LARGEST = 24_000
"""The largest file in bytes that is tried: the time grows with the square of the size, to some seconds here."""


def without_flip(content: bytes, sha256: str) -> bytes | None:
    """Return the content of a file before one of its bits was flipped; None if no single flip explains the damage.

    Parameters
    ----------
    content : bytes
        The damaged content, at most `LARGEST` bytes.
    sha256 : str
        The checksum of the original content, in hexadecimal.
    """
    if len(content) > LARGEST:
        return None
    wanted, view = bytes.fromhex(sha256), memoryview(content)
    before = hashlib.sha256()
    for place, byte in enumerate(content):
        for bit in range(8):
            attempt = before.copy()
            attempt.update(bytes([byte ^ 1 << bit]))
            attempt.update(view[place + 1 :])
            if attempt.digest() == wanted:
                return content[:place] + bytes([byte ^ 1 << bit]) + content[place + 1 :]
        before.update(view[place : place + 1])
    return None
