"""Learning keyframe queries: what each class is learned from, runs in workers, and what becomes of them."""

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
from kinedex.ops.errors import KinedexError
from kinedex.ops.keyframes.consensus import AtLeast, Consensus, find_consensus
from kinedex.ops.keyframes.fitness import training_frames
from kinedex.ops.keyframes.genetic_algorithm import evolve, random_search
from kinedex.ops.keyframes.greedy_selection import forward_selection
from kinedex.ops.keyframes.individuals import Individual
from kinedex.ops.keyframes.training_task import (
    EvolutionSettings,
    LearningRun,
    TrainingTask,
    make_training_task,
    steady_entries,
)
from kinedex.ops.templates.templates import QuantisedTemplate, learn_soft, quantise
from kinedex.ops.words import U64
from kinedex.pipelines.engine.code_digest import code_digest
from kinedex.pipelines.keyframes.margins import Margins, clips_hit, margins_of
from kinedex.pipelines.templates.learning import TrainingClips

Learner = Literal["genetic", "random", "greedy"]


@dataclass(frozen=True)
class Setting:
    """How queries are learned; `pipelines.stages.learn_keyframes.Params` says what each number means."""

    learner: Learner
    evolution: EvolutionSettings
    delta: float
    allowed: int
    features: int
    steady: int
    joins: int
    reach: float
    alternatives: int
    at_least: AtLeast
    agreements: tuple[float, ...]
    margins: Margins
    seed: int


@dataclass(frozen=True)
class Lesson:
    """What the query of one subclass is learned from: its clips, those of other classes, and background."""

    subclass: str
    names: tuple[str, ...]
    positives: tuple[U64, ...]
    negatives: tuple[U64, ...]
    background: tuple[U64, ...] = ()

    @property
    def subject(self) -> str:
        """What a task is about, for messages."""
        return f"the keyframe query of {self.subclass}"

    def key(self, setting: Setting) -> str:
        """All that a run follows from except its number, hashed: runs of the same key need not be run again.

        It begins with that of the clips (`clips_key`), and a hyphen.
        """
        same = replace(
            setting, margins="learned", alternatives=0, at_least="median", agreements=(), reach=0.0
        )  # what they say is about finished runs
        text = repr(sorted(asdict(same).items(), key=str))
        return f"{self.clips_key()}-{_digest(text, self.background)}"

    def clips_key(self) -> str:
        """A hash of the subclass, its clips, those of other classes, and the code that learns from them."""
        return _digest(repr((self.subclass, _code())), self.positives, self.negatives)


def _digest(text: str, *groups: Sequence[U64]) -> str:
    hasher = hashlib.sha256(text.encode())
    for group in groups:
        hasher.update(len(group).to_bytes(8, "little"))
        for words in group:
            hasher.update(len(words).to_bytes(8, "little") + np.ascontiguousarray(words).tobytes())
    return hasher.hexdigest()[:16]


@lru_cache(maxsize=1)
def _code() -> str:
    """Return a hash of the code of a run, so that runs of other code are not taken for its own."""
    return code_digest(do_runs)


@dataclass(frozen=True)
class RunTask:
    """Runs of one lesson that one worker does."""

    lesson: Lesson
    setting: Setting
    numbers: tuple[int, ...]

    @property
    def subject(self) -> str:
        """What the task is about, for messages."""
        return f"runs {self.numbers[0]} to {self.numbers[-1]} of {self.lesson.subject}"


@dataclass(frozen=True)
class AgreeTask:
    """The runs of one lesson that are to become one outcome."""

    lesson: Lesson
    setting: Setting
    runs: tuple[LearningRun, ...]

    @property
    def subject(self) -> str:
        """What the task is about, for messages."""
        return self.lesson.subject


@dataclass(frozen=True)
class Chosen:
    """A query that was chosen, and how many frames before and after its hits the motion may reach."""

    query: Individual
    left: int
    right: int


@dataclass(frozen=True)
class Outcome:
    """What came of a lesson: the consensus of its runs, and the queries that preselect for its subclass.

    precision, recall: of all chosen queries together, on the clips as they are; unlike the fitness they know nothing of
    background, of joined clips, and of what `steady` and `tempo` ask for. columns: of the template. clips: the
    names of the positive ones. runs: how many there were.
    """

    subclass: str
    consensus: Consensus
    chosen: tuple[Chosen, ...]
    precision: float
    recall: float
    columns: int
    clips: tuple[str, ...]
    runs: int


def lessons(clips: Sequence[TrainingClips], classes: Classes, background: Sequence[U64] = ()) -> list[Lesson]:
    """What each subclass is learned from: all clips of other classes are negative, other subclasses of its own are not.

    Parameters
    ----------
    clips: by subclass. classes: a subclass in none of them is a class of its own.
    background: stretches in which no class of these is to be found.
    """
    of = classes.of_subclass()
    label = {one.subclass: of.get(one.subclass, one.subclass) for one in clips}
    return [
        Lesson(
            one.subclass,
            one.names,
            one.words,
            tuple(words for other in clips if label[other.subclass] != label[one.subclass] for words in other.words),
            tuple(background),
        )
        for one in clips
    ]


