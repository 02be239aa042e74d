"""`python -m studies.corrections STORE`: what a person gains who corrects annotations, simulated with ground truth.

The store is that of `kinedex run annotate` with ground truth. One actor at a time is left out: the takes of that actor
are annotated and judged, and nothing else is done with them. The templates begin with one clip of each class, of other
actors. The takes of the other actors are annotated, and a simulated person looks at a few segments in each round: what
overlaps ground truth of its class becomes an example with the true edges, what agrees with another class an example of
that one, and the rest is rejected. Then everything is learned and annotated again. The orders in which segments are
looked at are compared: by confidence, by margin, by disagreement of `best` and `thesis`, at random. Where no take of
another actor has ground truth, the clips of each other actor are laid end to end; where none has any, so are those of
the actors who are left out, a third of all. With `--queries`, keyframe queries are learned from the examples of the
last round, with and without what was rejected, and takes are annotated within their hits.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import repeat
from pathlib import Path

import numpy as np
import polars as pl

from kinedex.catalog.classes import OWN, Classes, load_classes
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.ops.annotation.segments import Segment
from kinedex.ops.arrays import U64
from kinedex.ops.errors import KinedexError
from kinedex.ops.evaluation.metrics import Counts, compare, pooled
from kinedex.ops.words import TakeWords
from kinedex.pipelines.annotation.annotators import Annotator, make_annotator
from kinedex.pipelines.annotation.batches import annotate_words
from kinedex.pipelines.annotation.confidence_calibration import Target, calibrate_confidence
from kinedex.pipelines.annotation.methods import annotation_method
from kinedex.pipelines.annotation.threshold_calibration import calibrate
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.engine.executors import Executor, make_executor
from kinedex.pipelines.keyframes.learning_runs import learn_queries
from kinedex.pipelines.keyframes.parameters import KeyframeParameters, setting_of
from kinedex.pipelines.keyframes.query_learning import every_query, training_sets
from kinedex.pipelines.labels.file_segments import placed_files
from kinedex.pipelines.templates.examples import Rejected
from kinedex.pipelines.templates.template_learning import SubclassTemplate, TrainingClips, learn_templates
from kinedex.storage.formats.labels.formats import read_labels
from kinedex.storage.store.store import Store, open_store
from studies.few_clips import draw, truth_of

DELTA, TAU = 0.05, 0.13
AGREES = 0.5
"""A segment agrees with a manual one if they share this part of their union."""

PARTS = 3  # of the actors, where none has takes with ground truth

ORDERS = ("least confident", "smallest margin", "methods disagree", "random", "most confident")


@dataclass(frozen=True)
class Motion:
    """A long take with its actor, its words and its manual segments (class, start, stop)."""

    name: str
    actor: str
    words: U64
    truth: tuple[tuple[str, int, int], ...]


Found = tuple[Motion, str, Segment, float | None]
"""A segment with its motion, its class and its confidence, where it is calibrated."""


@dataclass
class Person:
    """The examples that a simulated person has made so far, and the segments that were looked at."""

    examples: dict[tuple[str, str], U64]
    actors: dict[str, str]
    rejected: list[Rejected] = field(default_factory=list)
    seen: dict[str, list[tuple[int, int]]] = field(default_factory=lambda: defaultdict(list))

    def has_seen(self, motion: Motion, segment: Segment) -> bool:
        """Return whether a segment was looked at before, as it is or nearly so."""
        return any(_shared(segment.start, segment.stop, *one) >= AGREES for one in self.seen[motion.name])

    def look(self, motion: Motion, label: str, segment: Segment) -> None:
        """Accept, correct or reject a segment."""
        self.seen[motion.name].append((segment.start, segment.stop))
        least = {label: 1e-9}  # a segment of the right class is corrected, however badly it is cut
        fitting = [
            one for one in motion.truth if _shared(segment.start, segment.stop, *one[1:]) >= least.get(one[0], AGREES)
        ]
        if not any(one[0] == label for one in fitting):
            self.rejected.append(Rejected(label, motion.name, motion.words[segment.start : segment.stop]))
        for name, start, stop in fitting:
            self.examples[name, f"{motion.name}[{start}:{stop}]"] = motion.words[start:stop]

    def clips(self) -> list[TrainingClips]:
        """Return the examples by class."""
        found: dict[str, list[str]] = defaultdict(list)
        for label, name in sorted(self.examples):
            found[label].append(name)
        return [
            TrainingClips(
                label,
                tuple(names),
                tuple(self.examples[label, name] for name in names),
                takes=tuple(name.rpartition("[")[0] or name for name in names),
            )
            for label, names in found.items()
        ]


def _shared(start: int, stop: int, first: int, last: int) -> float:
    return max(0, min(stop, last) - max(start, first)) / (max(stop, last) - min(start, first))


def motions_of(
    store: Store, classes: Classes, clips: pl.DataFrame, truth_file: Path | None
) -> tuple[list[Motion], list[Motion]]:
    """Return the takes with ground truth, of the store or of a file, and the clips of each actor laid end to end."""
    rows = {row["name"]: row for row in store.takes().iter_rows(named=True)}
    names = {row["take_id"]: name for name, row in rows.items()}
    segments: dict[str, list[tuple[str, int, int]]] = defaultdict(list)
    if truth_file is not None:
        for one in placed_files(store, [read_labels(truth_file)]).segments:
            segments[one.take].append((one.label, int(one.start), int(one.stop)))
    elif store.result("ground_truth").num_rows:
        for (take_id, label), ranges in truth_of(store).items():
            segments[names[take_id]] += [(label, *one) for one in ranges]
    takes = [
        Motion(name, rows[name]["actor"], store.words([rows[name]["take_id"]]).take(0), tuple(own))
        for name, own in segments.items()
    ]
    of = classes.of_subclass()
    laid = []
    for (actor,), group in clips.sort("actor", "name").group_by("actor", maintain_order=True):
        words, truth, at = [], [], 0
        for take_id, subclass in (
            group.sample(fraction=1.0, shuffle=True, seed=1).select("take_id", "class").iter_rows()
        ):
            words.append(store.words([take_id]).take(0))
            truth.append((of.get(subclass, subclass), at, at + len(words[-1])))
            at += len(words[-1])
        laid.append(Motion(f"{actor} laid", str(actor), np.concatenate(words), tuple(truth)))
    return takes, laid


def annotator(
    store: Store,
    templates: Sequence[SubclassTemplate],
    person: Person,
    method: str,
    tau: object = TAU,
    queries: Sequence[KeyframeQuery] = (),
) -> Annotator:
    """Return an annotator of one method with templates of a person's examples."""
    known = load_classes(OWN, {one.subclass for one in person.clips()})
    thresholds = tau if isinstance(tau, dict) else dict.fromkeys(known.names, TAU)
    return make_annotator(
        store.feature_set, templates, known, DELTA, thresholds, queries, method=annotation_method(method),
        clips=lambda: list(person.examples.values()),
    )  # fmt: skip


