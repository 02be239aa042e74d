"""`python -m studies.label_suspects DATA`: find labels that were made wrong among labels that are right.

DATA is a folder with `bandai` and `hdm05`. Clips are laid end to end, twenty takes of Bandai or twelve clips of HDM05
to a take, each with its label; contents of Bandai with fewer than `--least` takes are left out. Then 5 % of the labels
are made wrong, in one way or in all of the first three ways in equal parts:

- class: the label is another class, drawn of all;
- side: the label is the class of the other side (Bandai), or the clip is shown in the mirror (HDM05, whose classes with
  a side have no partner);
- edges: one edge or both move by a quarter to half of the label's length, until label and truth have less than three
  quarters of their union in common;
- rate: of clips that are takes of their own, the frames are twice or half as many a second as the store says.

Printed is the share of the wrong labels among twice as many suspects, the most suspect first; how many of these bear
the right kind; and the share that the remarks of `learn_templates` name, which are clips far from all others of their
class by the features, in order of name, eight at most of a class.

What suspicion is measured in was chosen on draws 0 to 4 of Bandai (class and edges), and 0 to 7 of HDM05 (side); the
draws that are judged begin at 100.
"""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.harness import silent
from kinedex.catalog.features import FeatureSet
from kinedex.ops.body.facing_direction import mirrored_positions
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.numeric.label_suspects import Judgement, Place, context_of, judge_labels
from kinedex.ops.numeric.label_windows import Window
from kinedex.ops.templates.clip_checks import far_clips
from kinedex.ops.templates.templates import learn
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.storage.store.store import Store, open_store
from studies import BUILD
from studies.bandai import ingest
from studies.recognition_methods import mirrored
from studies.recognition_protocols import Motion, end_to_end, motions_of

SHARE, MOST_NAMED, FIRST_DRAW = 0.05, 8, 100
PATTERN = r"clips/(?P<class>[^/]+)/[^/_]+_(?P<actor>[^/_]+)_.*_(?P<clip>\d+)_\d+\."
ONE_SIDED = re.compile(r"deposit|elbow|grab|jog|kick|sneak")
"""The classes of HDM05 that have a side."""


@dataclass(frozen=True)
class Labelled:
    """Takes, their labels as take, start, stop and class, and which labels are wrong in what way ("" if right)."""

    takes: tuple[Motion, ...]
    labels: tuple[tuple[int, int, int, str], ...]
    wrong: tuple[str, ...]


def laid_out(motions: Sequence[Motion], count: int, generator: np.random.Generator) -> Labelled:
    """Lay motions end to end in a drawn order, so many to a take."""
    order = generator.permutation(len(motions)).tolist()
    takes = end_to_end([motions[k] for k in order], count)
    labels = tuple((number, *one) for number, take in enumerate(takes) for one in take.truth)
    return Labelled(tuple(takes), labels, ("",) * len(labels))


def plant(found: Labelled, kind: str, count: int, features: FeatureSet, generator: np.random.Generator) -> Labelled:
    """Make so many of the labels that are right wrong, in one way."""
    takes, labels, wrong = list(found.takes), list(found.labels), list(found.wrong)
    classes = sorted({one[3] for one in labels})
    for number in generator.permutation(len(labels)).tolist():
        take, start, stop, label = labels[number]
        if wrong.count(kind) == count or wrong[number]:
            continue
        if kind == "class":
            others = [one for one in classes if one != label]
            labels[number] = (take, start, stop, others[generator.integers(len(others))])
        elif kind == "edges":
            labels[number] = (take, *moved(start, stop, len(takes[take].words), generator), label)
        elif kind == "side" and mirrored(label) != label and mirrored(label) in classes:
            labels[number] = (take, start, stop, mirrored(label))
        elif kind == "side" and ONE_SIDED.match(label):
            takes[take] = in_the_mirror(takes[take], start, stop, features)
        elif kind == "rate":
            takes[take] = at_rate(takes[take], 2.0 if generator.random() < 0.5 else 0.5)
            labels[number] = (take, 0, len(takes[take].words), label)
        else:
            continue
        wrong[number] = kind
    return Labelled(tuple(takes), tuple(labels), tuple(wrong))


def moved(start: int, stop: int, frames: int, generator: np.random.Generator) -> tuple[int, int]:
    """Return edges that are moved by a quarter to half of the length, one of them or both."""
    length = stop - start
    while True:
        shifts = generator.uniform(0.25, 0.5, 2) * generator.choice([-1, 0, 1], 2) * length
        first, last = max(round(start + shifts[0]), 0), min(round(stop + shifts[1]), frames)
        if last - first >= 6 and 4 * (min(stop, last) - max(start, first)) < 3 * (max(stop, last) - min(start, first)):
            return first, last


