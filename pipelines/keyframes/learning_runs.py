"""Run keyframe learning in rounds over all classes; a class ends early if its outcome no longer improves."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from kinedex.ops.keyframes.consensus import Consensus
from kinedex.ops.keyframes.training_task import Individual, LearningRun
from kinedex.pipelines.engine.executors import Executor
from kinedex.pipelines.keyframes.query_learning import (
    ChosenQuery,
    ConsensusTask,
    LearningSettings,
    Outcome,
    RunTask,
    TrainingSet,
    learn_runs,
    make_outcome,
)
from kinedex.storage.snapshot.schemas import result_schema

if TYPE_CHECKING:
    from kinedex.pipelines.engine.context import StageContext

SAVE_SECONDS = 20.0
"""The longest time, in seconds, after which finished runs are stored."""

GROUP = 8
"""The number of runs in a round; after each round, the classes that need more runs are determined.

The study of keyframe learning uses 8, 16 and 48.
"""

PATIENCE = 2
"""The number of rounds without a better outcome after which a class is settled: no more runs are made."""

SETTLED = 0.001
"""The smallest rise in rank by which an outcome counts as better."""


@dataclass(frozen=True)
class FinishedRun:
    """A finished run, with the key of its training set and parameters, its subclass and its number."""

    key: str
    subclass: str
    number: int
    run: LearningRun


@dataclass
class ClassRuns:
    """The runs of one class.

    Attributes
    ----------
    training : TrainingSet
        The clips that are learned from.
    key : str
        The key of its runs, see `TrainingSet.key`.
    runs : dict of int to LearningRun
        The finished runs by number.
    outcomes : list of Outcome
        The outcome after each round.
    settled : bool
        True if no more runs are needed.
    """

    training: TrainingSet
    key: str
    runs: dict[int, LearningRun] = field(default_factory=dict)
    outcomes: list[Outcome] = field(default_factory=list)
    settled: bool = False

    @property
    def outcome(self) -> Outcome:
        """The outcome of the highest rank, the last of equal ones; with more runs a consensus can become worse."""
        return max(reversed(self.outcomes), key=lambda one: one.consensus.rank)

    @property
    def used(self) -> dict[int, LearningRun]:
        """The runs that the last outcome uses; there may be more, from an earlier call with more runs."""
        wanted = self.outcomes[-1].runs if self.outcomes else 0
        return {number: run for number, run in sorted(self.runs.items()) if number < wanted}


@dataclass(frozen=True)
class Rounds:
    """The number of runs of a class, and the rule for ending them.

    Attributes
    ----------
    runs : int
        The largest number of runs.
    group : int
        The number of runs in a round.
    patience : int
        The number of rounds without a better outcome after which a class is settled: no more runs are made.
    settled : float
        The smallest rise in rank by which an outcome counts as better.
    """

    runs: int
    group: int = GROUP
    patience: int = PATIENCE
    settled: float = SETTLED


def learn_queries(
    trainings: Sequence[TrainingSet],
    setting: LearningSettings,
    rounds: Rounds,
    executor: Executor,
    known: Sequence[FinishedRun] = (),
    save: Callable[[list[ClassRuns]], None] | None = None,
    advance: Callable[[int], None] | None = None,
    message: Callable[[str], None] | None = None,
) -> list[ClassRuns]:
    """Make all runs that are needed; runs and outcomes do not depend on the number of workers.

    Parameters
    ----------
    trainings : sequence of TrainingSet
        The training set of each class.
    setting : LearningSettings
        The parameters of learning.
    rounds : Rounds
        The numbers of runs and rounds.
    executor : Executor
        The workers.
    known : sequence of FinishedRun
        Finished runs; those with the given training sets and parameters are reused.
    save : callable, optional
        Stores finished runs; called every `SAVE_SECONDS` and after each round.
    advance : callable, optional
        Called with the number of runs that were finished, or are no longer needed.
    message : callable, optional
        Called with a message after each round.

    Returns
    -------
    list of ClassRuns
        One for each training set, in their order.
    """
    classes = [ClassRuns(training, training.key(setting)) for training in trainings]
    by_key = {one_class.key: one_class for one_class in classes}
    for one in known:
        if one.key in by_key:
            by_key[one.key].runs[one.number] = one.run
    for begin in range(0, rounds.runs, rounds.group):
        numbers = range(begin, min(begin + rounds.group, rounds.runs))
        active = [one_class for one_class in classes if not one_class.settled]
        if not active:
            break
        _run_round(active, setting, numbers, executor, save and (lambda: save(classes)), advance)
        tasks = [ConsensusTask(c.training, setting, tuple(c.runs[n] for n in range(numbers.stop))) for c in active]
        for one_class, outcome in zip(active, executor.map(make_outcome, tasks), strict=True):
            one_class.outcomes.append(outcome)
            one_class.settled = _settled(one_class.outcomes, rounds)
            if one_class.settled and advance is not None:
                advance(rounds.runs - numbers.stop)
        if message is not None:
            settled = sum(one_class.settled for one_class in classes)
            message(
                f"{numbers.stop} of at most {rounds.runs} runs each: {settled} of {len(classes)} subclasses settled"
            )
    return classes


def _run_round(
    classes: Sequence[ClassRuns],
    setting: LearningSettings,
    numbers: range,
    executor: Executor,
    save: Callable[[], None] | None,
    advance: Callable[[int], None] | None,
) -> None:
    """Make the runs of one round that are not known yet."""
    work = []
    for one_class in classes:
        missing = tuple(number for number in numbers if number not in one_class.runs)
        if missing:
            work.append((one_class, RunTask(one_class.training, setting, missing)))
        if advance is not None:
            advance(len(numbers) - len(missing))
    stored = time.monotonic()
    try:
        for (one_class, task), found in zip(work, executor.map(learn_runs, [task for _, task in work]), strict=True):
            one_class.runs.update(zip(task.numbers, found, strict=True))
            if advance is not None:
                advance(len(found))
            if save is not None and time.monotonic() - stored > SAVE_SECONDS:
                save()
                stored = time.monotonic()
    finally:
        # Finished runs are stored even if a dead cluster or Ctrl-C ends the round.
        if save is not None and work:
            save()


def _settled(outcomes: Sequence[Outcome], rounds: Rounds) -> bool:
    """Return whether the outcome has not become better over the last rounds."""
    if len(outcomes) <= rounds.patience:
        return False
    ranks = [outcome.consensus.rank for outcome in outcomes]
    return max(ranks[-rounds.patience :]) - max(ranks[: -rounds.patience]) <= rounds.settled


def runs_table(runs: Sequence[FinishedRun], run: str) -> pa.Table:
    """Return finished runs as results of the kind `keyframe_runs`."""
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


def known_runs(table: pa.Table) -> list[FinishedRun]:
    """Return the finished runs of results of the kind `keyframe_runs`."""
    found = []
    for row in table.to_pylist():
        history = np.array(row["history"], np.float64).reshape(-1, 4)
        run = LearningRun(_query_of(row), row["fitness"], row["rank"], history, row["evaluated"])
        found.append(FinishedRun(row["key"], row["subclass"], row["number"], run))
    return found


def queries_table(classes: Sequence[ClassRuns], run: str) -> pa.Table:
    """Return outcomes as results of the kind `queries`, one row for each chosen query."""
    rows = []
    for one_class in classes:
        outcome = one_class.outcome
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
                    "settled": one_class.settled,
                    "matrix": found.matrix.ravel().tolist() if number == 0 else None,
                    "clips": list(outcome.clips),
                }
            )
    return pa.Table.from_pylist(rows, schema=result_schema("queries"))


def outcomes_of(table: pa.Table) -> list[Outcome]:
    """Return the outcomes of results of the kind `queries`, sorted by subclass."""
    outcomes: dict[str, Outcome] = {}
    for row in sorted(table.to_pylist(), key=lambda row: (row["subclass"], row["number"])):
        chosen = ChosenQuery(_query_of(row), row["left"], row["right"])
        if row["number"]:
            before = outcomes[row["subclass"]]
            outcomes[row["subclass"]] = replace(before, chosen=(*before.chosen, chosen))
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


def _query_columns(query: Individual) -> dict[str, list[int]]:
    return {name: getattr(query, name).tolist() for name in ("masks", "values", "positions", "lows", "highs")}


def _query_of(row: dict[str, list[int]]) -> Individual:
    masks, values = (np.array(row[name], np.uint64) for name in ("masks", "values"))
    positions, lows, highs = (np.array(row[name], np.int64) for name in ("positions", "lows", "highs"))
    return Individual(masks, values, positions, lows, highs)


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
