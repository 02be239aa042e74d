"""A made-up archive of labelled clips and long takes, written into a store as words: no motion files."""

from __future__ import annotations

import io
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydantic import BaseModel
from rich.console import Console

from kinedex.console.terminal import Terminal
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.executors import make_executor
from kinedex.pipelines.engine.stage import Stage
from kinedex.pipelines.labels.unmatched_labels import unmatched_summary
from kinedex.pipelines.stages.compare_methods import CompareMethods
from kinedex.storage.snapshot.manifest import StageRecord
from kinedex.storage.snapshot.parts import FramesWriter
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, take_row, takes_table

_random = np.random.default_rng(2012)
POSES = {
    name: _random.integers(0, 1 << 40, poses, dtype=np.uint64)
    for name, poses in {"walk": 4, "kick": 5, "wave": 4, "rest": 1}.items()
}
"""Subclass → the words that its motions run through; any two differ in about half of the features."""


def motion(subclass: str, frames_a_pose: int = 5) -> np.ndarray:
    return np.repeat(POSES[subclass], frames_a_pose)


def clip(subclass: str, actor: str, number: int, frames_a_pose: int = 5) -> dict[str, object]:
    name = f"{actor}_{subclass}_{number:03d}"
    return {"name": name, "actor": actor, "class": subclass, "words": motion(subclass, frames_a_pose)}


def long_take(name: str, actor: str, *subclasses: str, frames_a_pose: int = 5) -> dict[str, object]:
    words = np.concatenate([motion(subclass, frames_a_pose) for subclass in subclasses])
    return {"name": name, "actor": actor, "class": None, "words": words}


def write_store(path: Path, takes: list[dict[str, object]], source_root: Path | None = None) -> Path:
    """Write takes as they stand: rows whose `words`, and `positions`, are their frames; source frames are at 120 Hz."""
    with StoreWriter.open(path, BODY) as writer:
        ids = writer.assign_take_ids([str(take["name"]) for take in takes])
        rows = []
        with FramesWriter(path, BODY) as frames:
            for take in sorted(takes, key=lambda take: ids[str(take["name"])]):
                words = np.asarray(take["words"], np.uint64)
                positions = np.asarray(take.get("positions", np.zeros((len(BODY.joints), 3, len(words)))), np.float64)
                frames.add(ids[str(take["name"])], positions, np.zeros((4, len(words))), words)
                columns = {key: value for key, value in take.items() if key not in ("name", "words", "positions")}
                name = str(take["name"])
                rows.append(
                    take_row(ids[name], name, len(words), **columns, source_root=str(source_root or "/archive"))
                )
            part = frames.close()
        writer.add_takes(takes_table(rows), part)
        writer.commit()
    return path


class Line:
    """A pipeline for tests: runs stages on a store one after the other, each under its module's name."""

    INPUTS: ClassVar[dict[str, dict[str, str]]] = {
        "learn_templates": {},
        "annotate": {"templates": "learn_templates"},
        "evaluate": {"annotations": "annotate"},
        "compare_methods": {"templates": "learn_templates", "annotations": "annotate", "evaluation": "evaluate"},
    }

    PIPELINE = "test"

    def __init__(self, store: Path, executor: str = "serial") -> None:
        self.store = store
        self.executor = make_executor(executor, 2)
        self.params: dict[str, BaseModel] = {}
        self.printed = io.StringIO()

    def context(self, stage: str) -> StageContext:
        return StageContext(
            store_path=self.store,
            feature_set=BODY,
            pipeline=self.PIPELINE,
            stage=stage,
            run=f"run-{stage}",
            executor=self.executor,
            terminal=Terminal(Console(file=self.printed, soft_wrap=True, width=120)),
            uses=stage,
            inputs=dict(self.INPUTS[stage]),
            params=dict(self.params),
        )

    def run(self, kind: type[Stage[Any]], **params: object) -> Mapping[str, object]:
        stage = kind.name
        self.params[stage] = kind.parameters(**params)
        context = self.context(stage)
        summary = kind().run(context, self.params[stage]) | unmatched_summary(context.unmatched)
        record = StageRecord(
            f"{self.PIPELINE}/{stage}",
            "",
            context.run,
            datetime.now(UTC).isoformat(),
            0.0,
            {**summary, "uses": stage, "inputs": self.INPUTS[stage]},
        )
        with StoreWriter.open(self.store, BODY) as writer:
            writer.record_stage(record)
            writer.commit()
        return summary

    def leave_out(self, column: str = "actor") -> Mapping[str, object]:
        """Repeat the annotation for each value of a column, with templates of the others."""
        splits = [{"name": f"leave one {column} out", "leave_out": column}]
        return self.run(CompareMethods, splits=splits, embed="none")


CLIPS = [
    clip(subclass, actor, number, pace)
    for subclass in ("walk", "kick", "wave")
    for actor, number, pace in (("ann", 1, 4), ("ann", 2, 5), ("bob", 3, 6))
]
TAKES = [
    long_take("cat_take01", "cat", "rest", "walk", "rest", "kick", "rest"),
    long_take("bob_take01", "bob", "wave", "rest", "kick", frames_a_pose=6),
]
TRUTH = """take,class,start,stop
cat_take01,walk,20,100
cat_take01,kick,120,220
bob_take01,wave,0,96
bob_take01,kick,120,240
"""


def labelled_line(folder: Path) -> Line:
    """A store of these clips and takes in a folder, with their ground truth, and the stages to run on it."""
    archive = folder / "archive"
    archive.mkdir()
    (archive / "ground_truth.csv").write_text(TRUTH)
    return Line(write_store(folder / "store", CLIPS + TAKES, archive))
