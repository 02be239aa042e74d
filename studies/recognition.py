"""`python -m studies.recognition BANDAI HDM05 TRUTH`: recognise motions by numbers beside bits, with few examples.

BANDAI is the store of `python -m studies.bandai`, HDM05 that of `kinedex run hdm05-cmu`, TRUTH the ground truth of its
takes. Method `best`, as in the pipeline `annotate`, and the recogniser of `kinedex.ops.numeric` learn from the same
examples and label the same takes:

- of each content of Bandai that has eight takes at least, a number of examples is drawn, whatever their style; the
  other takes are labelled as they are (per cent with the right content), and laid end to end, twenty to a long take,
  without anything that says where one ends;
- of HDM05, the clips of one actor at a time are laid end to end and labelled by what the others teach; and the takes of
  the actor mm, of whom there are no clips.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from kinedex.catalog.classes import OWN, load_classes
from kinedex.ops.arrays import F64, U64
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.evaluation.metrics import Counts, compare, pooled
from kinedex.ops.intervals import analysis_frame
from kinedex.ops.numeric.recogniser import Recogniser, TaughtMotion
from kinedex.ops.words import TakeWords
from kinedex.pipelines.annotation.annotators import Annotator, make_annotator
from kinedex.pipelines.annotation.batches import annotate_words
from kinedex.pipelines.annotation.methods import annotation_method
from kinedex.pipelines.engine.executors import Executor, make_executor
from kinedex.pipelines.templates.template_learning import TrainingClips, learn_templates
from kinedex.storage.formats.labels.formats import read_labels
from kinedex.storage.store.store import Store, open_store

LEAST = 8
END_TO_END = 20
DELTA, TAU = 0.05, 0.13
ACTORS = ("bd", "bk", "dg")
SOURCE_HZ = 120.0

Label = tuple[int, int, str]
"""Frames of a segment, stop excluded, and its class."""


@dataclass(frozen=True)
class Motion:
    """A take, or several laid end to end."""

    positions: F64
    words: U64
    truth: tuple[Label, ...]


def motions_of(store: Store) -> dict[str, Motion]:
    """Return the takes of a store by name; one that has a class shows it from its first to its last frame."""
    rows = store.takes().select("take_id", "name", "class").sort("take_id")
    places = [f"{joint}.{axis} AS {joint}_{axis}" for joint in JOINTS for axis in "xyz"]
    frames = pl.DataFrame(store.sql(f"SELECT take_id, {', '.join(places)} FROM frames ORDER BY take_id, frame"))
    found = {}
    for take_id, name, label in rows.iter_rows():
        own = frames.filter(pl.col("take_id") == take_id).drop("take_id").to_numpy().astype(np.float64)
        truth = ((0, len(own), label),) if label is not None else ()
        found[name] = Motion(own.reshape(-1, len(JOINTS), 3), store.words([take_id]).words, truth)
    return found


def end_to_end(motions: Sequence[Motion], count: int) -> list[Motion]:
    """Lay motions end to end, so many to a take."""
    found = []
    for first in range(0, len(motions), count):
        part = motions[first : first + count]
        ends = np.cumsum([0, *(len(one.words) for one in part)]).tolist()
        truth = [
            (start + at, stop + at, label)
            for one, at in zip(part, ends, strict=False)
            for start, stop, label in one.truth
        ]
        positions, words = (np.concatenate([getattr(one, name) for one in part]) for name in ("positions", "words"))
        found.append(Motion(positions, words, tuple(truth)))
    return found


def label_by_best(
    store: Store, examples: Sequence[Motion], takes: Sequence[Motion], executor: Executor
) -> list[list[Label]]:
    """Label takes by method best, with a template for each class of the examples."""
    by_class: dict[str, list[U64]] = {}
    for one in examples:
        by_class.setdefault(one.truth[0][2], []).append(one.words)
    clips = [
        TrainingClips(label, tuple(f"{label} {k}" for k in range(len(words))), tuple(words))
        for label, words in sorted(by_class.items())
    ]
    features = len(store.feature_set.features)
    templates = [one for task in learn_templates(clips, ["soft"], features, executor) for one in task]
    annotator: Annotator = make_annotator(
        store.feature_set, templates, load_classes(OWN, set(by_class)), DELTA, TAU,
        method=annotation_method("best"), clips=lambda: [one.words for one in examples],
    )  # fmt: skip
    offsets = np.cumsum([0, *(len(one.words) for one in takes)])
    words = TakeWords(np.arange(len(takes)), offsets, np.concatenate([one.words for one in takes]))
    return [
        [(segment.start, segment.stop, annotator.classes[segment.class_index]) for segment in one.segments]
        for one in annotate_words(annotator, words)
    ]


def taught(store: Store, examples: Sequence[Motion], archive: Sequence[Motion]) -> Recogniser:
    """Return a recogniser that has learned the examples; classes called left and right mirror each other."""
    labels = [one.truth[0][2] for one in examples]
    mirror = {label: mirrored(label) for label in labels}
    given = [TaughtMotion(one.positions, label) for one, label in zip(examples, labels, strict=True)]
    return Recogniser.fit(given, [one.positions for one in archive], JOINTS, store.rate_hz, mirror)


def mirrored(label: str) -> str:
    """Return the content of mirror images: with left for right, and itself without a side."""
    return label.replace("left", "\0").replace("right", "left").replace("\0", "right")


def scores(found: Sequence[Sequence[Label]], takes: Sequence[Motion]) -> tuple[float, float]:
    """Return F (frames) and F (segments) of labels, over all takes and classes."""
    counts: list[Counts] = []
    for own, take in zip(found, takes, strict=True):
        for label in sorted({one[2] for one in (*own, *take.truth)}):
            automatic, manual = ([one[:2] for one in some if one[2] == label] for some in (own, take.truth))
            counts.append(compare(automatic, manual))
    whole = pooled(counts)
    return whole.f1, whole.f2


def draw(motions: Mapping[str, Motion], count: int, seed: int) -> tuple[list[Motion], list[Motion]]:
    """Draw examples of each content; return them, and the other takes in a drawn order."""
    generator = np.random.default_rng(seed)
    sizes = Counter(one.truth[0][2] for one in motions.values())
    examples, rest = [], []
    for label in sorted(label for label, size in sizes.items() if size >= LEAST):
        own = [one for one in motions.values() if one.truth[0][2] == label]
        order = generator.permutation(len(own)).tolist()
        examples += [own[k] for k in order[:count]]
        rest += [own[k] for k in order[count:]]
    return examples, [rest[k] for k in generator.permutation(len(rest)).tolist()]


def most_of(labels: Sequence[Label]) -> str:
    """Return the class that labels most frames."""
    frames: Counter[str] = Counter()
    for start, stop, label in labels:
        frames[label] += stop - start
    return frames.most_common(1)[0][0] if frames else ""


def bandai_rows(store: Store, counts: Sequence[int], draws: int, executor: Executor) -> Iterator[str]:
    """Yield the rows of Bandai's contents."""
    motions = motions_of(store)
    for count in counts:
        alone: list[tuple[float, float]] = []
        laid: list[tuple[float, float, float, float]] = []
        for seed in range(draws):
            examples, rest = draw(motions, count, seed)
            long = end_to_end(rest, END_TO_END)
            recogniser = taught(store, examples, rest)
            names = [recogniser.classes[int(recogniser.classify(one.positions).argmax())] for one in rest]
            theirs = [most_of(own) for own in label_by_best(store, examples, rest, executor)]
            alone.append((_right(theirs, rest), _right(names, rest)))
            found = [[(one.start, one.stop, one.label) for one in recogniser.label(take.positions)] for take in long]
            laid.append((*scores(label_by_best(store, examples, long, executor), long), *scores(found, long)))
        best, ours = np.mean(alone, axis=0)
        yield f"| Bandai, whole takes, {count} examples, % right | {best:.1f} | {ours:.1f} |"
        mean = np.mean(laid, axis=0)
        yield f"| Bandai, end to end, {count} examples | {mean[0]:.2f}/{mean[1]:.2f} | {mean[2]:.2f}/{mean[3]:.2f} |"


