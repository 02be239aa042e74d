"""The protocols of the study of recognition: what teaches, and which takes are labelled."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl

from kinedex.catalog.classes import load_classes
from kinedex.ops.arrays import F64, U64
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.intervals import analysis_frame
from kinedex.storage.formats.labels.formats import read_labels
from kinedex.storage.store.store import Store

LEAST = 8
"""Contents of Bandai with fewer takes take no part, except as motions that nobody taught."""

END_TO_END, CLIPS_END_TO_END = 20, 12
"""The number of Bandai's takes, and of HDM05's clips, in a long take."""

ACTORS = ("bd", "bk", "dg")
SOURCE_HZ = 120.0

FOREIGN = ("01_08", "01_14", "02_05", "02_06", "02_07", "02_08", "02_09", "02_10")
"""CMU's takes that come between clips: climbing, punches, bending, sword fights and washing; none of them is taught."""

PIECE = (60, 150)
"""The fewest and the most frames of a piece of a foreign take."""

Label = tuple[int, int, str]
"""Frames of a segment, stop excluded, and its class."""


@dataclass(frozen=True)
class Motion:
    """A take, a clip, or several laid end to end; `group` is the take or the person that a clip is of."""

    name: str
    positions: F64
    words: U64
    truth: tuple[Label, ...]
    group: str = ""

    @property
    def label(self) -> str:
        """The class of a clip."""
        return self.truth[0][2]


@dataclass(frozen=True)
class Trial:
    """Examples that teach, and takes to label.

    Attributes
    ----------
    examples, takes : sequence of Motion
        The examples, and the takes; the true labels of takes are of taught classes alone.
    whole : bool
        True where a take shows one class from its first to its last frame.
    sides : bool
        True where the names of classes say which is the mirror image of which.
    classes : mapping of str to str
        The class that a label counts as; a label that is not there is a class itself.
    """

    examples: Sequence[Motion]
    takes: Sequence[Motion]
    whole: bool = False
    sides: bool = False
    classes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Protocol:
    """A row of the table: its name, and its trials by their names."""

    name: str
    trials: Mapping[str, Callable[[], Trial]]


def motions_of(store: Store) -> dict[str, Motion]:
    """Return the takes of a store by name; one that has a class shows it from its first to its last frame."""
    rows = store.takes().select("take_id", "name", "class", "actor").sort("take_id")
    places = [f"{joint}.{axis} AS {joint}_{axis}" for joint in JOINTS for axis in "xyz"]
    frames = pl.DataFrame(store.sql(f"SELECT take_id, {', '.join(places)} FROM frames ORDER BY take_id, frame"))
    parts = {key[0]: part for key, part in frames.partition_by("take_id", as_dict=True, include_key=False).items()}
    found = {}
    for take_id, name, label, actor in rows.iter_rows():
        own = parts[take_id].to_numpy().astype(np.float64)
        truth = ((0, len(own), label),) if label is not None else ()
        found[name] = Motion(
            name, own.reshape(-1, len(JOINTS), 3), store.words([take_id]).words, truth, actor or ""
        )  # fmt: skip
    return found


def joined(motions: Sequence[Motion], name: str) -> Motion:
    """Lay motions end to end."""
    ends = np.cumsum([0, *(len(one.words) for one in motions)]).tolist()
    truth = [
        (start + at, stop + at, label)
        for one, at in zip(motions, ends, strict=False)
        for start, stop, label in one.truth
    ]
    positions, words = (np.concatenate([getattr(one, part) for one in motions]) for part in ("positions", "words"))
    return Motion(name, positions, words, tuple(truth))


def end_to_end(motions: Sequence[Motion], count: int) -> list[Motion]:
    """Lay motions end to end, so many to a take."""
    return [joined(motions[first : first + count], f"{first}") for first in range(0, len(motions), count)]


def shuffled(motions: Sequence[Motion], seed: int) -> list[Motion]:
    """Return motions in a drawn order."""
    return [motions[k] for k in np.random.default_rng(seed).permutation(len(motions)).tolist()]


