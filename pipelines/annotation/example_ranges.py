"""Store the ranges that single examples could label, so that a later run compares takes with new examples only."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from kinedex.ops.errors import StoreError
from kinedex.ops.words import U64
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import Store

I64 = npt.NDArray[np.int64]
Bool = npt.NDArray[np.bool_]

KIND = "example_ranges"
"""The kind of results that holds the ranges."""


@dataclass(frozen=True)
class PromisingRanges:
    """The ranges of a take in which each example could label frames (`ops.annotation.promising_ranges`).

    Attributes
    ----------
    fingerprint : str
        A hash of the take's words, see `words_print`; empty if unknown.
    keys : uint64 array (E,)
        The hashes of the examples, see `SingleExamples.keys`.
    counts : int64 array (E,)
        The number of ranges of each example.
    starts, stops : int64 array (R,)
        The frames [start, stop) of the ranges, grouped by example.
    """

    fingerprint: str
    keys: U64
    counts: I64
    starts: I64
    stops: I64

    def of(self, keys: U64) -> tuple[Bool, I64]:
        """Return which examples are known, bool (N,), and their ranges, int64 (R, 3): index in `keys`, start, stop."""
        if not len(self.keys):
            return np.zeros(len(keys), np.bool_), np.empty((0, 3), np.int64)
        order = np.argsort(self.keys)
        mine = order[np.minimum(np.searchsorted(self.keys, keys, sorter=order), len(order) - 1)]
        held = self.keys[mine] == keys
        firsts, counts = (np.cumsum(self.counts) - self.counts)[mine], np.where(held, self.counts[mine], 0)
        examples = np.repeat(np.arange(len(keys)), counts)
        rows = firsts[examples] + np.arange(len(examples)) - np.repeat(np.cumsum(counts) - counts, counts)
        return held, np.stack([examples, self.starts[rows], self.stops[rows]], axis=1)


_NOTHING = np.empty(0, np.int64)
NO_RANGES = PromisingRanges("", np.empty(0, np.uint64), _NOTHING, _NOTHING, _NOTHING)


def promising_of(keys: U64, ranges: I64) -> PromisingRanges:
    """Return promising ranges from rows of example, start and stop, int64 (R, 3), sorted by example."""
    counts = np.bincount(ranges[:, 0], minlength=len(keys))
    return PromisingRanges("", keys, counts, ranges[:, 1], ranges[:, 2])


def words_print(words: U64, code: str) -> str:
    """Return a hash of the words of a take and of the code that compares them with examples."""
    return hashlib.sha256(code.encode() + np.ascontiguousarray(words).tobytes()).hexdigest()[:32]


def ranges_table(found: Iterable[tuple[int, PromisingRanges]], names: Mapping[int, str], run: str) -> pa.Table:
    """Return the ranges of takes by take_id as results of the kind `example_ranges`; `names` has the names of takes."""
    rows = list(found)
    every = [one for _, one in rows]

    def lists(name: str) -> pa.Array:
        values = [getattr(one, name) for one in every]
        offsets = np.cumsum([0, *map(len, values)])
        flat = np.concatenate(values) if values else np.empty(0, np.int64)
        return pa.ListArray.from_arrays(pa.array(offsets, pa.int32()), pa.array(flat))

    columns = {
        "run": pa.array([run] * len(rows), pa.string()),
        "take_id": pa.array([take_id for take_id, _ in rows], pa.int64()),
        "take": pa.array([names[take_id] for take_id, _ in rows], pa.string()),
        "fingerprint": pa.array([one.fingerprint for one in every], pa.string()),
        **{column: lists(name) for column, name in _LISTS.items()},
    }
    schema = result_schema(KIND)
    return pa.table([columns[field.name].cast(field.type) for field in schema], schema=schema)


_LISTS = {"examples": "keys", "counts": "counts", "starts": "starts", "stops": "stops"}


def earlier_ranges(store: Store, stage: str) -> dict[int, PromisingRanges]:
    """Return the ranges that a stage stored earlier, by take_id; an empty dictionary if they cannot be read."""
    try:
        rows = store.result(KIND, stage=stage)
    except StoreError:
        return {}  # unreadable results are removed by repair, and computed again
    found: dict[int, PromisingRanges] = {}
    for batch in rows.to_batches():
        lists = []
        for name, kind in zip(_LISTS, (np.uint64, np.int64, np.int64, np.int64), strict=True):
            column = batch.column(name)
            offsets = column.offsets.to_numpy().tolist()
            flat = column.values.to_numpy().astype(kind)
            lists.append([flat[first:stop] for first, stop in pairwise(offsets)])
        prints, takes = (batch.column(name).to_pylist() for name in ("fingerprint", "take_id"))
        found |= {take: PromisingRanges(*row) for take, *row in zip(takes, prints, *lists, strict=True)}
    return found
