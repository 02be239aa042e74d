"""Render the page about takes and inertial sensors: errors, runs, agreement, calibration and motions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.wording import counted
from kinedex.pipelines.inertial.worn_sensors import WornTakes, stored_clocks
from kinedex.reports.embedded_motions import EmbeddedMotions, embed, script_json
from kinedex.reports.limb_error_data import (
    MAX_BYTES,
    LimbErrors,
    MarkedRun,
    StageKeys,
    StoredErrors,
    TakeErrors,
    packed_triads,
    refusals,
)
from kinedex.reports.limb_error_diagrams import (
    BINS,
    CHART_HEIGHT,
    CHART_WIDTH,
    AgreementChart,
    Box,
    DriftCurve,
    agreement_chart,
    box,
    curve_path,
    drift_curve,
    error_top,
    mapping_curves,
)
from kinedex.reports.page_environment import page_environment
from kinedex.reports.plots import Axis, time_axis
from kinedex.storage.store.store import Store


@dataclass(frozen=True)
class AgreementCard:
    """Precision, recall and F of some limbs against one annotator.

    Attributes
    ----------
    name : str
        The name of a limb or of a group, or "all".
    against : str
        The annotator.
    found_by : str
        The detector that is compared with the annotator: frames above τ, the runs of the page, or another annotator.
    chart : AgreementChart or None
        The plot over τ; None for limbs that are only in the table, and if two annotators are compared.
    at : dict
        The row of `limb_error_metrics` whose τ is nearest to that of the page.
    """

    name: str
    against: str
    found_by: str
    chart: AgreementChart | None
    at: Mapping[str, Any]

    @property
    def key(self) -> tuple[str, str, str]:
        """The scope, the name of the limb or group, and the annotator."""
        return self.at["scope"], self.at["name"], self.at["annotator"]


@dataclass(frozen=True)
class ShownLimb:
    """A limb of a take on the page: the path of its errors, the boxes of its timeline, and statistics in degrees."""

    errors: LimbErrors
    path: str
    automatic: tuple[Box, ...]
    manual: Mapping[str, tuple[Box, ...]]
    median: float
    p95: float
    largest: float
    swing: float
    twist: float


@dataclass(frozen=True)
class ShownTake:
    """A take on the page.

    `mounts` has rows of `sensor_calibration`, each with the curve of the drift of the heading; `playable` is True if
    the motion is embedded.
    """

    errors: TakeErrors
    shown: tuple[ShownLimb, ...]
    mounts: tuple[tuple[Mapping[str, Any], DriftCurve | None], ...]
    axis: Axis
    playable: bool


SIMULATED = "simulated"
"""The word in the names of annotators that marks labels as simulated."""


def limb_errors_page(store: Store, keys: StageKeys, title: str, most: int, *, demonstration: bool = False) -> str:
    """Return the HTML of the page.

    Parameters
    ----------
    store : Store
        The store.
    keys : StageKeys
        The stages whose results the page shows.
    title : str
        The title.
    most : int
        Largest number of takes that are shown: those with the largest fraction of wrong frames.
    demonstration : bool
        If True, show how a wrong mapping between sensor and limb hides errors (thesis, Figure 7.14).
    """
    stored = StoredErrors(store, keys)
    wrong = {take_id: stored.take(take_id).wrong for take_id in stored.take_ids}
    order = sorted(wrong, key=lambda take_id: (-wrong[take_id], take_id))[:most]
    takes = [stored.take(take_id) for take_id in order]
    taus = sorted({stored.tau_of(take_id) for take_id in stored.take_ids})
    tau = taus[0] if len(taus) == 1 else None
    triads, without = _triads(store, keys, takes)
    motions = embed(store, [take.take for take in takes], "auto", "report_limb_errors")
    agreement = agreement_cards(stored.metrics, float(np.median(taus)) if taus else 45.0)
    limbs = [limb for take in takes for limb in take.limbs]
    largest = max((float(limb.known.max()) for limb in limbs if len(limb.known)), default=0.0)
    top = error_top(largest, max((limb.tau_deg for limb in limbs), default=45.0))
    return (
        page_environment({"counted": counted})
        .get_template("limb_errors.html.j2")
        .render(
            title=title, total=len(wrong), tau=tau, top=top, bins=BINS, scripts=True,
            takes=[_shown(take, motions, store.rate_hz, top) for take in takes],
            refusals=refusals(stored.clocks, stored.calibrations, stored.log),
            agreement=agreement, printed=any(card.at.get("printed_source") for card in agreement),
            simulated=any(SIMULATED in card.against for card in agreement),
            runs=any(card.at["detector"] == RUNS for card in agreement),
            width=CHART_WIDTH, height=CHART_HEIGHT, mappings=mapping_curves() if demonstration else (),
            motions=motions, motions_json=script_json({**asdict(motions), "triads": triads}), without_axes=without,
        )
    )  # fmt: skip


def _triads(store: Store, keys: StageKeys, takes: Sequence[TakeErrors]) -> tuple[list[dict[str, Any]], int]:
    """Return the packed axes of the first takes that fit into the page, and the number of takes that do not fit."""
    worn = WornTakes(store, keys.limbs, keys.sensors)
    clocks = stored_clocks(store, keys.clocks)
    found: list[dict[str, Any]] = []
    room, without = MAX_BYTES, 0
    for take in takes:
        packed = packed_triads(worn.take(take.take_id), clocks, take.calibrations, take.frames, store.rate_hz)
        if packed is None:
            continue
        room -= len(packed["data"])
        if room < 0:
            without += 1
            continue
        found.append(packed)
    return found, without


def agreement_cards(rows: Sequence[Mapping[str, Any]], tau: float) -> list[AgreementCard]:
    """Return the agreement with annotators: plots for all limbs and for groups, and a table row for each limb.

    Parameters
    ----------
    rows : sequence of dict
        Rows of `limb_error_metrics`.
    tau : float
        The τ of the page in degrees.
    """
    groups: dict[tuple[str, str, str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["scope"], row["name"], row["detector"], row["annotator"]), []).append(row)
    names = {row["annotator"] for row in rows} - {"all"}
    everybody = (
        f"all {SIMULATED} annotators" if names and all(SIMULATED in name for name in names) else "all annotators"
    )
    cards: list[AgreementCard] = []
    for (scope, name, detector, annotator), own in groups.items():
        over = sorted((row for row in own if row["tau_deg"] is not None), key=lambda row: row["tau_deg"])
        at = min(over, key=lambda row: abs(row["tau_deg"] - tau)) if over else own[0]
        judges = next((card.at for card in cards if card.key == (scope, name, annotator)), None)
        if not at["frames_manual"] or (scope == "limb" and annotator != "all") or _alike(at, judges):
            continue
        chart = None
        if scope != "limb" and len(over) > 1:
            values = [(_number(row["p1"]), _number(row["r1"]), _number(row["f1"])) for row in over]
            chart = agreement_chart([row["tau_deg"] for row in over], values, tau)
        against = everybody if annotator == "all" else annotator
        found_by = {SENSORS: "frames above τ", RUNS: "runs of this page"}.get(detector, detector)
        cards.append(AgreementCard("all limbs" if scope == "all" else name, against, found_by, chart, at))
    return sorted(cards, key=_place)


def _place(card: AgreementCard) -> tuple[int, str, int]:
    """Return the sort key of a card: scope, name, then detector (frames above τ, runs, annotators)."""
    detectors = (SENSORS, RUNS)
    detector = card.at["detector"]
    rank = detectors.index(detector) if detector in detectors else len(detectors)
    return _SCOPES.index(card.at["scope"]), card.at["name"], rank


SENSORS, RUNS = "sensors", "runs"
"""The detectors of `limb_error_metrics` that are not annotators: frames above a threshold τ, and detected runs."""

_SCOPES = ("all", "group", "limb")


def _alike(row: Mapping[str, Any], other: Mapping[str, Any] | None) -> bool:
    """Return whether the measures of runs equal those of the frames above τ, so that one row can show both."""
    names = ("p1", "r1", "p2", "r2")
    return row["detector"] == RUNS and other is not None and all(row[name] == other[name] for name in names)


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _shown(take: TakeErrors, motions: EmbeddedMotions, rate_hz: float, top: float) -> ShownTake:
    seconds = max(take.seconds, 1e-6)
    mounts = tuple(
        (row, drift_curve([(one["t"], one["degrees"]) for one in row["drift"] or ()], seconds))
        for row in take.calibrations
    )
    limbs = []
    for limb in take.limbs:
        known = limb.known
        nan = (math.nan, math.nan, math.nan)
        numbers = (float(np.median(known)), float(np.percentile(known, 95)), float(known.max())) if len(known) else nan
        limbs.append(
            ShownLimb(
                limb, curve_path(limb.times, limb.degrees, seconds, top),
                _boxes(limb.automatic, take.frames, rate_hz),
                {who: _boxes(own, take.frames, rate_hz) for who, own in limb.manual.items()},
                *numbers, _median(limb.swing), _median(limb.twist),
            )
        )  # fmt: skip
    return ShownTake(take, tuple(limbs), mounts, time_axis(seconds), motions.has(take.take, 0, take.frames))


def _median(values: F64) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else math.nan


def _boxes(runs: Sequence[MarkedRun], frames: int, rate_hz: float) -> tuple[Box, ...]:
    return tuple(box(one.start_s, one.stop_s, frames, rate_hz, _text(one), jump=one.jump) for one in runs)


def _text(run: MarkedRun) -> str:
    text = f"{run.start_s:.2f} to {run.stop_s:.2f} s"
    if run.jump:
        return f"{text}: the take's limb jumps, its frames are in no count"
    if run.peak_deg is None or run.mean_deg is None:
        return text
    return f"{text}: {run.peak_deg:.0f}° at most, {run.mean_deg:.0f}° on average"
