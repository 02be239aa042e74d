"""`python -m studies.explorer_decisions DATA`: the decisions and the seconds of waiting until a class is found.

A person begins with one example of a class and answers yes or no in the explorer, which runs as a server of its own and
is asked what the page asks. The person is a script, which answers from file names (DATA, a folder of Bandai's files)
and from ground truth (the synthetic archive of the benchmarks). The store knows neither: takes have no class there.

Half of the takes, those of half of the styles or actors, are the ones that the person decides on; the other half is
annotated by the same templates, never looked at, and judges. After every round of decisions F is counted on both
halves, until it is 0.9 on both or so many decisions were made. Every strategy begins anew, on a copy of the store, with
some examples that are drawn by number: the same ones for all strategies.
"""

from __future__ import annotations

import argparse
import math
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np

from kinedex.ops.evaluation.metrics import Counts, compare, f_measure, pooled
from kinedex.storage.store.store import open_store
from studies import BUILD
from studies.explorer_person import Archive, Person, Range, Ranges, Row, bandai, explorer, synthetic, take_frames

ENOUGH = 0.9

BANDAI = ("wave-both-hands", "raise-up-left-hand", "walk-turn-left")
SYNTHETIC = ("kick", "squat")


def top_of_the_list(person: Person, _random: np.random.Generator) -> Iterator[None]:
    """Decide on the hits of the example from the top of the list."""
    while rows := person.next_hits():
        for row in rows:
            person.answer(row)
        yield


def more_like_these(person: Person, _random: np.random.Generator) -> Iterator[None]:
    """Decide on the best hits, and ask for more like these and less like those after every round."""
    while rows := person.next_hits():
        for row in rows:
            person.answer(row)
        person.more_like_these()
        yield


def learn(person: Person, _random: np.random.Generator) -> Iterator[None]:
    """Decide on the best hits, save them, learn, and then decide on what is doubtful, learning after every round.

    Where nothing of the class is undecided, the next ones are hits that are like what was accepted.
    """
    for row in person.next_hits():
        person.answer(row)
    person.save()
    while True:
        person.opened.learn()
        person.learns = True
        yield
        takes = open_store(person.archive.path).takes(person.archive.where(decided=True))["name"].to_list()
        body = {"classes": [person.label], "takes": takes, "limit": person.each}
        block = person.opened.ask("/api/labels/queue", body)
        rows = person.undecided(block["rows"])
        for row in rows:
            _decide(person, row, block["stage"])
        left = person.each - len(rows)
        if left > 0:
            person.more_like_these()
            more = person.next_hits()[:left]
            for row in more:
                person.answer(row)
            person.save()
            if not rows and not more:
                return


def _decide(person: Person, row: Row, stage: str) -> None:
    """Accept or reject an annotation; one that shows the class but is cut badly is cut to what shows it."""
    shown = [
        (max(start, row["start"]), min(stop, row["stop"]))
        for start, stop in person.archive.classes[person.label].get(row["take"], ())
    ]
    shown = [(start, stop) for start, stop in shown if stop - start >= 10]
    if shown and 2 * person.shows(row) < row["stop"] - row["start"]:
        person.decisions += 1
        person.corrections += 1
        person.draw(row["take"], *shown[0])
        return
    do = "accept" if person.answer(row) else "reject"
    edges = {key: row[key] for key in ("class", "subclass", "start", "stop")}
    person.edit(row["take"], {"do": do, "stage": stage, **edges, "seen": row["label"]})


def at_random(person: Person, random: np.random.Generator) -> Iterator[None]:
    """Label takes that are drawn at random, each of which is one decision, and learn after every round.

    An interval that shows the class is drawn, a correction unless it is the whole take; the others are no.
    """
    frames = take_frames(open_store(person.archive.path))
    names = open_store(person.archive.path).takes(person.archive.where(decided=True))["name"].to_list()
    person.draw(*(person.example[key] for key in ("take", "start", "stop")))
    order = [names[place] for place in random.permutation(len(names)).tolist()]
    for first in range(0, len(order), person.each):
        for name in order[first : first + person.each]:
            person.decisions += 1
            truth = person.archive.classes[person.label].get(name, ())
            for start, stop in truth:
                if person.is_drawn(name, start, stop):
                    continue
                person.corrections += (start, stop) != (0, frames[name])
                person.draw(name, start, stop)
            if not truth:
                person.draw(name, 0, frames[name], shows=False)
        person.opened.learn()
        person.learns = True
        yield


STRATEGIES: dict[str, Callable[[Person, np.random.Generator], Iterator[None]]] = {
    "top of the list": top_of_the_list,
    "more like these": more_like_these,
    "learn, doubtful first": learn,
    "takes at random, learn": at_random,
}


@dataclass(frozen=True)
class Point:
    """The state after a round: what was done so far, and F of takes, frames and segments of both halves."""

    decisions: int
    corrections: int
    waited: float
    decided: tuple[float, float, float]
    held_out: tuple[float, float, float]


def judged(found: Mapping[str, Sequence[Range]], truth: Ranges) -> tuple[float, float, float]:
    """Return F of takes, of frames and of segments; `found` names every take of a half.

    A take is found where anything in it is, and right where it shows the class anywhere.
    """
    counts: list[Counts] = [compare(own, truth.get(take, ())) for take, own in found.items()]
    every = pooled(counts)
    takes = [(bool(own), bool(truth.get(take))) for take, own in found.items()]
    both = sum(mine and theirs for mine, theirs in takes)
    mine, theirs = (sum(side) for side in zip(*takes, strict=True))
    f_takes = f_measure(both / mine if mine else float("nan"), both / theirs if theirs else float("nan"))
    return f_takes, every.f1, every.f2


