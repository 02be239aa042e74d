"""`python -m studies.decoding STORE`: choose the parameters of method best on example clips alone.

The clips of one actor at a time are left out, laid end to end in a drawn order, and labelled with the templates of the
others. Parameters that suit other people of the same studio may not suit anything else, so the same clips are also
changed to resemble other archives; and content in styles that no example shows is labelled where a second store has
any. Takes to annotate, and their ground truth, are not used. See `SETS`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rich import box
from rich.table import Table

from kinedex.catalog.classes import load_classes
from kinedex.catalog.features import FeatureSet
from kinedex.console.terminal import make_console
from kinedex.ops.annotation.background import SPLITS, background
from kinedex.ops.annotation.decoding import Decoding, ExplainedSegment, concatenated_columns, explain, margins
from kinedex.ops.arrays import U64
from kinedex.ops.evaluation.metrics import Counts, compare, pooled
from kinedex.ops.templates.templates import LearnedTemplate, learn_soft
from kinedex.ops.words import NO_WORD, TakeWords
from kinedex.pipelines.annotation.annotators import make_annotator
from kinedex.pipelines.annotation.batches import annotate_words
from kinedex.pipelines.templates.template_learning import SubclassTemplate
from kinedex.storage.store.store import Store, open_store

F64 = npt.NDArray[np.float64]

SETS = {
    "closed": "templates of all classes: every frame has a label",
    "open": "templates of five classes, drawn four times: what is of other classes should get no label",
    "fast": "closed, with two of seven frames left out",
    "slow": "closed, with three of seven frames twice",
    "habits": "closed; in each take five features, drawn, are always on or always off, as by another habit or studio",
    "amid": "closed, with intervals of 1.5 to 5 s of another archive's take between the clips",
    "styles": "contents in styles left out, three at a time, laid end to end",
    "styles open": "the same with templates of half of the contents, drawn twice",
    "alone": "the same as styles, every clip a take of its own",
}

MAX_CLIPS, CLIPS_A_TAKE, ORDERS = 4, 9, 3  # clips of a class in a drawn order, so that no class fills the takes
OPEN_SETS, OPEN_CLASSES = 4, 5
PACE = 1.4
HABITS = 5
STYLE_GROUPS, STYLE_CLIPS, MIN_CLIPS = 5, 7, 8

BANDS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)


@dataclass(frozen=True)
class Setting:
    """The parameters that are tried: the splits of the background, and the others."""

    decoding: Decoding = field(default_factory=Decoding)
    splits: int = SPLITS


GRID = [
    Setting(
        Decoding(0.05, 1.0, 0.05, 0.1, -0.06), 0
    ),  # chosen on the sets closed and open alone, with one average posture
    *(Setting(splits=splits) for splits in (0, 1, 3)),
    *(Setting(Decoding(smoothing=smoothing)) for smoothing in (0.02, 0.04, 0.05)),
    *(Setting(Decoding(entry=entry)) for entry in (0.4, 1.0, 1.5)),
    *(Setting(Decoding(skip=skip)) for skip in (0.0, 0.03, 0.05)),
    *(Setting(Decoding(stay=stay)) for stay in (0.05, 0.2)),
    *(Setting(Decoding(gain=gain)) for gain in (0.01, 0.0, -0.02, -0.04)),
]


@dataclass(frozen=True)
class Clip:
    """One example clip; clips of one group are left out together."""

    group: str
    label: str
    words: U64


@dataclass(frozen=True)
class LaidOut:
    """Clips laid end to end: their words, and the class and frames of each clip."""

    words: U64
    truth: tuple[tuple[str, int, int], ...]


class Fold:
    """Templates and background of the clips of some groups, and the takes made of the others'."""

    def __init__(self, clips: Sequence[Clip], takes: Sequence[LaidOut], features: int) -> None:
        self.takes, self._features, self._words = takes, features, [clip.words for clip in clips]
        labels = sorted({clip.label for clip in clips})
        self.learned = {
            label: learn_soft([clip.words for clip in clips if clip.label == label], features) for label in labels
        }
        self._usual: dict[int, F64] = {}

    def usual(self, splits: int) -> F64:
        """Return the background, learned once."""
        if splits not in self._usual:
            self._usual[splits] = background(self._words, self._features, splits)
        return self._usual[splits]


