"""Select examples for learning: intervals of takes with a class, from whole clips, labels of people, or label files."""

from __future__ import annotations

import hashlib
import re
from collections import Counter, defaultdict
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from kinedex.ops.errors import KinedexError
from kinedex.ops.templates.templates import MAX_AVERAGED
from kinedex.ops.wording import counted, name_list
from kinedex.ops.words import ALL_KNOWN, NO_WORD, U64
from kinedex.pipelines.engine.digests import Reading
from kinedex.pipelines.labels.file_segments import placed_files
from kinedex.pipelines.labels.unmatched_labels import UnmatchedLabels
from kinedex.storage.formats.labels.file_labels import ERROR
from kinedex.storage.formats.labels.formats import ground_truth_files, read_labels
from kinedex.storage.snapshot.stored_labels import is_of_limbs
from kinedex.storage.store.store import Store

if TYPE_CHECKING:
    import polars as pl

CLIPS, LABELS = "clips", "labels"
"""The sources of examples that are not label files."""


class ExampleParameters(BaseModel):
    """The parameters that select examples, shared by all stages that learn from them."""

    model_config = ConfigDict(extra="forbid")

    where: str = Field(
        "class IS NOT NULL",
        description="clips to learn from: a SQL filter over the columns of takes; they are grouped by `class`",
    )
    examples: list[str] = Field(
        [CLIPS],
        min_length=1,
        description="sources of examples: clips (whole takes, by `where`), labels (intervals that people have labelled "
        "in the store), or label files: a path, or a glob below the takes' source folders such as **/ground_truth.csv",
    )
    labels_where: str = Field(
        "true",
        description="takes whose labels and label files are learned from: a SQL filter over the columns of takes",
    )

    @property
    def patterns(self) -> list[str]:
        """The label files among the sources, as paths or globs."""
        return [one for one in self.examples if one not in (CLIPS, LABELS)]

    @property
    def only_clips(self) -> bool:
        """True if all examples are whole clips."""
        return set(self.examples) == {CLIPS}


@dataclass(frozen=True)
class Example:
    """An interval of a take that shows a class, or that a person has rejected for the class.

    The words of an interval are words of the take, so that the features of the first and last frames of the interval
    depend on frames outside it.

    Attributes
    ----------
    take_id : int
        The id of the take.
    take : str
        The name of the take.
    start, stop : int
        The frames [start, stop).
    frames : int
        The number of frames of the take.
    label : str
        The class (a subclass, for classes with several).
    source : str
        "clip", "label", or the place in a label file.
    positive : bool
        False for an interval that a person has rejected for this class.
    """

    take_id: int
    take: str
    start: int
    stop: int
    frames: int
    label: str
    source: str
    positive: bool = True

    @property
    def name(self) -> str:
        """The name of the take, followed by the interval if it is not the whole take, such as "walk_01[30:90]"."""
        whole = (self.start, self.stop) == (0, self.frames)
        return self.take if whole else f"{self.take}[{self.start}:{self.stop}]"


@dataclass(frozen=True)
class ChosenExamples:
    """The examples that the parameters select.

    Attributes
    ----------
    examples : list of Example
        The examples, rejected intervals last.
    remarks : list of str
        Remarks on labels that are excluded.
    unmatched : tuple of UnmatchedLabels
        The labels of files that match no take.
    """

    examples: list[Example]
    remarks: list[str]
    unmatched: tuple[UnmatchedLabels, ...]


