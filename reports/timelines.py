"""The geometry of timelines: one lane per class, automatic segments above manual ones (thesis, Fig. 5.2)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from kinedex.ops.intervals import TakeSegment, shown_seconds
from kinedex.ops.wording import counted
from kinedex.reports.axes import Axis, percent, time_axis
from kinedex.reports.data import Score, TakeRow


@dataclass(frozen=True)
class Bar:
    """One segment: its place in percent, whether annotation and ground truth agree, its tooltip, and its frames.

    `agrees` is None where the take has no ground truth. `near` is the place of its nearest example in the page's list.
    """

    left: float
    width: float
    agrees: bool | None
    tip: str
    start: int = 0
    stop: int = 0
    confidence: float | None = None
    near: int | None = None


@dataclass(frozen=True)
class Lane:
    """The segments of one class in one take."""

    label: str
    slot: int
    automatic: tuple[Bar, ...]
    manual: tuple[Bar, ...]
    description: str


@dataclass(frozen=True)
class Timeline:
    """The lanes and the time axis of one take."""

    take: TakeRow
    score: Score | None
    lanes: tuple[Lane, ...]
    axis: Axis
    judged: bool


def timeline(
    take: TakeRow,
    automatic: Sequence[TakeSegment],
    manual: Sequence[TakeSegment],
    slots: Mapping[str, int],
    score: Score | None = None,
    near: Mapping[tuple[str, str, int, int], int] | None = None,
) -> Timeline:
    """Lay out one take.

    Two segments agree as in the measure of segments (thesis, 5.4): they have the same class and a common frame.

    Parameters
    ----------
    take : TakeRow
        The take; every segment must lie in it.
    automatic, manual : sequence of TakeSegment
        Its segments.
    slots : mapping of str to int
        Colour of each class; its order is the order of the lanes.
    score : Score or None
        Row of the take in the evaluation.
    near : mapping of (take, class, start, stop) to int
        Place of the nearest example of a segment in the page's list.

    Returns
    -------
    Timeline
        The lanes of the classes that occur in the take.
    """
    judged = bool(manual) or score is not None  # ground truth may be empty
    occurring = {segment.label for segment in (*automatic, *manual)}
    lanes = []
    for label in (label for label in slots if label in occurring):
        ours = [segment for segment in automatic if segment.label == label]
        theirs = [segment for segment in manual if segment.label == label]
        lanes.append(
            Lane(
                label=label,
                slot=slots[label],
                automatic=tuple(bar(s, take, "automatic", theirs if judged else None, near) for s in ours),
                manual=tuple(bar(s, take, "manual", ours) for s in theirs),
                description=f"{label}: {counted(len(ours), 'automatic segment')}"
                + (f", {counted(len(theirs), 'manual segment')}" if judged else ""),
            )
        )
    return Timeline(take, score, tuple(lanes), time_axis(max(take.seconds, 1e-6)), judged)


def bar(
    segment: TakeSegment,
    take: TakeRow,
    origin: str,
    others: Sequence[TakeSegment] | None,
    near: Mapping[tuple[str, str, int, int], int] | None = None,
) -> Bar:
    """Place one segment, and describe it in its tooltip."""
    agrees = None if others is None else any(overlap(segment, other) for other in others)
    return Bar(
        left=percent(segment.start, take.frames),
        width=percent(segment.stop - segment.start, take.frames),
        agrees=agrees,
        tip=tip(segment, take.rate_hz, origin, agrees),
        start=segment.start,
        stop=segment.stop,
        confidence=segment.confidence,
        near=(near or {}).get(segment.key) if origin == "automatic" else None,
    )


def overlap(one: TakeSegment, other: TakeSegment) -> bool:
    """Return whether two segments of one take have a common frame."""
    return one.start < other.stop and other.start < one.stop


def tip(segment: TakeSegment, rate_hz: float, origin: str, agrees: bool | None) -> str:
    """Describe a segment in one line."""
    seconds = f"{shown_seconds(segment.start, rate_hz)}–{shown_seconds(segment.stop, rate_hz)} s"
    text = f"{segment.label}, {origin}: {seconds}, frames [{segment.start}, {segment.stop})"
    if segment.cost is not None:
        text += f", cost {segment.cost:.3f}"
    if segment.confidence is not None:
        text += f", confidence {segment.confidence:.2f}"
    if segment.subclass is not None and segment.subclass != segment.label:
        text += f", as {segment.subclass}"
    if segment.doubted is not None:
        text += f"; another method found {segment.doubted}"
    if agrees is False:
        text += "; no manual segment here" if origin == "automatic" else "; not found"
    return text
