"""Rivals of keyframe search to compare with: the printed recursion, compiled; and one SQL statement in DuckDB."""

from __future__ import annotations

import numpy as np
from numba import njit

from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.ops.arrays import I64
from kinedex.ops.errors import ParameterError
from kinedex.ops.ranges import TAKE_BITS, extend_and_unite
from kinedex.ops.search.gaps import UNBOUNDED

_ROOM = 4_000_000


def recursion(lists: list[I64], gaps: list[tuple[int, int]]) -> I64:
    """Run Algorithm 1 of the thesis as printed, over merged lists, and unite the ranges of its matches at the end."""
    starts, stops = (np.ascontiguousarray(column) for column in np.concatenate(lists).T)
    offsets = np.cumsum([0, *(len(one) for one in lists)])
    low = np.array([gap[0] for gap in gaps], np.int64)
    high = np.minimum(np.array([gap[1] for gap in gaps], np.int64), UNBOUNDED)
    found = np.empty((2, _ROOM), np.int64)
    count = _all_matches(starts, stops, offsets, low, high, found)
    if count > _ROOM:
        raise ParameterError("matches", f"at most {_ROOM}", count)
    takes = int(starts.max(initial=0) >> TAKE_BITS) + 1
    return extend_and_unite(found[:, :count].T, np.arange(takes + 1, dtype=np.int64) << TAKE_BITS)


# Neither is cached: a recursive function does not work when it is loaded from numba's cache.
@njit(nogil=True)
def _all_matches(starts, stops, offsets, low, high, found):  # type: ignore[no-untyped-def]
    count = len(offsets) - 1
    pointers = offsets[:-1].copy()
    cut = np.empty((2, count), np.int64)
    n = 0
    for first in range(offsets[0], offsets[1]):
        cut[0, 0], cut[1, 0] = starts[first], stops[first] - 1
        if count == 1:
            found[0, n], found[1, n] = starts[first], stops[first]
            n += 1
        else:
            n = _visit(1, starts, stops, offsets, low, high, pointers, cut, found, n)
    return n


@njit(nogil=True)
def _visit(k, starts, stops, offsets, low, high, pointers, cut, found, n):  # type: ignore[no-untyped-def]
    reach_start, reach_end = cut[0, k - 1] + low[k - 1], cut[1, k - 1] + high[k - 1]
    while pointers[k] < offsets[k + 1] and stops[pointers[k]] <= reach_start:
        pointers[k] += 1
    moved = False
    while pointers[k] < offsets[k + 1] and starts[pointers[k]] <= reach_end and stops[pointers[k]] > reach_start:
        cut[0, k] = max(starts[pointers[k]], reach_start)
        cut[1, k] = min(stops[pointers[k]] - 1, reach_end)
        if k == len(offsets) - 2:
            back = cut[0, k]
            for before in range(k - 1, -1, -1):
                back = max(cut[0, before], back - high[before])
            if n < found.shape[1]:
                found[0, n], found[1, n] = back, cut[1, k] + 1
            n += 1
        else:
            n = _visit(k + 1, starts, stops, offsets, low, high, pointers, cut, found, n)
        pointers[k] += 1
        moved = True
    if moved:
        pointers[k] -= 1
    return n


def sql(chain: KeyframeQuery) -> str:
    """Return one SELECT that finds the hits of a chain: lists joined under their gaps, and united ranges of matches.

    Forwards, a joined row knows the frames of each run that the gaps admit ([a, b]); backwards, where a hit can begin.
    """
    parts = []
    for k, keyframe in enumerate(chain.keyframes):
        parts.append(
            f"""list{k} AS (SELECT take_id, min(start) AS start, max(stop) - 1 AS last FROM (
                SELECT *, sum(fresh) OVER (PARTITION BY take_id ORDER BY start) AS island FROM (
                    SELECT take_id, start, stop, (start IS DISTINCT FROM
                        lag(stop) OVER (PARTITION BY take_id ORDER BY start))::INT AS fresh
                    FROM word_runs WHERE feature_set = '{keyframe.set}'
                        AND (word & {keyframe.mask}::UBIGINT) = {keyframe.value}::UBIGINT))
                GROUP BY take_id, island)"""
        )
    parts.append("step0 AS (SELECT take_id, start AS a0, last AS b0 FROM list0)")
    for k, gap in enumerate(chain.gaps, start=1):
        before = ", ".join(f"s.a{j}, s.b{j}" for j in range(k))
        parts.append(
            f"""step{k} AS (SELECT s.take_id, {before}, greatest(l.start, s.a{k - 1} + {gap.low}::BIGINT) AS a{k},
            least(l.last, s.b{k - 1} + {gap.high}::BIGINT) AS b{k} FROM step{k - 1} AS s JOIN list{k} AS l
            ON l.take_id = s.take_id AND l.start <= s.b{k - 1} + {gap.high}::BIGINT
            AND l.last >= s.a{k - 1} + {gap.low}::BIGINT)"""
        )
    last = len(chain.gaps)
    back = f"a{last}"
    for k in range(last - 1, -1, -1):
        back = f"greatest(a{k}, {back} - {chain.gaps[k].high}::BIGINT)"
    parts.append(f"matches AS (SELECT take_id, {back} AS start, b{last} + 1 AS stop FROM step{last})")
    return f"""WITH {", ".join(parts)}
        SELECT take_id, min(start)::BIGINT AS start, max(stop)::BIGINT AS stop FROM (
            SELECT *, sum(fresh) OVER (PARTITION BY take_id ORDER BY start, stop) AS island FROM (
                SELECT *, (start > coalesce(max(stop) OVER (PARTITION BY take_id ORDER BY start, stop
                    ROWS BETWEEN UNBOUNDED PRECEDING AND 1 PRECEDING), -1))::INT AS fresh FROM matches))
        GROUP BY take_id, island ORDER BY take_id, start"""
