"""`python -m benchmarks.keyframe_study STORE`: how well learned keyframe queries find people who were left out.

Queries are learned without the clips of one actor and searched in these, joined to takes in random order; for every
actor in turn, and for every variant of the learning. Takes with ground truth, if the store has some, are searched with
queries learned from all clips: they choose nothing. Tables are Markdown, as in docs/keyframe-learning.md.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from catalog.classes import load_classes
from ops.words import TakeWords
from pipelines.config import load_pipeline
from pipelines.executors import Executor, make_executor
from pipelines.keyframes.background import mine
from pipelines.keyframes.learning import Lesson, Outcome, lessons
from pipelines.keyframes.margins import hit_ranges
from pipelines.keyframes.runs import Rounds, learn
from pipelines.stages.learn_keyframes import Params, setting_of
from pipelines.stages.leave_one_out import without
from pipelines.templates.learning import TrainingClips, training_clips
from storage.store import Store, open_store

CLIPS_A_TAKE = 9
THESIS = "numbers of the thesis"

VARIANTS: dict[str, dict[str, object]] = {
    "genetic": {},
    "random search": {"learner": "random"},
    "greedy columns": {"learner": "greedy"},
    THESIS: {},
    "random search, numbers of the thesis": {"learner": "random"},
    "greedy columns, numbers of the thesis": {"learner": "greedy"},
    "one query a class": {"alternatives": 1},
    "three queries a class": {"alternatives": 3},
    "margins by the formula": {"margins": "formula"},
    "the wider margins": {"margins": "wider"},
    "steady 0": {"steady": 0},
    "tempo 0": {"tempo": 0.0},
    "joins 0": {"joins": 0},
    "parsimony 0": {"parsimony": 0.0},
    "gap_cost 0": {"gap_cost": 0.0},
    "100 generations": {"generations": 100},
    "beta 4": {"beta": 4.0},
}
"""What is changed of the numbers of `configs/pipelines/keyframes.yaml`, or, by their names, of the thesis's."""


@dataclass(frozen=True)
class Searched:
    """Takes to search: words, and for each take its segments (class, start, stop)."""

    words: TakeWords
    segments: tuple[tuple[tuple[str, int, int], ...], ...]


@dataclass(frozen=True)
class Measured:
    """How one class's queries did: segments, those touched by hits, those touched with margins, shares of frames."""

    label: str
    segments: int
    hit: int
    touched: int
    covered: float
    kept: float
    own: float


