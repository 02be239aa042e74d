"""Finished runs of keyframe learning that a stage keeps in the store, those of other settings among them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import pyarrow as pa

from kinedex.pipelines.keyframes.learning import Lesson
from kinedex.pipelines.keyframes.runs import Course, Known, known_runs, runs_table

if TYPE_CHECKING:
    from kinedex.pipelines.engine.context import StageContext


class KeptRuns:
    """The runs of a stage, whatever their number and setting, as long as the clips and the algorithm are the same.

    Runs of classes or clips that are not learned from any more go with the next save: nothing could use them, unless
    just these clips came back.
    """

    def __init__(self, context: StageContext, lessons: Sequence[Lesson]) -> None:
        self._context = context
        self._prefixes = {lesson.clips_key() for lesson in lessons}
        own = context.open().result("keyframe_runs", stage=context.key())
        self._runs: dict[tuple[str, int], Known] = {(one.key, one.number): one for one in known_runs(own)}

    def known(self) -> list[Known]:
        """All of them."""
        return list(self._runs.values())

    def save(self, courses: Sequence[Course]) -> None:
        """Add the finished runs of courses and put all into the store."""
        with self._context.writer() as writer:
            table = self.table(courses)
            writer.put_results("keyframe_runs", table, stage=self._context.key(), run=self._context.run)
            writer.commit()

    def table(self, courses: Sequence[Course]) -> pa.Table:
        """Add the finished runs of courses, and lay all out as results of the kind `keyframe_runs`."""
        for course in courses:
            for number, run in course.runs.items():
                self._runs[course.key, number] = Known(course.key, course.lesson.subclass, number, run)
        kept = [one for one in self._runs.values() if one.key.partition("-")[0] in self._prefixes]
        return runs_table(sorted(kept, key=lambda one: (one.subclass, one.key, one.number)), self._context.run)