def examples_of(store: Store, params: ExampleParameters, *, required: bool = True) -> ChosenExamples:
    """Return the examples that the parameters select.

    An interval that several sources give for one class is one example.

    Parameters
    ----------
    store : Store
        The store that holds the takes.
    params : ExampleParameters
        The sources.
    required : bool, optional
        False to allow that there is no example.

    Raises
    ------
    KinedexError
        A filter selects a clip without a class or nothing at all, or a label file cannot be read.
    """
    found: list[Example] = []
    remarks: list[str] = []
    unmatched: tuple[UnmatchedLabels, ...] = ()
    if CLIPS in params.examples:
        some = required and params.only_clips
        found += whole_takes(training_takes(store, params.where) if some else _classified(store, params.where))
    if not params.only_clips:
        takes = store.takes(params.labels_where)
        if LABELS in params.examples:
            labelled, remarks = _labelled(store, takes)
            found += labelled
        of_files, unused, unmatched = _of_files(store, takes, params.patterns)
        found += of_files
        remarks += unused
    once: dict[tuple[bool, str, str], Example] = {}
    for one in found:
        once.setdefault((one.positive, one.label, one.name), one)
    chosen = list(once.values())
    if required and not any(one.positive for one in chosen):
        raise KinedexError(
            f"no example to learn from: `examples` are {', '.join(params.examples)}, `where` is `{params.where}`, "
            f"`labels_where` is `{params.labels_where}`; `kinedex labels list {store.path}` shows the labels"
        )
    return ChosenExamples(sorted(chosen, key=lambda one: not one.positive), remarks, unmatched)


def training_takes(store: Store, where: str) -> pl.DataFrame:
    """Return the takes that a filter selects for learning, sorted by name; each of them has a class.

    Parameters
    ----------
    store : Store
        The store that holds the takes.
    where : str
        A SQL filter over the columns of takes.

    Raises
    ------
    KinedexError
        The filter selects no take, or one without a class.
    """
    takes = store.takes(where)
    if not takes.height:
        labelled = store.takes()["class"].count()
        raise KinedexError(
            f"no take to learn from: the filter `{where}` selects none of the {store.takes().height} takes, "
            f"{labelled} of which have a class. The class of a take comes from its path, by `patterns` of ingest"
        )
    return _classified(store, where)


def _classified(store: Store, where: str) -> pl.DataFrame:
    """Return the takes that a filter selects; raise a KinedexError if one has no class."""
    takes = store.takes(where)
    unlabelled = takes.filter(takes["class"].is_null())["name"].to_list()
    if unlabelled:
        raise KinedexError(
            f"the filter `{where}` selects {len(unlabelled)} takes to learn from that have no class, such as "
            f"{unlabelled[0]}; add `AND class IS NOT NULL`"
        )
    return takes


def whole_takes(takes: pl.DataFrame) -> list[Example]:
    """Return takes with a class as examples of it, by class and name."""
    rows = takes.sort("class", "name").select("take_id", "name", "frames", "class").iter_rows()
    return [Example(take_id, name, 0, frames, frames, label, "clip") for take_id, name, frames, label in rows]


def _labelled(store: Store, takes: pl.DataFrame) -> tuple[list[Example], list[str]]:
    """Return the labels of takes as examples, and remarks on labels that no longer match their takes."""
    rows = {str(row[0]): row[1:] for row in takes.select("name", "take_id", "frames", "checksum").iter_rows()}
    found, beyond, changed = [], [], []
    for one in store.labels().sort_by([("take", "ascending"), ("start", "ascending")]).to_pylist():
        if one["take"] not in rows or is_of_limbs(one):
            continue
        take_id, frames, checksum = rows[one["take"]]
        shown = f"{one['take']}[{one['start']}:{one['stop']}]"
        if one["stop"] > frames:
            beyond.append(shown)
            continue
        if one["checksum"] not in (None, checksum):
            changed.append(shown)
        edges = (one["start"], one["stop"], frames)
        found.append(Example(take_id, one["take"], *edges, one["class"], "label", one["verdict"] == "positive"))
    remarks = [f"labels beyond the end of their take, excluded: {name_list(beyond)}"] if beyond else []
    if changed:
        remarks.append(
            f"labels made when the take's file was another one, learned from all the same: {name_list(changed)}"
        )
    return found, remarks


def _of_files(
    store: Store, takes: pl.DataFrame, patterns: Sequence[str]
) -> tuple[list[Example], Sequence[str], tuple[UnmatchedLabels, ...]]:
    """Return segments of label files as examples, remarks on excluded ones, and labels that match no take."""
    if not patterns:
        return [], (), ()
    rows = {str(row[0]): row[1:] for row in takes.select("name", "take_id", "frames").iter_rows()}
    roots = sorted(set(store.takes()["source_root"]))
    paths = (file for pattern in patterns for file in ground_truth_files(pattern, roots))
    placed = placed_files(store, [read_labels(path) for path in dict.fromkeys(paths)])
    found = [
        Example(rows[one.take][0], one.take, int(one.start), int(one.stop), rows[one.take][1], one.label, one.where)
        for one in placed.segments
        if one.take in rows and not (one.label == ERROR and one.limb)
    ]
    return found, placed.remarks, placed.unmatched


