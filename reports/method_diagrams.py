"""Lay out the diagrams of a comparison of methods: curves over τ, timelines, confusion matrix, boundary errors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import I64
from kinedex.ops.evaluation.confusion import Confusion
from kinedex.ops.evaluation.metrics import Counts
from kinedex.ops.intervals import TakeSegment, in_seconds, shown_seconds
from kinedex.pipelines.evaluation.comparison_results import Threshold
from kinedex.pipelines.evaluation.folds import TestTake
from kinedex.pipelines.evaluation.method_scores import Outcome
from kinedex.reports.plots import Axis, HistogramBar, histogram, line_path, percent, time_axis

WIDTH, HEIGHT = 320.0, 150.0
"""Size of a small plot in SVG units."""

BINS, FURTHEST = 20, 1.0
"""Number of bars of the histogram of boundary errors, and the largest error on its axis in seconds."""

STRIP_WIDTHS = (250, 300, 350, 420, 500, 600, 700, 800, 1000, 1300)
"""Widths of a strip in pixels for which the page decides which blocks show the number of their class."""

_DIGIT, _ROUND = 7.0, 6.0  # pixels of a digit, and of the space around a number


@dataclass(frozen=True)
class Line:
    """One curve of a plot: its name and path, or a point if it has a single value."""

    name: str
    path: str
    point: tuple[float, float] | None = None


@dataclass(frozen=True)
class Plot:
    """The curves over τ for frames or for segments, with ticks (x, text) and a description for screen readers."""

    title: str
    lines: tuple[Line, ...]
    ticks: tuple[tuple[float, str], ...]
    description: str


@dataclass(frozen=True)
class Sweep:
    """The curves of one kind of method, for frames and for segments, and their points."""

    method: str
    plots: tuple[Plot, Plot]
    points: tuple[Threshold, ...]


@dataclass(frozen=True)
class Block:
    """A segment on a strip.

    Attributes
    ----------
    left, width : float
        Place in percent.
    number : int
        Number of the class.
    middle : float
        Place of the number in percent: the middle of the longest part that no later block covers.
    room : int or None
        Smallest of `STRIP_WIDTHS` at which the number fits into the block; None if it never fits.
    wrong : bool
        True if the ground truth (for a manual segment, the first method) has no segment of the class in these frames.
    tip, called : str
        The tooltip, and the title in the player.
    start, stop : int
        Analysis frames.
    near : int or None
        Index of the nearest example in the page's list.
    """

    left: float
    width: float
    number: int
    middle: float
    room: int | None
    wrong: bool
    tip: str
    start: int
    stop: int
    called: str
    near: int | None = None


@dataclass(frozen=True)
class Strip:
    """The segments of one method, or of a person."""

    name: str
    blocks: tuple[Block, ...]
    description: str


@dataclass(frozen=True)
class Strips:
    """A take with the segments of every method; `title` is unique among the takes of all splits."""

    title: str
    what: str
    test_take: TestTake
    strips: tuple[Strip, ...]
    axis: Axis
    scores: dict[str, Counts]


@dataclass(frozen=True)
class Shade:
    """One entry of a confusion matrix: frames, their share of the row, and the darkness of the cell in percent.

    `right` is True on the diagonal, where both labels are the same.
    """

    frames: float
    share: float
    dark: int
    right: bool


@dataclass(frozen=True)
class ConfusionRow:
    """One row of a confusion matrix: label, number of the class (empty for other labels), frames and entries."""

    label: str
    number: str
    frames: float
    shades: tuple[Shade, ...]


@dataclass(frozen=True)
class ConfusionTable:
    """A confusion matrix with the headings of its columns as (text, tooltip)."""

    heads: tuple[tuple[str, str], ...]
    rows: tuple[ConfusionRow, ...]


def sweeps(points: Sequence[Threshold]) -> list[Sweep]:
    """Draw precision, recall and F-measure over τ (thesis, Figure 5.6), for each kind of method."""
    result = []
    for curve in dict.fromkeys(point.curve for point in points):
        own = tuple(sorted((point for point in points if point.curve == curve), key=lambda point: point.tau))
        result.append(Sweep(curve, (_plot("frames", 1, own), _plot("segments", 2, own)), own))
    return result


def _plot(title: str, level: int, points: Sequence[Threshold]) -> Plot:
    low, high = points[0].tau, points[-1].tau
    across = [WIDTH * (point.tau - low) / (high - low) if high > low else WIDTH / 2 for point in points]
    lines, texts = [], []
    for letter, name in (("p", "precision"), ("r", "recall"), ("f", "F-measure")):
        values = [float(getattr(point.counts, f"{letter}{level}")) for point in points]
        known = [(x, value) for x, value in zip(across, values, strict=True) if not math.isnan(value)]
        path = line_path((x, HEIGHT * (1 - value)) for x, value in known) if len(known) > 1 else ""
        lines.append(Line(name, path, (known[0][0], HEIGHT * (1 - known[0][1])) if len(known) == 1 else None))
        if path:
            texts.append(f"{name} from {known[0][1]:.2f} to {known[-1][1]:.2f}")
        elif known:
            texts.append(f"{name} {known[0][1]:.2f}")
    positions = {0, len(points) // 2, len(points) - 1}
    ticks = tuple((across[i], f"{points[i].tau:g}") for i in sorted(positions))
    span = f"τ from {low:g} to {high:g}" if high > low else f"τ = {low:g}"
    return Plot(title, tuple(lines), ticks, f"{title}, {span}: {', '.join(texts)}")


def strips(
    title: str,
    what: str,
    test_take: TestTake,
    outcomes: Mapping[str, Outcome],
    numbers: Mapping[str, int],
    rate_hz: float,
    scores: Mapping[str, Counts],
    near: Mapping[tuple[str, int, int], int] | None = None,
) -> Strips:
    """Lay out a take: the manual segments on top, the segments of each method below.

    Segments of methods are compared with manual segments, and manual segments with those of the first method in
    `outcomes`. A segment is drawn as wrong if none of those that it is compared with has its class and shares a frame
    with it. `near` maps the class, start and stop of a segment to the index of its nearest example in the page's list.
    """
    manual = sorted(test_take.truth, key=lambda one: (one.start, one.stop, one.label))
    sides: list[tuple[str, Sequence[TakeSegment], Sequence[TakeSegment]]] = [
        ("manual", manual, next(iter(outcomes.values()))[test_take.name])
    ]
    sides += [(name, outcome[test_take.name], manual) for name, outcome in outcomes.items()]
    rows = [_strip(*side, test_take, numbers, rate_hz, near or {}) for side in sides]
    return Strips(
        title, what, test_take, tuple(rows), time_axis(max(in_seconds(test_take.frames, rate_hz), 1e-6)), dict(scores)
    )


def _strip(
    name: str,
    segments: Sequence[TakeSegment],
    others: Sequence[TakeSegment],
    test_take: TestTake,
    numbers: Mapping[str, int],
    rate_hz: float,
    near: Mapping[tuple[str, int, int], int],
) -> Strip:
    blocks, words = [], []
    for place, one in enumerate(segments):
        label, start, stop = one.label, one.start, one.stop
        wrong = not any(label == other.label and one.interval.overlaps(other.interval) for other in others)
        text = f"{label}, {shown_seconds(start, rate_hz)}–{shown_seconds(stop, rate_hz)} s"
        tip = f"{name}: {text}" + ("; " + ("not found" if name == "manual" else "no manual segment") if wrong else "")
        left, right = bare_part((start, stop), [(later.start, later.stop) for later in segments[place + 1 :]])
        blocks.append(
            Block(
                left=percent(start, test_take.frames),
                width=percent(stop - start, test_take.frames),
                number=numbers[label],
                middle=percent((left + right) / 2, test_take.frames),
                room=width_for_number(numbers[label], (right - left) / test_take.frames),
                wrong=wrong,
                tip=tip,
                start=start,
                stop=stop,
                called=f"{name}: {label}",
                near=near.get((label, start, stop)),
            )
        )
        words.append(text)
    return Strip(name, tuple(blocks), f"{name}: {'; '.join(words) or 'nothing'}")


def bare_part(block: tuple[int, int], later: Sequence[tuple[int, int]]) -> tuple[int, int]:
    """Return the longest part of a block that no later block covers, the first if equal; empty if there is none."""
    at, stop = block
    best = (at, at)
    for begin, end in [*sorted(one for one in later if one[0] < stop), (stop, stop)]:
        if begin - at > best[1] - best[0]:
            best = (at, begin)
        at = max(at, end)
    return best


def width_for_number(number: int, share: float) -> int | None:
    """Return the smallest of `STRIP_WIDTHS` at which a number fits into a fraction of the strip; None for none."""
    wanted = _DIGIT * len(str(number)) + _ROUND
    return next((width for width in STRIP_WIDTHS if width * share >= wanted), None)


def confusion_table(confusion: Confusion, numbers: Mapping[str, int]) -> ConfusionTable:
    """Lay out a confusion matrix without empty rows, and without the column of missing labels if it is empty."""
    given = [str(numbers[label]) for label in confusion.classes]
    few = confusion.frames[:, -1].any()
    heads = [*zip([*given, "–", "+"], confusion.columns, strict=True)][: None if few else -1]
    rows = []
    for index, (label, number) in enumerate(zip(confusion.rows, [*given, "", ""], strict=True)):
        frames = confusion.frames[index]
        total = float(frames.sum())
        if not total:
            continue
        shares = (frames / total).tolist()
        shades = tuple(
            Shade(count, share, round(60 * share**0.5), column == index)
            for column, (count, share) in enumerate(zip(frames.tolist(), shares, strict=True))
        )
        rows.append(ConfusionRow(label, number, total, shades[: len(heads)]))
    return ConfusionTable(tuple(heads), tuple(rows))


def boundary_errors(frames: I64, rate_hz: float) -> list[HistogramBar]:
    """Lay out a histogram of boundary errors in seconds; the outermost bars also count larger errors."""
    seconds = np.clip(in_seconds(frames, rate_hz), -FURTHEST, FURTHEST)
    return histogram(seconds, -FURTHEST, FURTHEST, BINS, (WIDTH, HEIGHT), 1)


def error_ticks() -> list[tuple[float, str]]:
    """Return the ticks of the histogram of boundary errors."""
    return [(25, f"≤ {-FURTHEST:g} s"), (WIDTH / 2, "0"), (WIDTH - 25, f"≥ {FURTHEST:g} s")]
