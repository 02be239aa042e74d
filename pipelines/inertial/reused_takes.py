"""Reuse a stage's results of takes whose fingerprints have not changed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import pyarrow as pa

from kinedex.ops.errors import StoreError
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.context import StageContext
from kinedex.storage.snapshot.manifest import ResultPart
from kinedex.storage.snapshot.schemas import result_table
from kinedex.storage.store.reused_results import rows_in_order, stored_fingerprints
from kinedex.storage.store.store import Store

Pieces = Callable[[pa.Table], Iterable[pa.Table]]


class ReusedTakes:
    """The takes of a stage, divided into those whose rows are reused and those that are computed again.

    A take is computed unless its earlier rows have its current fingerprint. All takes are computed if the stage runs
    with `--force`, if its code is unknown, or if a part of its earlier results is damaged.

    Parameters
    ----------
    context : StageContext
        The stage.
    store : Store
        The store with its earlier results.
    prints : mapping of int to (str or None)
        The ids of all takes in the order of results, each with a hash of everything that determines its rows; None if
        it is unknown.
    kinds : str
        The kinds of results of the stage, all with a column `take_id`, the first one with `fingerprint`.
    """

    def __init__(self, context: StageContext, store: Store, prints: Mapping[int, str | None], *kinds: str) -> None:
        self._context, self._store = context, store
        self._takes = tuple(prints)
        reusable = bool(context.code) and not context.anew and _are_sound(store, context.key(), kinds)
        before = stored_fingerprints(store, kinds[0], context.key()) if reusable else {}
        self.fresh = tuple(one for one, print_ in prints.items() if print_ is None or before.get(one) != print_)
        """The ids of the takes that are computed, in order."""

    @property
    def unchanged(self) -> int:
        """The number of takes whose rows are reused."""
        return len(self._takes) - len(self.fresh)

    def rows(
        self, kind: str, tables: Iterable[pa.Table], pieces: Pieces = lambda rows: (rows,)
    ) -> Iterator[pa.Table | ResultPart]:
        """Yield the rows of all takes in their order, in the form that `StoreWriter.put_results` takes.

        Parameters
        ----------
        kind : str
            The kind of results.
        tables : iterable of pyarrow.Table
            The rows of each take of `fresh`, in their order.
        pieces : callable, optional
            Divides the rows of one take into pieces, between which a row group may end.
        """
        context = self._context
        return rows_in_order(
            self._store, kind, context.key(), self._takes, self.fresh, tables, run=context.run, pieces=pieces
        )

    def put(self, kind: str, tables: Iterable[pa.Table], pieces: Pieces = lambda rows: (rows,)) -> None:
        """Store the rows of all takes, and commit them; the parameters are those of `rows`."""
        with self._context.writer() as writer:
            rows = self.rows(kind, tables, pieces)
            writer.put_results(kind, rows, stage=self._context.key(), run=self._context.run)
            writer.commit()

    def report(self, what: str) -> None:
        """Show how many takes were reused, if any; `what` names the work that was saved, such as "not read"."""
        if self.unchanged:
            self._context.say(f"unchanged: {counted(self.unchanged, 'take')}, {what} again")


def _are_sound(store: Store, stage: str, kinds: Iterable[str]) -> bool:
    """Return whether all parts of a stage's results can be read."""
    try:
        store.checked.parts([part for kind in kinds for part in store.stage_parts(kind, stage)])
    except StoreError:
        return False  # repair removes damaged parts, and the stage then computes all rows again
    return True


def take_tables(kind: str, rows: Iterable[dict[str, Any]], takes: Iterable[int], run: str) -> list[pa.Table]:
    """Return rows of a kind of results as one table for each take, in the order of takes.

    Parameters
    ----------
    kind : str
        The kind of results.
    rows : iterable of dict
        Rows with `take_id`; the order of rows within a take is kept.
    takes : iterable of int
        The ids of the takes.
    run : str
        Id of the run.
    """
    own: dict[int, list[dict[str, Any]]] = {take_id: [] for take_id in takes}
    for row in rows:
        own[row["take_id"]].append(row)
    return [result_table(kind, some, run) for some in own.values()]
