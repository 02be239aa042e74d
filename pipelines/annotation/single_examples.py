"""The method `best` with every example as a template, for archives in which people have labelled little.

A few examples of one class do not represent an archive. Where the examples differ, their average is vague. The postures
that are common in the examples are postures of the class itself, and cannot serve as background. Rejected intervals
resemble the class in everything that the average retains. Therefore, every example is a template, every rejected
interval is a template that assigns no label, and the background is learned from all takes (`studies.explorer_decisions`
compares the alternatives).
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import ClassVar

import numpy as np
import pyarrow as pa

from kinedex.ops.annotation.background import background
from kinedex.ops.annotation.decoding import Decoding
from kinedex.ops.annotation.promising_ranges import Group, promising_ranges, template_groups
from kinedex.ops.annotation.segments import Segment
from kinedex.ops.arrays import F64, I64, U64, Bool
from kinedex.ops.errors import StoreError
from kinedex.ops.templates.derived_templates import restricted_template
from kinedex.ops.templates.templates import QuantisedTemplate, Template, quantise
from kinedex.ops.words import TakeWords
from kinedex.pipelines.annotation.methods import (
    AnnotationMethod,
    LabelledMotion,
    Motion,
    Motions,
    Needs,
    Offers,
    Setting,
    Takes,
    best_known,
    whole_takes,
)
from kinedex.pipelines.annotation.template_methods import BestMethod, with_usual_values
from kinedex.pipelines.templates.template_learning import TrainingClips, learn_template
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import Store

KIND = "example_ranges"
"""The kind of results that holds promising ranges."""


@dataclass(frozen=True)
class PromisingRanges:
    """The ranges of a take in which each example could label frames (`ops.annotation.promising_ranges`).

    Attributes
    ----------
    fingerprint : str
        A hash of the take's words, see `words_fingerprint`; empty if unknown.
    keys : uint64 array (E,)
        The hashes of the examples, see `SingleExamples.keys`.
    counts : int64 array (E,)
        The number of ranges of each example.
    starts, stops : int64 array (R,)
        The frames [start, stop) of the ranges, grouped by example.
    """

    fingerprint: str
    keys: U64
    counts: I64
    starts: I64
    stops: I64

    def of(self, keys: U64) -> tuple[Bool, I64]:
        """Return whether each key is known, bool (N,), and rows of index in `keys`, start and stop, int64 (R, 3)."""
        if not len(self.keys):
            return np.zeros(len(keys), np.bool_), np.empty((0, 3), np.int64)
        order = np.argsort(self.keys)
        mine = order[np.minimum(np.searchsorted(self.keys, keys, sorter=order), len(order) - 1)]
        held = self.keys[mine] == keys
        firsts, counts = (np.cumsum(self.counts) - self.counts)[mine], np.where(held, self.counts[mine], 0)
        examples = np.repeat(np.arange(len(keys)), counts)
        rows = firsts[examples] + np.arange(len(examples)) - np.repeat(np.cumsum(counts) - counts, counts)
        return held, np.stack([examples, self.starts[rows], self.stops[rows]], axis=1)


_NOTHING = np.empty(0, np.int64)
NO_RANGES = PromisingRanges("", np.empty(0, np.uint64), _NOTHING, _NOTHING, _NOTHING)


def ranges_by_example(keys: U64, ranges: I64) -> PromisingRanges:
    """Return promising ranges from rows of example, start and stop, int64 (R, 3), sorted by example."""
    counts = np.bincount(ranges[:, 0], minlength=len(keys))
    return PromisingRanges("", keys, counts, ranges[:, 1], ranges[:, 2])


def words_fingerprint(words: U64, code: str) -> str:
    """Return a hash of the words of a take and of the code that compares them with examples."""
    return hashlib.sha256(code.encode() + np.ascontiguousarray(words).tobytes()).hexdigest()[:32]


def ranges_table(found: Iterable[tuple[int, PromisingRanges]], names: Mapping[int, str], run: str) -> pa.Table:
    """Return the ranges of takes by take_id as results of the kind `example_ranges`; `names` has the names of takes."""
    rows = list(found)
    every = [one for _, one in rows]

    def lists(name: str) -> pa.Array:
        values = [getattr(one, name) for one in every]
        offsets = np.cumsum([0, *map(len, values)])
        flat = np.concatenate(values) if values else np.empty(0, np.int64)
        return pa.ListArray.from_arrays(pa.array(offsets, pa.int32()), pa.array(flat))

    columns = {
        "run": pa.array([run] * len(rows), pa.string()),
        "take_id": pa.array([take_id for take_id, _ in rows], pa.int64()),
        "take": pa.array([names[take_id] for take_id, _ in rows], pa.string()),
        "fingerprint": pa.array([one.fingerprint for one in every], pa.string()),
        **{column: lists(name) for column, name in _LISTS.items()},
    }
    schema = result_schema(KIND)
    return pa.table([columns[field.name].cast(field.type) for field in schema], schema=schema)


_LISTS = {"examples": "keys", "counts": "counts", "starts": "starts", "stops": "stops"}


def earlier_ranges(store: Store, stage: str) -> dict[int, PromisingRanges]:
    """Return the ranges that a stage stored earlier, by take_id; an empty dictionary if they cannot be read."""
    try:
        rows = store.result(KIND, stage=stage)
    except StoreError:
        return {}  # unreadable results are removed by repair, and computed again
    found: dict[int, PromisingRanges] = {}
    for batch in rows.to_batches():
        lists = []
        for name, kind in zip(_LISTS, (np.uint64, np.int64, np.int64, np.int64), strict=True):
            column = batch.column(name)
            offsets = column.offsets.to_numpy().tolist()
            flat = column.values.to_numpy().astype(kind)
            lists.append([flat[first:stop] for first, stop in pairwise(offsets)])
        prints, takes = (batch.column(name).to_pylist() for name in ("fingerprint", "take_id"))
        found |= {take: PromisingRanges(*row) for take, *row in zip(takes, prints, *lists, strict=True)}
    return found


NOTHING = -1
"""The index that marks a template of a rejected interval, which assigns no label."""


MAX_FRAMES = 20_000
"""The largest number of frames from which the background is learned; more do not change its few postures."""


@dataclass(frozen=True)
class SingleExamples(AnnotationMethod):
    """Labels all frames of a take together, with every example as a template; a segment refers to its class's template.

    Attributes
    ----------
    row : BestMethod
        The method, with a template for each of E examples.
    positions : int64 array (E,)
        The index of the annotator's template that each example belongs to; `NOTHING` for a rejected interval.
    """

    name: ClassVar[str] = "best"
    label: ClassVar[str] = "examples in a row"
    needs: ClassVar[Needs] = Needs(words=True, templates="outlines", ranges=True)
    offers: ClassVar[Offers] = Offers(keeps_ranges=True)

    row: BestMethod
    positions: I64

    @classmethod
    def fit(cls, examples: Motions[LabelledMotion], unlabelled: Motions[Motion], setting: Setting) -> SingleExamples:
        """Make the method; templates of subclasses without examples, such as those from files, are used as they are.

        Frames that match a rejected example best get no label. The common postures of the archive are the background.
        """
        usual = unlabelled.once(usual_postures, setting.features)
        by_subclass: dict[str, list[LabelledMotion]] = {}
        for one in (one for one in examples if one.positive):
            by_subclass.setdefault(one.label, []).append(one)
        found: list[tuple[int, Template]] = []
        for place, subclass in enumerate(setting.subclasses):
            own = by_subclass.get(subclass)
            learned = [setting.templates[place]] if own is None else [_template_of(one, setting) for one in own]
            found += [(place, one) for one in learned]
        found += [(NOTHING, _template_of(one, setting)) for one in examples if not one.positive]
        places = np.array([place for place, _ in found], np.int64)
        row = BestMethod(
            tuple(with_usual_values(template, usual) for _, template in found),
            tuple(quantise(template, setting.delta) for _, template in found),
            np.where(places == NOTHING, len(setting.classes), setting.class_index[places]),
            usual,
            Decoding(),
        )
        return cls(row, places)

    def restricted(self, known: int, templates: Sequence[QuantisedTemplate], chosen: I64) -> SingleExamples:
        """Return the method for takes in which only some features are known; see `ThesisMethod.restricted`."""
        new = {int(place): index for index, place in enumerate(chosen.tolist())} | {NOTHING: NOTHING}
        kept = {
            example: own
            for example, place in enumerate(self.positions.tolist())
            if place in new and (own := restricted_template(self.row.quantised[example], known)) is not None
        }
        places = np.array([new[int(self.positions[example])] for example in kept], np.int64)
        return SingleExamples(self.row.restricted(known, list(kept.values()), np.array(list(kept), np.int64)), places)

    def annotate(self, takes: Takes) -> list[list[Segment]]:
        """Label takes; see `AnnotationMethod.annotate`."""
        words = takes.words
        if not (self.positions != NOTHING).any():
            return [[] for _ in range(len(words))]
        whole = whole_takes(words)
        within = [whole if place == NOTHING else takes.ranges[place] for place in self.positions.tolist()]
        promising = takes.promising or self.promising(words)
        return [
            [
                replace(one, subclass=int(self.positions[one.subclass]))
                for one in segments
                if self.positions[one.subclass] != NOTHING
            ]
            for segments in self.row.annotate(Takes(words, within, promising=promising))
        ]

    def promising(self, words: TakeWords, earlier: Sequence[PromisingRanges | None] | None = None) -> list[I64]:
        """Return the ranges of each take that examples could label.

        Parameters
        ----------
        words : TakeWords
            The words of T takes, concatenated.
        earlier : sequence of PromisingRanges or None, length T, optional
            The known ranges of each take; only examples that are not in them are compared with its words.

        Returns
        -------
        list of int64 array (R, 3), length T
            See `ops.annotation.promising_ranges`.
        """
        laid, found = self.row.own_words(words), []
        groups: dict[bytes, tuple[I64, list[Group]]] = {}
        for take, (start, stop) in enumerate(pairwise(words.offsets.tolist())):
            known = None if earlier is None else earlier[take]
            held, ranges = (NO_RANGES if known is None else known).of(self.keys)
            if held.tobytes() not in groups:
                new = np.flatnonzero(~held)
                templates = [self.row.templates[example] for example in new.tolist()]
                groups[held.tobytes()] = new, template_groups(templates, self.row.usual, self.row.decoding)
            new, own = groups[held.tobytes()]
            more = promising_ranges(own, self.row.usual, laid[start:stop], self.row.decoding)
            more[:, 0] = new[more[:, 0]]
            both = np.concatenate([ranges, more])
            found.append(both[np.lexsort((both[:, 1], both[:, 0]))])
        return found

    @cached_property
    def keys(self) -> U64:
        """The key of each example, uint64 (E,): a hash of everything but words that determines its promising ranges."""
        common = hashlib.sha256(f"{self.row.decoding!r}{self.row.usual.shape}".encode() + self.row.usual.tobytes())
        found = []
        for template in self.row.templates:
            hasher = common.copy()
            hasher.update(np.ascontiguousarray(template.values).tobytes())
            found.append(int.from_bytes(hasher.digest()[:8], "little"))
        return np.array(found, np.uint64)


def usual_postures(takes: Sequence[Motion], features: int) -> F64:
    """Return the common postures of takes, learned from at most `MAX_FRAMES` of their frames, spread evenly."""
    words = np.concatenate([np.empty(0, np.uint64), *(one.words for one in best_known(takes))])
    return background([words[:: -(-len(words) // MAX_FRAMES) or 1]], features)


def _template_of(example: LabelledMotion, setting: Setting) -> Template:
    """Return the template that is learned from an example alone."""
    alone = TrainingClips(example.label, ("",), (example.words,), known=example.known)
    return learn_template(alone, "soft", setting.features, setting.feature_weights).template
