"""Learn keyframe queries in each fold from its own training clips."""

from __future__ import annotations

from collections.abc import Sequence

from kinedex.catalog.classes import load_classes
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.evaluation.test_takes import Fold
from kinedex.pipelines.keyframes.learning import Outcome, TrainingSet, every_query, training_sets
from kinedex.pipelines.keyframes.parameters import KeyframeParameters, setting_of
from kinedex.pipelines.keyframes.run_storage import StoredRuns
from kinedex.pipelines.keyframes.runs import ClassRuns, known_runs, learn


class QueryLearner:
    """Learns the queries of folds as the stage `learn_keyframes` does.

    Learning runs that were finished earlier are reused, including those of that stage; they are kept in the store while
    any fold has their clips, whatever the settings. The parameters' filter of takes is not used, because a fold has its
    own clips.
    """

    def __init__(self, context: StageContext, params: KeyframeParameters) -> None:
        self._context = context
        self._params = params
        self._outcomes: dict[tuple[str, str], list[Outcome]] = {}

    def learn(self, folds: Sequence[Fold]) -> None:
        """Learn the queries of all folds; finished learning runs are stored at intervals."""
        context, params = self._context, self._params
        store = context.open()
        setting, rounds = setting_of(params, store), params.rounds()
        wanted = [self._trainings(fold) for fold in folds]
        kept = StoredRuns(context, [training for own in wanted for training in own])
        others = known_runs(store.result("keyframe_runs", pipeline=context.pipeline))
        finished: list[ClassRuns] = []
        with context.progress("runs", rounds.runs * sum(map(len, wanted))) as progress:
            for fold, own in zip(folds, wanted, strict=True):
                known = [*others, *kept.known()]  # including those of the folds before
                classes = learn(own, setting, rounds, context.executor, known, kept.save, progress.advance)
                finished += classes
                self._outcomes[fold.split, fold.name] = [one.outcome for one in classes]
        kept.save(finished)

    def _trainings(self, fold: Fold) -> list[TrainingSet]:
        """Return the training sets of a fold; raise a KinedexError if a class has no negative clip."""
        names = [one.subclass for one in fold.clips]
        wanted = training_sets(fold.clips, load_classes(self._params.classes, names))
        bare = [one.subclass for one in wanted if not one.negatives]
        if bare:
            raise KinedexError(
                f"split '{fold.split}', {fold.name}: no training clip is of another class than {bare[0]}, so "
                "there is nothing to tell it from"
            )
        return wanted

    def queries(self, fold: Fold) -> list[KeyframeQuery]:
        """Return the learned queries of a fold."""
        feature_set = self._context.feature_set
        return every_query(self._outcomes[fold.split, fold.name], feature_set)