@dataclass(frozen=True)
class Trial:
    """Takes of a fold, and the classes that are labelled in them and counted."""

    fold: Fold
    takes: Sequence[LaidOut]
    labels: Sequence[str]

    @cached_property
    def known(self) -> list[tuple[str, LearnedTemplate]]:
        """Return the classes that have a template."""
        return [(label, self.fold.learned[label]) for label in self.labels if label in self.fold.learned]

    def explained(self, setting: Setting) -> Iterator[tuple[LaidOut, list[ExplainedSegment], F64]]:
        """Yield each take with its explanation and the margins."""
        templates = [one.template for _, one in self.known]
        usual = self.fold.usual(setting.splits)
        columns, classes = concatenated_columns(templates, usual, setting.decoding), np.arange(len(templates))
        for take in self.takes:
            found = explain(templates, usual, take.words, setting.decoding, columns=columns)
            yield take, found, margins(found, templates, classes, usual, take.words, setting.decoding, columns)

    def best(self, setting: Setting) -> Counts:
        """Count the labels of the best explanation."""
        return pooled(
            self._compare(take, [(self.known[one.template][0], one.start, one.stop) for one in found])
            for take, found, _ in self.explained(setting)
        )

    def thesis(self, feature_set: FeatureSet, tau: float) -> Counts:
        """Count the labels of the thesis's method."""
        templates = [SubclassTemplate(label, "soft", learned, ()) for label, learned in self.known]
        classes = load_classes("own", {label for label, _ in self.known})
        annotator = make_annotator(feature_set, templates, classes, 0.05, tau)
        counts = []
        for take in self.takes:
            words = TakeWords(np.array([0]), np.array([0, len(take.words)]), take.words)
            segments = annotate_words(annotator, words)[0].segments
            found = [(annotator.classes[one.class_index], one.start, one.stop) for one in segments]
            counts.append(self._compare(take, found))
        return pooled(counts)

    def _compare(self, take: LaidOut, found: Sequence[tuple[str, int, int]]) -> Counts:
        return pooled(
            compare(*([(start, stop) for name, start, stop in side if name == label] for side in (found, take.truth)))
            for label in self.labels
        )


def clips_of(store: Store, where: str) -> list[Clip]:
    """Return the clips that a filter selects, by name."""
    takes = store.takes(f"class IS NOT NULL AND actor IS NOT NULL AND ({where})").sort("name")
    words = store.words(takes["take_id"].to_list())
    place = {take: index for index, take in enumerate(words.take_ids.tolist())}
    return [Clip(row["actor"], row["class"], words.take(place[row["take_id"]])) for row in takes.iter_rows(named=True)]


def laid_out(clips: Sequence[Clip], orders: int, most: int, a_take: int) -> list[LaidOut]:
    """Lay clips end to end in drawn orders."""
    found = []
    for seed in range(orders):
        random = np.random.default_rng(seed)
        chosen: list[Clip] = []
        for label in sorted({clip.label for clip in clips}):
            own = [clip for clip in clips if clip.label == label]
            chosen += [own[index] for index in random.permutation(len(own))[:most]]
        order = [chosen[index] for index in random.permutation(len(chosen))]
        for start in range(0, len(order), a_take):
            part = order[start : start + a_take]
            found.append(_joined([(clip.label, clip.words) for clip in part]))
    return found


def _joined(parts: Sequence[tuple[str | None, U64]]) -> LaidOut:
    """Lay words end to end; words without a label belong to no class."""
    edges = pairwise(np.cumsum([0, *(len(words) for _, words in parts)]).tolist())
    truth = [(label, *edge) for (label, _), edge in zip(parts, edges, strict=True) if label is not None]
    return LaidOut(np.concatenate([words for _, words in parts]), tuple(truth))


