"""Compute precision, recall and F of limb errors against manual labels, by threshold, limb, group and annotator."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from kinedex.catalog.limbs import LIMBS
from kinedex.catalog.published_results import PublishedResults
from kinedex.ops.arrays import I64
from kinedex.ops.evaluation.metrics import Counts, compare
from kinedex.ops.evaluation.threshold_counts import threshold_counts
from kinedex.pipelines.inertial.limb_error_curves import JudgedLimb
from kinedex.pipelines.inertial.limb_labels import PlacedLabel

SENSORS, RUNS, ALL = "sensors", "runs", "all"
"""The detectors (errors above each threshold, and stored runs), and the name of rows that pool everything."""

Scope = tuple[str, str]
"""Scope and name of a row: ("all", "all"), ("group", "legs") or ("limb", "lshank")."""

Pair = tuple[str, str]
"""A detector and an annotator."""


@dataclass
class LimbCounts:
    """Counts that are accumulated over takes.

    Attributes
    ----------
    taus : sequence of float
        The thresholds in degrees.
    above : dict
        Scope and annotator → the counts at each threshold.
    between : dict
        Scope, detector and annotator → the counts of stored runs, or of another annotator's labels, against the labels
        of the annotator.
    frames, takes : dict
        Scope, detector and annotator → the number of evaluated frames of limbs, and the ids of takes.
    """

    taus: Sequence[float]
    above: dict[tuple[Scope, str], list[Counts]] = field(default_factory=dict)
    between: dict[tuple[Scope, Pair], Counts] = field(default_factory=lambda: defaultdict(Counts))
    frames: dict[tuple[Scope, Pair], int] = field(default_factory=lambda: defaultdict(int))
    takes: dict[tuple[Scope, Pair], set[int]] = field(default_factory=lambda: defaultdict(set))

    def add(
        self,
        limb: JudgedLimb,
        annotators: Iterable[str],
        labels: Iterable[PlacedLabel],
        runs: Sequence[tuple[int, int]],
    ) -> None:
        """Count a limb of a take against every annotator who has examined the take.

        Frames that are not valid are first removed from detections and labels alike.

        Parameters
        ----------
        limb : JudgedLimb
            The limb with its errors.
        annotators : iterable of str
            The annotators who have examined the take.
        labels : iterable of PlacedLabel
            Their labels of this limb.
        runs : sequence of (int, int)
            The stored runs of wrong frames.
        """
        counted = limb.valid & np.isfinite(limb.error)
        place = np.concatenate([[0], np.cumsum(counted)])
        values = limb.error[counted]
        own = {annotator: list[tuple[int, int]]() for annotator in annotators}
        for label in labels:
            own[label.annotator].append((label.start, label.stop))
        manual = {annotator: _without_gaps(segments, place) for annotator, segments in own.items()}
        stored = _without_gaps(runs, place)
        for annotator, segments in manual.items():
            above = threshold_counts(values, segments, self.taus)
            against_runs = compare(stored, segments)
            for whose in (annotator, ALL):
                for scope in _scopes(limb.limb):
                    before = self.above.get((scope, whose), [Counts()] * len(above))
                    self.above[scope, whose] = [a + b for a, b in zip(before, above, strict=True)]
                    self._add_frames(scope, (SENSORS, whose), len(values), limb.take_id)
                self._add_between(limb, (RUNS, whose), against_runs, len(values))
            for other, theirs in manual.items():
                if other != annotator:
                    self._add_between(limb, (other, annotator), compare(theirs, segments), len(values))

    def _add_between(self, limb: JudgedLimb, pair: Pair, counts: Counts, frames: int) -> None:
        for scope in _scopes(limb.limb):
            self.between[scope, pair] += counts
            self._add_frames(scope, pair, frames, limb.take_id)

    def _add_frames(self, scope: Scope, pair: Pair, frames: int, take_id: int) -> None:
        self.frames[scope, pair] += frames
        self.takes[scope, pair].add(take_id)


def _scopes(limb: str) -> tuple[Scope, Scope, Scope]:
    return (ALL, ALL), ("group", LIMBS[limb].group), ("limb", limb)


def _without_gaps(segments: Sequence[tuple[int, int]], place: I64) -> I64:
    """Return segments with frames renumbered over the valid frames; segments without a valid frame are dropped."""
    found = place[np.asarray(segments, np.int64).reshape(-1, 2)]
    return found[found[:, 0] < found[:, 1]]


def metric_rows(counts: LimbCounts, printed: PublishedResults | None) -> Iterator[dict[str, Any]]:
    """Yield the rows of `limb_error_metrics`, for all limbs, groups and single limbs, by detector and annotator.

    Parameters
    ----------
    counts : LimbCounts
        The counts of all takes.
    printed : PublishedResults or None
        Published results for comparison.
    """
    for (scope, annotator), several in sorted(counts.above.items()):
        for tau, one in zip(counts.taus, several, strict=True):
            known = None if printed is None else printed.score(scope[1], annotator, tau)
            beside = {} if known is None or printed is None else {
                "printed_p1": known.p1, "printed_r1": known.r1, "printed_source": printed.source,
            }  # fmt: skip
            yield {**_row(counts, scope, (SENSORS, annotator), one), "tau_deg": tau, **beside}
    for (scope, pair), one in sorted(counts.between.items()):
        yield _row(counts, scope, pair, one)


def _row(counts: LimbCounts, scope: Scope, pair: Pair, one: Counts) -> dict[str, Any]:
    measures = {name: getattr(one, name) for name in ("p1", "r1", "f1", "p2", "r2", "f2")}
    return {
        "scope": scope[0],
        "name": scope[1],
        "detector": pair[0],
        "annotator": pair[1],
        **{name: None if math.isnan(value) else value for name, value in measures.items()},
        **asdict(one),
        "frames": counts.frames[scope, pair],
        "takes": len(counts.takes[scope, pair]),
    }


def runs_by_limb(rows: Iterable[Mapping[str, Any]]) -> dict[tuple[int, str], list[tuple[int, int]]]:
    """Return the frame ranges of the stored runs of wrong frames, by take_id and limb."""
    found: dict[tuple[int, str], list[tuple[int, int]]] = {}
    for row in rows:
        if row["kind"] == "distance":
            found.setdefault((row["take_id"], row["limb"]), []).append((row["start"], row["stop"]))
    return found
