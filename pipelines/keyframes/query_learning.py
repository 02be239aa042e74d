"""Learn keyframe queries: make training sets, run learners and find their consensus in workers, and return queries."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from itertools import count, pairwise
from typing import Literal
from zlib import crc32

import numpy as np

from kinedex.catalog.classes import Classes
from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import SAME_FRAME, Gap, Keyframe, KeyframeQuery
from kinedex.ops.cache import Cache
from kinedex.ops.errors import KinedexError
from kinedex.ops.keyframes.consensus import AtLeast, Consensus, find_consensus
from kinedex.ops.keyframes.fitness import training_frames
from kinedex.ops.keyframes.genetic_algorithm import evolve, random_search
from kinedex.ops.keyframes.greedy_selection import forward_selection
from kinedex.ops.keyframes.margins import Margins, clips_hit, margins_of
from kinedex.ops.keyframes.training_task import (
    EvolutionSettings,
    Individual,
    LearningRun,
    TrainingTask,
    make_training_task,
    steady_entries,
)
from kinedex.ops.templates.templates import QuantisedTemplate, learn_soft, quantise
from kinedex.ops.words import ALL_KNOWN, U64
from kinedex.pipelines.engine.code_digest import code_digest
from kinedex.pipelines.templates.examples import Rejected
from kinedex.pipelines.templates.template_learning import TrainingClips

Learner = Literal["genetic", "random", "greedy"]

REACH = 0.04
"""The largest distance between equal keyframes of two runs, as a fraction of the template's columns.

