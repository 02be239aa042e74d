"""Read the learned queries of a store, and format them as tables and as text."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import Keyframe, KeyframeQuery, features_of
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.pipelines.keyframes.learning_runs import outcomes_of
from kinedex.pipelines.keyframes.query_learning import Outcome, keyframe_queries
from kinedex.storage.snapshot.visible_results import pipeline_of, shown_pipeline
from kinedex.storage.store.store import Store

_OVERVIEW = pa.schema(
    [
        ("query", pa.string()),
        ("origin", pa.string()),
        ("runs", pa.int64()),
        ("precision", pa.float64()),
        ("recall", pa.float64()),
        ("fitness", pa.float64()),
        ("keyframes", pa.string()),
        ("margins", pa.string()),
    ]
)

LEGEND = """keyframes: features that are on, and off where a minus stands before them; & joins what holds in one frame;
→11–56→: the next keyframe follows 11 to 56 frames later. margins: frames before and after a hit that the motion may
reach. Precision and recall are those of all queries of a class together, in its first row."""
"""The text below the table on the terminal."""


@dataclass(frozen=True)
class StoredQueries:
    """The learned queries of one stage.

    Attributes
    ----------
    outcomes : tuple of Outcome
        The distinct outcomes of the requested classes.
    classes : frozenset of str
        All classes that were learned together.
    stage : str
        The stage that learned them, "<pipeline>/<stage>".
    other_stages : tuple of str
        Older stages that match the request as well.
    """

    outcomes: tuple[Outcome, ...]
    classes: frozenset[str]
    stage: str
    other_stages: tuple[str, ...]


def stored_queries(store: Store, classes: Sequence[str] | None = None, pipeline: str | None = None) -> StoredQueries:
    """Read the learned queries of a store.

    Parameters
    ----------
    store : Store
        The store.
    classes : sequence of str, optional
        The classes to read; by default all.
    pipeline : str, optional
        The pipeline that learned the queries, or "<pipeline>/<stage>"; by default that of the view `queries`.

    Returns
    -------
    StoredQueries
        The queries of one stage.

    Raises
    ------
    KinedexError
        If there are no learned queries, none of this pipeline, or none for a class.
    """
    # parts are in the order in which they were written
    stages = [part.stage for part in store.manifest.results.get("queries", ())]
    if not stages:
        raise KinedexError(f"{store.path} has no learned queries; learn some: kinedex keyframes learn {store.path}")
    asked = pipeline or shown_pipeline(store.manifest, "queries")
    fitting = [one for one in stages if asked in (one, pipeline_of(one))]
    if not fitting:
        known = ", ".join(dict.fromkeys(map(pipeline_of, stages)))
        raise KinedexError(f"--pipeline {pipeline}: it has learned no queries; expected one of {known}")
    stage = fitting[-1]
    others = dict.fromkeys(one for one in (fitting if pipeline else stages) if one != stage)
    found = {one.subclass: one for one in outcomes_of(store.result("queries", stage=stage))}
    for name in classes or ():
        if name not in found:
            raise KinedexError(f"no query was learned for '{name}' by {stage}{did_you_mean(name, found)}")
    chosen = tuple(found[name] for name in dict.fromkeys(classes or found))
    return StoredQueries(chosen, frozenset(found), stage, tuple(others))


def queries_overview(outcomes: Sequence[Outcome], feature_set: FeatureSet, taken: Collection[str]) -> pa.Table:
    """Return a table with a row for each query: its origin, its keyframes, and the scores of the queries of its class.

    Precision and recall are those of all queries of a class together on the training clips, and are in its first row
    only.

    Parameters
    ----------
    outcomes : sequence of Outcome
        The outcomes of classes.
    feature_set : FeatureSet
        The features of their keyframes.
    taken : collection of str
        The names of all subclasses, as for `keyframe_queries`.
    """
    rows = []
    for outcome in outcomes:
        for number, query in enumerate(keyframe_queries(outcome, feature_set, taken)):
            assert query.margins is not None
            rows.append(
                {
                    "query": query.name,
                    "origin": outcome.consensus.origin if number == 0 else "run",
                    "runs": outcome.runs,
                    "precision": round(outcome.precision, 3) if number == 0 else None,
                    "recall": round(outcome.recall, 3) if number == 0 else None,
                    "fitness": round(outcome.consensus.fitness, 3) if number == 0 else None,
                    "keyframes": query_sentence(query, feature_set),
                    "margins": f"{query.margins[0]} {query.margins[1]}",
                }
            )
    return pa.Table.from_pylist(rows, schema=_OVERVIEW)


def query_sentence(query: KeyframeQuery, feature_set: FeatureSet) -> str:
    """Return a query as one line: features that are on, features that are off with a minus, and gaps in frames."""
    text = _words(query.keyframes[0], feature_set)
    for gap, keyframe in zip(query.gaps, query.keyframes[1:], strict=True):
        text += " & " if gap.high == 0 else f" →{gap.low}–{gap.high}→ "
        text += _words(keyframe, feature_set)
    return text


def _words(keyframe: Keyframe, feature_set: FeatureSet) -> str:
    on, off = features_of(keyframe, feature_set)
    return " ".join([*on, *(f"−{name}" for name in off)])