def with_confidence(
    store: Store, made: Annotator, person: Person, pool: Sequence[Motion], executor: Executor
) -> Annotator:
    """Return an annotator of `best` with a confidence that is calibrated on a person's examples."""
    clips = person.clips()
    found = calibrate_confidence(
        clips,
        person.actors,
        load_classes(OWN, {one.subclass for one in clips}),
        "best",
        Target([len(one.words) for one in pool], [one.actor for one in pool]),
        lambda some, _: annotator(store, learned(store, some, executor), person, "best"),
        executor,
    )
    return replace(made, confidence=found.confidence)


def segments_of(made: Annotator, motions: Sequence[Motion]) -> list[Found]:
    """Annotate motions, and return each segment with its motion, class and confidence."""
    offsets = np.cumsum([0, *(len(one.words) for one in motions)]).astype(np.int64)
    words = TakeWords(np.arange(len(motions)), offsets, np.concatenate([one.words for one in motions]))
    return [
        (motion, made.classes[segment.class_index], segment, sure)
        for motion, one in zip(motions, annotate_words(made, words), strict=True)
        for segment, sure in zip(one.segments, one.confidences or repeat(None), strict=False)
    ]


def judged(found: Sequence[Found], motions: Sequence[Motion]) -> Counts:
    """Count the agreement of segments and ground truth over all motions and classes."""
    automatic, manual = defaultdict(list), defaultdict(list)
    for motion, label, segment, _ in found:
        automatic[motion.name, label].append((segment.start, segment.stop))
    for motion in motions:
        for label, start, stop in motion.truth:
            manual[motion.name, label].append((start, stop))
    return pooled(compare(automatic[key], manual[key]) for key in sorted({*automatic, *manual}))


