"""Format templates as text for the terminal: one template, or the contrast of two."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from kinedex.catalog.features import FeatureSet
from kinedex.ops.intervals import shown_seconds
from kinedex.ops.templates.derived_templates import Contrast, consistency
from kinedex.ops.templates.templates import CONVERGED, quantise
from kinedex.ops.wording import counted
from kinedex.pipelines.templates.template_learning import SubclassTemplate

ON, OFF, WILDCARD = "█", "·", "▒"


def template_lines(
    one: SubclassTemplate, features: FeatureSet, delta: float, rate_hz: float, width: int
) -> Iterator[str]:
    """Yield a template as lines: its heading, how it was learned, and its matrix with a row for each feature.

    Parameters
    ----------
    one : SubclassTemplate
        The template.
    features : FeatureSet
        The features of its rows.
    delta : float
        Values within delta of 0 or 1 are shown as off and on.
    rate_hz : float
        The analysis rate, in frames per second.
    width : int
        The width of the terminal.
    """
    template = one.learned.template
    yield template_heading(one, rate_hz)
    if template.feature_weights is not None:
        yield weights_line(template.feature_weights.tolist(), features)
    yield from (f"! {remark}" for remark in one.remarks)
    if len(one.learned.costs) > 1:
        yield f"largest cost between two clips, round by round: {convergence_text(one.learned.costs)}"
    yield ""
    names = [f"{feature.name} {feature.number:>2}" for feature in features.features]
    room = max(width - max(map(len, names)) - 9, 10)
    fold = -(-len(template) // room)
    many = f"; each sign stands for {fold} columns" if fold > 1 else ""
    yield f"{ON} on   {OFF} off   {WILDCARD} varies: anything fits (δ = {delta:g}){many}"
    yield "at the end of a row: how much the clips agree about the feature"
    values = quantise(template, delta).values(len(names))
    agreement = consistency(template)
    starts = {word_set.first for word_set in features.sets.values()}
    for number, name in enumerate(names, 1):
        if number in starts:
            yield f"{features.set_of(number).name}:"
        signs = "".join(_sign(values[at : at + fold, number - 1]) for at in range(0, len(values), fold))
        yield f"{name:>{max(map(len, names))}} {signs} {agreement[number - 1]:>4.0%}"


def template_heading(one: SubclassTemplate, rate_hz: float) -> str:
    """Return a heading for a template: name, kind, length and origin."""
    columns = len(one.learned.template)
    made = one.origin
    if made.startswith("learned"):
        made = f"{counted(len(one.clips), 'clip')}, {counted(one.learned.rounds, 'round')} of averaging"
        made += one.origin.removeprefix("learned").replace(", ", "; ", 1)
    return f"{one.subclass}, {one.kind}: {counted(columns, 'column')} ({shown_seconds(columns, rate_hz)} s); {made}"


def weights_line(weights: Sequence[float], features: FeatureSet) -> str:
    """Return a line that lists the features whose weight is not 1."""
    pairs = zip(features.features, weights, strict=True)
    unlike = [f"{feature.name} {weight:g}" for feature, weight in pairs if weight != 1]
    return f"feature weights: {', '.join(unlike)}; all others 1" if unlike else "feature weights: all 1"


def convergence_text(costs: tuple[float, ...]) -> str:
    """Return the largest cost between two clips after each round of averaging, and whether the rounds converged."""
    end = "settled" if costs[-1] < CONVERGED else "no longer changed, or stopped"
    return f"{' → '.join(f'{cost:.3f}' for cost in costs)} ({end})"


def contrast_lines(names: tuple[str, str], found: Contrast, features: FeatureSet, rate_hz: float) -> Iterator[str]:
    """Yield lines on the features with contradicting values in two templates, the most frequent first."""
    against, compared = int(np.abs(found.against).sum()), int(found.compared.sum())
    if not compared:
        yield f"{names[0]} and {names[1]} have no entry in common that neither leaves open"
        return
    yield (
        f"{names[0]} and {names[1]} contradict each other in {against / compared:.1%} of the entries that neither "
        f"leaves open, over {counted(len(found.path), 'aligned column')}"
    )
    columns = np.abs(found.against).sum(axis=0)
    order = [index for index in np.argsort(-columns, kind="stable").tolist() if columns[index]]
    for index in order:
        feature = features.features[index]
        parts = []
        for side, sign in enumerate((1, -1)):
            count = int((found.against[:, index] == sign).sum())
            if count:
                when = _where(found, index, sign, names, rate_hz)
                parts.append(f"on in {names[side]}, off in {names[1 - side]}, {counted(count, 'column')} ({when})")
        yield f"  {feature.description} (F{feature.number}): {'; '.join(parts)}"
    if len(order) < len(features.features):
        yield f"the other {counted(len(features.features) - len(order), 'feature')} contradict nowhere"


def _sign(values: np.ndarray) -> str:
    """Return the symbol for one column, or for several that are shown as one: a wildcard if they differ."""
    return ON if np.all(values == 1) else OFF if np.all(values == 0) else WILDCARD


def _where(found: Contrast, index: int, sign: int, names: tuple[str, str], rate_hz: float) -> str:
    """Return the times of contradictions in each of the two templates, in seconds."""
    columns = found.path[found.against[:, index] == sign]
    spans = [[shown_seconds(int(end), rate_hz) for end in (own.min(), own.max() + 1)] for own in columns.T]
    return ", ".join(f"{name} {start}–{stop} s" for name, (start, stop) in zip(names, spans, strict=True))
