"""Reuse earlier annotations of takes whose words and annotation settings are unchanged."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import Enum

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.compute as pc

from kinedex.ops.annotation.segments import Segment
from kinedex.pipelines.annotation.annotators import Annotator
from kinedex.pipelines.annotation.batches import confidences_of, split_takes
from kinedex.pipelines.annotation.methods import METHODS
from kinedex.pipelines.engine.code_digest import part_digest
from kinedex.storage.snapshot.manifest import ResultPart
from kinedex.storage.store.reused_results import ReusedParts, reused_parts
from kinedex.storage.store.store import Store

PIECE_BYTES = 16_000_000
"""The approximate size, in uncompressed bytes, of the pieces in which distance curves are rewritten."""


def setting_digest(annotator: Annotator, store_curves: bool, code: str) -> str:
    """Return a hash of everything except a take's words that determines its segments and curves.

    The confidence is excluded, because `with_confidence` computes it again for reused segments.

    Parameters
    ----------
    annotator : Annotator
        The annotator; its method holds thresholds only if the method uses thresholds.
    store_curves : bool
        True if distance curves are stored.
    code : str
        A hash of the code that the stage runs.
    """
    method = part_digest(METHODS, annotator.method.name)
    hasher = hashlib.sha256(f"{code}/{store_curves}/{method}".encode())
    _feed(hasher, replace(annotator, confidence=None))
    return hasher.hexdigest()[:16]


def _feed(hasher: hashlib._Hash, value: object) -> None:
    """Add a value to a hash, with its type and length, so that different values never add the same bytes."""
    hasher.update(f"{type(value).__name__}:".encode())
    if isinstance(value, np.ndarray):
        hasher.update(f"{value.dtype}{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
    elif hasattr(value, "digest") and isinstance(value.digest, str):  # a feature set
        hasher.update(value.digest.encode())
    elif is_dataclass(value):
        for field in fields(value):
            _feed(hasher, getattr(value, field.name))
    elif isinstance(value, dict):
        _feed(hasher, tuple(value.items()))
    elif isinstance(value, tuple | list):
        hasher.update(f"{len(value)}:".encode())
        for one in value:
            _feed(hasher, one)
    elif value is None or isinstance(value, str | int | float | Enum):
        text = repr(value).encode()
        hasher.update(f"{len(text)}:".encode() + text)
    else:
        raise TypeError(f"a {type(value).__name__} has no hash here")


def with_confidence(rows: pa.Table, annotator: Annotator, frames: Mapping[int, int]) -> pa.Table:
    """Return rows of annotations with the confidences that an annotator gives them.

    Parameters
    ----------
    rows : pyarrow.Table
        Results of the kind `annotations`, of takes annotated with the same templates; sorted by start within a take.
    annotator : Annotator
        The annotator, with its confidence.
    frames : mapping of int to int
        The length of each take in frames, by take_id.
    """
    if annotator.method.offers.probabilities:
        return rows
    confidence = annotator.confidence
    classes = {name: index for index, name in enumerate(annotator.classes)}
    subclasses = {name: index for index, name in enumerate(annotator.subclasses)}
    places: dict[int, list[int]] = defaultdict(list)
    segments = []
    for place, row in enumerate(rows.to_pylist()):
        places[row["take_id"]].append(place)
        cost, value = (np.nan if row[name] is None else row[name] for name in ("cost", "value"))
        label, template = classes[row["class"]], subclasses[row["subclass"]]
        segments.append(Segment(row["start"], row["stop"], label, cost, template, row["margin"], value))
    sure = np.full(len(segments), np.nan)
    if confidence is not None and segments:
        found = [[segments[place] for place in own] for own in places.values()]
        offsets = np.cumsum([0, *(frames[take] for take in places)]).astype(np.int64)
        sure[[place for own in places.values() for place in own]] = confidences_of(
            annotator, confidence, found, offsets
        )
    column = rows.schema.get_field_index("confidence")
    return rows.set_column(column, rows.schema.field("confidence"), pa.array(sure, from_pandas=True))


def fingerprints(store: Store, takes: pl.DataFrame, setting: str) -> dict[int, str]:
    """Return a hash of each take's words, known features and settings, by take_id; words are read in batches."""
    result = {}
    for batch in split_takes(takes["take_id"].to_list(), takes["frames"].to_list()):
        words = store.words(batch)
        for index, take_id in enumerate(words.take_ids.tolist()):
            hasher = hashlib.sha256(setting.encode())
            hasher.update(np.ascontiguousarray(words.take(index)).tobytes())
            if words.known is not None:
                hasher.update(words.known[index].tobytes())
            result[int(take_id)] = hasher.hexdigest()[:32]
    return result


@dataclass(frozen=True)
class EarlierAnnotations:
    """The annotations of an earlier run that are up to date.

    Attributes
    ----------
    store : Store
        The store that holds them.
    stage : str
        The stage that made them, "<pipeline>/<stage>".
    run : str
        The id of the run.
    searched : dict of int to float
        For each take that is up to date, by take_id, the fraction of its frames that templates were matched in.
    """

    store: Store
    stage: str
    run: str
    searched: dict[int, float]

    def annotations(self, run: str) -> pa.Table:
        """Return the segments, with the id of a new run."""
        return self._rows(self.store.result("annotations", run=self.run), run)

    def curve_parts(self) -> ReusedParts:
        """Divide the stored parts of distance curves into those that are kept and those whose rows are rewritten."""
        return reused_parts(self.store, "distance_curves", self.stage, self.searched)

    def curves(self, parts: Iterable[ResultPart], run: str) -> Iterator[pa.Table]:
        """Yield the distance curves of stored parts, with the id of a new run, in pieces of `PIECE_BYTES`."""
        waiting: list[pa.Table] = []
        for piece in self.store.result_pieces("distance_curves", parts):
            waiting.append(self._rows(piece, run))
            if sum(rows.nbytes for rows in waiting) >= PIECE_BYTES:
                yield pa.concat_tables(waiting).combine_chunks()
                waiting = []
        if waiting:
            yield pa.concat_tables(waiting).combine_chunks()

    def _rows(self, table: pa.Table, run: str) -> pa.Table:
        rows = table.filter(pc.is_in(table.column("take_id"), pa.array(self.searched, pa.int64())))
        place = rows.schema.get_field_index("run")
        return rows.set_column(place, rows.schema.field("run"), pa.repeat(pa.scalar(run), rows.num_rows))


def earlier_annotations(store: Store, stage: str, prints: dict[int, str]) -> EarlierAnnotations:
    """Return a stage's earlier annotations of takes whose fingerprints have not changed."""
    runs = [part.run for part in store.stage_parts("annotated_takes", stage)]
    if not runs:
        return EarlierAnnotations(store, stage, "", {})
    rows = store.result("annotated_takes", run=runs[-1]).select(["take_id", "fingerprint", "searched"]).to_pylist()
    same = {
        int(row["take_id"]): float(row["searched"])
        for row in rows
        if row["fingerprint"] is not None and prints.get(row["take_id"]) == row["fingerprint"]
    }
    return EarlierAnnotations(store, stage, runs[-1], same)