def ordered(order: str, best: Sequence[Found], thesis: Sequence[Found], random: np.random.Generator) -> list[Found]:
    """Return segments of `best` in the order in which a person looks at them."""
    others: Mapping[tuple[str, str], list[Segment]] = defaultdict(list)
    for motion, label, segment, _ in thesis:
        others[motion.name, label].append(segment)

    def agreement(one: Found) -> float:
        motion, label, segment, _ = one
        shares = [_shared(segment.start, segment.stop, own.start, own.stop) for own in others[motion.name, label]]
        return max(shares, default=0.0)

    keys: dict[str, Callable[[Found], float]] = {
        "least confident": lambda one: one[3] or 0.0,
        "smallest margin": lambda one: one[2].margin,
        "most confident": lambda one: -(one[3] or 0.0),
        "methods disagree": agreement,
        "random": lambda one: float(random.random()),
    }
    shuffled = [best[index] for index in random.permutation(len(best))]  # segments that are alike in no set order
    return sorted(shuffled, key=keys[order])


def learned(store: Store, clips: Sequence[TrainingClips], executor: Executor) -> list[SubclassTemplate]:
    """Return soft templates of examples."""
    features = len(store.feature_set.features)
    return [one for task in learn_templates(clips, ["soft"], features, executor) for one in task]


def calibrated(store: Store, person: Person, executor: Executor, *, negatives: bool) -> dict[str, float]:
    """Return calibrated thresholds of a person's examples, with or without what was rejected."""
    clips = person.clips()
    classes = load_classes(OWN, {one.subclass for one in clips})
    rejected = person.rejected if negatives else ()
    try:
        found = calibrate(
            clips, person.actors, classes, DELTA, lambda some: learned(store, some, executor), executor, rejected
        ).taus
    except KinedexError:  # the examples of each class are of one actor
        found = {}
    return {name: found.get(name, TAU) for name in classes.names}


def learned_queries(
    store: Store, person: Person, runs: int, executor: Executor, *, negatives: bool
) -> list[KeyframeQuery]:
    """Return keyframe queries of a person's examples, with or without what was rejected."""
    clips = person.clips()
    shipped = load_pipeline("keyframes").stage("learn_keyframes").params
    assert isinstance(shipped, KeyframeParameters)
    params = shipped.model_copy(update={"runs": runs})
    classes = load_classes(OWN, {one.subclass for one in clips})
    wanted = training_sets(clips, classes, person.rejected if negatives else ())
    outcomes = [one.outcome for one in learn_queries(wanted, setting_of(params, store), params.rounds(), executor)]
    return every_query(outcomes, store.feature_set)


def simulate(
    store: Store,
    seeds: Person,
    pool: Sequence[Motion],
    test: Sequence[Motion],
    order: str,
    given: argparse.Namespace,
    seed: int,
) -> tuple[list[Counts], dict[tuple[str, bool], Counts]]:
    """Return the agreement on unseen takes after each round, and that of the last round with and without rejections."""
    executor = make_executor("serial", None)
    random = np.random.default_rng(seed)
    person = Person(dict(seeds.examples), seeds.actors)
    curve: list[Counts] = []
    templates = learned(store, person.clips(), executor)
    for number in range(given.rounds + 1):
        best = annotator(store, templates, person, "best")
        curve.append(judged(segments_of(best, test), test))
        if number == given.rounds:
            break
        if "confident" in order:
            best = with_confidence(store, best, person, pool, executor)
        of_best = [one for one in segments_of(best, pool) if not person.has_seen(one[0], one[2])]
        thesis = annotator(store, templates, person, "thesis") if order == "methods disagree" else None
        of_thesis = segments_of(thesis, pool) if thesis is not None else []
        for motion, label, segment, _ in ordered(order, of_best, of_thesis, random)[: given.each]:
            person.look(motion, label, segment)
        templates = learned(store, person.clips(), executor)
    ends: dict[tuple[str, bool], Annotator] = {}
    print(f"{order}: {len(person.rejected)} rejections, {len(person.examples)} examples", flush=True)
    for negatives in (False, True):
        taus = calibrated(store, person, executor, negatives=negatives)
        ends["thesis, calibrated τ", negatives] = annotator(store, templates, person, "thesis", taus)
        if given.queries:
            queries = learned_queries(store, person, given.runs, executor, negatives=negatives)
            for method in ("thesis", "best"):
                made = annotator(store, templates, person, method, queries=queries)
                ends[f"{method}, learned queries", negatives] = made
    return curve, {name: judged(segments_of(made, test), test) for name, made in ends.items()}


