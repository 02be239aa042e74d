"""Put results of takes into the order of the takes, reusing those of most takes.

A run that reuses the rows of earlier takes must leave the store as a run over all takes would. So new rows are inserted
at their position in the order, and parts whose range they do not enter are kept as files. A part next to new rows is
rewritten with them unless it is full, so that there are never many small parts: a new take costs writing its own rows
and at most two parts of `storage.snapshot.parts.FULL_BYTES`.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise

import pyarrow as pa

from kinedex.storage.snapshot.part_records import ResultPart
from kinedex.storage.snapshot.parts import FULL_BYTES
from kinedex.storage.snapshot.row_groups import RowGroups
from kinedex.storage.snapshot.snapshot import Snapshot

LEAST_ROWS = 50_000
"""The smallest number of rows in a row group: a long take has groups of its own, and short takes share one."""

Pieces = Callable[[pa.Table], Iterable[pa.Table]]


def rows_in_order(
    store: Snapshot,
    kind: str,
    stage: str,
    takes: Sequence[int],
    fresh: Collection[int],
    tables: Iterable[pa.Table],
    *,
    run: str,
    pieces: Pieces = lambda rows: (rows,),
) -> Iterator[pa.Table | ResultPart]:
    """Yield the results of takes in the order of the takes, as input for `StoreWriter.put_results`.

    Parameters
    ----------
    store : Snapshot
        The store that has the earlier results.
    kind : str
        A kind of results with a column `take_id`.
    stage : str
        The stage, "<pipeline>/<stage>".
    takes : sequence of int
        The ids of all takes, in their order.
    fresh : collection of int
        The ids of takes with new rows; the earlier rows of the others are reused.
    tables : iterable of pyarrow.Table
        The rows of each take of `fresh`, in the order of `takes`.
    run : str
        Id of the run, for rewritten rows.
    pieces : callable, optional
        Divides the rows of one take where a row group may end.

    Raises
    ------
    StoreError
        A part is missing or cannot be read.
    """
    rank: dict[Hashable, int] = {take_id: place for place, take_id in enumerate(takes)}
    earlier = RowGroups(store, kind, stage, "take_id") if len(fresh) < len(takes) else None
    places: dict[Hashable, list[ResultPart]] = {}
    for part, values in (
        _staying(earlier.parts, rank, sorted(rank[one] for one in fresh)) if earlier is not None else ()
    ):
        for value in values:
            places.setdefault(value, []).append(part)
    given, wanted = iter(tables), set(fresh)

    def in_order() -> Iterator[pa.Table | ResultPart]:
        for take_id in takes:
            if take_id in wanted:
                yield from pieces(next(given))
            elif take_id in places:
                yield from places[take_id]
            elif earlier is not None:
                yield from pieces(_of_run(earlier.rows(take_id), run))
        next(given, None)  # a generator runs to its end only if it is asked for another item

    yield from _gathered(in_order())


def _of_run(rows: pa.Table, run: str) -> pa.Table:
    place = rows.schema.get_field_index("run")
    return rows.set_column(place, rows.schema.field("run"), pa.repeat(pa.scalar(run), rows.num_rows))


def _gathered(pieces: Iterable[pa.Table | ResultPart]) -> Iterator[pa.Table | ResultPart]:
    """Yield tables joined to at least `LEAST_ROWS` rows, and each part once."""
    waiting: list[pa.Table] = []
    count = 0
    last: ResultPart | None = None
    for one in pieces:
        if isinstance(one, pa.Table):
            waiting.append(one)
            count += one.num_rows
        if waiting and (isinstance(one, ResultPart) or count >= LEAST_ROWS):
            yield pa.concat_tables(waiting)
            waiting, count = [], 0
        if isinstance(one, ResultPart) and one != last:
            yield one
            last = one
    if waiting:
        yield pa.concat_tables(waiting)


PartValues = tuple[ResultPart, Sequence[Hashable]]


def _staying(parts: Sequence[PartValues], rank: Mapping[Hashable, int], new: Sequence[int]) -> list[PartValues]:
    """Return the parts that need not be rewritten, each with its takes.

    A part is kept if all its takes are reused, no new rows fall into its range and, unless it is full, none next to it.
    If a take has rows in several parts, either all of these are kept or all are rewritten. `rank` is the place of each
    take in the order; `new` the ascending ranks of the takes with new rows.
    """
    ranks = [[rank.get(value, -1) for value in values] for _, values in parts]
    flat = [one for own in ranks for one in own if one >= 0]
    if any(second < first for first, second in pairwise(flat)):
        return []
    ends = [(own[0], own[-1]) for own in ranks]

    def is_new_between(low: int, high: int) -> bool:
        return bisect_left(new, high) > bisect_right(new, low)

    known = set(new)
    stays = [min(own) >= 0 and known.isdisjoint(own) and not is_new_between(own[0], own[-1]) for own in ranks]

    def is_written_again(at: int, side: int) -> bool:
        """Return whether a part is rewritten because of what is next to it, before (side −1) or after it (side 1)."""
        other = at + side
        there = 0 <= other < len(parts)
        far = ends[other][side < 0] if there else (-1 if side < 0 else len(rank))
        near = ends[at][side > 0]
        if there and not stays[other]:
            return far == near or parts[at][0].bytes < FULL_BYTES
        return parts[at][0].bytes < FULL_BYTES and is_new_between(min(far, near), max(far, near))

    for side in (-1, 1):  # a change of one part affects those beside it, in either direction
        for at in range(len(parts))[::-side]:
            stays[at] = stays[at] and not (is_written_again(at, -1) or is_written_again(at, 1))
    return [one for one, same in zip(parts, stays, strict=True) if same]