def _parts(take: LaidOut) -> list[tuple[str, U64]]:
    return [(label, take.words[start:stop]) for label, start, stop in take.truth]


def paced(take: LaidOut, pace: float) -> LaidOut:
    """Change the pace of a take: drop frames or repeat them. (Features of speed stay as they were.)"""
    return _joined(
        [(label, words[np.arange(0, len(words) - 0.5, pace).round().astype(int)]) for label, words in _parts(take)]
    )


def with_habits(take: LaidOut, random: np.random.Generator, features: int) -> LaidOut:
    """Set some drawn features of a take always on or always off."""
    words = take.words.copy()
    for feature in random.permutation(features)[:HABITS].tolist():
        bit, on = np.uint64(1 << feature), random.random() < 0.5
        words = np.where(words == NO_WORD, words, words | bit if on else words & ~bit)
    return replace(take, words=words)


def amid(take: LaidOut, others: U64, rate_hz: float, random: np.random.Generator) -> LaidOut:
    """Insert an interval of other motion before each clip of a take."""
    parts: list[tuple[str | None, U64]] = []
    for part in _parts(take):
        length = int(rate_hz * random.uniform(1.5, 5.0))
        start = int(random.integers(0, max(len(others) - length, 1)))
        parts += [(None, others[start : start + length]), part]
    return _joined(parts)


def of_people(store: Store, where: str, other: str | None) -> dict[str, list[Trial]]:
    """Return the folds that leave out one actor each."""
    clips, features = clips_of(store, where), len(store.feature_set.features)
    labels = sorted({clip.label for clip in clips})
    folds = []
    for actor in sorted({clip.group for clip in clips}):
        takes = laid_out([clip for clip in clips if clip.group == actor], ORDERS, MAX_CLIPS, CLIPS_A_TAKE)
        folds.append(Fold([clip for clip in clips if clip.group != actor], takes, features))
    random = np.random.default_rng(1)
    few = min(OPEN_CLASSES, len(labels))
    drawn = [sorted(random.permutation(labels)[:few].tolist()) for _ in range(OPEN_SETS)]

    def changed(change: Callable[[LaidOut], LaidOut]) -> list[Trial]:
        return [Trial(fold, [change(take) for take in fold.takes], labels) for fold in folds]

    habits, intervals = np.random.default_rng(2), np.random.default_rng(3)
    sets = {
        "closed": changed(lambda take: take),
        "open": [Trial(fold, fold.takes, some) for some in drawn for fold in folds],
        "fast": changed(lambda take: paced(take, PACE)),
        "slow": changed(lambda take: paced(take, 1 / PACE)),
        "habits": changed(lambda take: with_habits(take, habits, features)),
    }
    if other is not None:
        words = store.words([store.take_id(other)]).words
        sets["amid"] = changed(lambda take: amid(take, words, store.rate_hz, intervals))
    return sets


