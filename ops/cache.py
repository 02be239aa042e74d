"""This module provides a cache that keeps the most recently used values, bounded by their number or total size."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Generic, TypeVar

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")


def _one(_: object) -> int:
    return 1


class Cache(Generic[Key, Value]):
    """A thread-safe mapping that drops the least recently used values when their total size exceeds a bound.

    Parameters
    ----------
    most : int
        The maximum of the sum of all sizes.
    size : callable, optional
        A function that returns the size of a value; by default every size is 1, so that `most` is a number of values.
    least : int
        The number of most recently used values that are kept whatever their size.
    """

    def __init__(self, most: int, size: Callable[[Value], int] = _one, *, least: int = 1) -> None:
        self._most, self._size, self._least = most, size, least
        self._held: OrderedDict[Key, tuple[Value, int]] = OrderedDict()
        self._total = 0
        self._lock = Lock()

    def get(self, key: Key) -> Value | None:
        """Return the value of a key and mark it as used now; return None if the cache does not hold the key."""
        with self._lock:
            if key not in self._held:
                return None
            self._held.move_to_end(key)
            return self._held[key][0]

    def put(self, key: Key, value: Value) -> Value:
        """Store a value, replacing any earlier value of the key, and return the new value."""
        size = self._size(value)
        with self._lock:
            self._total += size - self._held.pop(key, (value, 0))[1]
            self._held[key] = value, size
            while self._total > self._most and len(self._held) > self._least:
                self._total -= self._held.popitem(last=False)[1][1]
        return value
