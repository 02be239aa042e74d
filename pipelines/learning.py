"""Learning templates for the subclasses of an archive: the training clips, the tasks, and the table of results."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import polars as pl
import pyarrow as pa

from ops.errors import KinedexError
from ops.templates import Learned, Template, learn_hard, learn_soft
from ops.words import U64
from pipelines.executors import Executor
from storage.schemas import result_schema
from storage.store import Store

Kind = Literal["soft", "hard"]

_TASK_CELLS = 20_000_000
"""Cells of the alignments of one round that make a task worth a second or so."""


@dataclass(frozen=True)
class TrainingClips:
    """The clips of one subclass in the order of their names: names and words."""

    subclass: str
    names: tuple[str, ...]
    words: tuple[U64, ...]

    @property
    def cells(self) -> int:
        """Cells of the alignments of one round: all pairs of frames of all pairs of clips."""
        return sum(len(words) for words in self.words) ** 2


@dataclass(frozen=True)
class SubclassTemplate:
    """A learned template with its provenance."""

    subclass: str
    kind: Kind
    learned: Learned
    clips: tuple[str, ...]


@dataclass(frozen=True)
class Task:
    """Subclasses whose templates one worker learns."""

    clips: tuple[TrainingClips, ...]
    kinds: tuple[Kind, ...]
    features: int


def training_takes(store: Store, where: str) -> pl.DataFrame:
    """The takes that a filter selects for learning, sorted by name; all of them have a class.

    Raises
    ------
    KinedexError: none is selected, or one without a class; the message says what the archive has.
    """
    takes = store.takes(where)
    if not takes.height:
        labelled = store.takes().filter(pl.col("class").is_not_null()).height
        raise KinedexError(
            f"no take to learn templates from: the filter `{where}` selects none of the {store.takes().height} takes, "
            f"{labelled} of which have a class. The class of a take comes from its path, by `patterns` of ingest"
        )
    unlabelled = takes.filter(pl.col("class").is_null())["name"].to_list()
    if unlabelled:
        raise KinedexError(
            f"the filter `{where}` selects {len(unlabelled)} takes to learn from that have no class, such as "
            f"{unlabelled[0]}; add `AND class IS NOT NULL`"
        )
    return takes


def training_clips(store: Store, takes: pl.DataFrame) -> list[TrainingClips]:
    """Group training takes by subclass and read their words; subclasses and clips in the order of their names."""
    words = store.words(takes["take_id"].to_list())
    place = {take_id: index for index, take_id in enumerate(words.take_ids.tolist())}
    clips = []
    for (subclass,), group in takes.sort("class", "name").group_by("class", maintain_order=True):
        of_clips = tuple(words.take(place[take_id]) for take_id in group["take_id"].to_list())
        clips.append(TrainingClips(str(subclass), tuple(group["name"].to_list()), of_clips))
    return clips


def tasks(clips: Iterable[TrainingClips], kinds: Sequence[Kind], features: int) -> list[Task]:
    """Divide subclasses into tasks worth a second or more."""
    groups: list[list[TrainingClips]] = []
    cells = _TASK_CELLS
    for one in clips:
        if cells >= _TASK_CELLS:
            groups.append([])
            cells = 0
        groups[-1].append(one)
        cells += one.cells
    return [Task(tuple(group), tuple(kinds), features) for group in groups]


def learn_task(task: Task) -> list[SubclassTemplate]:
    """Learn the templates of a task (runs in a worker)."""
    learn = {"soft": learn_soft, "hard": learn_hard}
    return [
        SubclassTemplate(one.subclass, kind, learn[kind](one.words, task.features), one.names)
        for one in task.clips
        for kind in task.kinds
    ]


def learn_templates(
    clips: Sequence[TrainingClips], kinds: Sequence[Kind], features: int, executor: Executor
) -> Iterator[list[SubclassTemplate]]:
    """Learn the templates of many subclasses, task by task, in their order."""
    yield from executor.map(learn_task, tasks(clips, kinds, features))


def templates_table(templates: Iterable[SubclassTemplate], run: str, take_filter: str) -> pa.Table:
    """Lay templates out as results of the kind `templates`."""
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
        }
        for one in templates
    ]
    return pa.Table.from_pylist(rows, schema=result_schema("templates"))


def read_templates(store: Store, stage: str, kind: Kind) -> list[SubclassTemplate]:
    """Read the templates of one kind that a stage has stored, by subclass.

    Parameters
    ----------
    stage: "<pipeline>/<stage>".

    Raises
    ------
    KinedexError: the stage has not run, or it learned no templates of this kind.
    """
    rows = store.result("templates", run=run_of(store, stage)).to_pylist()
    found = [
        SubclassTemplate(
            row["subclass"],
            kind,
            Learned(
                Template(np.array(row["values"]).reshape(row["columns"], row["features"]), np.array(row["weights"])),
                row["rounds"],
                tuple(row["costs"]),
            ),
            tuple(row["clips"]),
        )
        for row in rows
        if row["kind"] == kind
    ]
    if not found:
        has = ", ".join(sorted({row["kind"] for row in rows})) or "none"
        raise KinedexError(f"stage {stage} learned no {kind} templates (it has: {has}); set its `methods`")
    return sorted(found, key=lambda one: one.subclass)


def run_of(store: Store, stage: str) -> str:
    """The run of a stage whose results are live; a KinedexError says that it has not run."""
    record = store.manifest.stages.get(stage)
    if record is None:
        raise KinedexError(f"stage {stage} has not run on {store.path}")
    return record.run