def of_styles(store: Store, where: str) -> dict[str, list[Trial]]:
    """Return the folds that leave out some styles each; a store of `studies.bandai` has the style as actor."""
    clips, features = clips_of(store, where), len(store.feature_set.features)
    every = [clip.label for clip in clips]
    labels = sorted({label for label in every if every.count(label) >= MIN_CLIPS})
    clips = [clip for clip in clips if clip.label in labels]
    styles, random = sorted({clip.group for clip in clips}), np.random.default_rng(2)
    halves = [sorted(random.permutation(labels)[: len(labels) // 2].tolist()) for _ in range(2)]
    found: dict[str, list[Trial]] = {"styles": [], "styles open": [], "alone": []}
    for first in range(STYLE_GROUPS):
        out = styles[first::STYLE_GROUPS]
        theirs = [clip for clip in clips if clip.group in out]
        takes = laid_out(theirs, 1, len(theirs), STYLE_CLIPS)
        fold = Fold([clip for clip in clips if clip.group not in out], takes, features)
        found["styles"].append(Trial(fold, takes, labels))
        found["styles open"] += [Trial(fold, takes, half) for half in halves]
        found["alone"].append(Trial(fold, [_joined([part]) for take in takes for part in _parts(take)], labels))
    return found


def grid(sets: Mapping[str, Sequence[Trial]], feature_set: FeatureSet) -> Table:
    """Lay out F (frames) and F (segments) of every setting and of the thesis's method on every set."""
    table = Table(box=box.SIMPLE_HEAD, title="F (frames), F (segments)", title_justify="left")
    for name in ("splits", "smoothing", "entry", "skip", "stay", "gain", *sets, "mean"):
        table.add_column(name, justify="right", min_width=len(name.split()[0]))

    def add(cells: Sequence[str], counts: Callable[[Trial], Counts], style: str | None = None) -> None:
        scores = [pooled(counts(trial) for trial in trials) for trials in sets.values()]
        mean = float(np.mean([[one.f1, one.f2] for one in scores]))
        table.add_row(*cells, *(f"{one.f1:.3f} {one.f2:.3f}" for one in scores), f"{mean:.3f}", style=style)

    for setting in [Setting(), *(one for one in GRID if one != Setting())]:
        one = setting.decoding
        cells = [f"{value:g}" for value in (setting.splits, one.smoothing, one.entry, one.skip, one.stay, one.gain)]
        add(cells, lambda trial, setting=setting: trial.best(setting), "bold" if setting == Setting() else None)  # type: ignore[misc]
    for tau in (0.13, 0.06):
        add(["thesis", f"τ = {tau}", *[""] * 4], lambda trial, tau=tau: trial.thesis(feature_set, tau))  # type: ignore[misc]
    return table


def reliability(sets: Mapping[str, Sequence[Trial]]) -> Table:
    """Lay out the fraction of right segments by confidence: those of the class that most of their frames have."""
    table = Table(box=box.SIMPLE_HEAD, title="right, of segments by confidence", title_justify="left")
    for name in ("confidence", *sets, "all"):
        table.add_column(name, justify="right")
    found: dict[str, tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]] = {}
    for name, trials in sets.items():
        sure, right = [], []
        for trial in trials:
            for take, segments, sureness in trial.explained(Setting()):
                for one, confidence in zip(segments, sureness.tolist(), strict=True):
                    label = trial.known[one.template][0]
                    own = sum(max(0, min(one.stop, b) - max(one.start, a)) for at, a, b in take.truth if at == label)
                    sure.append(confidence)
                    right.append(2 * own > one.stop - one.start)
        found[name] = np.digitize(sure, BANDS[1:-1]), np.array(right)
    bands, rights = zip(*found.values(), strict=True)
    found["all"] = np.concatenate(bands), np.concatenate(rights)
    for index, (low, high) in enumerate(pairwise(BANDS)):
        cells = [right[bands == index] for bands, right in found.values()]
        table.add_row(
            f"{low:g} to {high:g}", *(f"{one.mean():.0%} of {len(one)}" if len(one) else "–" for one in cells)
        )
    return table


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m studies.decoding", description=__doc__)
    parser.add_argument("store", type=Path, help="a store with example clips of several actors")
    parser.add_argument("--where", default="true", help="which of them: a SQL filter")
    parser.add_argument("--amid", help="name of a take of the store, of other motions, to lay between the clips")
    parser.add_argument("--styles", type=Path, help="a store of `studies.bandai`")
    parser.add_argument("--styles-where", default="name LIKE 'dataset-1%'", help="which of its takes: a SQL filter")
    given = parser.parse_args()
    store = open_store(given.store)
    sets = of_people(store, given.where, given.amid)
    if given.styles is not None:
        sets |= of_styles(open_store(given.styles), given.styles_where)
    console = make_console()
    for name in sets:
        console.print(f"{name}: {SETS[name]}")
    console.print(grid(sets, store.feature_set))
    console.print(reliability(sets))


if __name__ == "__main__":
    main()
