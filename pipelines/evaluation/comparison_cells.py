"""Compute the cells of a comparison, one for each method in each fold; stored cells are not computed again."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
import pyarrow as pa

from kinedex.ops.arrays import F64
from kinedex.ops.intervals import TakeSegment
from kinedex.ops.wording import name_list
from kinedex.ops.words import ALL_KNOWN, TakeWords
from kinedex.pipelines.annotation.annotators import Annotator
from kinedex.pipelines.annotation.batches import BATCH_FRAMES, annotate_words, stored_positions
from kinedex.pipelines.annotation.earlier_annotations import setting_digest
from kinedex.pipelines.engine.code_digest import code_digest
from kinedex.pipelines.engine.executors import Executor, batches_of
from kinedex.pipelines.evaluation.comparison_parameters import Method
from kinedex.pipelines.evaluation.folds import WHOLE, Fold, TestTake
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import Store

CODE = "kinedex.pipelines.evaluation.comparison_cells:annotate_task"
"""The function that computes a cell; a cell depends on the code that this function and the cell's method reach."""

SAVE_SECONDS = 20.0
"""The longest time, in seconds, after which finished cells are stored."""


@dataclass(frozen=True)
class Cell:
    """One method in one fold.

    Attributes
    ----------
    key : str
        A hash of everything that determines its segments.
    fold : Fold
        The takes to annotate.
    method : Method
        The method.
    annotator : Annotator
        The annotator, with templates learned in the fold.
    remarks : tuple of str
        Remarks on templates and thresholds.
    """

    key: str
    fold: Fold
    method: Method
    annotator: Annotator
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Task:
    """Takes of one cell that one worker annotates."""

    store: Store
    annotator: Annotator
    test_takes: tuple[TestTake, ...]


SegmentsByTake = dict[str, tuple[TakeSegment, ...]]
"""The segments of a cell, by take name."""


def cell_key(fold: Fold, annotator: Annotator, store: Store) -> str:
    """Return a hash of the takes of a fold, the annotator and its code."""
    hasher = hashlib.sha256()
    # positions depend on more than words do, such as the filling of gaps
    columns = ["checksum", *(["recipe"] if annotator.method.needs.positions else [])]
    rows = store.takes().select("take_id", *columns).iter_rows()
    checksums = {take_id: " ".join(map(str, own)) for take_id, *own in rows}
    hasher.update(store.feature_set.digest.encode() + repr(store.rate_hz).encode())
    for test_take in fold.test_takes:
        parts = [checksums[take_id] for take_id in test_take.take_ids]
        mask = test_take.known(store.known)
        known = [] if mask == ALL_KNOWN else [mask]
        hasher.update(json.dumps([test_take.name, test_take.frames, parts, *known]).encode())
    hasher.update(setting_digest(annotator, False, code_digest(CODE, type(annotator.method))).encode())
    return hasher.hexdigest()[:32]


def run_cells(
    cells: Sequence[Cell],
    store: Store,
    executor: Executor,
    known: Mapping[str, SegmentsByTake],
    save: Callable[[Mapping[str, SegmentsByTake]], None],
    advance: Callable[[int], None],
) -> dict[str, SegmentsByTake]:
    """Compute the cells that are not known yet; the result does not depend on the number of workers.

    Parameters
    ----------
    cells : sequence of Cell
        The cells; those of the same key are computed once.
    store : Store
        The store; workers read the same version of it.
    executor : Executor
        The workers.
    known : mapping of str to SegmentsByTake
        The segments of cells that were computed before, by key.
    save : callable
        Stores finished cells; called every `SAVE_SECONDS`.
    advance : callable
        Called with the number of newly finished cells.

    Returns
    -------
    dict of str to SegmentsByTake
        The segments of each cell, by key.
    """
    wanted = {cell.key: cell for cell in cells}
    finished = {key: known[key] for key in wanted if key in known}
    advance(len(finished))
    todo = [cell for key, cell in wanted.items() if key not in finished]
    pieces = {
        cell.key: batches_of(cell.fold.test_takes, [one.frames for one in cell.fold.test_takes], BATCH_FRAMES)
        for cell in todo
    }
    tasks = [Task(store, cell.annotator, piece) for cell in todo for piece in pieces[cell.key]]
    results = executor.map(annotate_task, tasks)
    stored = time.monotonic()
    for key, own in pieces.items():
        finished[key] = {name: segments for part in islice(results, len(own)) for name, segments in part.items()}
        advance(1)
        if time.monotonic() - stored > SAVE_SECONDS:
            save(finished)
            stored = time.monotonic()
    return finished