def _right(labels: Sequence[str], takes: Sequence[Motion]) -> float:
    """Return the per cent of takes that have the right label."""
    return 100 * float(np.mean([label == one.truth[0][2] for label, one in zip(labels, takes, strict=True)]))


def hdm05_rows(store: Store, truth: Path, executor: Executor) -> Iterator[str]:
    """Yield the rows of HDM05's actors."""
    motions = motions_of(store)
    actors = dict(store.takes().select("name", "actor").iter_rows())
    clips = {name: one for name, one in motions.items() if one.truth and actors[name] in ACTORS}
    for left in ACTORS:
        examples = [one for name, one in clips.items() if actors[name] != left]
        own = [one for name, one in sorted(clips.items()) if actors[name] == left]
        order = np.random.default_rng(0).permutation(len(own)).tolist()
        yield _compared(f"HDM05, {left} left out", store, examples, end_to_end([own[k] for k in order], 12), executor)
    labels: dict[str, list[Label]] = {}
    for one in read_labels(truth).segments:
        start, stop = (analysis_frame(edge, SOURCE_HZ, store.rate_hz) for edge in one.source_frames(SOURCE_HZ))
        labels.setdefault(one.take, []).append((start, stop, one.label))
    takes = [
        Motion(motions[name].positions, motions[name].words, tuple(own))
        for name, own in sorted(labels.items())
        if name in motions
    ]
    yield _compared("HDM05, mm", store, list(clips.values()), takes, executor)


def _compared(name: str, store: Store, examples: Sequence[Motion], takes: Sequence[Motion], executor: Executor) -> str:
    """Return a row with the scores of both methods."""
    recogniser = Recogniser.fit(
        [TaughtMotion(one.positions, one.truth[0][2]) for one in examples],
        [one.positions for one in takes], JOINTS, store.rate_hz,
    )  # fmt: skip
    found = [[(one.start, one.stop, one.label) for one in recogniser.label(take.positions)] for take in takes]
    best = scores(label_by_best(store, examples, takes, executor), takes)
    ours = scores(found, takes)
    return f"| {name} | {best[0]:.2f}/{best[1]:.2f} | {ours[0]:.2f}/{ours[1]:.2f} |"


def main() -> None:
    """Print the table as Markdown."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.recognition", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("bandai", type=Path, help="store of `python -m studies.bandai`")
    parser.add_argument("hdm05", type=Path, help="store of `kinedex run hdm05-cmu`")
    parser.add_argument("truth", type=Path, help="ground truth of the takes of mm")
    parser.add_argument("--examples", type=int, nargs="+", default=[1, 3, 5, 10], help="of each content of Bandai")
    parser.add_argument("--draws", type=int, default=6, help="number of draws")
    given = parser.parse_args()
    executor = make_executor("serial", None)
    print("| F (frames)/F (segments), or per cent | best | numbers |\n|---|--:|--:|")
    for row in bandai_rows(open_store(given.bandai), given.examples, given.draws, executor):
        print(row, flush=True)
    for row in hdm05_rows(open_store(given.hdm05), given.truth, executor):
        print(row, flush=True)


if __name__ == "__main__":
    main()
