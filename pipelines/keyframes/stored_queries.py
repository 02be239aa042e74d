"""Read the learned queries of a store, of one stage and of given classes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.pipelines.keyframes.learning import Outcome
from kinedex.pipelines.keyframes.runs import outcomes_of
from kinedex.storage.snapshot.shown_results import pipeline_of, shown_pipeline
from kinedex.storage.store.store import Store


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
        The pipeline that learned them, or "<pipeline>/<stage>"; by default the one that the view `queries` shows.

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
