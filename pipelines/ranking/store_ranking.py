"""Rankings of a store by templates and by examples: which templates are used, which queries they get, the hits."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import pyarrow as pa

from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.catalog.template_files import NamedTemplate
from kinedex.ops.errors import KinedexError
from kinedex.ops.templates.templates import Kind, quantise
from kinedex.pipelines.console.wording import few
from kinedex.pipelines.ranking.ranking import RankedTemplate, Ranking, partly_known, rank_takes, ranking_table
from kinedex.pipelines.search.not_applied import known_of, remarks_on
from kinedex.pipelines.templates.stored_templates import choose_templates
from kinedex.storage.store.store import Store

DELTA, TAU, TOP = 0.1, 0.1, 20
"""Thresholds of a ranking, as configs/pipelines/retrieval.yaml has them, and a screen of hits."""


@dataclass(frozen=True)
class StoreRanking:
    """The rankings of a store by some templates.

    Attributes
    ----------
    rankings : tuple of Ranking
        One for each template, with its hits, the best first.
    rate_hz : float
        The analysis rate of the store, in frames per second.
    remarks : tuple of str
        Templates that were excluded or not applied to some takes, and those that were ranked in all frames though
        others have queries.
    """

    rankings: tuple[Ranking, ...]
    rate_hz: float
    remarks: tuple[str, ...] = ()

    def table(self) -> pa.Table:
        """Return the hits as results of the kind `ranked_hits`."""
        return ranking_table(self.rankings, self.rate_hz)


def rank_store(
    store: Store,
    templates: Sequence[str | NamedTemplate] | None = None,
    *,
    queries: Sequence[KeyframeQuery] | None = None,
    kind: Kind = "soft",
    stage: str | None = None,
    delta: float = DELTA,
    tau: float = TAU,
    top: int | None = TOP,
    where: str | None = None,
    workers: int | None = None,
) -> StoreRanking:
    """Rank the places of an archive by how well templates fit them.

    Parameters
    ----------
    store : Store
        The store to search.
    templates : sequence of str or NamedTemplate, optional
        Subclasses with a learned template, paths of template files, or templates themselves; all learned templates
        unless given, except those that are wildcards alone.
    queries : sequence of KeyframeQuery, optional
        A template is ranked within the hits of the queries whose target has its name, and in all frames where it has
        none; in all frames unless given.
    kind : {"soft", "hard"}
        The kind of the learned templates.
    stage : str, optional
        The stage that learned them: "<pipeline>/<stage>", or the name of the pipeline alone.
    delta : float
        Entries of a template within delta of 0 or 1 count, the others are wildcards.
    tau : float
        Distances below it make a hit.
    top : int, optional
        The largest number of hits of a template; None returns all.
    where : str, optional
        A SQL filter over the columns of takes.
    workers : int, optional
        The number of threads; that of the cores unless given.

    Returns
    -------
    StoreRanking
        The hits of every template, with remarks.

    Raises
    ------
    KinedexError
        A template cannot be found or is wildcards alone, no query is for any of the templates, or no take is selected.
    """
    names = None if templates is None else [one for one in templates if isinstance(one, str)]
    given = [one for one in templates or () if not isinstance(one, str)]
    found = choose_templates(store, names, kind, stage) if names or templates is None else []
    ranked, remarks = ranked_templates([*found, *given], delta, queries, strict=templates is not None)
    known = known_of(store.known, store.takes(where)["take_id"].to_list()) if store.known else {}
    remarks += remarks_on(partly_known(ranked, store.feature_set, known), known)
    rankings = rank_takes(store, ranked, tau, top, where, workers)
    return StoreRanking(tuple(rankings), store.rate_hz, tuple(remarks))


def ranked_templates(
    templates: Iterable[NamedTemplate],
    delta: float,
    queries: Sequence[KeyframeQuery] | None = None,
    *,
    strict: bool = False,
) -> tuple[list[RankedTemplate], list[str]]:
    """Quantise templates, and give each the queries for its name.

    Parameters
    ----------
    templates : iterable of NamedTemplate
        The templates to rank by.
    delta : float
        Entries within delta of 0 or 1 count, the others are wildcards.
    queries : sequence of KeyframeQuery, optional
        The queries that preselect frames, each for the template that its target names.
    strict : bool
        True raises where a template is wildcards alone; otherwise it is excluded, with a remark.

    Returns
    -------
    list of RankedTemplate
        At least one.
    list of str
        Remarks on templates that are excluded, or that have no query where others have one.

    Raises
    ------
    KinedexError
        A template is wildcards alone (`strict`), all of them are, or queries are given and none is for any of them.
    """
    ranked, vague = [], []
    for one in templates:
        quantised = quantise(one.template, delta)
        if quantised.fixed:
            own = tuple(query for query in queries or () if query.target == one.name)
            ranked.append(RankedTemplate(one.name, quantised, own))
        else:
            vague.append(one.name)
    if vague and (strict or not ranked):
        alone = f"the template '{vague[0]}' is" if len(vague) == 1 else f"the templates {few(vague)} are"
        raise KinedexError(
            f"at delta = {delta:g} {alone} wildcards alone, which fit anything; choose a larger delta, or other "
            "templates"
        )
    remarks = [f"templates of wildcards alone at delta = {delta:g}, excluded: {few(vague)}"] if vague else []
    bare = [one.name for one in ranked if not one.queries]
    if queries and len(bare) == len(ranked):
        targets = ", ".join(sorted({query.target for query in queries}))
        raise KinedexError(f"no query is for {few(bare)}; the queries are for: {targets}")
    if queries and bare:
        remarks.append(f"templates without a query, ranked in all frames: {few(bare)}")
    return ranked, remarks
