"""Learn motion templates of the subclasses of an archive: training clips, tasks for workers, and tables of results."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from kinedex.ops.arrays import F64
from kinedex.ops.errors import KinedexError
from kinedex.ops.templates.clip_checks import clip_remarks
from kinedex.ops.templates.derived_templates import without_unknown
from kinedex.ops.templates.templates import MAX_AVERAGED, REFERENCES, LearnedTemplate, NamedTemplate, Spread, learn
from kinedex.ops.templates.templates import Kind as Kind
from kinedex.ops.wording import name_list
from kinedex.ops.words import ALL_KNOWN, NO_WORD, U64, known_bits
from kinedex.pipelines.engine.executors import Executor
from kinedex.pipelines.templates.examples import Example, example_words, whole_takes
from kinedex.pipelines.templates.stored_templates import LEARNED_ORIGIN as LEARNED
from kinedex.pipelines.templates.stored_templates import SubclassTemplate as SubclassTemplate
from kinedex.pipelines.templates.stored_templates import template_of
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import Store

if TYPE_CHECKING:
    import polars as pl


_TASK_CELLS = 20_000_000
"""The approximate number of alignment cells of one round in a task, which take about a second."""

_SPLIT_CELLS = 100_000_000
"""The number of cells of a class from which on its rounds are divided among all workers."""


@dataclass(frozen=True)
class TrainingClips:
    """The clips of one subclass, sorted by name, without invalid frames.

    Attributes
    ----------
    subclass : str
        The subclass.
    names : tuple of str
        The names of the takes, with intervals if they are not whole ("walk_01[30:90]").
    words : tuple of uint64 arrays (L,)
        The words of each clip.
    mirrored : int
        The number of clips of `source` with left and right exchanged, which come after the other clips.
    source : str
        The subclass of the mirrored clips.
    remarks : tuple of str
        Remarks on clips that were shortened or excluded.
    takes : tuple of str
        The take of each clip; by default the names.
    known : int
        The mask of the features known in all clips, with the bits of a word. Only these are learned.
    actors : tuple of str
        The actor of each clip; by default the same for all. Clips of large classes are drawn evenly over actors.
    starts : tuple of int
        The first frame of each clip in its take; by default 0.
    """

    subclass: str
    names: tuple[str, ...]
    words: tuple[U64, ...]
    mirrored: int = 0
    source: str = ""
    remarks: tuple[str, ...] = ()
    takes: tuple[str, ...] = ()
    known: int = int(ALL_KNOWN)
    actors: tuple[str, ...] = ()
    starts: tuple[int, ...] = ()

    @property
    def of_starts(self) -> tuple[int, ...]:
        """The first frame of each clip in its take."""
        return self.starts or (0,) * len(self.names)

    @property
    def of_actors(self) -> tuple[str, ...]:
        """The actor of each clip; empty texts if actors are not given."""
        return self.actors or ("",) * len(self.names)

    @property
    def of_takes(self) -> tuple[str, ...]:
        """The take of each clip."""
        return self.takes or self.names

    @property
    def cells(self) -> int:
        """The approximate number of alignment cells in one round: all pairs of frames of all aligned pairs of clips."""
        frames = sum(len(words) for words in self.words)
        count = len(self.words)
        return frames**2 if count <= MAX_AVERAGED else frames**2 * REFERENCES // count

    @property
    def origin(self) -> str:
        """The origin of a template that is learned from these clips, as text."""
        if not self.mirrored:
            return LEARNED
        return f"{LEARNED}, {self.mirrored} of {len(self.names)} clips are those of {self.source} in the mirror"

    def without(self, names: Container[str]) -> TrainingClips:
        """Return the clips except those from the given takes."""
        return self._of([index for index, take in enumerate(self.of_takes) if take not in names])

    def only(self, names: Container[str]) -> TrainingClips:
        """Return the clips from the given takes."""
        return self._of([index for index, take in enumerate(self.of_takes) if take in names])

    def first(self) -> TrainingClips:
        """Return the first clip alone."""
        return self._of([0])

    def _of(self, chosen: Sequence[int]) -> TrainingClips:
        images = sum(index >= len(self.names) - self.mirrored for index in chosen)
        return TrainingClips(
            self.subclass,
            tuple(self.names[index] for index in chosen),
            tuple(self.words[index] for index in chosen),
            mirrored=images,
            source=self.source if images else "",
            takes=tuple(self.of_takes[index] for index in chosen),
            known=self.known,
            actors=tuple(self.of_actors[index] for index in chosen),
            starts=tuple(self.of_starts[index] for index in chosen),
        )


@dataclass(frozen=True)
class Task:
    """The clips of some subclasses, whose templates one worker learns."""

    clips: tuple[TrainingClips, ...]
    kinds: tuple[Kind, ...]
    features: int
    feature_weights: F64 | None = None


def training_clips(store: Store, takes: pl.DataFrame) -> list[TrainingClips]:
    """Group whole takes by subclass and read their words (`example_clips`)."""
    return example_clips(store, whole_takes(takes))


def example_clips(store: Store, examples: Iterable[Example]) -> list[TrainingClips]:
    """Group examples by subclass and read their words.

    Invalid frames at the ends of an example are removed; an example with other invalid frames, or without any valid
    frame, is excluded.

    Parameters
    ----------
    store : Store
        The store that holds the takes.
    examples : iterable of Example
        Clips and intervals; rejected ones are ignored.

    Returns
    -------
    list of TrainingClips
        The examples of each subclass, both sorted by name.

    Raises
    ------
    KinedexError
        A subclass has no example left.
    """
    words = example_words(store, (one for one in examples if one.positive))
    actors = dict(store.takes().select("name", "actor").iter_rows())
    clips = []
    for subclass, group in groupby(
        sorted(words, key=lambda one: (one.label, one.take, one.start, one.stop)), key=lambda one: one.label
    ):
        chosen = list(group)
        known = {one.name: store.known[one.take_id] for one in chosen if one.take_id in store.known}
        who = {one.name: actors[one.take] or "" for one in chosen}
        usable = usable_clips(subclass, {one.name: words[one] for one in chosen}, known, who)
        take = {one.name: one.take for one in chosen}
        first = {one.name: one.start + int(np.argmax(words[one] != NO_WORD)) for one in chosen}
        takes = tuple(take[name] for name in usable.names)
        clips.append(replace(usable, takes=takes, starts=tuple(first[name] for name in usable.names)))
    return clips


def usable_clips(
    subclass: str,
    every: dict[str, U64],
    known: Mapping[str, int] | None = None,
    actors: Mapping[str, str] | None = None,
) -> TrainingClips:
    """Return the clips of one subclass that can be used for learning.

    Parameters
    ----------
    subclass : str
        The name of the subclass.
    every : dict of str to uint64 array
        The words of each clip by its name.
    known : mapping of str to int, optional
        The masks of known features of the clips that lack some.
    actors : mapping of str to str, optional
        The actor of each clip.

    Returns
    -------
    TrainingClips
        The clips without invalid frames at their ends. Clips are excluded if they have other invalid frames or no valid
        frame, or if they lack a feature that is known in the clip with the most known features.

    Raises
    ------
    KinedexError
        No clip is left.
    """
    kept: dict[str, U64] = {}
    shortened, excluded = [], []
    masks = {name: (known or {}).get(name, int(ALL_KNOWN)) for name in every}
    for name, words in every.items():
        valid = np.flatnonzero(words != NO_WORD)
        inner = words[valid[0] : valid[-1] + 1] if len(valid) else words[:0]
        if not len(valid) or len(inner) > len(valid):
            excluded.append(name)
            continue
        kept[name] = inner
        if len(inner) < len(words):
            shortened.append(name)
    if not kept:
        raise KinedexError(
            f"subclass {subclass} is left without a clip to learn from: all of them have invalid frames "
            f"({name_list(excluded)}); exclude it from the training takes, or ingest with a larger `fill_gap_frames`"
        )
    remarks = []
    if excluded:
        remarks.append(f"clips with invalid frames in the middle, excluded: {name_list(excluded)}")
    if shortened:
        remarks.append(f"clips with invalid frames at an end, which are cut off: {name_list(shortened)}")
    # Choose the mask with most features; of masks with equal numbers, that of most clips, then the greater mask.
    mask = max(Counter(masks[name] for name in kept).items(), key=lambda one: (one[0].bit_count(), one[1], one[0]))[0]
    lacking = [name for name in kept if mask & ~masks[name]]
    if lacking:
        remarks.append(f"clips whose bodies lack joints that others have, excluded: {name_list(lacking)}")
    if mask != ALL_KNOWN:
        remarks.append(f"the bodies of all clips lack joints: {mask.bit_count()} features are learned")
    used = {name: words for name, words in kept.items() if name not in lacking}
    who = tuple(actors[name] for name in used) if actors else ()
    return TrainingClips(subclass, tuple(used), tuple(used.values()), remarks=tuple(remarks), known=mask, actors=who)


def learn_template(
    clips: TrainingClips,
    kind: Kind,
    features: int,
    feature_weights: F64 | None = None,
    spread: Spread = map,
    pieces: int = 1,
) -> LearnedTemplate:
    """Learn a template from clips as `ops.templates.templates.learn` does; unknown features get no weight."""
    if clips.known == ALL_KNOWN:
        return learn(kind, clips.words, features, feature_weights, spread, pieces, clips.of_actors)
    weights = np.where(known_bits(clips.known, features), 1.0 if feature_weights is None else feature_weights, 0.0)
    found = learn(kind, clips.words, features, weights, spread, pieces, clips.of_actors)
    return replace(found, template=without_unknown(found.template, clips.known))


def learning_tasks(
    clips: Iterable[TrainingClips], kinds: Sequence[Kind], features: int, feature_weights: F64 | None = None
) -> list[Task]:
    """Divide subclasses into tasks that take at least about a second."""
    groups: list[list[TrainingClips]] = []
    cells = _TASK_CELLS
    for one in clips:
        if cells >= _TASK_CELLS:
            groups.append([])
            cells = 0
        groups[-1].append(one)
        cells += one.cells
    return [Task(tuple(group), tuple(kinds), features, feature_weights) for group in groups]


def learn_task(task: Task) -> list[SubclassTemplate]:
    """Learn the templates of a task, in a worker."""
    return [
        learned_template(one, kind, learn_template(one, kind, task.features, task.feature_weights))
        for one in task.clips
        for kind in task.kinds
    ]


def learn_templates(
    clips: Sequence[TrainingClips],
    kinds: Sequence[Kind],
    features: int,
    executor: Executor,
    feature_weights: F64 | None = None,
) -> Iterator[list[SubclassTemplate]]:
    """Learn the templates of many subclasses in workers; yield those of the largest subclasses last.

    Subclasses are divided among the workers, and for subclasses with very many clips also the alignments of each round.
    The templates do not depend on the executor, to the last bit.

    Parameters
    ----------
    clips : sequence of TrainingClips
        The clips of each subclass.
    kinds : sequence of {"soft", "hard"}
        The kinds of templates to learn.
    features : int
        The number f of features.
    executor : Executor
        The workers.
    feature_weights : float64 array (f,), optional
        The weight of each feature in alignments and distance curves; by default all are equal.

    Yields
    ------
    list of SubclassTemplate
        The templates of a task.
    """
    most = _SPLIT_CELLS if executor.workers > 1 else math.inf
    split, whole = [one for one in clips if one.cells >= most], [one for one in clips if one.cells < most]
    yield from executor.map(learn_task, learning_tasks(whole, kinds, features, feature_weights))
    for one in split:
        for kind in kinds:
            pieces = 4 * executor.workers
            found = learn_template(one, kind, features, feature_weights, executor.map, pieces)
            yield [learned_template(one, kind, found)]


def as_subclass_template(
    named: NamedTemplate, kind: Kind = "soft", origin: str = "from a file", feature_weights: F64 | None = None
) -> SubclassTemplate:
    """Convert a template from a file or an example to the form of learned templates, without clips.

    Parameters
    ----------
    named : NamedTemplate
        The template and its name.
    kind : {"soft", "hard"}
        The kind of the result.
    origin : str
        The origin in results.
    feature_weights : float64 array (f,), optional
        The weights of features if the template has none of its own.
    """
    template = named.template
    if template.feature_weights is None:
        template = replace(template, feature_weights=feature_weights)
    return SubclassTemplate(named.name, kind, LearnedTemplate(template, 0, ()), (), origin)


def learned_template(clips: TrainingClips, kind: Kind, learned: LearnedTemplate) -> SubclassTemplate:
    """Return a learned template with its provenance, and with remarks on clips that are unlike the others."""
    lengths = [len(words) for words in clips.words]
    remarks = (*clips.remarks, *clip_remarks(clips.names, lengths, learned.clip_costs))
    return SubclassTemplate(clips.subclass, kind, learned, clips.names, clips.origin, remarks)


def templates_table(templates: Iterable[SubclassTemplate], run: str, take_filter: str) -> pa.Table:
    """Return templates as results of the kind `templates`."""
    rows = [
        {
            "run": run,
            "subclass": one.subclass,
            "kind": one.kind,
            "features": one.learned.template.values.shape[1],
            "columns": len(one.learned.template),
            "values": one.learned.template.values.ravel(),
            "weights": one.learned.template.weights,
            "clips": list(one.clips),
            "rounds": one.learned.rounds,
            "costs": list(one.learned.costs),
            "take_filter": take_filter,
            "origin": one.origin,
            "clip_costs": list(one.learned.clip_costs),
            "feature_weights": one.learned.template.feature_weights,
            "remarks": list(one.remarks),
        }
        for one in templates
    ]
    return pa.Table.from_pylist(rows, schema=result_schema("templates"))


def read_templates(store: Store, stage: str, kind: Kind) -> list[SubclassTemplate]:
    """Read the templates of one kind that a stage has stored, sorted by subclass.

    Parameters
    ----------
    store : Store
        The store to read.
    stage : str
        "<pipeline>/<stage>".
    kind : {"soft", "hard"}
        The kind of template.

    Raises
    ------
    KinedexError
        The stage has not run, or it learned no templates of this kind.
    """
    rows = store.result("templates", run=run_of(store, stage)).to_pylist()
    found = [template_of(row) for row in rows if row["kind"] == kind]
    if not found:
        has = ", ".join(sorted({row["kind"] for row in rows})) or "none"
        raise KinedexError(f"stage {stage} learned no {kind} templates (it has: {has}); set its `methods`")
    return sorted(found, key=lambda one: one.subclass)


def run_of(store: Store, stage: str) -> str:
    """Return the id of the run that holds a stage's current results; raise a KinedexError if it has not run."""
    record = store.manifest.stages.get(stage)
    if record is None:
        raise KinedexError(f"stage {stage} has not run on {store.path}")
    return record.run
