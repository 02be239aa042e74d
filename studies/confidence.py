"""`python -m studies.confidence STORE TRUTH --bandai STORE`: does confidence hold what it says?

STORE is that of `kinedex run hdm05-cmu`, TRUTH the ground truth of HDM05's takes; the other one that of `python -m
studies.bandai`. Confidence is calibrated as the stage `annotate` does, on the examples alone. Judged is each segment:
right is one most of whose frames are of its class. Sets:

- mm: takes of HDM05's actor mm, learned from 1, 2, 3, 5 and all clips of each class of bd, bk and dg.
- left out: the clips of one of bd, bk and dg laid end to end, learned from clips of the other two, as many.
- open: the same, learned from all clips of five classes, so that what is of the others should get no label.
- examples: Bandai, five examples of each content, all other takes, as in `studies.bandai`; and the takes of each of
  the two data sets among them.
- styles: Bandai, half of the styles, drawn, as examples, the takes of the others.

Evidence and spreads of `ops.annotation.confidence` were chosen on the seeds 0 to 5 of all sets but mm, and on clips of
synthetic actors who were left out (`--clips`). `--prior` prints the numbers of `PRIORS`, from the sets left out and
open.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import polars as pl

from kinedex.catalog.classes import OWN, load_classes
from kinedex.ops.annotation.confidence import PRIORS, Prior, learn_confidence
from kinedex.ops.annotation.evidence import evidence_of
from kinedex.ops.arrays import U64
from kinedex.ops.evaluation.reliability import EDGES, auroc, brier, reliability
from kinedex.ops.words import TakeWords
from kinedex.pipelines.annotation.annotators import Annotator, make_annotator
from kinedex.pipelines.annotation.batches import annotate_words
from kinedex.pipelines.annotation.confidence_calibration import Target, calibrate_confidence
from kinedex.pipelines.annotation.methods import annotation_method
from kinedex.pipelines.engine.executors import Executor, make_executor
from kinedex.pipelines.labels.file_segments import placed_files
from kinedex.pipelines.templates.template_learning import SubclassTemplate, TrainingClips, learn_templates
from kinedex.storage.formats.labels.formats import read_labels
from kinedex.storage.store.store import Store, open_store
from studies.bandai import draw as draw_examples
from studies.decoding import Clip, clips_of, laid_out

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

METHODS = ("best", "thesis")
DELTA, TAU = 0.05, 0.13
COUNTS = (1, 2, 3, 5, None)
OPEN_CLASSES, MIN_TAKES, BOOTSTRAPS = 5, 8, 1000
FIFTHS = 5


@dataclass(frozen=True)
class Judged:
    """A take to annotate: its name, actor, words, and true segments (class, start, stop)."""

    name: str
    actor: str
    words: U64
    truth: tuple[tuple[str, int, int], ...]


@dataclass(frozen=True)
class Trial:
    """Examples to learn from, and takes to annotate."""

    clips: Sequence[Clip]
    takes: Sequence[Judged]


class Study:
    """A store, and what is learned from and judged in it."""

    def __init__(self, store: Store, executor: Executor) -> None:
        self.features, self.feature_set, self.executor = len(store.feature_set.features), store.feature_set, executor

    def learn(self, clips: Sequence[TrainingClips]) -> list[SubclassTemplate]:
        """Return soft templates of clips."""
        return [one for task in learn_templates(clips, ["soft"], self.features, self.executor) for one in task]

    def annotator(self, trial: Trial, method: str, *, calibrated: bool = True) -> Annotator:
        """Return the annotator of a trial, with the confidence that is calibrated on its examples."""
        groups: dict[str, list[Clip]] = defaultdict(list)
        for clip in trial.clips:
            groups[clip.label].append(clip)
        names = {id(clip): f"{clip.label}_{place:04}" for place, clip in enumerate(trial.clips)}
        clips = [
            TrainingClips(label, tuple(names[id(one)] for one in own), tuple(one.words for one in own))
            for label, own in sorted(groups.items())
        ]
        classes = load_classes(OWN, set(groups))

        def make(some: Sequence[TrainingClips], *_: object) -> Annotator:
            chosen, words = annotation_method(method), [words for one in some for words in one.words]
            templates = self.learn(some)
            return make_annotator(self.feature_set, templates, classes, DELTA, TAU, method=chosen, clips=lambda: words)

        made = make(clips)
        if not calibrated:
            return made
        actors: dict[str, str | None] = {names[id(clip)]: clip.group for clip in trial.clips}
        target = Target([len(one.words) for one in trial.takes], [one.actor for one in trial.takes])
        found = calibrate_confidence(clips, actors, classes, method, target, make, self.executor)
        return replace(made, confidence=found.confidence)

    def rows(self, trial: Trial, method: str) -> Iterator[dict[str, object]]:
        """Yield a row for each segment of a trial."""
        made = self.annotator(trial, method)
        for take, found in zip(trial.takes, annotate_words(made, _laid(trial.takes)), strict=True):
            for one, sure in zip(found.segments, found.confidences or (), strict=True):
                label = made.classes[one.class_index]
                right = _is_right(take, label, one.start, one.stop)
                yield {
                    "method": method, "take": take.name, "actor": take.actor, "confidence": sure,
                    "margin": one.margin, "cost": one.cost, "right": right,
                }  # fmt: skip


def _laid(takes: Sequence[Judged]) -> TakeWords:
    offsets = np.cumsum([0, *(len(one.words) for one in takes)]).astype(np.int64)
    return TakeWords(np.arange(len(takes)), offsets, np.concatenate([one.words for one in takes]))


def _is_right(take: Judged, label: str, start: int, stop: int) -> bool:
    own = sum(max(0, min(stop, b) - max(start, a)) for name, a, b in take.truth if name == label)
    return 2 * own > stop - start


def _some(clips: Sequence[Clip], count: int | None, seed: int) -> list[Clip]:
    """Draw clips of every class."""
    random, found = np.random.default_rng(seed), []
    for label in sorted({clip.label for clip in clips}):
        own = [clip for clip in clips if clip.label == label]
        found += [own[place] for place in random.permutation(len(own))[:count]]
    return found


def of_mm(store: Store, truth: Path, clips: Sequence[Clip], seeds: Sequence[int]) -> Iterator[Trial]:
    """Yield the trials of the set mm."""
    segments: dict[str, list[tuple[str, int, int]]] = defaultdict(list)
    for one in placed_files(store, [read_labels(truth)]).segments:
        segments[one.take].append((one.label, int(one.start), int(one.stop)))
    takes = [
        Judged(name, "mm", store.words([store.take_id(name)]).take(0), tuple(own))
        for name, own in sorted(segments.items())
    ]
    for count in COUNTS[:-1]:
        for seed in seeds:
            yield Trial(_some(clips, count, seed), takes)
    yield Trial(clips, takes)


def of_left_out(clips: Sequence[Clip], seeds: Sequence[int]) -> Iterator[Trial]:
    """Yield the trials of the set left out."""
    for others, takes in _by_actor(clips):
        for seed in seeds:
            for count in COUNTS[:-1]:
                yield Trial(_some(others, count, seed), takes)
        yield Trial(others, takes)


def of_open(clips: Sequence[Clip], seeds: Sequence[int]) -> Iterator[Trial]:
    """Yield the trials of the set open."""
    labels = sorted({clip.label for clip in clips})
    for others, takes in _by_actor(clips):
        for seed in seeds:
            few = np.random.default_rng(seed).permutation(labels)[:OPEN_CLASSES].tolist()
            yield Trial([clip for clip in others if clip.label in few], takes)


def _by_actor(clips: Sequence[Clip]) -> Iterator[tuple[list[Clip], list[Judged]]]:
    """Yield for each actor the clips of the others, and takes of the own clips laid end to end."""
    for actor in sorted({clip.group for clip in clips}):
        own = [clip for clip in clips if clip.group == actor]
        yield (
            [clip for clip in clips if clip.group != actor],
            [
                Judged(f"{actor} {place}", actor, one.words, one.truth)
                for place, one in enumerate(laid_out(own, 1, len(own), OPEN_CLASSES + 4))
            ],
        )


def of_examples(store: Store, clips: Mapping[str, Clip], seeds: Sequence[int]) -> Iterator[Trial]:
    """Yield the trials of the set examples."""
    for seed in seeds:
        drawn = draw_examples(store.takes(), seed, 5, MIN_TAKES)
        yield Trial(
            [clips[name] for name in drawn.examples], [_alone(name, clips[name]) for name in drawn.rest["name"]]
        )


def of_styles(clips: Mapping[str, Clip], seeds: Sequence[int]) -> Iterator[Trial]:
    """Yield the trials of the set styles."""
    labels = [clip.label for clip in clips.values()]
    usual = {name: clip for name, clip in clips.items() if labels.count(clip.label) >= MIN_TAKES}
    styles = sorted({clip.group for clip in usual.values()})
    for seed in seeds:
        half = set(np.random.default_rng(seed).permutation(styles)[: len(styles) // 2].tolist())
        learned = [clip for clip in usual.values() if clip.group in half]
        known = {clip.label for clip in learned}
        rest = {name: clip for name, clip in usual.items() if clip.group not in half and clip.label in known}
        yield Trial(learned, [_alone(name, clip) for name, clip in rest.items()])


def _alone(name: str, clip: Clip) -> Judged:
    return Judged(name, clip.group, clip.words, ((clip.label, 0, len(clip.words)),))


def interval(rows: pl.DataFrame, by: str, measure: Callable[[I64], float]) -> tuple[float, float]:
    """Return the 95 % interval of a measure of rows, over takes or actors drawn with replacement."""
    groups = [
        np.array(own, np.int64) for own in rows.with_row_index().group_by(by, maintain_order=True).agg("index")["index"]
    ]
    drawn = np.random.default_rng(0).integers(0, len(groups), (BOOTSTRAPS, len(groups)))
    values = [measure(np.concatenate([groups[place] for place in one.tolist()])) for one in drawn]
    low, high = np.nanpercentile(values, [2.5, 97.5])
    return float(low), float(high)


def areas(rows: pl.DataFrame) -> dict[str, Callable[[I64], float]]:
    """Return the area under the receiver operating characteristic of each score, as a function of chosen rows."""
    right = rows["right"].to_numpy()

    def area(scores: F64) -> Callable[[I64], float]:
        return lambda some: auroc(scores[some], right[some])

    sure, margin = (area(rows[name].to_numpy()) for name in ("confidence", "margin"))
    cost = area(-rows["cost"].fill_nan(1.0).to_numpy())
    return {
        "confidence": sure,
        "margin": margin,
        "cost": cost,
        "confidence, more than cost": lambda some: sure(some) - cost(some),
    }


def report(name: str, rows: pl.DataFrame, by: str) -> None:
    """Print the tables of one set as Markdown; intervals are over takes or actors."""
    for method in METHODS:
        own = rows.filter(pl.col("method") == method)
        right, sure = own["right"].to_numpy(), own["confidence"].to_numpy()
        print(
            f"\n{name}, {method}: {own.height} segments of {own['take'].n_unique()} takes, {right.mean():.0%} right; "
            f"intervals over {own[by].n_unique()} {by}s\n"
        )
        print("| | AUROC (95 %) | Brier score |\n|---|---|--:|")
        for column, area in areas(own).items():
            low, high = interval(own, by, area)
            score = f"{brier(own[column].to_numpy(), right):.3f}" if column in ("confidence", "margin") else ""
            print(f"| {column} | {area(np.arange(len(right))):.2f} ({low:.2f}–{high:.2f}) | {score} |")
        fifths = (0.0, *np.quantile(sure, np.arange(1, FIFTHS) / FIFTHS).tolist(), 1.0)
        for title, edges in (("confidence", EDGES), ("fifth", fifths)):
            print(f"\n| {title} | segments | mean | right (95 %) |\n|---|--:|--:|---|")
            for bucket in reliability(sure, right, edges):
                if bucket.count:
                    some = own.filter((sure >= bucket.low) & (sure < bucket.high))
                    low, high = interval(some, by, _share(some))
                    print(
                        f"| {bucket.low:.2g} to {bucket.high:.2g} | {bucket.count} | {bucket.confidence:.0%} | "
                        f"{bucket.share:.0%} ({low:.0%}–{high:.0%}) |",
                        flush=True,
                    )


def _share(rows: pl.DataFrame) -> Callable[[I64], float]:
    right = rows["right"].to_numpy()
    return lambda some: float(right[some].mean())


def print_priors(study: Study, trials: Sequence[Trial]) -> None:
    """Print the priors that segments of all trials give."""
    for method in METHODS:
        names, parts, right = PRIORS[method].evidence, [], []
        for trial in trials:
            made = study.annotator(trial, method, calibrated=False)
            laid = _laid(trial.takes)
            found = [one.segments for one in annotate_words(made, laid)]
            parts.append(evidence_of(names, found, laid.offsets, *made.shapes))
            right += [
                _is_right(take, made.classes[one.class_index], one.start, one.stop)
                for take, own in zip(trial.takes, found, strict=True)
                for one in own
            ]
        evidence, truth = np.concatenate(parts), np.array(right)
        centres, scales = evidence.mean(axis=0), evidence.std(axis=0)
        bare = Prior(names, tuple(centres), tuple(scales), 0.0, (0.0,) * len(names))
        learned = learn_confidence(bare, evidence, np.zeros(len(truth), np.int64), truth, 1)
        offset, slopes = learned.coefficients[[0]] + learned.coefficients[-1], learned.coefficients[1:-1]
        rounded = [[round(float(one), 3) for one in some] for some in (centres, scales, offset, slopes)]
        print(method, names, *rounded)


def main() -> None:
    """Annotate, judge and print the tables."""
    parser = argparse.ArgumentParser(prog="python -m studies.confidence", description=__doc__)
    parser.add_argument("store", type=Path, help="store of `kinedex run hdm05-cmu`")
    parser.add_argument("truth", type=Path, help="ground truth of HDM05's takes")
    parser.add_argument("--bandai", type=Path, help="store of `python -m studies.bandai`")
    parser.add_argument("--clips", default="actor IN ('bd', 'bk', 'dg')", help="SQL filter of the clips of STORE")
    parser.add_argument("--seeds", type=int, nargs="+", default=[6, 7, 8, 9, 10, 11], help="of the draws of examples")
    parser.add_argument("--sets", nargs="+", default=["mm", "left out", "open", "examples", "styles"])
    parser.add_argument("--prior", action="store_true", help="print the numbers of the priors, and nothing else")
    given = parser.parse_args()
    store, executor, seeds = open_store(given.store), make_executor("serial", None), given.seeds
    clips = clips_of(store, given.clips)
    if given.prior:
        print_priors(Study(store, executor), [*of_left_out(clips, seeds), *of_open(clips, seeds)])
        return
    trials: dict[str, tuple[Store, str, Callable[[], Iterator[Trial]]]] = {
        "mm": (store, "take", lambda: of_mm(store, given.truth, clips, seeds)),
        "left out": (store, "take", lambda: of_left_out(clips, seeds)),
        "open": (store, "take", lambda: of_open(clips, seeds)),
    }
    if given.bandai is not None:
        bandai = open_store(given.bandai)
        takes = bandai.takes("class IS NOT NULL AND actor IS NOT NULL").sort("name")
        named = dict(zip(takes["name"].to_list(), clips_of(bandai, "true"), strict=True))
        trials["examples"] = bandai, "take", lambda: of_examples(bandai, named, seeds)
        trials["styles"] = bandai, "actor", lambda: of_styles(named, seeds)
    for name, (archive, by, make) in trials.items():
        if name not in given.sets:
            continue
        study = Study(archive, executor)
        found = [row for trial in make() for method in METHODS for row in study.rows(trial, method)]
        rows = pl.DataFrame(found, infer_schema_length=None)
        report(name, rows, by)
        if name == "examples":
            for part in ("dataset-1", "dataset-2"):
                report(f"{name} of {part}", rows.filter(pl.col("take").str.starts_with(part)), by)


if __name__ == "__main__":
    main()
