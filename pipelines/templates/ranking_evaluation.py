"""Evaluate rankings of hits in takes and of clips that were not learned from, and vary the stiffness of queries.

Hits in takes are compared with manual segments. For each stiffness of the gaps in queries, the hits within the frames
that the queries keep are evaluated.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa
from pydantic import BaseModel, ConfigDict

from kinedex.catalog.classes import OWN, load_classes
from kinedex.catalog.queries.keyframe_query import SAME_FRAME, Gap, KeyframeQuery
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.evaluation.metrics import average_precision, precision_recall
from kinedex.ops.intervals import Interval
from kinedex.ops.ranking.hit_selection import KEYS
from kinedex.ops.search.gaps import UNBOUNDED, nominal_gap
from kinedex.ops.templates.derived_templates import restricted_template
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import TakeWords
from kinedex.pipelines.engine.display import Progress, ResultTable
from kinedex.pipelines.evaluation.ground_truth import GroundTruth, Manual, place_ground_truth
from kinedex.pipelines.labels.file_segments import with_take_names
from kinedex.pipelines.templates.ranked_hits import RankedTemplate
from kinedex.pipelines.templates.ranking import rank_takes
from kinedex.storage.formats.labels.formats import ground_truth_files, read_labels
from kinedex.storage.snapshot.schemas import hits_of, result_schema
from kinedex.storage.store.store import Store

EVERYWHERE = "all frames"
WRITTEN = "as written"


class Fold(BaseModel):
    """The clips to learn templates from, and the clips to rank, as SQL filters over the columns of takes."""

    model_config = ConfigDict(extra="forbid")
    name: str
    learn: str
    rank: str


@dataclass(frozen=True)
class EvaluatedRanking:
    """The evaluation of one ranking.

    Attributes
    ----------
    evaluation : str
        "takes" or "clips".
    fold : str
        The column value whose clips were held out; empty for none.
    label : str
        The class.
    relevant : tuple of bool
        True for each rank that is right, the best first.
    total : int
        The number of segments or clips to find.
    found : int
        The number of these that were found below τ.
    confused : tuple of (str, int)
        The wrong classes ranked above the last right hit, with their numbers, the most frequent first.
    """

    evaluation: str
    fold: str
    label: str
    relevant: tuple[bool, ...]
    total: int
    found: int
    confused: tuple[tuple[str, int], ...] = ()

    @property
    def average_precision(self) -> float:
        """The average precision; see `ops.evaluation.metrics.average_precision`."""
        return average_precision(self.relevant, self.total)

    @property
    def recall(self) -> float:
        """The fraction of segments or clips that was found below τ; NaN if there are none to find."""
        return self.found / self.total if self.total else math.nan


def read_truth(store: Store, pattern: str, where: str, subclasses: Sequence[str]) -> GroundTruth:
    """Read the ground truth of the takes that a SQL filter selects; labels without a template count as missed.

    Parameters
    ----------
    store : Store
        The store that holds the takes.
    pattern : str
        The label files below the source folders of the takes, as a glob.
    where : str
        A SQL filter over the columns of takes.
    subclasses : sequence of str
        The subclasses that have templates.
    """
    takes = store.takes(where)
    files = ground_truth_files(pattern, sorted(takes["source_root"].unique()))
    labels, remarks = with_take_names(store, list(map(read_labels, files)))
    classes = load_classes(OWN, set(subclasses))
    truth = place_ground_truth(labels, takes, store.takes()["name"], classes, "miss")
    return replace(truth, remarks=(*remarks, *truth.remarks))


def names_filter(takes: Sequence[str]) -> str:
    """Return a SQL filter that selects takes by their names."""
    return "name IN (" + ", ".join("'" + name.replace("'", "''") + "'" for name in takes) + ")"


def evaluate_hits(label: str, hits: pa.Table, truth: Sequence[Manual], tau: float) -> EvaluatedRanking:
    """Evaluate the ranked hits of a class by the manual segments of all classes.

    A hit is right if it overlaps a segment of its class by at least half of the shorter of the two, and if no better
    hit has matched this segment. A second hit on a segment is wrong.
    """
    wanted = [segment for segment in truth if segment.label == label]
    taken: set[int] = set()
    relevant, found = [], 0
    others: Counter[str] = Counter()
    pending: Counter[str] = Counter()
    for hit in hits_of(hits):
        match = next((i for i, one in enumerate(wanted) if i not in taken and _same(hit.interval, one)), None)
        relevant.append(match is not None)
        if match is not None:
            taken.add(match)
            found += hit.cost is not None and hit.cost < tau
            others += pending
            pending.clear()
        else:
            labels = [one.label for one in truth if _same(hit.interval, one)]
            pending[labels[0] if labels else "nothing"] += 1
    return EvaluatedRanking("takes", "", label, tuple(relevant), len(wanted), found, tuple(others.most_common()))


def _same(hit: Interval, segment: Manual) -> bool:
    if hit.take != segment.take:
        return False
    both = min(hit.stop, segment.stop) - max(hit.start, segment.start)
    return 2 * both >= min(hit.frames, segment.stop - segment.start)


def clip_costs(templates: Mapping[str, QuantisedTemplate], clips: TakeWords) -> dict[str, np.ndarray]:
    """Return the smallest distance of each template in each clip, float64 (C,).

    The distance is ∞ for clips that are too short for a template, and for clips that lack too many of its features.
    """
    least = np.full((len(templates), len(clips)), np.inf)
    for mask in clips.masks:
        places, own = clips.knowing(mask)
        restricted = [restricted_template(one, mask) for one in templates.values()]
        rows = np.flatnonzero([one is not None for one in restricted])
        filled = np.flatnonzero(own.frames > 0)
        if not len(rows) or not len(filled):
            continue
        ranges = np.stack([own.offsets[:-1], own.offsets[1:]], axis=1)
        curves = distance_curves([one for one in restricted if one is not None], own.words, ranges)
        least[np.ix_(rows, places[filled])] = np.minimum.reduceat(curves, own.offsets[:-1][filled], axis=1)
    return dict(zip(templates, least, strict=True))


def evaluate_clips(
    fold: str, label: str, costs: np.ndarray, labels: Sequence[str], names: Sequence[str], tau: float
) -> EvaluatedRanking:
    """Evaluate the clips of a fold, ranked by smallest distance; clips of equal distance are ordered by name."""
    keys = [round(cost * KEYS) if math.isfinite(cost) else math.inf for cost in costs.tolist()]
    order = sorted(range(len(names)), key=lambda i: (keys[i], names[i]))
    relevant = tuple(labels[i] == label for i in order)
    total = sum(relevant)
    last = max((place for place, right in enumerate(relevant) if right), default=-1)
    confused = Counter(labels[i] for i in order[:last] if labels[i] != label)
    found = sum(1 for i in order if labels[i] == label and costs[i] < tau)
    return EvaluatedRanking("clips", fold, label, relevant, total, found, tuple(confused.most_common()))


def mean_average_precision(judged: Sequence[EvaluatedRanking]) -> float:
    """Return the average precision, averaged over folds and then over classes; NaN if there was nothing to find."""
    by_label: dict[str, list[float]] = {}
    for one in judged:
        if one.total:
            by_label.setdefault(one.label, []).append(one.average_precision)
    return float(np.mean([np.mean(values) for values in by_label.values()])) if by_label else math.nan


def recall_at_tau(judged: Sequence[EvaluatedRanking]) -> float:
    """Return the fraction of all segments or clips to find that were found below τ."""
    total = sum(one.total for one in judged)
    return sum(one.found for one in judged) / total if total else math.nan


def retrieval_rows(judged: Sequence[EvaluatedRanking], run: str) -> pa.Table:
    """Return evaluated rankings as results of the kind `retrieval`."""
    rows = [
        {
            "run": run,
            "evaluation": one.evaluation,
            "fold": one.fold,
            "class": one.label,
            "relevant": one.total,
            "found": one.found,
            "average_precision": None if math.isnan(one.average_precision) else one.average_precision,
            "recall_at_tau": None if math.isnan(one.recall) else one.recall,
            "confused_with": [f"{label} {count}" for label, count in one.confused],
        }
        for one in judged
    ]
    return pa.Table.from_pylist(rows, schema=result_schema("retrieval"))


def retrieval_table(judged: Sequence[EvaluatedRanking], title: str, tau: float) -> ResultTable:
    """Return a table of evaluated rankings, folds pooled by class: average precision, recall at τ, and confusions."""
    columns = ("class", "to find", "AP", f"recall at {tau:g}", "above the last right one")
    table = ResultTable(columns, texts=frozenset({0, 4}), title=title)
    for label in sorted({one.label for one in judged}):
        own = [one for one in judged if one.label == label]
        confused: Counter[str] = Counter()
        for one in own:
            confused.update(dict(one.confused))
        shown = ", ".join(f"{name} {count}" for name, count in confused.most_common(3))
        total = sum(one.total for one in own)
        numbers = (str(total), _number(mean_average_precision(own)), _number(recall_at_tau(own)))
        table.add(label, *numbers, shown)
    every = str(sum(one.total for one in judged))
    means = (_number(mean_average_precision(judged)), _number(recall_at_tau(judged)))
    table.add("mean", every, *means, "", section=True)
    return table


def _number(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.3f}"


@dataclass(frozen=True)
class Trial:
    """The ranking of one class with one variant of its queries.

    Attributes
    ----------
    variant : str
        `EVERYWHERE` (no preselection), `WRITTEN`, or a stiffness as text.
    stiffness : float, optional
        The stiffness of all gaps.
    judged : EvaluatedRanking
        The evaluation of the ranking.
    kept : float
        The fraction of frames that was ranked.
    """

    variant: str
    stiffness: float | None
    judged: EvaluatedRanking
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
                judged = evaluate_hits(ranking.name, ranking.hits, truth, tau)
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
