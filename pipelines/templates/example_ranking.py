"""Rank a store by examples: words find the candidates, and numbers order them by their similarity to the examples."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pyarrow as pa

from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.ops.arrays import F64, Bool
from kinedex.ops.body.facing_direction import mirrored_positions
from kinedex.ops.intervals import Hit
from kinedex.ops.numeric.example_similarity import compare, interval_descriptor
from kinedex.ops.templates.templates import NamedTemplate
from kinedex.pipelines.templates.ranked_hits import as_ranked
from kinedex.pipelines.templates.store_ranking import RankingQuestion, StoreRanking, rank_store
from kinedex.storage.snapshot.frames import read_intervals
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.snapshot.schemas import comparison_schema, hits_of
from kinedex.storage.store.store import Store

CANDIDATES = 600
"""The number of candidates of least cost that are ordered by similarity; others come after them, by their cost."""

NEEDED = "a pair of hips or shoulders and a whole leg"
"""The joints without which an interval cannot be described."""


def rank_by_examples(
    store: Store,
    template: NamedTemplate,
    examples: Sequence[Hit | F64],
    asked: RankingQuestion,
    rejected: Sequence[Hit] = (),
    queries: Sequence[KeyframeQuery] | None = None,
) -> StoreRanking:
    """Rank intervals of the takes of a store by their similarity to examples of a motion.

    Parameters
    ----------
    store : Store
        The store to search.
    template : NamedTemplate
        The template of the examples, by which candidates are found.
    examples : sequence of Hit or float array (T, J, 3)
        Intervals of the store, or positions at the rate of the store and with its joints; at least one.
    asked : RankingQuestion
        Thresholds, takes, and the number of hits.
    rejected : sequence of Hit, optional
        Intervals of the store that do not show the motion; what is more similar to one of these comes last.
    queries : sequence of KeyframeQuery, optional
        Queries that preselect frames, as for `rank_store`.

    Returns
    -------
    StoreRanking
        The hits with the columns `similarity` and `probable`, the most similar first. Both are null for a hit that
        cannot be compared, as its body lacks joints of the examples, or as there are more than `CANDIDATES` hits of
        less cost.

    Raises
    ------
    KinedexError
        As `rank_store` raises.
    """
    top = None if asked.top is None else max(asked.top, CANDIDATES)
    found = rank_store(store, [template], replace(asked, top=top), queries=queries)
    (ranking,) = found.rankings
    described = [one for hit in examples if (one := _descriptor(store, hit)) is not None]
    remarks = list(found.remarks)
    if 0 < len(described) < len(examples):
        remarks.append(f"examples without {NEEDED}, not compared: {len(examples) - len(described)}")
    if described:
        used: Bool = np.asarray(np.isfinite(np.stack(described)).all(axis=0))  # of joints that all examples know
        others = [_descriptor(store, hit) for hit in rejected]
        unlike = [one[used] for one in others if one is not None and np.isfinite(one[used]).all()]
        if len(unlike) < len(rejected):
            remarks.append(f"rejected intervals that lack joints of the examples, ignored: {len(others) - len(unlike)}")
        hits = _ordered(store, ranking.hits, np.stack(described), used, unlike)
    else:
        remarks.append(f"no example has {NEEDED}: hits are in the order of their costs")
        hits = _with_comparison(ranking.hits, np.full(len(ranking), np.nan), np.zeros(len(ranking), np.bool_))
    kept = replace(ranking, hits=as_ranked(hits.slice(0, asked.top)))
    return replace(found, rankings=(kept,), remarks=tuple(remarks), compared=True)


def _ordered(store: Store, hits: pa.Table, examples: F64, used: Bool, rejected: Sequence[F64]) -> pa.Table:
    """Return hits in the order of their similarity to examples; those that cannot be compared follow by their cost.

    Parameters
    ----------
    store : Store
        The store of the hits.
    hits : pyarrow.Table
        The hits in the order of their costs.
    examples : float64 array (E, D)
        The descriptors of the examples.
    used : bool array (D,)
        The numbers that are compared.
    rejected : sequence of float64 arrays
        These numbers of intervals that do not show the motion.
    """
    first = hits.slice(0, CANDIDATES)
    if not first.num_rows:
        return _with_comparison(hits, np.empty(0), np.empty(0, np.bool_))
    descriptors = np.full((first.num_rows, examples.shape[1]), np.nan)
    for place, one in _descriptors(store, hits_of(first)):
        if one is not None:
            descriptors[place] = one
    known = np.flatnonzero(np.isfinite(descriptors[:, used]).all(axis=1))
    takes = np.array(first.column("take_id").to_pylist(), np.int64)
    unlike = np.array(rejected).reshape(len(rejected), np.count_nonzero(used))
    compared = compare(examples[:, used], descriptors[known][:, used], takes[known], unlike)
    similarity = np.full(hits.num_rows, np.nan)
    probable = np.zeros(hits.num_rows, np.bool_)
    similarity[known], probable[known] = compared
    order = np.argsort(-similarity, kind="stable").tolist()
    found = _with_comparison(hits, similarity, probable)
    values = [column.to_pylist() for column in found.columns]  # `Table.take` would load `pyarrow.compute`
    return pa.table([[own[place] for place in order] for own in values], schema=found.schema)


def _with_comparison(hits: pa.Table, similarity: F64, probable: Bool) -> pa.Table:
    """Add the columns `similarity` and `probable` to hits; both are null where the similarity is NaN."""
    unknown = np.isnan(similarity)
    for name, values in (("similarity", similarity), ("probable", probable)):
        hits = hits.append_column(comparison_schema().field(name), pa.array(values, mask=unknown))
    return hits


def _descriptor(store: Store, example: Hit | F64) -> F64 | None:
    """Return the descriptor of an example; None if it cannot be described."""
    if isinstance(example, Hit):
        ((_, found),) = _descriptors(store, [example])
        return found
    return interval_descriptor(example, store.feature_set.joints, store.rate_hz)


def _descriptors(store: Store, hits: Sequence[Hit]) -> Iterator[tuple[int, F64 | None]]:
    """Yield the index and the descriptor of each hit, in any order; None if a hit cannot be described."""
    joints = store.feature_set.joints
    places = [(store.take_ids[one.interval.take], one.interval.start, one.interval.stop) for one in hits]
    numbers, tables = zip(*read_intervals(store.checked, store.manifest, places, joints), strict=True)
    positions = joint_positions(pa.concat_tables(tables), joints).transpose(2, 0, 1).astype(np.float64)
    ends = np.cumsum([rows.num_rows for rows in tables])
    for place, own in zip(numbers, np.split(positions, ends[:-1]), strict=True):
        seen = mirrored_positions(own, joints) if hits[place].mirrored else own
        yield place, interval_descriptor(seen, joints, store.rate_hz)
