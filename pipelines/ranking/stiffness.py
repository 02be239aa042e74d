"""Run the stiffness experiment: fractions of frames that queries keep, precision and recall, by stiffness of gaps."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import pyarrow as pa

from kinedex.catalog.queries.keyframe_query import SAME_FRAME, Gap, KeyframeQuery
from kinedex.ops.evaluation.ranking_metrics import precision_recall
from kinedex.ops.search.gaps import UNBOUNDED, nominal_gap
from kinedex.pipelines.engine.display import Progress
from kinedex.pipelines.evaluation.ground_truth import Manual
from kinedex.pipelines.ranking.ranked_hits import RankedTemplate
from kinedex.pipelines.ranking.ranking import rank_takes
from kinedex.pipelines.ranking.ranking_evaluation import Judged, judge_hits
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import Store

EVERYWHERE = "all frames"
WRITTEN = "as written"


@dataclass(frozen=True)
class Trial:
    """The ranking of one class with one variant of its queries.

    Attributes
    ----------
    variant : str
        `EVERYWHERE` (no preselection), `WRITTEN`, or a stiffness as text.
    stiffness : float, optional
        The stiffness of all gaps.
    judged : Judged
        The evaluation of the ranking.
    kept : float
        The fraction of frames that was ranked.
    """

    variant: str
    stiffness: float | None
    judged: Judged
    kept: float


def stiffened(query: KeyframeQuery, stiffness: float) -> KeyframeQuery:
    """Return a query with the same stiffness in all gaps (thesis, Figure 3.14: σ ≡ 1.0).

    A gap that was given as a range gets the nominal distance of the range (Eq. 4.8). Gaps between parts of one
    keyframe, and gaps without an upper bound, which have no distance, are unchanged.
    """
    gaps = tuple(_gap(gap, stiffness) for gap in query.gaps)
    return replace(query, gaps=gaps, alternatives=tuple(stiffened(other, stiffness) for other in query.alternatives))


def _gap(gap: Gap, stiffness: float) -> Gap:
    if gap == SAME_FRAME:
        return gap
    distance = gap.distance
    if distance is None:
        if gap.high >= UNBOUNDED:
            return gap
        distance = round(nominal_gap(gap.low, gap.high)[0])
    return Gap.of_distance(distance, stiffness)


def mean_stiffness(queries: Iterable[KeyframeQuery]) -> float | None:
    """Return the mean stiffness of all gaps of some queries (thesis, Table 3.2), without those within a keyframe."""
    values = [
        gap.nominal_stiffness for query in queries for chain in query.chains for gap in chain.gaps if gap != SAME_FRAME
    ]
    return sum(values) / len(values) if values else None


def run_trials(
    store: Store,
    searched: Sequence[RankedTemplate],
    truth: Sequence[Manual],
    takes: str,
    stiffnesses: Sequence[float],
    tau: float,
    workers: int,
    progress: Progress,
) -> list[Trial]:
    """Rank takes in all frames, within the hits of the queries as written, and with changed stiffnesses.

    Parameters
    ----------
    store : Store
        The store to search.
    searched : sequence of RankedTemplate
        The templates; those without queries are ranked in all frames only.
    truth : sequence of Manual
        The manual segments to find.
    takes : str
        A SQL filter over the columns of takes.
    stiffnesses : sequence of float
        The stiffnesses in [0, 1], each used for all gaps of all queries.
    tau : float
        The threshold of recall.
    workers : int
        The number of threads.
    progress : callable
        Function of a description and a number of steps that returns a progress bar.
    """
    variants: list[tuple[str, float | None, list[RankedTemplate]]] = [
        (EVERYWHERE, None, [replace(one, queries=()) for one in searched])
    ]
    asked = [one for one in searched if one.queries]
    if asked:
        variants.append((WRITTEN, None, asked))
        for value in stiffnesses:
            rigid = [replace(one, queries=tuple(stiffened(each, value) for each in one.queries)) for one in asked]
            variants.append((f"{value:g}", value, rigid))
    trials = []
    with progress("stiffnesses", len(variants)) as bar:
        for name, stiffness, templates in variants:
            for ranking in rank_takes(store, templates, 1.0, None, takes, workers):
                judged = judge_hits(ranking.name, ranking.hits, truth, tau)
                trials.append(Trial(name, stiffness, judged, ranking.kept))
            bar.advance()
    return trials


def trial_rows(trials: Sequence[Trial], run: str) -> pa.Table:
    """Return trials as results of the kind `precision_recall`."""
    rows = []
    for trial in trials:
        judged = trial.judged
        precision, recall = precision_recall(judged.relevant, judged.total)
        average = judged.average_precision
        rows.append(
            {
                "run": run,
                "variant": trial.variant,
                "stiffness": trial.stiffness,
                "class": judged.label,
                "relevant": judged.total,
                "ranked": sum(judged.relevant),
                "found": judged.found,
                "kept": trial.kept,
                "average_precision": None if math.isnan(average) else average,
                "precision": precision.tolist(),
                "recall": recall.tolist() if judged.total else [],
            }
        )
    return pa.Table.from_pylist(rows, schema=result_schema("precision_recall"))