The thesis does not give a value.
"""


@dataclass(frozen=True)
class LearningSettings:
    """The parameters with which queries are learned; `KeyframeParameters` describes each of them."""

    learner: Learner
    evolution: EvolutionSettings
    delta: float
    allowed: int
    features: int
    steady: int
    joins: int
    alternatives: int
    at_least: AtLeast
    margins: Margins
    seed: int


@dataclass(frozen=True)
class TrainingSet:
    """The clips that the query of one subclass is learned from.

    Attributes
    ----------
    subclass : str
        The subclass.
    names : tuple of str
        The names of its clips.
    positives : tuple of uint64 arrays (L,)
        The words of its clips.
    negatives : tuple of uint64 arrays (L,)
        The words of clips of other classes in which the features in `known` are known, and of intervals that a person
        has rejected.
    known : int
        The mask of the features known in the clips, with the bits of a word; keyframes use no others.
    """

    subclass: str
    names: tuple[str, ...]
    positives: tuple[U64, ...]
    negatives: tuple[U64, ...]
    known: int = int(ALL_KNOWN)

    @property
    def subject(self) -> str:
        """The subject of the task, for messages."""
        return f"the keyframe query of {self.subclass}"

    def key(self, setting: LearningSettings) -> str:
        """Return a hash of all inputs and parameters of a learning run except its number.

        The hash begins with that of the clips (`clips_key`) and a hyphen. Parameters that affect only the evaluation of
        finished runs are excluded.
        """
        same = replace(setting, margins="learned", alternatives=0, at_least="median")
        return f"{self.clips_key()}-{_digest(repr(sorted(asdict(same).items(), key=str)))}"

    def clips_key(self) -> str:
        """Return a hash of the subclass, the positive and negative clips, and the code that learns from them."""
        known = () if self.known == ALL_KNOWN else (self.known,)
        return _digest(repr((self.subclass, _code(), *known)), self.positives, self.negatives)


def _digest(text: str, *groups: Sequence[U64]) -> str:
    hasher = hashlib.sha256(text.encode())
    for group in groups:
        hasher.update(len(group).to_bytes(8, "little"))
        for words in group:
            hasher.update(len(words).to_bytes(8, "little") + np.ascontiguousarray(words).tobytes())
    return hasher.hexdigest()[:16]


@lru_cache(maxsize=1)
def _code() -> str:
    """Return a hash of the code of a run, so that runs made by other code are not reused."""
    return code_digest(learn_runs)


@dataclass(frozen=True)
class RunTask:
    """A task: some of the runs of one training set."""

    training: TrainingSet
    setting: LearningSettings
    numbers: tuple[int, ...]

    @property
    def subject(self) -> str:
        """The subject of the task, for messages."""
        return f"runs {self.numbers[0]} to {self.numbers[-1]} of {self.training.subject}"


@dataclass(frozen=True)
class ConsensusTask:
    """A task: to find the consensus of the runs of one training set."""

    training: TrainingSet
    setting: LearningSettings
    runs: tuple[LearningRun, ...]

    @property
    def subject(self) -> str:
        """The subject of the task, for messages."""
        return self.training.subject


@dataclass(frozen=True)
class ChosenQuery:
    """A selected query, and the margins: frames before and after a hit into which the motion may extend."""

    query: Individual
    left: int
    right: int


@dataclass(frozen=True)
class Outcome:
    """The result of the runs of one subclass.

    Attributes
    ----------
    subclass : str
        The subclass.
    consensus : Consensus
        The consensus of the runs.
    chosen : tuple of ChosenQuery
        The queries that preselect for the subclass.
    precision, recall : float
        Precision and recall of all selected queries together on the clips. In contrast to the fitness, joined clips do
        not count, and the conditions `steady` and `tempo` are not applied.
    columns : int
        The number of columns of the template.
    clips : tuple of str
        The names of the positive clips.
    runs : int
        The number of runs.
    """

    subclass: str
    consensus: Consensus
    chosen: tuple[ChosenQuery, ...]
    precision: float
    recall: float
    columns: int
    clips: tuple[str, ...]
    runs: int


def training_sets(
    clips: Sequence[TrainingClips], classes: Classes, rejected: Sequence[Rejected] = ()
) -> list[TrainingSet]:
    """Make the training set of each subclass; its negatives are the clips of other classes.

    Clips of other subclasses of the same class are not negatives, nor are clips that lack a feature known in the
    subclass.

    Parameters
    ----------
    clips : sequence of TrainingClips
        The clips of each subclass.
    classes : Classes
        The classes; a subclass that is in no class forms a class by itself.
    rejected : sequence of Rejected, optional
        Intervals that a person has rejected. An interval is a negative of the subclass that it was rejected for, or of
        all subclasses if it was rejected for a class. Rejected intervals come after clips.
    """
    of = classes.of_subclass()
    label = {one.subclass: of.get(one.subclass, one.subclass) for one in clips}
    return [
        TrainingSet(
            one.subclass,
            one.names,
            one.words,
            (
                *(
                    words
                    for other in clips
                    if label[other.subclass] != label[one.subclass] and not one.known & ~other.known
                    for words in other.words
                ),
                *(
                    other.words
                    for other in rejected
                    if other.label in (one.subclass, label[one.subclass]) and not one.known & ~other.known
                ),
            ),
            one.known,
        )
        for one in clips
    ]


def allowed_features(feature_set: FeatureSet, sets: Sequence[str]) -> int:
    """Return the features of some sets as a mask, bit i − 1 for F_i; all features if no set is named."""
    numbers = [number for name in sets or feature_set.sets for number in feature_set.word_set(name).numbers]
    return sum(1 << (number - 1) for number in set(numbers))


def strict_template(training: TrainingSet, setting: LearningSettings) -> QuantisedTemplate:
    """Return the template whose columns become keyframes; its fixed entries hold for `steady` columns on either side.

    If no fixed entry keeps its value for so long, all fixed entries are used.

    Raises
    ------
    KinedexError
        The template has no fixed entry of an allowed and known feature.
    """
    plain = quantise(learn_soft(training.positives, setting.features).template, setting.delta)
    allowed = np.uint64(setting.allowed & training.known)
    for steady in (setting.steady, 0):
        template = steady_entries(plain, steady)
        if (template.mask & allowed).any():
            return template
    raise KinedexError(
        f"{training.subclass}: the clips have nothing in common that could be a keyframe (at delta = "
        f"{setting.delta:g}, in the feature sets allowed); raise `delta`, allow more `sets`, or exclude the class"
    )


def training_task(training: TrainingSet, setting: LearningSettings) -> TrainingTask:
    """Return the clips as bitmaps, positives first, with the columns of the template."""
    others = [*training.negatives, *_joined(training, setting)]
    every = [*training.positives, *others]
    judged = [setting.steady] * len(training.positives) + [0] * len(others)
    frames = training_frames(every, setting.features, judged)
    allowed = setting.allowed & training.known
    return make_training_task(frames, len(training.positives), strict_template(training, setting), allowed)


def _joined(training: TrainingSet, setting: LearningSettings) -> list[U64]:
    """Join pairs of negative clips in random order, because a query must not reach from one motion into the next."""
    random = np.random.default_rng([setting.seed, crc32(training.subclass.encode())])
    pairs = []
    for _ in range(setting.joins):
        order = random.permutation(len(training.negatives)).tolist()
        pairs += [(training.negatives[a], training.negatives[b]) for a, b in pairwise(order)]
    return [np.concatenate(pair) for pair in pairs]


_TASKS: Cache[str, TrainingTask] = Cache(4)
"""The training tasks of a worker, each made by the first run that needs it."""


def _cached_task(training: TrainingSet, setting: LearningSettings) -> TrainingTask:
    key = training.key(setting)
    kept = _TASKS.get(key)
    return _TASKS.put(key, training_task(training, setting)) if kept is None else kept


def learn_runs(task: RunTask) -> list[LearningRun]:
    """Perform learning runs on one training set; the random numbers of a run depend on seed, subclass and number."""
    material = _cached_task(task.training, task.setting)
    evolution = task.setting.evolution
    results = []
    for number in task.numbers:
        seed = (task.setting.seed, crc32(task.training.subclass.encode()), number)
        if task.setting.learner == "genetic":
            results.append(evolve(material, evolution, seed))
        elif task.setting.learner == "random":
            results.append(random_search(material, evolution, seed))
        else:
            results.append(forward_selection(material, evolution))
    return results


def make_outcome(task: ConsensusTask) -> Outcome:
    """Find the consensus of the runs of one training set, and select its queries, in a worker."""
    training, setting = task.training, task.setting
    material = _cached_task(training, setting)
    reach = max(1, round(REACH * len(material.masks)))
    seed = (setting.seed, crc32(training.subclass.encode()), len(task.runs), 1)
    found = find_consensus(material, task.runs, setting.evolution, reach, seed, setting.at_least)
    queries = _queries(found, task.runs, setting.alternatives)
    margins = margins_of(queries, training.positives, setting.features, setting.margins)
    chosen = tuple(ChosenQuery(query, *pair) for query, pair in zip(queries, margins, strict=True))
    retrieved = clips_hit([*training.positives, *training.negatives], queries, setting.features)
    right = int(retrieved[: len(training.positives)].sum())
    total = int(retrieved.sum())
    return Outcome(
        training.subclass, found, chosen, right / total if total else 0.0, right / len(training.positives),
        len(material.masks),
        training.names, len(task.runs),
    )  # fmt: skip


def _queries(found: Consensus, runs: Sequence[LearningRun], alternatives: int) -> list[Individual]:
    """Return the consensus, then the runs of highest rank, each with other keyframes than the queries before it."""
    queries = [found.query]
    for run in sorted(runs, key=lambda run: -run.rank):
        if len(queries) < alternatives and all(run.query.masks.tolist() != one.masks.tolist() for one in queries):
            queries.append(run.query)
    return queries


def every_query(outcomes: Sequence[Outcome], feature_set: FeatureSet) -> list[KeyframeQuery]:
    """Return the selected queries of all outcomes, with distinct names."""
    taken = {one.subclass for one in outcomes}
    return [query for one in outcomes for query in keyframe_queries(one, feature_set, taken)]


def keyframe_queries(outcome: Outcome, feature_set: FeatureSet, taken: Collection[str] = ()) -> list[KeyframeQuery]:
    """Return the selected queries in their written form: named after the subclass, keyframes divided into feature sets.

    Parameters
    ----------
    outcome : Outcome
        The outcome of a subclass.
    feature_set : FeatureSet
        The features of its keyframes.
    taken : collection of str
        The names of all subclasses: the second query of "walk" is named "walk 2", unless a subclass has that name.
    """
    result: list[KeyframeQuery] = []
    free = (name for number in count(2) if (name := f"{outcome.subclass} {number}") not in taken)
    for one in outcome.chosen:
        keyframes: list[Keyframe] = []
        gaps: list[Gap] = []
        positions: list[int] = []
        for k in range(len(one.query)):
            parts = _parts(int(one.query.masks[k]), int(one.query.values[k]), feature_set)
            if k:
                gaps.append(Gap(int(one.query.lows[k - 1]), int(one.query.highs[k - 1])))
            gaps += [SAME_FRAME] * (len(parts) - 1)
            keyframes += parts
            positions += [int(one.query.positions[k])] * len(parts)
        name = next(free) if result else outcome.subclass
        made = KeyframeQuery(name, outcome.subclass, tuple(keyframes), tuple(gaps), tuple(positions))
        result.append(replace(made, margins=(one.left, one.right)))
    return result


def _parts(mask: int, value: int, feature_set: FeatureSet) -> list[Keyframe]:
    parts = []
    for name, word_set in feature_set.sets.items():
        bits = (1 << word_set.count) - 1
        own = mask >> (word_set.first - 1) & bits
        if own:
            parts.append(Keyframe(name, own, value >> (word_set.first - 1) & own))
    return parts