def main() -> None:
    """Simulate all orders and print the tables as Markdown."""
    parser = argparse.ArgumentParser(prog="python -m studies.corrections", description=__doc__)
    parser.add_argument("store", type=Path, help="store of `kinedex run annotate` with ground truth")
    parser.add_argument("--classes", default=OWN, help="the classes that the ground truth speaks of")
    parser.add_argument("--truth", type=Path, help="label file with ground truth; that of the store unless given")
    parser.add_argument("--rounds", type=int, default=6, help="rounds")
    parser.add_argument("--each", type=int, default=10, help="segments that the person looks at in a round")
    parser.add_argument("--actors", type=int, default=3, help="actors (or parts of them) to leave out, at most")
    parser.add_argument("--draws", type=int, default=1, help="draws of the first clips for each actor")
    parser.add_argument("--orders", nargs="+", choices=ORDERS, default=ORDERS, help="orders to compare")
    parser.add_argument("--least", type=int, default=1, help="classes with fewer clips are excluded")
    parser.add_argument("--most", type=int, help="clips of an actor and class that take part, at most")
    parser.add_argument("--queries", action="store_true", help="learn keyframe queries with and without rejections")
    parser.add_argument("--runs", type=int, default=8, help="runs of keyframe learning, at most")
    given = parser.parse_args()
    store = open_store(given.store)
    clips = clips_of(store, given.least, given.most)
    classes = load_classes(given.classes, set(clips["class"]))
    curves, ends = defaultdict(list), defaultdict(list)
    parts = list(parts_of(store, classes, clips, given))
    for actors, pool, test in parts:
        for seed in range(given.draws):
            others = clips.filter(~pl.col("actor").is_in(actors))
            others = others.with_columns(pl.col("class").replace(classes.of_subclass()))
            first = others.filter(pl.col("name").is_in(draw(others, 1, seed)))
            words = {row["name"]: store.words([row["take_id"]]).take(0) for row in first.iter_rows(named=True)}
            people = {one.name: one.actor for one in (*pool, *test)} | dict(first.select("name", "actor").iter_rows())
            seeds = Person(
                {(row["class"], row["name"]): words[row["name"]] for row in first.iter_rows(named=True)}, people
            )
            for order in given.orders:
                curve, end = simulate(store, seeds, pool, test, order, given, seed)
                curves[order].append([one.f1 for one in curve])
                for (name, negatives), counts in end.items():
                    ends[order, name, negatives].append([counts.f1, counts.f2])
    print(f"{len(parts)} parts left out, {given.draws} draws; at first one clip of {len(seeds.examples)} classes\n")
    print(f"| looked at | {' | '.join(str(given.each * number) for number in range(given.rounds + 1))} |")
    print(f"|---|{'--:|' * (given.rounds + 1)}")
    for order, rows in curves.items():
        print(f"| {order} | {' | '.join(f'{value:.2f}' for value in np.mean(rows, axis=0))} |")
    print("\n| last round | | F (frames) | F (segments) | with rejections | F (segments) |")
    print("|---|---|--:|--:|--:|--:|")
    for order, name in dict.fromkeys((order, name) for order, name, _ in ends):
        cells = [value for negatives in (False, True) for value in np.mean(ends[order, name, negatives], axis=0)]
        print(f"| {order} | {name} | {' | '.join(f'{value:.3f}' for value in cells)} |")


def clips_of(store: Store, least: int, most: int | None) -> pl.DataFrame:
    """Return the clips of classes that have enough, of each actor and class at most so many."""
    clips = store.takes("class IS NOT NULL AND actor IS NOT NULL").sort("name")
    clips = clips.filter(pl.len().over("class") >= least)
    return clips if most is None else clips.filter(pl.int_range(pl.len()).over("actor", "class") < most)


def parts_of(
    store: Store, classes: Classes, clips: pl.DataFrame, given: argparse.Namespace
) -> Iterator[tuple[list[str], list[Motion], list[Motion]]]:
    """Yield the actors of each part that is left out, the motions of others to look at, and those to judge."""
    takes, laid = motions_of(store, classes, clips, given.truth)
    if takes:
        for actor in sorted({one.actor for one in takes})[: given.actors]:
            pool = [one for one in takes if one.actor != actor] or [one for one in laid if one.actor != actor]
            yield [actor], pool, [one for one in takes if one.actor == actor]
    else:
        actors = sorted({one.actor for one in laid})
        for place in range(given.actors):
            own = actors[place::PARTS]
            test = [one for one in laid if one.actor in own]
            yield own, [one for one in laid if one.actor not in own], test


if __name__ == "__main__":
    main()