def amid(motions: Sequence[Motion], foreign: Sequence[Motion], seed: int) -> list[Motion]:
    """Lay a piece of a foreign motion after each motion; both are one then."""
    generator = np.random.default_rng(seed)
    found = []
    for one in motions:
        other = foreign[int(generator.integers(len(foreign)))]
        length = min(int(generator.integers(*PIECE)), len(other.words))
        start = int(generator.integers(len(other.words) - length + 1))
        frames = slice(start, start + length)
        piece = replace(other, positions=other.positions[frames], words=other.words[frames], truth=())
        found.append(joined([one, piece], one.name))
    return found


def contents(motions: Sequence[Motion]) -> list[str]:
    """Return the classes of motions that have enough of them."""
    sizes = Counter(one.label for one in motions)
    return sorted(label for label, size in sizes.items() if size >= LEAST)


def draw(motions: Sequence[Motion], count: int, seed: int) -> tuple[list[Motion], list[Motion]]:
    """Draw examples of each content; return them, and the other takes in a drawn order."""
    generator = np.random.default_rng(seed)
    examples: list[Motion] = []
    rest: list[Motion] = []
    for label in contents(motions):
        own = [one for one in motions if one.label == label]
        order = generator.permutation(len(own)).tolist()
        examples += [own[k] for k in order[:count]]
        rest += [own[k] for k in order[count:]]
    return examples, [rest[k] for k in generator.permutation(len(rest)).tolist()]


def untaught(takes: Sequence[Motion], labels: Sequence[str]) -> list[Motion]:
    """Return takes whose true labels are of certain classes alone; what shows another class has none."""
    return [replace(one, truth=tuple(own for own in one.truth if own[2] in labels)) for one in takes]


