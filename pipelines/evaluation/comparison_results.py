"""The results of a comparison of methods: splits, the scores of each method, and their form as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from kinedex.ops.evaluation.metrics import Counts, pooled
from kinedex.ops.intervals import TakeSegment, in_seconds
from kinedex.pipelines.evaluation.annotation_scores import Row, defined, scores
from kinedex.pipelines.evaluation.comparison_parameters import Method, Metric, Split
from kinedex.pipelines.evaluation.folds import WHOLE, Fold, TestTake
from kinedex.pipelines.evaluation.method_scores import MethodScores, Outcome, SegmentOutcome, chosen_takes


@dataclass(frozen=True)
class Threshold:
    """A point of the sweep over τ (thesis, Figure 5.6): the method's name without τ, τ, and the counts."""

    curve: str
    tau: float
    counts: Counts


@dataclass(frozen=True)
class SplitResult:
    """One split: its folds, the scores of each method, the sweep, and the outcomes of manual segments."""

    split: Split
    folds: tuple[Fold, ...]
    outcomes: dict[str, Outcome]
    judgements: dict[str, MethodScores]
    sweep: tuple[Threshold, ...]
    segment_outcomes: tuple[SegmentOutcome, ...]
    notes: tuple[str, ...] = ()

    @property
    def test_takes(self) -> tuple[TestTake, ...]:
        """The takes of all folds."""
        return tuple(test_take for fold in self.folds for test_take in fold.test_takes)

    @property
    def remarks(self) -> list[str]:
        """The distinct remarks on the split and its folds."""
        return list(dict.fromkeys([*self.notes, *(remark for fold in self.folds for remark in fold.remarks)]))

    @property
    def missed(self) -> list[SegmentOutcome]:
        """The manual segments that no method has found."""
        return [one for one in self.segment_outcomes if one.missed]

    @property
    def leading(self) -> str:
        """The method with the highest F (frames), the first of equal ones."""
        return max(self.judgements, key=lambda name: np.nan_to_num(self.judgements[name].pooled.f1, nan=-1.0))

    def shown(self) -> dict[str, str]:
        """Return the takes whose timelines are shown: the best, median and worst take of the leading method."""
        return chosen_takes(self.judgements[self.leading].by_take)


@dataclass(frozen=True)
class Study:
    """A comparison of methods.

    Attributes
    ----------
    group : str
        The column of takes that results are divided by.
    splits : tuple of SplitResult
        The splits, with the scores of every method.
    remarks : tuple of str
        Remarks on methods that apply to all splits.
    class_of : dict of str to str
        The class of each subclass.
    """

    title: str
    pipeline: str
    run: str
    created: str
    store: str
    archive: str
    rate_hz: float
    classes: tuple[str, ...]
    descriptions: dict[str, str]
    group: str
    metrics: tuple[Metric, ...]
    methods: tuple[Method, ...]
    splits: tuple[SplitResult, ...]
    remarks: tuple[str, ...] = ()
    class_of: dict[str, str] = field(default_factory=dict)


def boundary_summary(
    judgement: MethodScores, rate_hz: float, *, joined: bool = False
) -> dict[str, dict[str, float | int | None]]:
    """Summarise boundary errors in seconds, at start and stop.

    Parameters
    ----------
    judgement : MethodScores
        The scores of a method.
    rate_hz : float
        The analysis rate, in frames per second.
    joined : bool
        True to use the segments that result from joining touching segments of a class.

    Returns
    -------
    dict of str to dict
        For "start" and "stop": `segments`, the number of segments; `median`, the median error, which is positive for
        late boundaries; `median_size`, the median of absolute errors; `size_of_nine_tenths`, their 90 % quantile.
    """
    summary: dict[str, dict[str, float | int | None]] = {}
    frames = judgement.joined_boundaries if joined else judgement.boundaries
    for column, end in enumerate(("start", "stop")):
        errors = in_seconds(frames[:, column], rate_hz)
        sizes = np.abs(errors)
        summary[end] = {
            "segments": len(errors),
            "median": float(np.median(errors)) if len(errors) else None,
            "median_size": float(np.median(sizes)) if len(errors) else None,
            "size_of_nine_tenths": float(np.quantile(sizes, 0.9)) if len(errors) else None,
        }
    return summary


