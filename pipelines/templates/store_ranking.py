"""Rank a store by templates and by examples: choose templates, assign keyframe queries, and return the hits."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import floor

import pyarrow as pa

from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.ops.errors import KinedexError
from kinedex.ops.intervals import shown_seconds
from kinedex.ops.templates.templates import Kind, NamedTemplate, quantise
from kinedex.ops.wording import name_list
from kinedex.pipelines.keyframes.applicability import known_masks, remarks_on
from kinedex.pipelines.templates.ranked_hits import RankedTemplate, Ranking, ranking_table
from kinedex.pipelines.templates.ranking import partly_known, rank_both_sides, rank_takes
from kinedex.pipelines.templates.stored_templates import choose_templates
from kinedex.storage.store.store import Store

DELTA, TAU, TOP = 0.1, 0.1, 20
"""Default thresholds δ and τ of a ranking, as in configs/pipelines/retrieval.yaml, and default number of hits."""

EXAMPLE_TAU = 0.5
"""The default threshold τ of a search by example, below which an interval is a candidate."""

FARTHEST = 1.0
"""The cost where every fixed entry of a template is wrong, which is the largest possible."""


@dataclass(frozen=True)
class RankingQuestion:
    """The options of a ranking: thresholds, the takes to search, and the number of hits.

    Attributes
    ----------
    delta : float
        Entries of a template within delta of 0 or 1 count, the others are wildcards.
    tau : float
        The threshold below which a distance is a hit.
    top : int, optional
        The largest number of hits of a template; None returns all.
    where : str, optional
        A SQL filter over the columns of takes.
    mirror : bool
        True to search the mirror images of the templates as well: the same motions of the other side of the body.
    nearest : int
        The number of best matches to return for each template without a hit.
    workers : int, optional
        The number of threads; by default one per core.
    """

    delta: float = DELTA
    tau: float = TAU
    top: int | None = TOP
    where: str | None = None
    mirror: bool = False
    nearest: int = 0
    workers: int | None = None


USUAL = RankingQuestion()
"""The default options, with which all takes are searched."""


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
        Remarks on templates that were excluded or not applied to some takes, or ranked in all frames although
        others have queries.
    mirror : bool
        True if mirror images of the templates were searched as well.
    nearest : tuple of Ranking
        The best matches of templates without a hit, if they were requested.
    compared : bool
        True if hits were compared with examples, and are in the order of their similarity.
    """

    rankings: tuple[Ranking, ...]
    rate_hz: float
    remarks: tuple[str, ...] = ()
    mirror: bool = False
    nearest: tuple[Ranking, ...] = ()
    compared: bool = False

    def table(self) -> pa.Table:
        """Return the hits as results of the kind `ranked_hits`, with a column `mirrored` if images were searched.

        Hits that were compared with examples also have the columns `similarity` and `probable`.
        """
        return ranking_table(self.rankings, mirror=self.mirror, compared=self.compared)

    def nearest_table(self) -> pa.Table:
        """Return the best matches of templates without a hit, in the same form."""
        return ranking_table(self.nearest, mirror=self.mirror)

    def misses(self, tau: float, option: str = "--tau ") -> list[str]:
        """Return a sentence on each template without a hit below tau: its best match, and the τ that would include it.

        `option` is the way in which the caller gives τ: "--tau " in a command, "tau=" in Python.
        """
        return [_miss(one, tau, self.rate_hz, option) for one in self.nearest]