def example_words(store: Store, examples: Iterable[Example]) -> dict[Example, U64]:
    """Return the words of examples, taken from the words of their takes."""
    chosen = list(examples)
    words = store.words(sorted({one.take_id for one in chosen}))
    place = {take_id: index for index, take_id in enumerate(words.take_ids.tolist())}
    return {one: words.take(place[one.take_id])[one.start : one.stop] for one in chosen}


def interval_of(name: str, takes: Container[str]) -> tuple[str, slice]:
    """Return the take and the frames that the name of an example denotes; all frames if it denotes no interval."""
    match = re.fullmatch(r"(.*)\[(\d+):(\d+)\]", name, re.DOTALL)
    if name in takes or match is None or match[1] not in takes:
        return name, slice(None)
    return match[1], slice(int(match[2]), int(match[3]))


@dataclass(frozen=True)
class Rejected:
    """An interval that a person has rejected for a class, as a counterexample.

    Attributes
    ----------
    label : str
        The class or subclass.
    take : str
        The take.
    words : uint64 array (L,)
        The words of the interval, without invalid frames.
    known : int
        The mask of the features known in the take, with the bits of a word.
    start, stop : int
        The frames [start, stop) of the interval.
    """

    label: str
    take: str
    words: U64
    known: int = int(ALL_KNOWN)
    start: int = 0
    stop: int = 0


def rejected_examples(store: Store, params: ExampleParameters, *, of_any: bool = False) -> list[Rejected]:
    """Return the rejected intervals that the parameters select; an empty list if they do not select labels.

    A rejected interval that overlaps a positive label of its class is excluded, because the interval shows the class
    and only its start or stop was wrong. With `of_any`, a rejected interval that overlaps a positive label of any class
    is excluded, because it is an example of that class.
    """
    if LABELS not in params.examples:
        return []
    labelled, _ = _labelled(store, store.takes(params.labels_where))
    shown = defaultdict(list)
    for one in labelled:
        if one.positive:
            shown[one.take, "" if of_any else one.label].append(one)
    refused = [
        one
        for one in labelled
        if not one.positive
        and not any(
            one.start < other.stop and other.start < one.stop for other in shown[one.take, "" if of_any else one.label]
        )
    ]
    words = example_words(store, refused)
    valid = ((one, own[own != NO_WORD]) for one, own in words.items())
    return [
        Rejected(one.label, one.take, own, store.known.get(one.take_id, int(ALL_KNOWN)), one.start, one.stop)
        for one, own in valid
        if len(own)
    ]


def examples_read(store: Store, params: ExampleParameters) -> Reading:
    """Return a digest of the names, classes, verdicts and words of the examples that the parameters select.

    Parameters
    ----------
    store : Store
        The store.
    params : ExampleParameters
        The sources.

    Raises
    ------
    KinedexError
        A filter does not work, a label file or the takes cannot be read.
    """
    found = examples_of(store, params, required=False).examples
    counts = Counter(one.label for one in found if one.positive)
    actors = dict(store.takes().select("name", "actor").iter_rows())
    hasher = hashlib.sha256(f"{store.feature_set.digest} {store.rate_hz!r}".encode())
    for one, words in example_words(store, found).items():
        own = np.ascontiguousarray(words)
        mask = (store.known[one.take_id],) if one.take_id in store.known else ()
        actor = (actors[one.take],) if counts[one.label] > MAX_AVERAGED else ()  # clips are drawn evenly over actors
        hasher.update(repr((one.name, one.label, one.positive, len(own), *mask, *actor)).encode() + own.tobytes())
    clips = sum(one.source == "clip" for one in found)
    parts = [counted(clips, "clip")] if clips else []
    if len(found) > clips:
        parts.append(counted(len(found) - clips, "labelled interval"))
    return Reading(hasher.hexdigest()[:16], ", ".join(parts) or counted(0, "example"))
