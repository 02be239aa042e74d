"""A cache keeps the values that were used last, bounded by their number or by their size."""

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
    """A mapping that drops what was used longest ago once it holds too much. Several threads may use it.

    Parameters
    ----------
    most : int
        The largest sum of sizes.
    size : callable, optional
        Function of a value that returns its size; by default each counts as one, so that `most` is their number.
    least : int
        The number of values that are kept however large they are: those used last.
    """

    def __init__(self, most: int, size: Callable[[Value], int] = _one, *, least: int = 1) -> None:
        self._most, self._size, self._least = most, size, least
        self._held: OrderedDict[Key, tuple[Value, int]] = OrderedDict()
        self._total = 0
        self._lock = Lock()

    def get(self, key: Key) -> Value | None:
        """Return the value of a key, which then was used last; None if it is not kept."""
        with self._lock:
            if key not in self._held:
                return None
            self._held.move_to_end(key)
            return self._held[key][0]

    def put(self, key: Key, value: Value) -> Value:
        """Keep a value, in place of an earlier one of the key, and return it."""
        size = self._size(value)
        with self._lock:
            self._total += size - self._held.pop(key, (value, 0))[1]
            self._held[key] = value, size
            while self._total > self._most and len(self._held) > self._least:
                self._total -= self._held.popitem(last=False)[1][1]
        return value