def annotate_task(task: Task) -> SegmentsByTake:
    """Annotate the takes of a task, in a worker."""
    ids = sorted({take_id for test_take in task.test_takes for take_id in test_take.take_ids})
    words = task.store.words(ids)
    place = {take_id: index for index, take_id in enumerate(words.take_ids.tolist())}
    laid_out = [
        np.concatenate([words.take(place[take_id]) for take_id in test_take.take_ids]) for test_take in task.test_takes
    ]
    offsets = np.cumsum([0, *(len(one) for one in laid_out)])
    masks = np.array([test_take.known(task.store.known) for test_take in task.test_takes], np.uint64)
    known = None if (masks == ALL_KNOWN).all() else masks
    together = TakeWords(np.arange(len(laid_out), dtype=np.int64), offsets, np.concatenate(laid_out), known)
    annotator = task.annotator
    positions = _laid_out_positions(task) if annotator.method.needs.positions else None
    names = [one.name for one in task.test_takes]
    return {
        names[one.take_id]: tuple(
            TakeSegment(
                names[one.take_id],
                annotator.classes[segment.class_index],
                segment.start,
                segment.stop,
                confidence=float(segment.margin),
            )
            for segment in one.segments
        )
        for one in annotate_words(annotator, together, positions=positions)
    }


def _laid_out_positions(task: Task) -> list[F64]:
    """Return the positions of the takes of a task, float64 (L, J, 3) each."""
    ids = sorted({take_id for test_take in task.test_takes for take_id in test_take.take_ids})
    read = stored_positions(task.store, ids, [task.store.take_frames[take_id] for take_id in ids])
    of_take = dict(zip(ids, read, strict=True))
    return [np.concatenate([of_take[take_id] for take_id in one.take_ids]) for one in task.test_takes]


def cells_table(cells: Sequence[Cell], found: Mapping[str, SegmentsByTake], run: str) -> pa.Table:
    """Return finished cells as results of the kind `method_cells`, one row for each cell and take.

    Several cells can have the same key, and thus the same segments: a method and a point of the sweep with the same
    threshold, for instance, or the cells of splits that share a fold. There are rows for each of these cells.
    """
    rows = [
        {
            "run": run,
            "cell": cell.key,
            "split": cell.fold.split,
            "fold": cell.fold.name,
            "method": cell.method.name,
            "take": test_take.name,
            "frames": test_take.frames,
            "classes": [one.label for one in found[cell.key][test_take.name]],
            "starts": [one.start for one in found[cell.key][test_take.name]],
            "stops": [one.stop for one in found[cell.key][test_take.name]],
            "confidences": [one.confidence for one in found[cell.key][test_take.name]],
        }
        for cell in cells
        if cell.key in found
        for test_take in cell.fold.test_takes
    ]
    return pa.Table.from_pylist(rows, schema=result_schema("method_cells"))


def remarks_of(cells: Sequence[Cell]) -> list[str]:
    """Return the distinct remarks of cells for each fold, with their methods unless they concern all methods."""
    methods: dict[str, None] = dict.fromkeys(cell.method.name for cell in cells)
    found: dict[tuple[str, str], list[str]] = {}
    for cell in cells:
        for remark in cell.remarks:
            found.setdefault((cell.fold.name, remark), []).append(cell.method.name)
    return [
        (f"{fold}: " if fold != WHOLE else "") + remark + ("" if len(own) == len(methods) else f" ({name_list(own)})")
        for (fold, remark), own in found.items()
    ]


def known_cells(table: pa.Table) -> dict[str, SegmentsByTake]:
    """Return the segments of stored cells, by key."""
    known: dict[str, SegmentsByTake] = {}
    for row in table.to_pylist():
        columns = (row["classes"], row["starts"], row["stops"], row["confidences"])
        known.setdefault(row["cell"], {})[row["take"]] = tuple(
            TakeSegment(row["take"], label, start, stop, confidence=sure)
            for label, start, stop, sure in zip(*columns, strict=True)
        )
    return known