def rank_store(
    store: Store,
    templates: Sequence[str | NamedTemplate] | None = None,
    asked: RankingQuestion = USUAL,
    *,
    queries: Sequence[KeyframeQuery] | None = None,
    kind: Kind = "soft",
    stage: str | None = None,
) -> StoreRanking:
    """Rank intervals of the takes of a store by their distance to templates.

    Parameters
    ----------
    store : Store
        The store to search.
    templates : sequence of str or NamedTemplate, optional
        Subclasses with a learned template, paths of template files, or templates themselves; by default all learned
        templates that have fixed entries.
    asked : RankingQuestion, optional
        Thresholds, takes, and the number of hits.
    queries : sequence of KeyframeQuery, optional
        The queries that preselect frames. A template is ranked within the hits of the queries whose target is its name,
        and in all frames if there are none. By default, all templates are ranked in all frames.
    kind : {"soft", "hard"}
        The kind of the learned templates.
    stage : str, optional
        The stage that learned them: "<pipeline>/<stage>", or the name of the pipeline alone.

    Returns
    -------
    StoreRanking
        The hits of every template, with remarks.

    Raises
    ------
    KinedexError
        A template cannot be found or has no fixed entry, no query is for any of the templates, no take is selected, or
        features cannot be mirrored.
    """
    names = None if templates is None else [one for one in templates if isinstance(one, str)]
    given = [one for one in templates or () if not isinstance(one, str)]
    found = choose_templates(store, names, kind, stage) if names or templates is None else []
    ranked, remarks = ranked_templates([*found, *given], asked.delta, queries, strict=templates is not None)
    known = (
        known_masks(store.known, store.takes_table(asked.where).column("take_id").to_pylist()) if store.known else {}
    )
    remarks += remarks_on(partly_known(ranked, store.feature_set, known), known)
    rank = rank_both_sides if asked.mirror else rank_takes
    rankings = rank(store, ranked, asked.tau, asked.top, asked.where, asked.workers)
    missed = [own for own, one in zip(ranked, rankings, strict=True) if not len(one)]
    near = []
    if asked.nearest and missed and asked.tau < FARTHEST:
        near = rank(store, missed, FARTHEST, asked.nearest, asked.where, asked.workers)
    return StoreRanking(tuple(rankings), store.rate_hz, tuple(remarks), asked.mirror, tuple(near))


def _miss(one: Ranking, tau: float, rate_hz: float, option: str) -> str:
    """Return the sentence on a template without a hit below tau, given its best matches."""
    if not len(one):
        return f"'{one.name}' fits nowhere below {FARTHEST:g}"
    (best,) = one.hits.slice(0, 1).to_pylist()
    enough = min((floor(best["cost"] * 100) + 1) / 100, FARTHEST)  # rounded up to two digits, above the cost
    return (
        f"no hit of '{one.name}' below {tau:g}; the nearest place costs {best['cost']:.3f}: {best['take']} at "
        f"{shown_seconds(best['start'], rate_hz)} s; {option}{enough:g} makes it a hit"
    )


def ranked_templates(
    templates: Iterable[NamedTemplate],
    delta: float,
    queries: Sequence[KeyframeQuery] | None = None,
    *,
    strict: bool = False,
) -> tuple[list[RankedTemplate], list[str]]:
    """Quantise templates, and assign to each the queries whose target has its name.

    Parameters
    ----------
    templates : iterable of NamedTemplate
        The templates to rank by.
    delta : float
        Entries within delta of 0 or 1 count, the others are wildcards.
    queries : sequence of KeyframeQuery, optional
        The queries that preselect frames, each for the template that its target names.
    strict : bool
        True to raise an error for a template without fixed entries; otherwise it is excluded, with a remark.

    Returns
    -------
    list of RankedTemplate
        The quantised templates; at least one.
    list of str
        Remarks on templates that are excluded, or that have no query although others have one.

    Raises
    ------
    KinedexError
        A template has no fixed entry (`strict`), none has any, or queries are given but none is for these templates.
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
        alone = f"the template '{vague[0]}' is" if len(vague) == 1 else f"the templates {name_list(vague)} are"
        raise KinedexError(
            f"at delta = {delta:g} {alone} wildcards alone, which fit anything; choose a larger delta, or other "
            "templates"
        )
    remarks = [f"templates of wildcards alone at delta = {delta:g}, excluded: {name_list(vague)}"] if vague else []
    bare = [one.name for one in ranked if not one.queries]
    if queries and len(bare) == len(ranked):
        targets = ", ".join(sorted({query.target for query in queries}))
        raise KinedexError(f"no query is for {name_list(bare)}; the queries are for: {targets}")
    if queries and bare:
        remarks.append(f"templates without a query, ranked in all frames: {name_list(bare)}")
    return ranked, remarks
