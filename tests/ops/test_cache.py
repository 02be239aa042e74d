"""A cache drops what was used longest ago, by number or by size."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.cache import Cache


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 7), st.booleans()), max_size=40), st.integers(1, 12))
def test_a_cache_holds_what_was_used_last_within_its_size(steps: list[tuple[int, int, bool]], most: int) -> None:
    cache: Cache[int, tuple[int]] = Cache(most, lambda value: value[0])
    used: list[tuple[int, tuple[int]]] = []  # the one that was used last comes last
    for key, size, puts in steps:
        if puts:
            value = (size,)
            assert cache.put(key, value) is value
            used = [*(one for one in used if one[0] != key), (key, value)]
            while len(used) > 1 and sum(own[0] for _, own in used) > most:
                del used[0]
        else:
            expected = dict(used).get(key)
            assert cache.get(key) is expected
            used.sort(key=lambda one: one[0] == key)
    assert {key: cache.get(key) for key in range(6)} == {key: dict(used).get(key) for key in range(6)}


def test_the_last_values_stay_however_large_they_are() -> None:
    cache: Cache[str, bytes] = Cache(10, len, least=2)
    for name in "abc":
        cache.put(name, bytes(100))
    assert [cache.get(name) is None for name in "abc"] == [True, False, False]
    counted: Cache[str, int] = Cache(2)
    for number, name in enumerate("abc"):
        counted.put(name, number)
    assert [counted.get(name) for name in "abc"] == [None, 1, 2]
