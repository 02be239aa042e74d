"""Keyframe runs on a Dask cluster: the same queries as alone, also where a worker is killed on the way."""

from __future__ import annotations

from itertools import count
from pathlib import Path

import pytest

from kinedex.catalog.classes import load_classes
from kinedex.pipelines.engine.executors import DaskExecutor, Executor, SerialExecutor
from kinedex.pipelines.keyframes.learning_runs import ClassRuns, Rounds, learn_queries
from kinedex.pipelines.keyframes.parameters import KeyframeParameters, setting_of
from kinedex.pipelines.keyframes.query_learning import LearningSettings, training_sets
from kinedex.pipelines.templates.template_learning import training_clips
from kinedex.storage.store.store import Store, open_store
from tests.pipelines.engine.test_executors import Cluster
from tests.pipelines.labelled import POSES, clip, write_store

ROUNDS = Rounds(runs=6, group=2, patience=5, settled=0.0)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    clips = [clip(subclass, "al", number, frames) for subclass in POSES for number, frames in ((1, 5), (2, 6), (3, 4))]
    return open_store(write_store(tmp_path_factory.mktemp("learning") / "store", clips))


def learned(store: Store, executor: Executor, advance: object = None) -> list[ClassRuns]:
    setting: LearningSettings = setting_of(
        KeyframeParameters(generations=6, population=12, steady=1, alternatives=2), store
    )  # type: ignore[call-arg]
    clips = training_clips(store, store.takes("class IS NOT NULL"))
    wanted = training_sets(clips, load_classes("own", [one.subclass for one in clips]))
    return learn_queries(wanted, setting, ROUNDS, executor, advance=advance)  # type: ignore[arg-type]


def outcome(courses: list[ClassRuns]) -> list[object]:
    """All that was learned, to the last bit."""
    return [
        (
            course.training.subclass,
            [(number, run.query.key(), run.rank, run.history.tobytes()) for number, run in sorted(course.runs.items())],
            [(one.query.key(), one.left, one.right) for one in course.outcomes[-1].chosen],
            course.outcomes[-1].consensus.matrix.tobytes(),
        )
        for course in courses
    ]


@pytest.mark.slow
def test_a_cluster_learns_the_same_also_when_a_worker_dies_on_the_way(store: Store, tmp_path: Path) -> None:
    alone = outcome(learned(store, SerialExecutor()))
    cluster = Cluster(tmp_path)
    try:
        workers = [cluster.add_worker(), cluster.add_worker()]
        executor = DaskExecutor(1, cluster.address)
        advanced = count()

        def kill(_: int) -> None:
            # with the first runs done, the others are under way
            if next(advanced) == 5:
                workers[0].kill()

        assert outcome(learned(store, executor, kill)) == alone
        assert workers[0].wait(timeout=240) != 0
        assert workers[1].poll() is None
        executor.close()
    finally:
        cluster.close()
