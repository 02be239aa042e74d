"""Reuse parts of results when a stage adds new ones, and put results of takes into the order of the takes.

Results of takes, such as distance curves, grow with an archive. If a run reuses the results of an earlier run for most
takes, the new version of the store names the old parts again. Only parts with removed or recomputed takes are
rewritten, and small parts when there are many (by the tiers of `storage.store.compaction`). A part is full at
`storage.snapshot.parts.FULL_BYTES`, so that a change of one take rewrites little.

A run that reuses earlier rows must leave the same rows in the same order as a run over all takes. New rows are
therefore inserted at their position in the order; parts with no new rows between their first and last take are kept as
files. A part next to new rows is rewritten together with them unless the part is full, so that there are never many
small parts. A new take thus costs writing its own rows and at most two parts of `storage.snapshot.parts.FULL_BYTES`.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from kinedex.ops.errors import StoreError
from kinedex.storage.snapshot.manifest import ResultPart
from kinedex.storage.snapshot.parts import FULL_BYTES, read_errors
from kinedex.storage.snapshot.row_groups import RowGroups
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.store.compaction import merge_groups


@dataclass(frozen=True)
class ReusedParts:
    """The parts of a stage's results with rows that are still valid.

    Attributes
    ----------
    stay : tuple of ResultPart
        Parts that `StoreWriter.put_results` should keep unchanged.
    again : tuple of ResultPart
        Parts whose valid rows must be written again, together with new rows.
    """

    stay: tuple[ResultPart, ...]
    again: tuple[ResultPart, ...]


def reused_parts(
    store: Snapshot, kind: str, stage: str, take_ids: Collection[int | str], column: str = "take_id"
) -> ReusedParts:
    """Divide the parts of a stage's results into those to keep and those with rows to write again.

    Parameters
    ----------
    store : Snapshot
        The store that has the results.
    kind : str
        A kind of results with the column.
    stage : str
        The stage, "<pipeline>/<stage>".
    take_ids : collection of int or str
        The takes (or other values of the column) whose rows are still valid.
    column : str, optional
        The column that names the take of a row.

    Raises
    ------
    StoreError
        A part is missing or cannot be read.
    """
    wanted = set(take_ids)
    held = {
        part: values_in(store, part, column)
        for part in (store.manifest.results.get(kind, ()) if wanted else ())
        if part.stage == stage
    }
    whole = [part for part, values in held.items() if values <= wanted]
    rewritten = {part for part, values in held.items() if not values <= wanted and values & wanted}
    rewritten |= {part for group in merge_groups(whole, FULL_BYTES) for part in group}
    while True:  # rows of a take in several parts keep their order only if all of the parts are rewritten
        moved = set().union(*(held[part] & wanted for part in rewritten))
        more = {part for part in whole if part not in rewritten and held[part] & moved}
        if not more:
            break
        rewritten |= more
    return ReusedParts(
        tuple(part for part in whole if part not in rewritten), tuple(part for part in held if part in rewritten)
    )


def stored_fingerprints(store: Snapshot, kind: str, stage: str, column: str = "take_id") -> dict[int | str, str]:
    """Return a dict from take or recording to fingerprint in a stage's results; empty if the results cannot be read.

    Parameters
    ----------
    store : Snapshot
        The store that has the results.
    kind : str
        A kind of results with the column and `fingerprint`.
    stage : str
        The stage, "<pipeline>/<stage>".
    column : str, optional
        The column that names the take or the recording of a row.
    """
    found: dict[int | str, str] = {}
    columns = [column, "fingerprint"]
    try:
        for rows in store.result_pieces(kind, store.stage_parts(kind, stage), columns):
            pairs = rows.group_by(columns).aggregate([])
            names, prints = (pairs.column(name).to_pylist() for name in columns)
            found |= {name: one for name, one in zip(names, prints, strict=True) if one is not None}
    except StoreError:
        return {}  # `kinedex repair` removes these results, and the stage recomputes all of them
    return found


def values_in(store: Snapshot, part: ResultPart, column: str) -> set[int | str]:
    """Return the values of a column in a part of results."""
    file = store.checked.part(part)
    with read_errors(file):
        found = pq.read_table(file, columns=[column]).column(column)
    return set(pc.unique(found).to_pylist())


MIN_ROWS = 50_000
"""The smallest number of rows in a row group; a long take fills separate row groups, and short takes share one."""

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
        Id of the run, which rewritten rows get.
    pieces : callable, optional
        Divides the rows of one take into tables; a row group may end after each.

    Raises
    ------
    StoreError
        A part is missing or cannot be read.
    """
    rank: dict[Hashable, int] = {take_id: place for place, take_id in enumerate(takes)}
    earlier = RowGroups(store, kind, stage, "take_id") if len(fresh) < len(takes) else None
    places: dict[Hashable, list[ResultPart]] = {}
    for part, values in (
        _kept_parts(earlier.parts, rank, sorted(rank[one] for one in fresh)) if earlier is not None else ()
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

    yield from _joined_tables(in_order())


def _of_run(rows: pa.Table, run: str) -> pa.Table:
    place = rows.schema.get_field_index("run")
    return rows.set_column(place, rows.schema.field("run"), pa.repeat(pa.scalar(run), rows.num_rows))


def _joined_tables(pieces: Iterable[pa.Table | ResultPart]) -> Iterator[pa.Table | ResultPart]:
    """Join successive tables until they have `MIN_ROWS` rows, and yield them and each part once, in order."""
    waiting: list[pa.Table] = []
    count = 0
    last: ResultPart | None = None
    for one in pieces:
        if isinstance(one, pa.Table):
            waiting.append(one)
            count += one.num_rows
        if waiting and (isinstance(one, ResultPart) or count >= MIN_ROWS):
            yield pa.concat_tables(waiting)
            waiting, count = [], 0
        if isinstance(one, ResultPart) and one != last:
            yield one
            last = one
    if waiting:
        yield pa.concat_tables(waiting)


PartValues = tuple[ResultPart, Sequence[Hashable]]


def _kept_parts(parts: Sequence[PartValues], rank: Mapping[Hashable, int], new: Sequence[int]) -> list[PartValues]:
    """Return the parts that need not be rewritten, each with its takes.

    A part is kept if all its takes are reused and no new rows are inserted between them. Unless the part is full, there
    must also be no new rows next to it. If a take has rows in several parts, either all of these parts are kept or all
    are rewritten. `rank` is the position of each take in the order, and `new` has the ascending ranks of the takes with
    new rows.
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
        """Return whether a part is rewritten because of new or rewritten rows before (side −1) or after it (side 1)."""
        other = at + side
        there = 0 <= other < len(parts)
        far = ends[other][side < 0] if there else (-1 if side < 0 else len(rank))
        near = ends[at][side > 0]
        if there and not stays[other]:
            return far == near or parts[at][0].bytes < FULL_BYTES
        return parts[at][0].bytes < FULL_BYTES and is_new_between(min(far, near), max(far, near))

    for side in (-1, 1):  # rewriting a part can affect the parts before and after it
        for at in range(len(parts))[::-side]:
            stays[at] = stays[at] and not (is_written_again(at, -1) or is_written_again(at, 1))
    return [one for one, same in zip(parts, stays, strict=True) if same]
