"""Store the finished runs of keyframe learning of a stage, for all settings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import pyarrow as pa

from kinedex.pipelines.keyframes.learning import TrainingSet
from kinedex.pipelines.keyframes.runs import ClassRuns, FinishedRun, known_runs, runs_table

if TYPE_CHECKING:
    from kinedex.pipelines.engine.context import StageContext


class StoredRuns:
    """The learning runs that a stage has stored.

    Saving removes the runs of other training clips, because they cannot be reused.
    """

    def __init__(self, context: StageContext, trainings: Sequence[TrainingSet]) -> None:
        self._context = context
        self._prefixes = {training.clips_key() for training in trainings}
        own = context.open().result("keyframe_runs", stage=context.key())
        self._runs: dict[tuple[str, int], FinishedRun] = {(one.key, one.number): one for one in known_runs(own)}

    def known(self) -> list[FinishedRun]:
        """Return all stored runs."""
        return list(self._runs.values())

    def save(self, classes: Sequence[ClassRuns]) -> None:
        """Add the finished runs of classes, and store all runs."""
        self._context.put_results(keyframe_runs=self.table(classes))

    def table(self, classes: Sequence[ClassRuns]) -> pa.Table:
        """Add the finished runs of classes, and return all as results of the kind `keyframe_runs`."""
        for one_class in classes:
            for number, run in one_class.runs.items():
                self._runs[one_class.key, number] = FinishedRun(one_class.key, one_class.training.subclass, number, run)
        kept = [one for one in self._runs.values() if one.key.partition("-")[0] in self._prefixes]
        return runs_table(sorted(kept, key=lambda one: (one.subclass, one.key, one.number)), self._context.run)
