"""The runs of keyframe learning: in rounds over all classes, kept as they finish, stopped where nothing moves."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pyarrow as pa

from kinedex.ops.keyframes.consensus import Consensus
from kinedex.ops.keyframes.individuals import Individual
from kinedex.ops.keyframes.training_task import LearningRun
from kinedex.pipelines.engine.executors import Executor
from kinedex.pipelines.keyframes.learning import AgreeTask, Chosen, Lesson, Outcome, RunTask, Setting, agree, do_runs
from kinedex.storage.snapshot.schemas import result_schema

SAVE_SECONDS = 20.0
"""How long runs may be finished without being stored."""


@dataclass(frozen=True)
class Known:
    """A finished run: its lesson's key, its subclass, its number, and what it found."""

    key: str
    subclass: str
    number: int
    run: LearningRun


@dataclass
class Course:
    """A lesson on its way: its finished runs by number, what became of them, and whether more are wanted."""

    lesson: Lesson
    key: str
    runs: dict[int, LearningRun] = field(default_factory=dict)
    outcomes: list[Outcome] = field(default_factory=list)
    settled: bool = False

    @property
    def outcome(self) -> Outcome:
        """The outcome that ranks highest, of equal ones the last: with more runs a consensus can become worse."""
        return max(reversed(self.outcomes), key=lambda one: one.consensus.rank)

    @property
    def used(self) -> dict[int, LearningRun]:
        """The runs that were wanted; a course may know more, of a time when more were asked for."""
        wanted = self.outcomes[-1].runs if self.outcomes else 0
        return {number: run for number, run in sorted(self.runs.items()) if number < wanted}


@dataclass(frozen=True)
class Rounds:
    """How many runs there are: at most `runs`, in rounds of `group`; it ends after `patience` rounds that have not
    raised the outcome's rank by more than `settled`."""

    runs: int
    group: int
    patience: int
    settled: float


def learn(
    lessons: Sequence[Lesson],
    setting: Setting,
    rounds: Rounds,
    executor: Executor,
    known: Sequence[Known] = (),
    save: Callable[[list[Course]], None] | None = None,
    advance: Callable[[int], None] | None = None,
    say: Callable[[str], None] | None = None,
) -> list[Course]:
    """Do all runs that are wanted; whatever the workers, the same runs and the same outcomes.

    Parameters
    ----------
    known: runs that were finished before; those of these lessons and this setting are not done again. save: keeps
    finished runs; called every `SAVE_SECONDS` and after each round. advance: is told how many runs are done, or not
    wanted any more. say: is told how far it is, after each round.
    """
    courses = [Course(lesson, lesson.key(setting)) for lesson in lessons]
    by_key = {course.key: course for course in courses}
    for one in known:
        if one.key in by_key:
            by_key[one.key].runs[one.number] = one.run
    for begin in range(0, rounds.runs, rounds.group):
        numbers = range(begin, min(begin + rounds.group, rounds.runs))
        active = [course for course in courses if not course.settled]
        if not active:
            break
        _run_round(active, setting, numbers, executor, save and (lambda: save(courses)), advance)
        tasks = [AgreeTask(c.lesson, setting, tuple(c.runs[n] for n in range(numbers.stop))) for c in active]
        for course, outcome in zip(active, executor.map(agree, tasks), strict=True):
            course.outcomes.append(outcome)
            course.settled = _settled(course.outcomes, rounds)
            if course.settled and advance is not None:
                advance(rounds.runs - numbers.stop)
        if say is not None:
            settled = sum(course.settled for course in courses)
            say(f"{numbers.stop} of at most {rounds.runs} runs each: {settled} of {len(courses)} subclasses settled")
    return courses


def _run_round(
    courses: Sequence[Course],
    setting: Setting,
    numbers: range,
    executor: Executor,
    save: Callable[[], None] | None,
    advance: Callable[[int], None] | None,
) -> None:
    work = []
    for course in courses:
        missing = tuple(number for number in numbers if number not in course.runs)
        if missing:
            work.append((course, RunTask(course.lesson, setting, missing)))
        if advance is not None:
            advance(len(numbers) - len(missing))
    stored = time.monotonic()
    try:
        for (course, task), found in zip(work, executor.map(do_runs, [task for _, task in work]), strict=True):
            course.runs.update(zip(task.numbers, found, strict=True))
            if advance is not None:
                advance(len(found))
            if save is not None and time.monotonic() - stored > SAVE_SECONDS:
                save()
                stored = time.monotonic()
    finally:
        # whatever ended it, a dead cluster or Ctrl-C: what is finished is not lost
        if save is not None and work:
            save()