def in_the_mirror(take: Motion, start: int, stop: int, features: FeatureSet) -> Motion:
    """Return a take in which the frames [start, stop) are mirrored."""
    positions, words = take.positions.copy(), take.words.copy()
    positions[start:stop] = mirrored_positions(positions[start:stop], JOINTS)
    words[start:stop] = features.mirrored(words[start:stop])
    return replace(take, positions=positions, words=words)


def at_rate(take: Motion, factor: float) -> Motion:
    """Return a take with so many times as many frames."""
    times = np.arange(0, len(take.words) - 1, 1 / factor)
    before, share = times.astype(int), (times % 1)[:, None, None]
    positions = (1 - share) * take.positions[before] + share * take.positions[before + 1]
    return Motion(take.name, positions, take.words[before], ((0, len(before), take.truth[0][2]),))


def judged(found: Labelled, rate_hz: float) -> list[Judgement]:
    """Judge the labels."""

    def windows() -> Iterator[tuple[int, Window]]:
        for number, (take, start, stop, _) in enumerate(found.labels):
            positions = found.takes[take].positions
            first, last = context_of(start, stop, len(positions))
            yield number, Window(positions[first:last], start - first, stop - first)

    return judge_labels([Place(take, label) for take, _, _, label in found.labels], windows, JOINTS, rate_hz)


def named_by_remarks(found: Labelled, features: int) -> set[int]:
    """Return the labels that remarks on the clips of a class name."""
    named: set[int] = set()
    for label in sorted({one[3] for one in found.labels}):
        own = [number for number, one in enumerate(found.labels) if one[3] == label]
        words = [found.takes[found.labels[number][0]].words[slice(*found.labels[number][1:3])] for number in own]
        far = far_clips(learn("soft", words, features).clip_costs)
        named |= {own[place] for place in far[:MOST_NAMED]}
    return named


def stores(data: Path) -> dict[str, Store]:
    """Return the stores of both archives, which are made where they are missing."""
    bandai, hdm05 = BUILD / "bandai-store", BUILD / "hdm05-clips"
    found = {"Bandai": ingest(data / "bandai", bandai)}
    assignments = {"source": str(data / "hdm05"), "patterns": f"['{PATTERN}']"}
    run_pipeline("ingest", hdm05, assignments=assignments, terminal=silent())
    return found | {"HDM05": open_store(hdm05)}


def row(name: str, store: Store, kinds: Sequence[str], motions: Sequence[Motion], draws: int) -> str:
    """Return a row of the table: the mean over draws."""
    numbers = []
    for draw in range(draws):
        generator = np.random.default_rng(FIRST_DRAW + draw)
        alone = kinds == ("rate",)
        found = laid_out(motions, 1 if alone else 20 if name == "Bandai" else 12, generator)
        for kind in kinds:
            count = max(round(SHARE * len(found.labels) / len(kinds)), 1)
            found = plant(found, kind, count, store.feature_set, generator)
        wrong = {number for number, kind in enumerate(found.wrong) if kind}
        if not wrong:
            return f"| {name} | {kinds[0]} | none can be made{' |' * 6}"
        judgements = judged(found, store.rate_hz)
        ranks = sorted(range(len(judgements)), key=lambda one: -np.nan_to_num(judgements[one].suspicion))
        top = wrong & set(ranks[: 2 * len(wrong)])
        named = named_by_remarks(found, len(store.feature_set.features))
        right = sum(judgements[one].kind == found.wrong[one] for one in top) / max(len(top), 1)
        numbers.append((len(wrong), len(top) / len(wrong), right, len(named), len(wrong & named) / len(wrong)))
    wrong_mean, share, right, named_mean, theirs = np.mean(numbers, axis=0)
    least = min(one[1] for one in numbers)
    what = kinds[0] if len(kinds) == 1 else "all three"
    cells = [name, what, f"{wrong_mean:.0f} of {len(found.labels)}", f"{share:.0%}", f"{least:.0%}", f"{right:.0%}"]
    return f"| {' | '.join([*cells, f'{theirs:.0%}', f'{named_mean:.0f}'])} |".replace("%", " %")


def main() -> None:
    """Print the table as Markdown."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.label_suspects",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("data", type=Path, help="folder with bandai and hdm05")
    parser.add_argument("--draws", type=int, default=6, help="number of draws")
    parser.add_argument("--least", type=int, default=8, help="takes of a content of Bandai")
    given = parser.parse_args()
    head = ["archive", "mistake", "wrong labels", "found", "least", "right kind", "named by remarks", "named at all"]
    print(f"| {' | '.join(head)} |\n|---|---|{'--:|' * 6}")
    for name, store in stores(given.data).items():
        motions = [one for one in motions_of(store).values() if one.truth]
        sizes = Counter(one.truth[0][2] for one in motions)
        motions = [one for one in motions if sizes[one.truth[0][2]] >= given.least]
        for kinds in (("class",), ("side",), ("edges",), ("class", "side", "edges"), ("rate",)):
            print(row(name, store, kinds, motions, given.draws), flush=True)


if __name__ == "__main__":
    main()