def examples(archive: Archive, label: str, count: int) -> list[Row]:
    """Draw examples of a class, each from another take of the half that is decided on.

    An interval longer than twice the usual one is none, since it repeats the motion: a person selects it once.
    """
    store = open_store(archive.path)
    names = set(store.takes(archive.where(decided=True))["name"])
    shown = [(name, *own) for name, ranges in sorted(archive.classes[label].items()) if name in names for own in ranges]
    usual = median(stop - start for _, start, stop in shown)
    single = {name: (start, stop) for name, start, stop in reversed(shown) if stop - start <= 2 * usual}
    order = np.random.default_rng(1).permutation(len(single)).tolist()[:count]
    drawn = [sorted(single.items())[place] for place in order]
    return [{"take": name, "start": start, "stop": stop, "mirrored": False} for name, (start, stop) in drawn]


def run(archive: Archive, label: str, strategy: str, example: Row, given: argparse.Namespace, seed: int) -> list[Point]:
    """Let a person look for a class on a copy of the store."""
    copy = BUILD / f"{archive.path.name}-copy"
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(archive.path, copy)
    own = Archive(archive.name, copy, archive.classes, archive.decided, archive.by_take)
    points: list[Point] = []
    with explorer(copy) as opened:
        person = Person(own, label, example, opened, given.each)
        for _ in STRATEGIES[strategy](person, np.random.default_rng(seed)):
            both = [judged(person.found(decided=side), archive.classes[label]) for side in (True, False)]
            points.append(Point(person.decisions, person.corrections, opened.waited, both[0], both[1]))
            reached = min(one[0 if archive.by_take else 1] for one in both) >= ENOUGH
            if reached or person.decisions >= given.most:
                break
    return points


def reached(points: Sequence[Point], side: str, by_take: bool) -> Point | None:
    """Return the first point with enough F on one half."""
    return next((one for one in points if getattr(one, side)[0 if by_take else 1] >= ENOUGH), None)


def report(archive: Archive, label: str, strategy: str, runs: Sequence[Sequence[Point]]) -> str:
    """Return a row of the table about all runs of one class and strategy."""
    cells = [label, strategy]
    for side in ("decided", "held_out"):
        found = [reached(points, side, archive.by_take) for points in runs]
        decisions = [math.inf if one is None else one.decisions for one in found]
        waited = [math.inf if one is None else one.waited for one in found]
        cells += [
            _median(decisions, ""),
            _median(waited, " s"),
            f"{sum(map(bool, found))} of {len(found)}",
        ]
    last = [points[-1] for points in runs]
    cells += [f"{median(one.held_out[kind] for one in last):.2f}" for kind in range(3)]
    cells += [
        f"{median(one.waited / max(one.decisions, 1) for one in last):.2f}",
        f"{median(one.corrections for one in last):g}",
    ]
    return f"| {' | '.join(cells)} |"


def _median(values: Sequence[float], unit: str) -> str:
    """Return the median and the greatest of some values, of which those that are not reached are infinite."""

    def shown(value: float) -> str:
        return "never" if math.isinf(value) else f"{value:.0f}{unit}"

    return f"{shown(median(values))} ({shown(max(values))})"


def main() -> None:
    """Let people look for all classes by all strategies, and print the table as Markdown."""
    parser = argparse.ArgumentParser(prog="python -m studies.explorer_decisions", description=__doc__)
    parser.add_argument("data", type=Path, help="folder of Bandai's BVH files")
    parser.add_argument("--classes", nargs="+", default=[*BANDAI, *SYNTHETIC], help="contents of Bandai, kick, squat")
    parser.add_argument("--strategies", nargs="+", choices=list(STRATEGIES), default=list(STRATEGIES))
    parser.add_argument("--examples", type=int, default=5, help="first examples of each class")
    parser.add_argument("--each", type=int, default=20, help="decisions of a round, after which is learned")
    parser.add_argument("--most", type=int, default=200, help="decisions at most")
    parser.add_argument("--curves", action="store_true", help="print F after each round, too")
    given = parser.parse_args()
    archives = [
        make()
        for make, own in ((lambda: bandai(given.data), False), (synthetic, True))
        if any((one in SYNTHETIC) == own for one in given.classes)
    ]
    print(
        "| class | strategy | decisions, decided half | waiting | reached | decisions, held-out half | waiting "
        "| reached | F (takes) | F (frames) | F (segments) | s a decision | corrections |"
    )
    print("|---|---|" + "--:|" * 11)
    for archive in archives:
        # a few takes of Bandai show a kick, too
        asked = [one for one in given.classes if (one in SYNTHETIC) == (archive.name == "synthetic")]
        for label in (one for one in asked if one in archive.classes):
            drawn = examples(archive, label, given.examples)
            for strategy in given.strategies:
                runs = [run(archive, label, strategy, one, given, seed) for seed, one in enumerate(drawn)]
                print(report(archive, label, strategy, runs), flush=True)
                if given.curves:
                    curves(archive, runs)


def curves(archive: Archive, runs: Sequence[Sequence[Point]]) -> None:
    """Print F of both halves after each round."""
    kind = 0 if archive.by_take else 1
    for points in runs:
        print(
            "   ",
            "  ".join(
                f"{p.decisions}: {p.decided[kind]:.2f} {p.held_out[kind]:.2f} ({p.waited:.1f} s)" for p in points
            ),
        )


if __name__ == "__main__":
    main()
