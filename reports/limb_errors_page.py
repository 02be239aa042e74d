"""The page about takes and inertial sensors: curves of errors, boxes of runs, agreement, calibration, motions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.ops.wording import counted
from kinedex.pipelines.inertial.worn_sensors import WornTakes, stored_clocks
from kinedex.reports.axes import Axis, time_axis
from kinedex.reports.limb_error_data import (
    LimbErrors,
    MarkedRun,
    Refusal,
    StageKeys,
    StoredErrors,
    TakeErrors,
    refusals,
)
from kinedex.reports.limb_error_figures import (
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
)
from kinedex.reports.limb_triads import MOST_BYTES, packed_triads
from kinedex.reports.mapping_demonstration import MappingCurve, mapping_curves
from kinedex.reports.motions import Motions, embed, script_json
from kinedex.reports.page_environment import page_environment
from kinedex.storage.store.store import Store

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True)
class AgreementCard:
    """Precision, recall and F of some limbs against one annotator.

    Attributes
    ----------
    name : str
        The limbs: a limb, a group, or all.
    against : str
        The annotator.
    found_by : str
        What is compared with the annotator: frames above τ, the runs of the page, or another annotator.
    chart : AgreementChart or None
        The plot over τ; None for limbs that are in the table only, and where two annotators are compared.
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
    """A limb of a take on the page; `automatic` and `manual` are boxes of its timeline."""

    limb: str
    basis: str
    tau: float
    path: str
    automatic: tuple[Box, ...]
    manual: Mapping[str, tuple[Box, ...]]
    frames: int
    runs: int
    wrong: float
    median: float
    p95: float
    largest: float
    swing: float
    twist: float


@dataclass(frozen=True)
class ShownMount:
    """A row of `sensor_calibration` with the curve of its heading's drift."""

    row: Mapping[str, Any]
    drift: DriftCurve | None


@dataclass(frozen=True)
class ShownTake:
    """A take on the page; `playable` is true where its motion is embedded."""

    take: str
    frames: int
    seconds: float
    wrong: float
    worst: LimbErrors | None
    limbs: tuple[LimbErrors, ...]
    shown: tuple[ShownLimb, ...]
    clocks: tuple[Mapping[str, Any], ...]
    mounts: tuple[ShownMount, ...]
    axis: Axis
    playable: bool


@dataclass(frozen=True)
class PageContent:
    """The content of the page.

    Attributes
    ----------
    title : str
        The title.
    total : int
        Takes that were compared; those in `takes` may be fewer.
    takes : sequence of TakeErrors
        The takes of the page, in their order.
    rate_hz : float
        Analysis frames per second.
    tau : float or None
        The τ of all takes; None where they differ.
    motions : Motions
        The motions of the takes.
    triads : list of dict
        Packed axes of limbs for the player.
    without_axes : int
        Number of takes whose axes were omitted, because the page would become too large.
    agreement : sequence of AgreementCard
        The agreement with annotators.
    left_out : sequence of Refusal
        The takes, recordings and sensors that were excluded.
    mappings : sequence of MappingCurve
        The demonstration of the thesis's Figure 7.14; empty where the page does not have it.
    """

    title: str
    total: int
    takes: Sequence[TakeErrors]
    rate_hz: float
    tau: float | None
    motions: Motions
    triads: Sequence[Mapping[str, Any]] = ()
    without_axes: int = 0
    agreement: Sequence[AgreementCard] = ()
    left_out: Sequence[Refusal] = field(default=())
    mappings: Sequence[MappingCurve] = ()


SIMULATED = "simulated"
"""The word in the names of annotators that marks labels as simulated."""


def limb_errors_page(store: Store, keys: StageKeys, title: str, most: int, *, demonstration: bool = False) -> str:
    """Return the HTML of the page.

    Parameters
    ----------
    store : Store
        The store.
    keys : StageKeys
        The stages whose results it shows.
    title : str
        The title.
    most : int
        Most takes that are shown: those of whose frames the largest fraction is wrong.
    demonstration : bool
        Show how a wrong mapping between sensor and limb hides errors (thesis, Figure 7.14).
    """
    stored = StoredErrors(store, keys)
    wrong = {take_id: stored.take(take_id).wrong for take_id in stored.take_ids}
    order = sorted(wrong, key=lambda take_id: (-wrong[take_id], take_id))[:most]
    takes = [stored.take(take_id) for take_id in order]
    taus = sorted({stored.tau_of(take_id) for take_id in stored.take_ids})
    triads, without = _triads(store, keys, takes)
    return rendered(
        PageContent(
            title, len(wrong), takes, store.rate_hz, taus[0] if len(taus) == 1 else None,
            embed(store, [take.take for take in takes], "auto", "report_limb_errors"), triads, without,
            agreement_cards(stored.metrics, float(np.median(taus)) if taus else 45.0),
            refusals(stored.clocks, stored.calibrations, stored.log),
            mapping_curves() if demonstration else (),
        )
    )  # fmt: skip


