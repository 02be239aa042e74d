"""`python -m studies.cross_studio STORE TRUTH`: explain the labels of takes of another studio by features.

The store is that of `kinedex run hdm05-cmu`, TRUTH its ground truth. Each manual segment has a row: its labels by both
methods, with the confidence of method best; the value of a label of its own class to method best (below 0 it costs
more than it gains); the template of its own class that fits best there, if there is one, and the best of all others,
each with its distance and the features that make up the distance.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.classes import Classes, load_classes
from kinedex.ops.annotation.decoding import explain
from kinedex.ops.arrays import U64
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import TakeWords, bits
from kinedex.pipelines.annotation.annotators import Annotator, make_annotator
from kinedex.pipelines.annotation.batches import annotate_words
from kinedex.pipelines.annotation.material import template_examples
from kinedex.pipelines.annotation.methods import Needs
from kinedex.pipelines.annotation.template_methods import BestMethod, ThesisMethod
from kinedex.pipelines.evaluation.ground_truth import Manual, place_ground_truth
from kinedex.pipelines.templates.template_learning import read_templates
from kinedex.storage.formats.labels.formats import read_labels
from kinedex.storage.store.store import Store, open_store

F64 = npt.NDArray[np.float64]

STAGE = "hdm05-cmu/learn_templates"
DELTA, TAU = 0.05, 0.13
"""The parameters of `configs/pipelines/hdm05-cmu.yaml`."""

MAX_FEATURES = 4


@dataclass(frozen=True)
class Fit:
    """The best place of a template within an interval: distance, frames [start, stop), parts of features."""

    subclass: str
    cost: float
    start: int
    stop: int
    shares: F64


def contributions(template: QuantisedTemplate, words: U64, features: int) -> F64:
    """Return the part of each feature in the distance of the best path from the first of some words to the last.

    Steps and weights are those of `ops.distances.dtw.distance_curves`.

    Returns
    -------
    float64 array (f,)
        The parts, whose sum is the distance.

    Raises
    ------
    ValueError
        No path leads through: the words are more than twice as many as the columns, or less than half.
    """
    wrong = bits((words[None, :] ^ template.value[:, None]).ravel() & np.repeat(template.mask, len(words)), features)
    counted = np.maximum(np.bitwise_count(template.mask), 1).astype(float)
    parts = wrong.reshape(len(template), len(words), features) / counted[:, None, None]
    local = parts.sum(axis=2)
    total = np.full(local.shape, np.inf)
    total[0, 0] = local[0, 0]
    steps = ((1, 1, 1), (1, 2, 1), (2, 1, 2))  # step in the template, step in the take, weight of the local cost
    came = np.zeros(local.shape, np.int64)
    for n in range(1, local.shape[0]):
        for m in range(1, local.shape[1]):
            ways = [
                total[n - a, m - b] + weight * local[n, m] if n >= a and m >= b else np.inf for a, b, weight in steps
            ]
            came[n, m] = int(np.argmin(ways))
            total[n, m] = ways[came[n, m]]
    n, m = len(template) - 1, len(words) - 1
    if not np.isfinite(total[n, m]):
        raise ValueError(f"no path leads from the first to the last of {len(words)} words in {len(template)} columns")
    found = np.zeros(features)
    while (n, m) != (0, 0):
        a, b, weight = steps[came[n, m]]
        found += weight * parts[n, m]
        n, m = n - a, m - b
    shares: F64 = (found + parts[0, 0]) / len(template)
    return shares


def best_fit(annotator: Annotator, words: U64, start: int, stop: int, chosen: Sequence[int]) -> Fit | None:
    """Return the template that fits best with an end in an interval of a take; None where no path ends there."""
    curves = distance_curves([annotator.templates[index] for index in chosen], words)[:, start:stop]
    if not curves.size or not np.isfinite(curves.min()):
        return None
    row, place = divmod(int(np.argmin(curves)), curves.shape[1])
    template, end = annotator.templates[chosen[row]], start + place
    begin = begin_of(template, words, end)
    shares = contributions(template, words[begin : end + 1], len(annotator.feature_set.features))
    return Fit(annotator.subclasses[chosen[row]], float(curves[row, place]), begin, end + 1, shares)


def begin_of(template: QuantisedTemplate, words: U64, end: int) -> int:
    """Return the last frame at which a best path to a given last frame can begin.

    A range that begins later excludes paths, so that the distance at its end never decreases with its first frame.
    """
    low, high = max(0, end - 2 * (len(template) - 1)), end + 1
    least = distance_curves([template], words, np.array([[low, end + 1]]))[0, end]
    while high - low > 1:
        middle = (low + high) // 2
        if distance_curves([template], words, np.array([[middle, end + 1]]))[0, end] == least:
            low = middle
        else:
            high = middle
    return low


def labels_within(annotator: Annotator, words: TakeWords, manual: Manual) -> str:
    """List the labels of a manual segment in per cent of its frames, the most first; of best with margins."""
    counts: Counter[str] = Counter()
    sure: dict[str, list[float]] = {}
    for one in annotate_words(annotator, words)[0].segments:
        within = min(one.stop, manual.stop) - max(one.start, manual.start)
        if within > 0:
            counts[annotator.classes[one.class_index]] += within
            sure.setdefault(annotator.classes[one.class_index], []).append(one.margin)
    length = manual.stop - manual.start
    margins = isinstance(annotator.method, BestMethod)
    parts = []
    for name, count in counts.most_common(3):
        if 20 * count >= length:
            edges = sorted({f"{edge(sure[name]):.1f}" for edge in (min, max)})
            parts.append(f"{name} {100 * count / length:.0f} %" + (f" ({'–'.join(edges)})" if margins else ""))
    return ", ".join(parts) or "nothing"


def worth(annotator: Annotator, words: U64, manual: Manual, chosen: Sequence[int]) -> str:
    """Return the value of the best single segment that templates make of a manual segment, with its entry cost."""
    row = annotator.method
    assert isinstance(row, BestMethod)
    free = replace(row.decoding, entry=0.0)
    found = explain([row.templates[index] for index in chosen], row.usual, words[manual.start : manual.stop], free)
    value = max((one.value for one in found), default=0.0)
    return f"{value - row.decoding.entry:+.2f}".replace("-", "−")


def described(fit: Fit | None, annotator: Annotator, rate_hz: float) -> str:
    """Describe a fit in words."""
    if fit is None:
        return "–"
    order = np.argsort(-fit.shares, kind="stable")[:MAX_FEATURES]
    names = annotator.feature_set.features
    parts = [f"{names[index].name} {fit.shares[index]:.3f}" for index in order if fit.shares[index] > 0.002]
    where = f"{fit.start / rate_hz:.1f}–{fit.stop / rate_hz:.1f} s"
    return f"{fit.subclass} {fit.cost:.3f} ({where}): {', '.join(parts) or 'nothing'}"


def rows(store: Store, truth: Path, classes: Classes) -> list[str]:
    """Return the lines of the table, one for each manual segment."""
    templates = read_templates(store, STAGE, "soft")
    words = [one.words for one in template_examples(store, templates, Needs(words=True))]
    thesis, best = (
        make_annotator(store.feature_set, templates, classes, DELTA, TAU, method=one, clips=lambda: words)
        for one in (ThesisMethod, BestMethod)
    )
    takes = store.takes("class IS NULL")
    placed = place_ground_truth([read_labels(truth)], takes, store.takes()["name"], classes, "miss")
    found = []
    for manual in sorted(placed.segments, key=lambda one: (one.take, one.start)):
        words = store.words([manual.take_id])
        own = [index for index, at in enumerate(thesis.class_index) if thesis.classes[at] == manual.label]
        others = [index for index in range(len(thesis.templates)) if index not in own]
        fits = [best_fit(thesis, words.words, manual.start, manual.stop, chosen) for chosen in (own, others) if chosen]
        mine = described(fits[0], thesis, store.rate_hz) if own else "no template"
        other = described(fits[-1], thesis, store.rate_hz)
        seconds = f"{manual.start / store.rate_hz:.1f}–{manual.stop / store.rate_hz:.1f}"
        by = [labels_within(annotator, words, manual) for annotator in (thesis, best)]
        by.append(worth(best, words.words, manual, own) if own else "–")
        found.append(f"| {manual.take} | {seconds} | {manual.label} | {' | '.join(by)} | {mine} | {other} |")
    return found


def main() -> None:
    """Print the corresponding classes, and the table as Markdown."""
    parser = argparse.ArgumentParser(prog="python -m studies.cross_studio", description=__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("truth", type=Path)
    given = parser.parse_args()
    store = open_store(given.store)
    templates = read_templates(store, STAGE, "soft")
    labelled = set(store.takes()["class"].drop_nulls())
    classes = load_classes("thesis-15", {one.subclass for one in templates} | labelled)
    known = [(one.name, set(one.subclasses) & {template.subclass for template in templates}) for one in classes.classes]
    print("templates: " + "; ".join(f"{name}: {', '.join(sorted(own))}" for name, own in known if own) + "\n")
    print(
        "| take | seconds | manual | thesis | best | its class alone | nearest of its class | nearest of the others |\n"
        + "|---" * 8
        + "|"
    )
    for line in rows(store, given.truth, classes):
        print(line)


if __name__ == "__main__":
    main()
