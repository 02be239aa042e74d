"""Stage rank: find the best hits of every template in an archive, in all frames or within hits of keyframe queries."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, ClassVar

from pydantic import Field

from kinedex.catalog.queries.query_reader import query_file_paths, read_query_files
from kinedex.ops.templates.templates import Kind, NamedTemplate
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import files_digest
from kinedex.pipelines.engine.display import ResultTable
from kinedex.pipelines.engine.file_parameters import NamesFile, StageParameters
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.keyframes.applicability import known_masks, not_applied_table, remarks_on
from kinedex.pipelines.keyframes.search_explanation import explain_store
from kinedex.pipelines.keyframes.store_search import search_store
from kinedex.pipelines.templates.ranked_hits import RankedTemplate, Ranking, ranking_table
from kinedex.pipelines.templates.ranking import partly_known, rank_takes
from kinedex.pipelines.templates.ranking_evaluation import mean_stiffness
from kinedex.pipelines.templates.store_ranking import ranked_templates
from kinedex.pipelines.templates.template_learning import read_templates
from kinedex.storage.store.store import Store


class Params(StageParameters):
    """The parameters of the stage `rank`."""

    where: str = Field("class IS NULL", description="takes to rank: a SQL filter over the columns of takes")
    templates: Kind = Field("soft", description="which of the learned templates: soft or hard")
    delta: float = Field(0.1, ge=0, lt=0.5, description="template values within delta of 0 or 1 count")
    tau: float = Field(0.1, ge=1e-6, le=1, description="distances below tau make a hit")
    top: int | None = Field(100, ge=1, description="how many hits a template at most; null for all")
    queries: Annotated[list[str], NamesFile("queries")] = Field(
        [], description="keyframe queries that preselect frames: files, by names or paths"
    )


class Rank(Stage[Params]):
    """Finds the best hits of every template in an archive, in all frames or within the hits of keyframe queries."""

    name = "rank"
    parameters = Params
    inputs: ClassVar = {"takes": Input("ingest"), "templates": Input("learn_templates")}

    def external_digest(self, params: Params, store: Store | None) -> str:
        """Return a hash of the query files."""
        return files_digest(query_file_paths(params.queries))

    def run(self, context: StageContext, params: Params) -> dict[str, object]:
        """Rank the archive, store the hits, and show a row for each class (thesis, Table 3.2)."""
        store = context.open()
        learned = read_templates(store, context.key(context.inputs["templates"]), params.templates)
        queries = read_query_files(params.queries, store.feature_set, store.rate_hz)
        searched, remarks = ranked_templates(
            [NamedTemplate(one.subclass, one.learned.template) for one in learned], params.delta, queries
        )
        names = dict(store.takes(params.where).select("take_id", "name").iter_rows())
        known = known_masks(store.known, names)
        partly = partly_known(searched, store.feature_set, known)
        context.message(*remarks, *remarks_on(partly, known))
        rankings = _rank(context, store, searched, params)
        table = ranking_table(rankings, context.run)
        lists = _lists(store, searched, params.where)
        context.terminal.show(_shown(searched, rankings, lists))
        refused = not_applied_table(partly, known, names, context.run)
        context.put_results(ranked_hits=table, not_applied=refused)
        return {
            "templates": len(searched),
            "hits": table.num_rows,
            "tau": params.tau,
            "delta": params.delta,
            "frames": rankings[0].frames,
            "skipped": {one.name: None if one.skipped is None else round(one.skipped, 4) for one in rankings},
            "kept": {one.name: round(one.kept, 4) for one in rankings},
            "reading": {one.name: round(one.reading, 4) for one in rankings},
            "seconds": {one.name: round(one.ranking, 4) for one in rankings},
            "columns": {one.name: len(one.template) for one in searched},
            "lists": {name: asdict(found) for name, found in lists.items()},
        }


def _rank(context: StageContext, store: Store, searched: Sequence[RankedTemplate], params: Params) -> list[Ranking]:
    """Rank by each template with queries separately, and by all templates without queries in one pass."""
    workers = context.executor.workers
    free = [one for one in searched if not one.queries]
    groups = [[one] for one in searched if one.queries] + ([free] if free else [])
    some = store.takes(params.where).sort("frames")["take_id"].to_list()[-1:]
    for group in groups[-1:] + groups[:1]:  # warm-up: kernels are compiled when first called
        for take_id in some:
            rank_takes(store, group, params.tau, 1, f"take_id = {take_id}", workers)
    if len(free) > 1:
        context.message(
            f"{len(free)} templates were ranked in one pass: each row shows the reading time of the whole pass, and a "
            "share of the ranking time by the number of columns"
        )
    context.message("reading: listing takes, reading and coding words, looking up keyframes; ranking: all that follows")
    found: dict[str, Ranking] = {}
    with context.progress("templates", len(searched)) as progress:
        for group in groups:
            rankings = rank_takes(store, group, params.tau, params.top, params.where, workers)
            found |= {one.name: one for one in rankings}
            progress.advance(len(group))
    return [found[one.name] for one in searched]


@dataclass(frozen=True)
class Lists:
    """Statistics of the keyframe search of one class (thesis, Table 3.2).

    Attributes
    ----------
    keyframes : int
        The number K of keyframes.
    stiffness : float or None
        The mean stiffness of the gaps between keyframes; None if there are none.
    segments : int
        The number of segments in the inverted lists of all keyframes.
    seconds : float
        The time of the search in the bit slices of the index.
    lists_seconds : float
        The time of the search by inverted lists, without reading the lists.
    """

    keyframes: int
    stiffness: float | None
    segments: int
    seconds: float
    lists_seconds: float


def _lists(store: Store, searched: Sequence[RankedTemplate], where: str) -> dict[str, Lists]:
    """Return statistics of the keyframe search in the index, for each template that has queries."""
    found = {}
    for query in [query for one in searched for query in one.queries][:1]:
        explain_store(store, [query], where)  # a first search before time is measured
    for one in searched:
        if one.queries:
            reports = explain_store(store, one.queries, where)
            steps = [keyframe for report in reports for keyframe in report.keyframes]
            begin = time.perf_counter()
            search_store(store, one.queries, where)
            seconds = time.perf_counter() - begin
            spent = sum(report.milliseconds for report in reports) + sum(step.milliseconds for step in steps)
            segments = sum(step.segments for step in steps)
            found[one.name] = Lists(len(steps), mean_stiffness(one.queries), segments, seconds, spent / 1000)
    return found


def _shown(
    searched: Sequence[RankedTemplate],
    rankings: Sequence[Ranking],
    lists: dict[str, Lists],
) -> ResultTable:
    """Return a table with a row for each subclass: its keyframe search, the frames that are kept, and its ranking."""
    columns = ["subclass", "columns", "skipped", "reading ms", "ranking ms", "hits", "best"]
    if lists:
        columns[2:2] = ["K", "mean σ", "Σ|Λ|", "search ms", "in lists", "kept"]
    table = ResultTable(tuple(columns))
    for one, ranking in zip(searched, rankings, strict=True):
        first = [str(len(one.template))]
        if lists:
            own = lists.get(one.name, Lists(0, None, 0, 0.0, 0.0))
            first += [str(own.keyframes), "–" if own.stiffness is None else f"{own.stiffness:.2f}", f"{own.segments:,}"]
            first += [f"{1000 * own.seconds:.1f}", f"{1000 * own.lists_seconds:.2f}", f"{ranking.kept:.1%}"]
        best = f"{ranking.hits.column('cost')[0].as_py():.3f}" if len(ranking) else "–"
        skipped = "not tried" if ranking.skipped is None else f"{ranking.skipped:.0%}"
        times = [f"{1000 * seconds:.1f}" for seconds in (ranking.reading, ranking.ranking)]
        table.add(one.name, *first, skipped, *times, str(len(ranking)), best)
    return table
