"""Render the pages that compare methods of annotation, or two evaluations."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from jinja2 import Environment

from kinedex.ops.evaluation.detection import THRESHOLDS
from kinedex.ops.wording import two_digits
from kinedex.pipelines.engine.display import Progress
from kinedex.pipelines.evaluation.comparison_results import (
    SplitResult,
    Study,
    boundary_summary,
)
from kinedex.pipelines.evaluation.differences import Comparison
from kinedex.pipelines.templates.stored_clips import Key
from kinedex.reports.comparison_tables import (
    MEASURE_NAMES,
    capitalised,
    headings,
    interval_text,
    method_cells,
    outcome_text,
    overlap_notes,
    six_measures,
    split_description,
    take_title,
)
from kinedex.reports.difference_tables import HEADER, VERDICTS, remarks, settings, signed_difference
from kinedex.reports.embedded_motions import Embed, EmbeddedMotions, embed, motions_json
from kinedex.reports.example_motions import with_study
from kinedex.reports.method_diagrams import (
    HEIGHT,
    STRIP_WIDTHS,
    WIDTH,
    ConfusionTable,
    Strips,
    Sweep,
    boundary_errors,
    confusion_table,
    error_ticks,
    strips,
    sweeps,
)
from kinedex.reports.page_environment import page_environment
from kinedex.reports.palette import colour_rules, colour_slot
from kinedex.reports.plots import HistogramBar
from kinedex.storage.store.store import Store

MAX_ROWS = 300
"""Largest number of rows of a list of takes or segments; the page states how many more there are."""


@dataclass(frozen=True)
class Section:
    """The diagrams and tables of one split; `labels` are the classes of its tables."""

    result: SplitResult
    labels: tuple[str, ...]
    takes: tuple[Strips, ...]
    sweeps: tuple[Sweep, ...]
    confusion: dict[str, ConfusionTable]
    bars: dict[str, list[HistogramBar]]


def methods_page(study: Study, motions: EmbeddedMotions | None = None, near: Mapping[Key, int] | None = None) -> str:
    """Render a comparison of methods.

    Parameters
    ----------
    study : Study
        The comparison.
    motions : EmbeddedMotions or None
        Motions of the player, named by the titles of takes; None for a page without player.
    near : mapping of (title, class, start, stop) to int, or None
        Place of the nearest example of a segment in `motions.near`.

    Returns
    -------
    str
        A complete HTML page without outside references; equal studies give equal text.
    """
    labels = _labels(study)
    light, dark = colour_rules(len(labels))
    return (
        _environment()
        .get_template("methods.html.j2")
        .render(
            study=study,
            sections=[_section(study, result, labels, near or {}) for result in study.splits],
            labels=labels,
            slots={label: colour_slot(index) for index, label in enumerate(labels)},
            numbers={label: index + 1 for index, label in enumerate(labels)},
            headings=headings(study),
            overlap_notes=overlap_notes(study),
            thresholds=THRESHOLDS,
            width=WIDTH,
            rooms=STRIP_WIDTHS,
            height=HEIGHT,
            error_ticks=error_ticks(),
            measure_names=MEASURE_NAMES,
            most=MAX_ROWS,
            motions=motions,
            motions_json=motions_json(motions),
            light=light,
            dark=dark,
        )
    )


def _labels(study: Study) -> list[str]:
    """Return the labels of all splits, the classes first."""
    found = list(study.classes)
    for result in study.splits:
        for judgement in result.judgements.values():
            found += [label for label in judgement.by_class if label not in found]
    return found


def _section(study: Study, result: SplitResult, labels: list[str], near: Mapping[Key, int]) -> Section:
    numbers = {label: index + 1 for index, label in enumerate(labels)}
    lead = result.leading
    ordered = {lead: result.outcomes[lead], **result.outcomes}
    test_takes = {test_take.name: test_take for test_take in result.test_takes}
    judgement = result.judgements[lead]
    used = tuple(
        label
        for label in judgement.by_class
        if any(
            one.by_class[label].frames_automatic + one.by_class[label].frames_manual
            for one in result.judgements.values()
        )
    )
    takes = [
        strips(
            take_title(study, result, test_takes[name]),
            what,
            test_takes[name],
            ordered,
            numbers,
            study.rate_hz,
            {method: one.by_take[name] for method, one in result.judgements.items()},
            {key[1:]: place for key, place in near.items() if key[0] == take_title(study, result, test_takes[name])},
        )
        for what, name in result.shown().items()
    ]
    bars = {
        end: boundary_errors(judgement.boundaries[:, column], study.rate_hz)
        for column, end in enumerate(("start", "stop"))
    }
    confusion = {name: confusion_table(result.judgements[name].confusion, numbers) for name in ordered}
    return Section(result, used, tuple(takes), tuple(sweeps(result.sweep)), confusion, bars)


def _environment() -> Environment:
    filters: dict[str, Callable[..., object]] = {
        "digits": two_digits,
        "between": interval_text,
        "described": split_description,
        "sentence": capitalised,
        "row": method_cells,
        "outcome_text": outcome_text,
        "six": six_measures,
        "boundaries": boundary_summary,
        "sortable": lambda value: "" if value is None or math.isnan(value) else value,
    }
    return page_environment(filters)


def study_page(store: Store, study: Study, embedded: Embed, stage: str, progress: Progress) -> str:
    """Return the page of a comparison, with the motions of the takes on it and their nearest examples.

    Parameters
    ----------
    store : Store
        The store of the takes and the clips.
    study : Study
        The comparison.
    embedded : str or sequence of str
        The takes whose motions are embedded: "auto", "all", "none", or names.
    stage : str
        The name of the stage, for remarks.
    progress : callable
        Makes a progress bar of a description and a number of steps.
    """
    named = dict(store.takes().select("take_id", "name").iter_rows())
    shown = {title: [named[part] for part in parts] for title, parts in _shown_parts(study).items()}
    motions = embed(store, shown, embedded, stage, progress)
    motions, near = with_study(store, study, motions, progress)
    return methods_page(study, motions, near)


def comparison_page(comparisons: Sequence[Comparison]) -> str:
    """Return comparisons as one self-contained HTML page."""
    environment = page_environment(
        {"digits": two_digits, "signed": signed_difference, "remarks": remarks, "settings": settings}
    )
    return environment.get_template("compared.html.j2").render(
        comparisons=comparisons, verdicts=VERDICTS, header=HEADER
    )


def _shown_parts(study: Study) -> dict[str, tuple[int, ...]]:
    """Return the takes of the store that make up each take with a timeline, by title."""
    parts = {}
    for result in study.splits:
        test_takes = {test_take.name: test_take for test_take in result.test_takes}
        for name in result.shown().values():
            parts[take_title(study, result, test_takes[name])] = test_takes[name].take_ids
    return parts