def study_json(study: Study) -> dict[str, object]:
    """Return a study as JSON values; segments are included only for takes with a timeline."""
    return {
        "format": "kinedex evaluation 1",
        "title": study.title,
        "pipeline": study.pipeline,
        "run": study.run,
        "created": study.created,
        "rate_hz": study.rate_hz,
        "classes": list(study.classes),
        "divided_by": study.group,
        "metrics": list(study.metrics),
        "methods": [one.model_dump(mode="json") for one in study.methods],
        "remarks": list(study.remarks),
        "splits": [_split(one, study) for one in study.splits],
    }


def _split(result: SplitResult, study: Study) -> dict[str, object]:
    shown = result.shown()
    test_takes = {test_take.name: test_take for test_take in result.test_takes}
    return {
        "name": result.split.name,
        "split": result.split.model_dump(mode="json"),
        "remarks": result.remarks,
        "folds": [
            {
                "name": fold.name,
                "clips": sum(len(one.names) for one in fold.clips),
                "takes": [e.name for e in fold.test_takes],
            }
            for fold in result.folds
        ],
        "methods": {name: _judgement(one, study) for name, one in result.judgements.items()},
        "sweep": [{"method": one.curve, "tau": one.tau, **scores(one.counts)} for one in result.sweep],
        "never_found": len(result.missed),
        "segments": [asdict(one) for one in result.segment_outcomes],
        "shown": {
            what: {
                "take": name,
                "frames": test_takes[name].frames,
                "manual": [[one.label, one.start, one.stop] for one in test_takes[name].truth],
                "automatic": {method: list(map(_segment, found[name])) for method, found in result.outcomes.items()},
            }
            for what, name in shown.items()
        },
    }


def _segment(one: TakeSegment) -> dict[str, object]:
    return {"label": one.label, "start": one.start, "stop": one.stop, "sure": one.confidence}


def _judgement(one: MethodScores, study: Study) -> dict[str, object]:
    result: dict[str, object] = {
        "pooled": scores(one.pooled),
        "intervals": {name: [defined(low), defined(high)] for name, (low, high) in one.intervals.items()},
        "groups": {name: scores(counts) for name, counts in one.by_group.items()},
        "classes": {name: scores(counts) for name, counts in one.by_class.items()},
        "takes": {name: scores(counts) for name, counts in one.by_take.items()},
        "confusion": {
            "rows": list(one.confusion.rows),
            "columns": list(one.confusion.columns),
            "frames": one.confusion.frames.round(3).tolist(),
        },
    }
    if "overlap" in study.metrics:
        result["map"] = {f"{threshold:g}": defined(value) for threshold, value in one.precision.items()}
        result["average_precision"] = {
            label: {f"{threshold:g}": defined(value) for threshold, value in values.items()}
            for label, values in one.class_precision.items()
        }
    if "boundaries" in study.metrics:
        result["boundaries"] = boundary_summary(one, study.rate_hz)
    if "joined" in study.metrics:
        result["joined"] = {
            "map": {f"{threshold:g}": defined(value) for threshold, value in one.joined_precision.items()},
            "boundaries": boundary_summary(one, study.rate_hz, joined=True),
        }
    return result


def evaluation_rows(judged: MethodScores, folds: Sequence[Fold]) -> tuple[Row, ...]:
    """Return scores as rows of an evaluation; a group holds the takes with the same value of `divide_by`."""
    by_fold = {fold.name: pooled(judged.by_take[test_take.name] for test_take in fold.test_takes) for fold in folds}
    return (
        Row("pooled", "all", judged.pooled),
        *(Row("fold", name, counts) for name, counts in by_fold.items() if name != WHOLE),
        *(Row("group", name, counts) for name, counts in judged.by_group.items()),
        *(Row("class", name, counts) for name, counts in judged.by_class.items()),
        *(Row("take", name, counts) for name, counts in judged.by_take.items()),
    )
