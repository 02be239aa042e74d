"""Which parts of a stage's results stay as they are when it puts new ones beside them.

Results of takes, such as distance curves, grow with an archive. Where a run keeps what an earlier one found in most
takes, the new version of the store names the old parts again. Written again are only parts some of whose takes go or
are found anew, and small ones, before there are many of them (by the tiers of `storage.store.compaction`). A part is
full at
`storage.snapshot.parts.FULL_BYTES`, so that little is written again for one take.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import pyarrow.compute as pc
import pyarrow.parquet as pq

from kinedex.storage.snapshot.manifest import ResultPart
from kinedex.storage.snapshot.parts import FULL_BYTES, part_file, read_errors
from kinedex.storage.snapshot.snapshot import Snapshot
from kinedex.storage.store.compaction import worthwhile


@dataclass(frozen=True)
class Lasting:
    """What becomes of a stage's parts of one kind of results.

    stay: those that `StoreWriter.put_results` is to keep. again: those whose rows are to be put again, as far as they
    are wanted, with the new ones.
    """

    stay: tuple[ResultPart, ...]
    again: tuple[ResultPart, ...]


def lasting(store: Snapshot, kind: str, stage: str, take_ids: Collection[int]) -> Lasting:
    """Divide the parts of a stage's results.

    Parameters
    ----------
    kind: of results with a column `take_id`. stage: "<pipeline>/<stage>". take_ids: the takes whose rows still hold.

    Raises
    ------
    StoreError: a part is missing or cannot be read.
    """
    wanted = set(take_ids)
    whole, again = [], []
    for part in store.manifest.results.get(kind, ()) if wanted else ():
        if part.stage == stage:
            held = _takes_of(store, part)
            if held <= wanted:
                whole.append(part)
            elif held & wanted:
                again.append(part)
    small = {part.path for group in worthwhile(whole, FULL_BYTES) for part in group}
    stay = tuple(part for part in whole if part.path not in small)
    return Lasting(stay, (*again, *(part for part in whole if part.path in small)))


def _takes_of(store: Snapshot, part: ResultPart) -> set[int]:
    file = part_file(store.path, part.path)
    with read_errors(file):
        column = pq.read_table(file, columns=["take_id"]).column("take_id")
    return set(pc.unique(column).to_pylist())
