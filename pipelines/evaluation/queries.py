"""Keyframe queries that are learned in each fold from its own training clips, each set of clips once."""

from __future__ import annotations

from collections.abc import Sequence

from kinedex.catalog.classes import load_classes
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.evaluation.test_takes import Fold
from kinedex.pipelines.keyframes.learning import Lesson, Outcome, every_query, lessons
from kinedex.pipelines.keyframes.parameters import KeyframeParameters, setting_of
from kinedex.pipelines.keyframes.run_storage import KeptRuns
from kinedex.pipelines.keyframes.runs import Course, known_runs, learn


class QueryLearner:
    """Learns the queries of folds as the stage `learn_keyframes` does; runs that were finished before are known, those
    of that stage too, and stay in the store for as long as any fold has their clips, whatever the settings.

    params: of the stage `learn_keyframes`; its filters of takes are not used, a fold has its own clips.
    """

    def __init__(self, context: StageContext, params: KeyframeParameters) -> None:
        if params.background is not None:
            raise KinedexError(
                "queries learned in folds know no background takes, which could be takes to annotate; leave "
                "`background` of the stage learn_keyframes out"
            )
        self._context = context
        self._params = params
        self._outcomes: dict[tuple[str, str], list[Outcome]] = {}

    def learn(self, folds: Sequence[Fold]) -> None:
        """Learn the queries of all folds; what is finished is kept in the store from time to time."""
        context, params = self._context, self._params
        store = context.open()
        setting, rounds = setting_of(params, store), params.rounds()
        wanted = [self._lessons(fold) for fold in folds]
        kept = KeptRuns(context, [lesson for own in wanted for lesson in own])
        others = known_runs(store.result("keyframe_runs", pipeline=context.pipeline))
        finished: list[Course] = []
        with context.progress("runs", rounds.runs * sum(map(len, wanted))) as progress:
            for fold, own in zip(folds, wanted, strict=True):
                known = [*others, *kept.known()]  # those of the folds before among them
                courses = learn(own, setting, rounds, context.executor, known, kept.save, progress.advance)
                finished += courses
                self._outcomes[fold.split, fold.name] = [course.outcome for course in courses]
        kept.save(finished)

    def _lessons(self, fold: Fold) -> list[Lesson]:
        """What each query of a fold is learned from; a KinedexError where a class has nothing to be told from."""
        names = [one.subclass for one in fold.clips]
        wanted = lessons(fold.clips, load_classes(self._params.classes, names))
        bare = [one.subclass for one in wanted if not one.negatives]
        if bare:
            raise KinedexError(
                f"split '{fold.split}', {fold.name}: no training clip is of another class than {bare[0]}, so "
                "there is nothing to tell it from"
            )
        return wanted

    def queries(self, fold: Fold) -> list[KeyframeQuery]:
        """The queries of a fold."""
        feature_set = self._context.feature_set
        return every_query(self._outcomes[fold.split, fold.name], feature_set)