def _settled(outcomes: Sequence[Outcome], rounds: Rounds) -> bool:
    """Nothing moves: over the last rounds the outcome has not become better by more than a trifle."""
    if len(outcomes) <= rounds.patience:
        return False
    ranks = [outcome.consensus.rank for outcome in outcomes]
    return max(ranks[-rounds.patience :]) - max(ranks[: -rounds.patience]) <= rounds.settled


# ---- tables ----------------------------------------------------------------------------------------------


def runs_table(runs: Sequence[Known], run: str) -> pa.Table:
    """Finished runs as results of the kind `keyframe_runs`."""
    rows = [
        {
            "run": run,
            "key": one.key,
            "subclass": one.subclass,
            "number": one.number,
            "fitness": one.run.fitness,
            "rank": one.run.rank,
            "evaluated": one.run.evaluated,
            **_query_columns(one.run.query),
            "history": one.run.history.ravel().tolist(),
        }
        for one in runs
    ]
    return pa.Table.from_pylist(rows, schema=result_schema("keyframe_runs"))


def known_runs(table: pa.Table) -> list[Known]:
    """Read runs back."""
    found = []
    for row in table.to_pylist():
        history = np.array(row["history"], np.float64).reshape(-1, 4)
        run = LearningRun(_query_of(row), row["fitness"], row["rank"], history, row["evaluated"])
        found.append(Known(row["key"], row["subclass"], row["number"], run))
    return found


def queries_table(courses: Sequence[Course], run: str) -> pa.Table:
    """The outcomes as results of the kind `queries`, one row for each chosen query."""
    rows = []
    for course in courses:
        outcome = course.outcome
        found = outcome.consensus
        for number, chosen in enumerate(outcome.chosen):
            rows.append(
                {
                    "run": run,
                    "subclass": outcome.subclass,
                    "number": number,
                    "origin": found.origin if number == 0 else "run",
                    **_query_columns(chosen.query),
                    "left": chosen.left,
                    "right": chosen.right,
                    "columns": outcome.columns,
                    "fitness": found.fitness,
                    "rank": found.rank,
                    "median": found.median,
                    "best": found.best,
                    "agreement": found.agreement,
                    "precision": outcome.precision,
                    "recall": outcome.recall,
                    "runs": outcome.runs,
                    "settled": course.settled,
                    "matrix": found.matrix.ravel().tolist() if number == 0 else None,
                    "clips": list(outcome.clips),
                }
            )
    return pa.Table.from_pylist(rows, schema=result_schema("queries"))


def outcomes_of(table: pa.Table) -> list[Outcome]:
    """Read outcomes back, by subclass."""
    outcomes: dict[str, Outcome] = {}
    for row in sorted(table.to_pylist(), key=lambda row: (row["subclass"], row["number"])):
        chosen = Chosen(_query_of(row), row["left"], row["right"])
        if row["number"]:
            before = outcomes[row["subclass"]]
            outcomes[row["subclass"]] = _with(before, chosen)
            continue
        matrix = np.array(row["matrix"], np.float64).reshape(row["columns"], -1)
        consensus = Consensus(
            row["origin"], chosen.query, row["fitness"], row["rank"], row["agreement"], row["median"], row["best"],
            matrix,
        )  # fmt: skip
        outcomes[row["subclass"]] = Outcome(
            row["subclass"], consensus, (chosen,), row["precision"], row["recall"], row["columns"],
            tuple(row["clips"]), row["runs"],
        )  # fmt: skip
    return list(outcomes.values())


def _with(outcome: Outcome, chosen: Chosen) -> Outcome:
    return replace(outcome, chosen=(*outcome.chosen, chosen))


def _query_columns(query: Individual) -> dict[str, list[int]]:
    return {name: getattr(query, name).tolist() for name in ("masks", "values", "positions", "lows", "highs")}


def _query_of(row: dict[str, list[int]]) -> Individual:
    masks, values = (np.array(row[name], np.uint64) for name in ("masks", "values"))
    positions, lows, highs = (np.array(row[name], np.int64) for name in ("positions", "lows", "highs"))
    return Individual(masks, values, positions, lows, highs)