def _triads(store: Store, keys: StageKeys, takes: Sequence[TakeErrors]) -> tuple[list[dict[str, Any]], int]:
    """Return the packed axes of the first takes that fit into the page, and the number of takes that do not fit."""
    worn = WornTakes(store, keys.limbs, keys.sensors)
    clocks = stored_clocks(store, keys.clocks)
    found: list[dict[str, Any]] = []
    room, without = MOST_BYTES, 0
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
    """Return the agreement with annotators: plots of all limbs and of groups, and rows of a table for each limb.

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
"""The detectors of `limb_error_metrics` that are not annotators: frames above a τ, and the runs that were found."""

_SCOPES = ("all", "group", "limb")


def _alike(row: Mapping[str, Any], other: Mapping[str, Any] | None) -> bool:
    """Return whether the measures of runs equal those of the frames above τ, so that they need no row of their own."""
    names = ("p1", "r1", "p2", "r2")
    return row["detector"] == RUNS and other is not None and all(row[name] == other[name] for name in names)


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def rendered(content: PageContent) -> str:
    """Return the HTML of the page."""
    limbs = [limb for take in content.takes for limb in take.limbs]
    largest = max((float(limb.known.max()) for limb in limbs if len(limb.known)), default=0.0)
    top = error_top(largest, max((limb.tau_deg for limb in limbs), default=45.0))
    motions = {**asdict(content.motions), "triads": list(content.triads)}
    return (
        page_environment({"counted": counted})
        .get_template("limb_errors.html.j2")
        .render(
            title=content.title, total=content.total, tau=content.tau, top=top, bins=BINS, scripts=True,
            takes=[_shown(take, content, top) for take in content.takes], refusals=content.left_out,
            agreement=content.agreement, printed=any(card.at.get("printed_source") for card in content.agreement),
            simulated=any(SIMULATED in card.against for card in content.agreement),
            runs=any(card.at["detector"] == RUNS for card in content.agreement),
            width=CHART_WIDTH, height=CHART_HEIGHT, mappings=content.mappings,
            motions=content.motions, motions_json=script_json(motions), without_axes=content.without_axes,
        )
    )  # fmt: skip


def _shown(take: TakeErrors, content: PageContent, top: float) -> ShownTake:
    return ShownTake(
        take.take, take.frames, take.seconds, take.wrong, take.worst, take.limbs,
        tuple(_limb(limb, take, content.rate_hz, top) for limb in take.limbs),
        take.clocks,
        tuple(ShownMount(row, _drift(row, take.seconds)) for row in take.calibrations),
        time_axis(max(take.seconds, 1e-6)), content.motions.has(take.take, 0, take.frames),
    )  # fmt: skip


def _drift(row: Mapping[str, Any], seconds: float) -> DriftCurve | None:
    return drift_curve([(one["t"], one["degrees"]) for one in row["drift"] or ()], max(seconds, 1e-6))


def _limb(limb: LimbErrors, take: TakeErrors, rate_hz: float, top: float) -> ShownLimb:
    known = limb.known
    figures = (float(np.median(known)), float(np.percentile(known, 95)), float(known.max())) if len(known) else _NAN
    return ShownLimb(
        limb.limb, limb.basis, limb.tau_deg,
        curve_path(limb.times, limb.degrees, max(take.seconds, 1e-6), top),
        _boxes(limb.automatic, take.frames, rate_hz),
        {who: _boxes(own, take.frames, rate_hz) for who, own in limb.manual.items()},
        len(known), sum(not one.jump for one in limb.automatic), limb.wrong, *figures,
        _median(limb.swing), _median(limb.twist),
    )  # fmt: skip


_NAN = (math.nan, math.nan, math.nan)


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
