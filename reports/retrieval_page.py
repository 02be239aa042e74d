"""Render the page about retrieval: search and ranking of each class, precision and recall, stiffness of queries."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from kinedex.pipelines.templates.ranking_evaluation import EVERYWHERE, WRITTEN
from kinedex.reports.page_environment import page_environment
from kinedex.reports.plots import line_path, share_ticks

SIZE = 150
"""Side of a diagram in SVG units; both axes are from 0 to 1."""

WIDE, HIGH = 560, 170
RIGID = 1.0
"""The stiffness that is drawn for each class, as in Figure 3.14."""

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Line:
    """One ranking in a diagram: its CSS class, its name, its path, and the dot at its end."""

    name: str
    words: str
    path: str
    dot: tuple[float, float] | None


@dataclass(frozen=True)
class Diagram:
    """The rankings of one class, with a caption and a description for screen readers."""

    label: str
    lines: tuple[Line, ...]
    caption: str
    description: str


@dataclass(frozen=True)
class Search:
    """The keyframe search of one class; times are in milliseconds, `kept` is a fraction of the frames."""

    keyframes: int
    stiffness: float | None
    segments: int
    search: float
    lists: float
    kept: float


@dataclass(frozen=True)
class TwoStages:
    """One row of the table of search and ranking (thesis, Table 3.2).

    `search` is None if the class has no queries; `reading` and `ranking` are in milliseconds; `skipped` is None if no
    lower bound was used.
    """

    label: str
    columns: int
    search: Search | None
    reading: float | None
    ranking: float
    skipped: float | None
    hits: int
    best: float | None


@dataclass(frozen=True)
class Quality:
    """One row of the table of average precision: the values of a class over takes and over held-out clips."""

    label: str
    takes: tuple[int, float | None, float | None] | None
    clips: tuple[int, float | None, float | None] | None
    confused: str


@dataclass(frozen=True)
class Variant:
    """One row of the stiffness experiment, over the classes that have queries."""

    name: str
    stiffness: float | None
    kept: float
    to_find: int
    ranked: int
    recall: float
    average_precision: float | None


@dataclass(frozen=True)
class Curve:
    """The curve of one measure over the stiffness: its names, its path in SVG units, and its points."""

    name: str
    words: str
    path: str
    dots: tuple[tuple[float, float, str], ...]


def retrieval_page(
    title: str,
    rank_summary: Mapping[str, Any],
    hits: Sequence[Row],
    quality: Sequence[Row],
    trials: Sequence[Row],
    figures: Mapping[str, Any] | None = None,
) -> str:
    """Render the page.

    Parameters
    ----------
    title : str
        Title of the page.
    rank_summary : mapping
        Summary of the stage `rank`.
    hits, quality, trials : sequence of mapping
        Rows of the result kinds `ranked_hits`, `retrieval` and `precision_recall`.
    figures : mapping, optional
        Groups of moving figures and what the template needs for them, as `best_hits` returns them.

    Returns
    -------
    str
        A complete HTML page without outside references; equal data give equal text.
    """
    rows = two_stages(rank_summary, hits)
    found = variants(trials)
    return (
        page_environment()
        .get_template("retrieval.html.j2")
        .render(
            title=title,
            summary=rank_summary,
            rows=rows,
            searches=[row.search for row in rows if row.search is not None],
            ranked=[row.ranking for row in rows if row.search is not None],
            qualities=qualities(quality),
            means={kind: mean_of(quality, kind) for kind in ("takes", "clips")},
            diagrams=diagrams(trials, (EVERYWHERE, WRITTEN)),
            rigid=diagrams(trials, (WRITTEN, f"{RIGID:g}")) if any(row["stiffness"] == RIGID for row in trials) else [],
            variants=found,
            courses=stiffness_curves(found),
            stiffness_ticks=share_ticks(WIDE, (0, 0.2, 0.4, 0.6, 0.8, 1)),
            size=SIZE,
            wide=WIDE,
            high=HIGH,
            **(figures or {"groups": []}),
        )
    )


def two_stages(summary: Mapping[str, Any], hits: Sequence[Row]) -> list[TwoStages]:
    """Return the rows of the table of search and ranking, in the order of the rankings."""
    found = []
    for label, columns in summary["columns"].items():
        own = [row["cost"] for row in hits if row["template"] == label]
        lists = summary["lists"].get(label)
        search = _search(lists, summary["kept"][label]) if lists else None
        read = summary.get("reading", {}).get(label)  # rankings of earlier versions have none
        reading, ranking = None if read is None else 1000 * read, 1000 * summary["seconds"][label]
        skipped = summary["skipped"][label]
        found.append(TwoStages(label, columns, search, reading, ranking, skipped, len(own), min(own, default=None)))
    return found


def _search(lists: Mapping[str, Any], kept: float) -> Search:
    seconds, inside = 1000 * lists["seconds"], 1000 * lists["lists_seconds"]
    return Search(lists["keyframes"], lists["stiffness"], lists["segments"], seconds, inside, kept)


def qualities(rows: Sequence[Row]) -> list[Quality]:
    """Return average precision and recall of every class, over all folds."""
    found = []
    for label in sorted({row["class"] for row in rows}):
        both = [_pooled([row for row in rows if (row["class"], row["evaluation"]) == (label, kind)])
                for kind in ("takes", "clips")]  # fmt: skip
        confused: dict[str, int] = {}
        for row in rows:
            for one in row["confused_with"] if row["class"] == label else ():
                name, count = one.rsplit(" ", 1)
                confused[name] = confused.get(name, 0) + int(count)
        most = sorted(confused.items(), key=lambda pair: -pair[1])[:3]
        found.append(Quality(label, both[0], both[1], ", ".join(f"{name} ({count})" for name, count in most)))
    return found


def _pooled(rows: Sequence[Row]) -> tuple[int, float | None, float | None] | None:
    if not rows:
        return None
    total = sum(row["relevant"] for row in rows)
    averages = [row["average_precision"] for row in rows if row["average_precision"] is not None]
    average = sum(averages) / len(averages) if averages else None
    return total, average, sum(row["found"] for row in rows) / total if total else None


def mean_of(rows: Sequence[Row], kind: str) -> tuple[float, float] | None:
    """Return mean average precision over classes and recall over all segments; None if either is undefined."""
    own = qualities([row for row in rows if row["evaluation"] == kind])
    pairs = [pair for pair in ((one.takes if kind == "takes" else one.clips) for one in own) if pair is not None]
    averages = [average for _, average, _ in pairs if average is not None]
    total = sum(count for count, _, _ in pairs)
    if not averages or not total:
        return None
    return sum(averages) / len(averages), sum(count * (recall or 0.0) for count, _, recall in pairs) / total


def diagrams(trials: Sequence[Row], names: tuple[str, str]) -> list[Diagram]:
    """Lay out precision over recall of each class for two variants (thesis, Figures 3.13 and 3.14)."""
    found = []
    for label in sorted({row["class"] for row in trials if row["relevant"]}):
        lines, texts = [], []
        for place, name in enumerate(names):
            row = next((row for row in trials if (row["class"], row["variant"]) == (label, name)), None)
            if row is None:
                continue
            words = name if name in (EVERYWHERE, WRITTEN) else f"σ ≡ {name}"
            lines.append(_line("second" if place == 0 else "first", words, row))
            average = row["average_precision"]
            texts.append(
                f"{words}: AP {average:.2f}, {row['found']} of {row['relevant']} found below τ and {row['ranked']} at "
                f"any rank, {row['kept']:.0%} kept"
            )
        if lines:
            text = f"precision and recall of {label}: " + "; ".join(texts)
            found.append(Diagram(label, tuple(lines), "; ".join(texts), text))
    return found


def _line(name: str, words: str, row: Row) -> Line:
    """Lay out the points (recall, precision) after each rank, up to the last relevant hit."""
    points = list(zip(row["recall"], row["precision"], strict=True))
    best = max(row["recall"], default=0.0)
    last = next((place for place, (recall, _) in enumerate(points) if recall == best), -1) if best else -1
    positions = [(SIZE * recall, SIZE * (1 - precision)) for recall, precision in points[: last + 1]]
    return Line(name, words, line_path(positions), positions[-1] if positions else None)


def variants(trials: Sequence[Row]) -> list[Variant]:
    """Return the rows of the stiffness experiment, over the classes that have queries."""
    asked = {row["class"] for row in trials if row["variant"] == WRITTEN and row["relevant"]}
    found = []
    for name in dict.fromkeys(row["variant"] for row in trials):
        own = [row for row in trials if row["variant"] == name and row["class"] in asked]
        if not own:
            continue
        averages = [row["average_precision"] for row in own if row["average_precision"] is not None]
        total, ranked = sum(row["relevant"] for row in own), sum(row["ranked"] for row in own)
        found.append(
            Variant(
                name, own[0]["stiffness"], sum(row["kept"] for row in own) / len(own), total, ranked, ranked / total,
                sum(averages) / len(averages) if averages else None,
            )
        )  # fmt: skip
    return found


def stiffness_curves(found: Sequence[Variant]) -> list[Curve]:
    """Lay out recall, mean average precision and the fraction of frames kept over the stiffness."""
    swept = sorted((one for one in found if one.stiffness is not None), key=lambda one: one.stiffness or 0.0)
    measures = (
        ("recall", "found at any rank", [one.recall for one in swept]),
        ("precision", "mean average precision", [one.average_precision or math.nan for one in swept]),
        ("kept", "share of frames kept", [one.kept for one in swept]),
    )
    drawn = []
    for name, words, values in measures:
        dots = tuple(
            (WIDE * (one.stiffness or 0.0), HIGH * (1 - value), f"{words} {value:.3f} at σ = {one.stiffness:g}")
            for one, value in zip(swept, values, strict=True)
            if not math.isnan(value)
        )
        if dots:
            drawn.append(Curve(name, words, line_path((x, y) for x, y, _ in dots), dots))
    return drawn
