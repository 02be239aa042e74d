"""Accept doubts about takes, so that they are listed as accepted as long as their messages stay the same."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from kinedex.catalog.doubts import KIND, STAGE
from kinedex.ops.errors import KinedexError
from kinedex.storage.snapshot.schemas import result_table
from kinedex.storage.store.store import Store
from kinedex.storage.store.writer import StoreWriter


@dataclass(frozen=True)
class Doubt:
    """A warning about a take, or a guess."""

    take: str
    message: str


def chosen_doubts(store: Store, takes: Sequence[str] = (), where: str | None = None) -> tuple[Doubt, ...]:
    """Return doubts about takes, whether accepted or not.

    Parameters
    ----------
    store : Store
        The store.
    takes : sequence of str
        Names of takes; all takes if there are none.
    where : str, optional
        A SQL filter over the columns of the view `doubts`.

    Raises
    ------
    KinedexError
        Neither takes nor filter are given, a take is unknown, or there are no such doubts.
    """
    if not takes and where is None:
        raise KinedexError("name the takes whose doubts to accept, or choose doubts with --where")
    for name in takes:
        store.take_id(name)
    condition = "" if where is None else f" AND ({where}\n)"
    rows = store.sql(f"SELECT take, message FROM doubts WHERE take IS NOT NULL{condition}").to_pylist()
    named = set(takes)
    found = dict.fromkeys(Doubt(row["take"], row["message"]) for row in rows if not named or row["take"] in named)
    if not found:
        raise KinedexError(
            "there are no such doubts about takes; refused files are none, since they can only be read or left; "
            "`SELECT * FROM doubts` lists all"
        )
    return tuple(found)


def accept_doubts(writer: StoreWriter, doubts: Sequence[Doubt], *, revoke: bool = False) -> int:
    """Accept doubts, or take their acceptance back, and return how many have changed; nothing is committed.

    Parameters
    ----------
    writer : StoreWriter
        The writer of the store.
    doubts : sequence of Doubt
        The doubts.
    revoke : bool, optional
        True to take the acceptance back.
    """
    rows = writer.store.result(KIND).to_pylist()
    chosen = {(one.take, one.message) for one in doubts}
    standing = {(row["take"], row["message"]) for row in rows}
    run, now = uuid.uuid4().hex, datetime.now(UTC)
    if revoke:
        kept = [row for row in rows if (row["take"], row["message"]) not in chosen]
    else:
        new = sorted(chosen - standing)
        kept = [*rows, *({"take": take, "message": message, "accepted_at": now} for take, message in new)]
    changed = abs(len(kept) - len(rows))
    if changed:
        table = result_table(KIND, ({**row, "run": run} for row in kept), run)
        writer.put_results(KIND, table, stage=STAGE, run=run)
    return changed
