"""`python -m studies.root_motion DATA`: do features of the root help where people have labelled a few takes?

The 40 features are relations within the body: whether a person turns, or walks sideways, is not among them. Here six
bits of the root are added to the words of Bandai's takes (DATA): it turns to the left or to the right, and it moves
forwards, backwards, to the left or to the right. A person is simulated, who decides on the least certain takes of half
of the styles, as in `studies.explorer_decisions`, but without the explorer; the takes of the other half judge. What was
chosen was chosen on `CHOSEN_ON`, with another division of the styles.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from statistics import mean

import numpy as np
import numpy.typing as npt
import polars as pl

from kinedex.ops.annotation.decoding import Decoding
from kinedex.ops.annotation.segments import Segment
from kinedex.ops.arrays import U64
from kinedex.ops.evaluation.metrics import f_measure
from kinedex.ops.templates.templates import quantise
from kinedex.ops.words import NO_WORD, TakeWords, bits
from kinedex.pipelines.annotation.methods import Motion, whole_takes
from kinedex.pipelines.annotation.methods import Takes as AnnotatedTakes
from kinedex.pipelines.annotation.single_examples import NOTHING, SingleExamples, usual_postures
from kinedex.pipelines.annotation.template_methods import BestMethod, with_usual_values
from kinedex.pipelines.templates.template_learning import TrainingClips, learn_template
from kinedex.storage.store.store import Store, open_store
from studies.explorer_person import bandai

F64 = npt.NDArray[np.float64]

FEATURES = 40

CHOSEN_ON = (
    "walk-turn-right", "walk-left", "walk-right", "walk-back", "bow", "raise-up-both-hands", "run", "walk",
    "raise-up-right-hand", "wave-left-hand", "guide",
)  # fmt: skip

JUDGED_ON = ("wave-both-hands", "raise-up-left-hand", "walk-turn-left")

DECISIONS, EACH = 100, 20

TURN_SECONDS, MOVE_SECONDS = 2.0, 1.0
"""Velocities of the root are averaged over so many seconds."""

TURN, MOVE, ASIDE = 0.2, 0.3, 0.15
"""Radians per second, and metres per second ahead and aside, from which a bit is on."""


@dataclass(frozen=True)
class Takes:
    """The takes of an archive with their words, whose first bits are the features of the store."""

    words: TakeWords
    features: int
    contents: Sequence[str]
    styles: Sequence[str]


def root_bits(root: F64, facing: F64, rate_hz: float) -> npt.NDArray[np.bool_]:
    """Return the bits of the root: it turns left, turns right, moves ahead, back, to the left, to the right.

    Parameters
    ----------
    root : float64 array (L, 2)
        Its place on the floor, in metres.
    facing : float64 array (L,)
        The angle that the hips face, in radians.
    rate_hz : float
        Frames per second.
    """
    angle, place = np.unwrap(facing), np.nan_to_num(root)
    if len(angle) < 2:
        return np.zeros((len(angle), 6), np.bool_)
    turn = _averaged(np.gradient(angle) * rate_hz, TURN_SECONDS * rate_hz)
    even = _averaged(angle, rate_hz / 2)
    moved = np.gradient(place, axis=0) * rate_hz
    ahead = _averaged(np.sin(even) * moved[:, 0] + np.cos(even) * moved[:, 1], MOVE_SECONDS * rate_hz)
    left = _averaged(np.cos(even) * moved[:, 0] - np.sin(even) * moved[:, 1], MOVE_SECONDS * rate_hz)
    return np.stack([turn > TURN, turn < -TURN, ahead > MOVE, ahead < -MOVE, left > ASIDE, left < -ASIDE], axis=1)


def _averaged(values: F64, frames: float) -> F64:
    """Return the mean of so many frames around each; the first and the last value go on beyond the ends."""
    count = min(max(int(frames), 1), len(values))
    padded = np.concatenate([np.full(count, values[0]), values, np.full(count, values[-1])])
    mean_of: F64 = np.convolve(padded, np.full(count, 1 / count), mode="same")[count:-count]
    return mean_of


def takes_of(store: Store, classes: Mapping[str, Iterable[str]], weight: int) -> Takes:
    """Return the takes of a store; each bit of the root is there so many times, 0 for none."""
    words, rows = store.words(None), store.takes()
    content = {name: label for label, names in classes.items() for name in names}
    names, styles = (dict(rows.select("take_id", one).iter_rows()) for one in ("name", "actor"))
    ids = words.take_ids.tolist()
    if weight:
        words = TakeWords(words.take_ids, words.offsets, _with_root(store, words, weight))
    return Takes(words, FEATURES + 6 * weight, [content[names[one]] for one in ids], [styles[one] for one in ids])


def _with_root(store: Store, words: TakeWords, weight: int) -> U64:
    joints = "root.x AS x, root.z AS z, lhip.x - rhip.x AS a, lhip.z - rhip.z AS b"
    frames = pl.DataFrame(store.sql(f"SELECT take_id, {joints} FROM frames ORDER BY take_id, frame"))
    result = words.words.copy()
    for place, (take_id,) in enumerate(frames.select("take_id").unique(maintain_order=True).iter_rows()):
        own = frames.filter(pl.col("take_id") == take_id)
        piece = slice(int(words.offsets[place]), int(words.offsets[place + 1]))
        # the hips lie across the direction that they face
        facing = np.arctan2(-own["b"].to_numpy(), own["a"].to_numpy())
        found = root_bits(own.select("x", "z").to_numpy(), np.nan_to_num(facing), store.rate_hz)
        more = np.zeros(len(own), np.uint64)
        for bit, column in enumerate(np.repeat(found, weight, axis=1).T):
            more |= column.astype(np.uint64) << np.uint64(FEATURES + bit)
        result[piece] = np.where(result[piece] == NO_WORD, NO_WORD, result[piece] | more)
    return result


class Person:
    """Somebody who decides on takes of one class, and the method that learns from it."""

    def __init__(self, takes: Takes, label: str, decided: frozenset[str], first: int) -> None:
        self._takes, self._label = takes, label
        self._mine = [place for place, style in enumerate(takes.styles) if style in decided]
        self._usual = usual_postures([Motion(words=takes.words.best_known)], takes.features)
        self._shares = np.stack([self._share(place) for place in range(len(takes.words))])
        self._positives, self._negatives = [self._interval(first)], [(first, 0, 0)][:0]
        self._seen = {first}

    def _share(self, place: int) -> F64:
        own = self._takes.words.take(place)
        return bits(own[own != NO_WORD], self._takes.features).mean(axis=0)

    def _interval(self, place: int) -> tuple[int, int, int]:
        return place, 0, len(self._takes.words.take(place))

    def found(self) -> list[list[Segment]]:
        """Label all takes by what was decided so far."""
        templates = []
        for place, start, stop in (*self._positives, *self._negatives):
            own = self._takes.words.take(place)[start:stop]
            alone = TrainingClips(self._label, ("",), (own[own != NO_WORD],))
            learned = learn_template(alone, "soft", self._takes.features).template
            templates.append(with_usual_values(learned, self._usual))
        positions = np.array([0] * len(self._positives) + [NOTHING] * len(self._negatives))
        row = BestMethod(
            tuple(templates),
            tuple(quantise(one, 0.05) for one in templates),
            np.where(positions == NOTHING, 1, 0),
            self._usual,
            Decoding(),
        )
        words = self._takes.words
        return SingleExamples(row, positions).annotate(AnnotatedTakes(words, [whole_takes(words)]))

    def decide(self, found: Sequence[Sequence[Segment]]) -> bool:
        """Decide on the takes of the smallest margin, then on those most like accepted ones; False if none is left."""
        left = [place for place in self._mine if place not in self._seen]
        doubtful = sorted((min(one.margin for one in found[place]), place) for place in left if found[place])
        accepted = self._shares[[place for place, _, _ in self._positives]]
        others = sorted(
            (float(np.abs(accepted - self._shares[place]).mean(axis=1).min()), place)
            for place in left
            if not found[place]
        )
        chosen = [place for _, place in (*doubtful, *others)][:EACH]
        for place in chosen:
            self._seen.add(place)
            if self._takes.contents[place] == self._label:
                self._positives.append(self._interval(place))
            elif found[place]:
                self._negatives.append((place, found[place][0].start, found[place][0].stop))
            else:
                self._negatives.append(self._interval(place))
        return bool(chosen)

    def result(self) -> list[list[Segment]]:
        """Decide round by round, and return what is found in the end."""
        found = self.found()
        while len(self._seen) < DECISIONS and self.decide(found):
            found = self.found()
        return found


def scores(takes: Takes, label: str, found: Sequence[Sequence[Segment]], positions: Iterable[int]) -> tuple[float, ...]:
    """Return F, precision and recall of takes; one is found where anything in it is."""
    pairs = [(bool(found[place]), takes.contents[place] == label) for place in positions]
    both = sum(mine and true for mine, true in pairs)
    mine, true = (sum(side) for side in zip(*pairs, strict=True))
    precision, recall = both / mine if mine else 0.0, both / true if true else 0.0
    return f_measure(precision, recall), precision, recall


def other_half(styles: Iterable[str]) -> frozenset[str]:
    """Return the styles that are decided on where something is chosen: another half than the one that judges."""
    return frozenset(sorted(set(styles), key=lambda one: sha256(f"other{one}".encode()).hexdigest())[::2])


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="folder of Bandai's BVH files")
    parser.add_argument(
        "--weights", nargs="+", type=int, default=[0, 1, 3], help="how often each bit of the root counts"
    )
    parser.add_argument("--examples", type=int, default=2, help="first examples of each class")
    given = parser.parse_args()
    archive = bandai(given.data)
    store = open_store(archive.path)
    each = [takes_of(store, archive.classes, weight) for weight in given.weights]
    for title, labels in (("chosen on", CHOSEN_ON), ("judged on", JUDGED_ON)):
        decided = other_half(each[0].styles) if labels is CHOSEN_ON else archive.decided
        names = [f"weight {one}" if one else "without" for one in given.weights]
        print(f"| {title} | takes | " + " | ".join(f"{one}: F | P | R" for one in names) + " |")
        print("|---|--:|" + "--:|--:|--:|" * len(each))
        everything: list[list[float]] = [[] for _ in each]
        for label in labels:
            cells = []
            for takes, all_of in zip(each, everything, strict=True):
                rest = [place for place, style in enumerate(takes.styles) if style not in decided]
                own = [p for p, one in enumerate(takes.contents) if one == label and takes.styles[p] in decided]
                drawn = np.random.default_rng(1).permutation(own).tolist()[: given.examples]
                found = [scores(takes, label, Person(takes, label, decided, one).result(), rest) for one in drawn]
                all_of.append(mean(one[0] for one in found))
                cells += [f"{mean(values):.2f}" for values in zip(*found, strict=True)]
            count = sum(each[0].contents[place] == label for place in rest)
            print(f"| {label} | {count} | " + " | ".join(cells) + " |", flush=True)
        print("| mean | | " + " | ".join(f"{mean(one):.2f} | |" for one in everything) + " |")


if __name__ == "__main__":
    main()