def main() -> None:
    """Measure the variants and print their tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("store", type=Path)
    parser.add_argument("--variant", action="append", choices=sorted(VARIANTS), help="only this one; may be repeated")
    parser.add_argument("--runs", type=int, default=16)
    parser.add_argument("--seeds", type=int, default=1, help="how often the whole is repeated, with other seeds")
    parser.add_argument("--workers", type=int, default=None)
    parser.add_argument("--background", help="a filter: takes whose false hits are further negatives")
    parser.add_argument("--clips-only", action="store_true", help="leave the takes with ground truth out")
    parser.add_argument("--by-class", action="store_true", help="a table of classes for each variant")
    arguments = parser.parse_args()
    store = open_store(arguments.store)
    executor = make_executor("processes", arguments.workers)
    print("| variant | left out | segments hit | with margins | of them covered | frames kept |")
    print("|---|---|---|---|---|---|")
    details = []
    for name in arguments.variant or VARIANTS:
        rows = measure(
            store, name, arguments.runs, arguments.seeds, executor, arguments.background, arguments.clips_only
        )
        pooled = [one for actor, found in rows.items() if actor != "takes" for one in found]
        print(_line(name, "each actor in turn", pooled), flush=True)
        for actor, found in rows.items():
            print(_line("", actor, found), flush=True)
        details += [(name, actor, one) for actor, found in rows.items() for one in found]
    if arguments.by_class:
        _by_class(details)
    executor.close()


def measure(
    store: Store,
    variant: str,
    runs: int,
    seeds: int,
    executor: Executor,
    background: str | None = None,
    clips_only: bool = False,
) -> dict[str, list[Measured]]:
    """Learn without each actor, search that actor; then learn from all, and search the takes with ground truth."""
    takes = store.takes("class IS NOT NULL")
    clips = training_clips(store, takes)
    actor_of = dict(takes.select("name", "actor").iter_rows())
    found: dict[str, list[Measured]] = {}
    for seed in range(seeds):
        params = params_of(variant, runs, seed)
        for actor in sorted(set(actor_of.values())):
            own = {name for name, other in actor_of.items() if other == actor}
            rest = [part for one in clips if (part := without(one, own)).names]
            others = set(actor_of) - own
            held = [part for one in clips if (part := without(one, others)).names]
            found.setdefault(actor, []).extend(_search(store, rest, joined(held, seed), params, executor, background))
        manual = None if clips_only else with_ground_truth(store)
        if manual is not None:
            found.setdefault("takes", []).extend(_search(store, clips, manual, params, executor, background))
    return found


def params_of(variant: str, runs: int, seed: int) -> Params:
    """The parameters of a variant."""
    own: dict[str, object] = {"runs": runs, "seed": 2012 + seed, **VARIANTS[variant]}
    if variant.endswith(THESIS):
        return Params(**own)  # type: ignore[arg-type]
    shipped = load_pipeline("keyframes").stage("learn_keyframes").params
    assert isinstance(shipped, Params)
    return Params(**{**shipped.model_dump(), **own})


def joined(clips: Sequence[TrainingClips], seed: int) -> Searched:
    """Clips one after the other in random order, as takes of `CLIPS_A_TAKE`."""
    every = [(one.subclass, words) for one in clips for words in one.words]
    order = np.random.default_rng(seed).permutation(len(every)).tolist()
    pieces, segments = [], []
    for begin in range(0, len(order), CLIPS_A_TAKE):
        at, words, labels = 0, [], []
        for index in order[begin : begin + CLIPS_A_TAKE]:
            label, part = every[index]
            labels.append((label, at, at + len(part)))
            words.append(part)
            at += len(part)
        pieces.append(np.concatenate(words))
        segments.append(tuple(labels))
    offsets = np.concatenate([[0], np.cumsum([len(piece) for piece in pieces])]).astype(np.int64)
    return Searched(TakeWords(np.arange(len(pieces)), offsets, np.concatenate(pieces)), tuple(segments))


def with_ground_truth(store: Store) -> Searched | None:
    """The takes of the store that have manual labels, as an evaluation has stored them."""
    rows = store.result("ground_truth").to_pylist()
    ids = sorted({row["take_id"] for row in rows})
    if not ids:
        return None
    segments = [
        tuple((row["class"], row["start"], row["stop"]) for row in rows if row["take_id"] == take_id) for take_id in ids
    ]
    return Searched(store.words(ids), tuple(segments))


def _search(
    store: Store,
    clips: Sequence[TrainingClips],
    searched: Searched,
    params: Params,
    executor: Executor,
    background: str | None,
) -> Iterator[Measured]:
    setting = setting_of(params, store)
    rounds = Rounds(params.rounds().runs, params.group, params.patience, params.settled)
    wanted: list[Lesson] = lessons(clips, load_classes("own", [one.subclass for one in clips]))
    outcomes = [course.outcomes[-1] for course in learn(wanted, setting, rounds, executor)]
    if background is not None:
        words = store.words(store.takes(background)["take_id"].to_list())
        pairs = zip(wanted, outcomes, strict=True)
        wanted = [mine(lesson, outcome, words, setting.features, params.background_clips) for lesson, outcome in pairs]
        outcomes = [course.outcomes[-1] for course in learn(wanted, setting, rounds, executor)]
    for outcome in outcomes:
        found = measured(outcome, searched, setting.features)
        if found.segments:
            yield found


def measured(outcome: Outcome, searched: Searched, features: int) -> Measured:
    """Search one class's queries, and compare with the segments of the class."""
    words = searched.words
    hits = np.zeros(len(words.words), bool)
    kept = np.zeros_like(hits)
    for chosen in outcome.chosen:
        ranges = hit_ranges(words, chosen.query, features)
        for take, start, stop in zip(*(part.tolist() for part in ranges), strict=True):
            first, end = int(words.offsets[take]), int(words.offsets[take + 1])
            hits[first + start : first + stop] = True
            kept[max(first, first + start - chosen.left) : min(end, first + stop + chosen.right)] = True
    own = [
        slice(int(words.offsets[take]) + start, int(words.offsets[take]) + stop)
        for take, segments in enumerate(searched.segments)
        for label, start, stop in segments
        if label == outcome.subclass
    ]
    return Measured(
        outcome.subclass,
        len(own),
        sum(bool(hits[piece].any()) for piece in own),
        sum(bool(kept[piece].any()) for piece in own),
        float(np.mean([kept[piece].mean() for piece in own])) if own else 0.0,
        float(kept.mean()),
        sum(piece.stop - piece.start for piece in own) / len(kept),
    )


def _line(name: str, actor: str, rows: Sequence[Measured]) -> str:
    hit = np.mean([one.hit / one.segments for one in rows])
    touched = np.mean([one.touched / one.segments for one in rows])
    covered, kept = np.mean([one.covered for one in rows]), np.mean([one.kept for one in rows])
    return f"| {name} | {actor} | {hit:.3f} | {touched:.3f} | {covered:.2f} | {kept:.1%} |"


def _by_class(details: Sequence[tuple[str, str, Measured]]) -> None:
    for name in dict.fromkeys(variant for variant, _, _ in details):
        print(f"\n{name}: segments hit of all, and per cent of the frames kept (of the class's own)\n")
        places = list(dict.fromkeys(actor for variant, actor, _ in details if variant == name))
        print("| class | " + " | ".join(places) + " |")
        print("|---" * (1 + len(places)) + "|")
        for label in sorted({one.label for variant, _, one in details if variant == name}):
            cells = []
            for place in places:
                own = [one for variant, actor, one in details if (variant, actor, one.label) == (name, place, label)]
                hit, total = sum(one.hit for one in own), sum(one.segments for one in own)
                kept, share = (np.mean([getattr(one, key) for one in own] or [0.0]) for key in ("kept", "own"))
                cells.append(f"{hit}/{total}, {kept:.0%} ({share:.0%})" if own else "–")
            print(f"| {label} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