def bandai_protocols(
    motions: Sequence[Motion], foreign: Sequence[Motion], counts: Sequence[int], draws: int
) -> list[Protocol]:
    """Return the protocols of Bandai's takes, whose groups are themselves and whose persons are styles."""
    found = []
    seeds = range(draws)
    few = range(min(draws, 3))
    alone = [replace(one, group=one.name) for one in motions]

    def drawn(count: int, seed: int, whole: bool) -> Trial:
        examples, rest = draw(alone, count, seed)
        return Trial(examples, rest if whole else end_to_end(rest, END_TO_END), whole, sides=True)

    def half(seed: int) -> Trial:
        examples, rest = draw(alone, 5, seed)
        labels = np.random.default_rng(seed).permutation(contents(motions)).tolist()
        labels = labels[: (len(labels) + 1) // 2]
        examples = [one for one in examples if one.label in labels]
        return Trial(examples, untaught(end_to_end(rest, END_TO_END), labels), sides=True)

    def between(seed: int) -> Trial:
        examples, rest = draw(alone, 5, seed)
        return Trial(examples, end_to_end(amid(rest, foreign, seed), END_TO_END), sides=True)

    for whole, name in ((True, "whole takes"), (False, "end to end")):
        for count in counts:
            title = f"Bandai, {name}, {count} example" + "s" * (count > 1)
            found.append(Protocol(title, {f"{seed}": partial(drawn, count, seed, whole) for seed in seeds}))
    if 5 in counts:
        found.append(Protocol("Bandai, half of the contents taught", {f"{seed}": partial(half, seed) for seed in few}))
        found.append(Protocol("Bandai, amid CMU", {f"{seed}": partial(between, seed) for seed in few}))
    return found + _style_protocols(motions)


def _style_protocols(motions: Sequence[Motion]) -> list[Protocol]:
    """Return the protocols that leave styles out: a third of those of dataset 1, and all of dataset 2."""
    first, second = (
        [one for one in motions if one.name.startswith(name)] for name in ("dataset-1", "dataset-2")
    )  # fmt: skip
    usual = [one for one in first if one.label in contents(first)]
    styles = sorted({one.group for one in usual})

    def left_out(part: int) -> Trial:
        kept = set(styles[part::3])
        examples = [one for one in usual if one.group not in kept]
        takes = shuffled([one for one in usual if one.group in kept], part)
        return Trial(examples, end_to_end(takes, END_TO_END), sides=True)

    def other() -> Trial:
        labels = {one.label for one in usual}
        takes = shuffled([one for one in second if one.label in labels], 0)
        return Trial(usual, end_to_end(takes, END_TO_END), sides=True)

    found = []
    if len(styles) >= 3:
        name = "Bandai, dataset 1, a third of the styles left out"
        found.append(Protocol(name, {f"{part}": partial(left_out, part) for part in range(3)}))
    if {one.label for one in usual} & {one.label for one in second}:
        found.append(Protocol("Bandai, dataset 1 teaches, dataset 2 is labelled", {"all": other}))
    return found


def hdm05_protocols(
    store: Store, motions: Mapping[str, Motion], truth: Path, foreign: Sequence[Motion]
) -> list[Protocol]:
    """Return the protocols of HDM05's actors; the groups of clips are their actors."""
    clips = [one for one in motions.values() if one.truth and one.group in ACTORS]
    labels = sorted({one.label for one in clips})
    halves = {"six": labels[::2], "five": labels[1::2]}

    def left_out(actor: str, taught: Sequence[str], foreign: Sequence[Motion]) -> Trial:
        examples = [one for one in clips if one.group != actor and one.label in taught]
        own = shuffled([one for one in clips if one.group == actor], 0)
        own = amid(own, foreign, 0) if foreign else own
        return Trial(examples, untaught(end_to_end(own, CLIPS_END_TO_END), taught))

    def of_mm(taught: Sequence[str]) -> Trial:
        taken = untaught(true_takes(motions, truth, store.rate_hz), taught)
        return Trial([one for one in clips if one.label in taught], taken)

    def by_actors(taught: Sequence[str], foreign: Sequence[Motion] = ()) -> dict[str, Callable[[], Trial]]:
        return {actor: partial(left_out, actor, taught, foreign) for actor in ACTORS}

    halved = {
        f"{actor} {name}": partial(left_out, actor, taught, ())
        for actor in ACTORS
        for name, taught in halves.items()
    }  # fmt: skip
    return [
        Protocol("HDM05, an actor left out", by_actors(labels)),
        Protocol("HDM05, an actor left out, amid CMU", by_actors(labels, foreign)),
        Protocol("HDM05, an actor left out, half of the classes taught", halved),
        Protocol("HDM05, mm", {"all": partial(of_mm, labels)}),
        *(
            Protocol(f"HDM05, mm, {len(some)} of {len(labels)} classes taught", {"all": partial(of_mm, some)})
            for some in halves.values()
        ),
    ]


def cmu_protocol(store: Store, motions: Mapping[str, Motion], truth: Path) -> Protocol:
    """Return the protocol of another studio: HDM05 teaches, and CMU's takes with labels are labelled."""
    clips = [one for one in motions.values() if one.truth and one.group in ACTORS]
    classes = load_classes("thesis-15", {one.label for one in clips})
    meanings = {label: classes.class_of(label) or label for label in {one.label for one in clips}}
    return Protocol(
        "HDM05 teaches, CMU is labelled",
        {
            "all": lambda: Trial(
                clips,
                untaught(true_takes(motions, truth, store.rate_hz), sorted(set(meanings.values()))),
                classes=meanings,
            )
        },
    )


def true_takes(motions: Mapping[str, Motion], truth: Path, rate_hz: float) -> list[Motion]:
    """Return the takes that a file of ground truth names, with its labels."""
    labels: dict[str, list[Label]] = {}
    for one in read_labels(truth).segments:
        start, stop = (analysis_frame(edge, SOURCE_HZ, rate_hz) for edge in one.source_frames(SOURCE_HZ))
        labels.setdefault(one.take, []).append((start, stop, one.label))
    return [replace(motions[name], truth=tuple(own)) for name, own in sorted(labels.items()) if name in motions]