def allowed_features(feature_set: FeatureSet, sets: Sequence[str]) -> int:
    """The features of these sets as a mask, bit i − 1 for F_i; all features where no set is named."""
    numbers = [number for name in sets or feature_set.sets for number in feature_set.word_set(name).numbers]
    return sum(1 << (number - 1) for number in set(numbers))


def strict_template(lesson: Lesson, setting: Setting) -> QuantisedTemplate:
    """The template whose columns become keyframes: entries that do not vary, and hold for some columns around.

    Where nothing is left of it, entries that hold in their own column alone; where even that is nothing, the message of
    the KinedexError says so.
    """
    plain = quantise(learn_soft(lesson.positives, setting.features).template, setting.delta)
    allowed = np.uint64(setting.allowed)
    for steady in (setting.steady, 0):
        template = steady_entries(plain, steady)
        if (template.mask & allowed).any():
            return template
    raise KinedexError(
        f"{lesson.subclass}: the clips have nothing in common that could be a keyframe (at delta = {setting.delta:g}, "
        "in the feature sets allowed); raise `delta`, allow more `sets`, or leave the class out"
    )


def material_of(lesson: Lesson, setting: Setting) -> TrainingTask:
    """The clips as bitmaps, positives first, and the template's columns."""
    others = [*lesson.negatives, *_joined(lesson, setting), *lesson.background]
    every = [*lesson.positives, *others]
    judged = [setting.steady] * len(lesson.positives) + [0] * len(others)
    frames = training_frames(every, setting.features, judged)
    return make_training_task(frames, len(lesson.positives), strict_template(lesson, setting), setting.allowed)


def _joined(lesson: Lesson, setting: Setting) -> list[U64]:
    """Negative clips two by two in random order: no chain of keyframes may reach from one into the next."""
    random = np.random.default_rng([setting.seed, crc32(lesson.subclass.encode())])
    pairs = []
    for _ in range(setting.joins):
        order = random.permutation(len(lesson.negatives)).tolist()
        pairs += [(lesson.negatives[a], lesson.negatives[b]) for a, b in pairwise(order)]
    return [np.concatenate(pair) for pair in pairs]


@lru_cache(maxsize=4)
def _cached(key: str) -> list[TrainingTask]:
    # One material per lesson and worker; filled by its first task.
    return []


def _material(lesson: Lesson, setting: Setting) -> TrainingTask:
    kept = _cached(lesson.key(setting))
    if not kept:
        kept.append(material_of(lesson, setting))
    return kept[0]


def do_runs(task: RunTask) -> list[LearningRun]:
    """Do runs of one lesson (in a worker); a run follows from seed, subclass and number alone."""
    material = _material(task.lesson, task.setting)
    evolution = task.setting.evolution
    results = []
    for number in task.numbers:
        seed = (task.setting.seed, crc32(task.lesson.subclass.encode()), number)
        if task.setting.learner == "genetic":
            results.append(evolve(material, evolution, seed))
        elif task.setting.learner == "random":
            results.append(random_search(material, evolution, seed))
        else:
            results.append(forward_selection(material, evolution))
    return results


def agree(task: AgreeTask) -> Outcome:
    """Make an outcome of the runs of one lesson (in a worker)."""
    lesson, setting = task.lesson, task.setting
    material = _material(lesson, setting)
    reach = max(1, round(setting.reach * len(material.masks)))
    seed = (setting.seed, crc32(lesson.subclass.encode()), len(task.runs), 1)
    found = find_consensus(material, task.runs, setting.evolution, reach, seed, setting.at_least, setting.agreements)
    queries = _queries(found, task.runs, setting.alternatives)
    columns = len(material.masks)
    margins = margins_of(queries, lesson.positives, setting.features, columns, setting.margins)
    chosen = tuple(Chosen(query, *pair) for query, pair in zip(queries, margins, strict=True))
    retrieved = clips_hit([*lesson.positives, *lesson.negatives], queries, setting.features)
    right = int(retrieved[: len(lesson.positives)].sum())
    total = int(retrieved.sum())
    return Outcome(
        lesson.subclass, found, chosen, right / total if total else 0.0, right / len(lesson.positives), columns,
        lesson.names, len(task.runs),
    )  # fmt: skip


def _queries(found: Consensus, runs: Sequence[LearningRun], alternatives: int) -> list[Individual]:
    """What the runs agree on, then the fittest runs; each with other keyframes than those before."""
    queries = [found.query]
    for run in sorted(runs, key=lambda run: -run.rank):
        if len(queries) < alternatives and all(run.query.masks.tolist() != one.masks.tolist() for one in queries):
            queries.append(run.query)
    return queries


def every_query(outcomes: Sequence[Outcome], feature_set: FeatureSet) -> list[KeyframeQuery]:
    """The chosen queries of all outcomes; no two have the same name."""
    taken = {one.subclass for one in outcomes}
    return [query for one in outcomes for query in keyframe_queries(one, feature_set, taken)]


def keyframe_queries(outcome: Outcome, feature_set: FeatureSet, taken: Collection[str] = ()) -> list[KeyframeQuery]:
    """The chosen queries as people write them: named after the subclass, keyframes divided into feature sets.

    taken: names of all subclasses; the second query of "walk" is "walk 2", unless a subclass has that name.
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
