"""Stage learn_keyframes: keyframe queries for every subclass, learned from its clips and those of all others."""

from __future__ import annotations

from typing import Annotated

import polars as pl
from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.classes import OWN, load_classes
from kinedex.catalog.configs import config_path
from kinedex.ops.errors import KinedexError
from kinedex.ops.keyframes.consensus import AGREEMENTS, AtLeast
from kinedex.ops.keyframes.training_task import EvolutionSettings, InitialGaps
from kinedex.pipelines.console.wording import counted, few
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading, files_digest, takes_read
from kinedex.pipelines.keyframes.background import mine
from kinedex.pipelines.keyframes.learning import Learner, Lesson, Setting, allowed_features, lessons
from kinedex.pipelines.keyframes.margins import Margins
from kinedex.pipelines.keyframes.run_storage import KeptRuns
from kinedex.pipelines.keyframes.runs import Course, Rounds, learn, queries_table
from kinedex.pipelines.report.keyframes import keyframes_page
from kinedex.pipelines.report.output import write_page
from kinedex.pipelines.templates.learning import training_clips, training_takes
from kinedex.storage.store.store import Store

Odds = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]


class Params(BaseModel):
    """What the stage `learn_keyframes` takes; the numbers of the thesis, Chapter 4, unless set.

    `configs/pipelines/keyframes.yaml` sets what generalises best to people who were not in the training.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    where: str = Field("class IS NOT NULL", description="takes to learn from: a SQL filter over the columns of takes")
    classes: str = Field(OWN, description="a class file; other subclasses of a class are no negatives of each other")
    sets: list[str] = Field([], description="feature sets that keyframes may be about; all unless given")
    learner: Learner = Field("genetic", description="genetic; or, to compare with it, random or greedy")
    seed: int = Field(2012, ge=0, description="what all random numbers follow from, whatever the number of workers")

    population: int = Field(50, ge=1, description="M: individuals in a population")
    parents: int = Field(5, ge=2, description="r: parents in a generation; r (r − 1) / 2 offspring")
    generations: int = Field(100, ge=0, description="G: generations of a run")
    beta: float = Field(2.0, gt=0, description="β: how many times recall weighs as much as precision")
    delta: float = Field(0.0, ge=0, lt=0.5, description="δ of the template whose columns become keyframes")
    keyframes_mean: float = Field(3.0, description="mean number of keyframes of an initial individual")
    keyframes_sd: float = Field(2.0, ge=0, description="its standard deviation")
    least_keyframes: int = Field(
        2,
        ge=1,
        description="least number of keyframes of an initial individual; recombination or consensus may give fewer",
    )
    most_keyframes: int = Field(12, ge=1, description="the largest number of keyframes; the thesis sets none")
    gap_tolerance: float = Field(2.0, ge=0, description="upper end of U(0, 2), which widens initial gaps")
    initial_gaps: InitialGaps = Field("around", description="around the template's spacing; printed: around half of it")
    gap_step: float = Field(0.5, ge=0, description="share of the spacing by which a mutation changes a gap's ends")
    mutations: tuple[Odds, Odds, Odds] = Field(
        (1.0, 1.0, 1.0), description="odds of a mutation of keyframes, of entries, and of gaps"
    )
    runs: int = Field(100, ge=1, description="N: runs at most (the thesis: 100 to 500)")

    group: int = Field(8, ge=1, description="runs between two looks at whether the outcome still moves")
    patience: int = Field(2, ge=1, description="rounds without a change after which no more runs are done")
    settled: float = Field(0.001, ge=0, description="rises of the outcome's rank up to this are no change")
    reach: float = Field(0.04, ge=0, le=1, description="share of the template within which keyframes are the same")
    alternatives: int = Field(1, ge=1, description="queries a subclass: the consensus, then the best different runs")
    at_least: AtLeast = Field(
        "median", description="the consensus counts if no less fit than the median run, or the best; else the best run"
    )
    agreements: list[Share] = Field(
        list(AGREEMENTS),
        min_length=1,
        description="shares of the runs' keyframes at a place that must agree on an entry: each is tried",
    )

    steady: int = Field(0, ge=0, description="frames before and after for which keyframes must hold in positive clips")
    tempo: float = Field(0.0, ge=0, description="positive clips count only if hit even when so much slower or faster")
    parsimony: float = Field(0.0, ge=0, description="what a fixed entry takes off the fitness")
    gap_cost: float = Field(0.0, ge=0, description="what a frame between the ends of a gap takes off the fitness")
    outside_cost: float = Field(
        0.0, ge=0, description="what the template's share before the first and after the last keyframe takes off"
    )
    open_share: float = Field(0.0, ge=0, le=1, description="share of entries that a generalisation may open at once")
    joins: int = Field(0, ge=0, description="how often all negative clips are joined two by two as further negatives")
    background: str | None = Field(
        None, description="takes without any of the classes, a SQL filter: what the queries find there becomes negative"
    )
    background_clips: int = Field(50, ge=1, description="at most so many of these for a subclass, the longest first")
    margins: Margins = Field(
        "learned",
        description="frames around a hit: learned, shared (by all queries of a subclass), formula (from the template), "
        "wider (of learned and formula)",
    )

    def evolution(self) -> EvolutionSettings:
        """The numbers of the algorithm."""
        return EvolutionSettings(**{name: getattr(self, name) for name in EvolutionSettings.__dataclass_fields__})

    def rounds(self) -> Rounds:
        """How many runs there are; the greedy learner has nothing to repeat."""
        most = 1 if self.learner == "greedy" else self.runs
        return Rounds(most, self.group, self.patience, self.settled)


def external_digest(params: Params, store: Store | None) -> str:
    """What the stage depends on outside the store: the text of its class file."""
    return files_digest([] if params.classes == OWN else [config_path("classes", params.classes)])


def reads(params: Params, store: Store) -> Reading:
    """The takes that the stage depends on: the clips that it learns from, and the takes that it mines for negatives."""
    background = {} if params.background is None else {"background take": params.background}
    return takes_read(store, {"clip": params.where, **background})


def setting_of(params: Params, store: Store) -> Setting:
    """How queries are learned from this store."""
    return Setting(
        learner=params.learner,
        evolution=params.evolution(),
        delta=params.delta,
        allowed=allowed_features(store.feature_set, params.sets),
        features=len(store.feature_set.features),
        steady=params.steady,
        joins=params.joins,
        reach=params.reach,
        alternatives=params.alternatives,
        at_least=params.at_least,
        agreements=tuple(params.agreements),
        margins=params.margins,
        seed=params.seed,
    )


def run(context: StageContext, params: Params) -> dict[str, object]:
    """Learn and store the queries and all runs; runs that were finished before are not done again."""
    store = context.open()
    takes = training_takes(store, params.where)
    clips = training_clips(store, takes)
    if len(clips) < 2:
        raise KinedexError(
            f"keyframe queries tell classes apart, so clips of at least two are needed; the filter "
            f"`{params.where}` selects those of {clips[0].subclass} only"
        )
    for one in clips:
        for remark in one.remarks:
            context.say(f"{one.subclass}: {remark}")
    wanted = lessons(clips, load_classes(params.classes, [one.subclass for one in clips]))
    bare = [one.subclass for one in wanted if not one.negatives]
    if bare:
        raise KinedexError(f"no clip is of another class than {few(bare)}, so there is nothing to tell it from")
    setting, rounds = setting_of(params, store), params.rounds()
    kept = KeptRuns(context, wanted)
    before = {(one.key, one.number) for one in kept.known()}
    subclasses = counted(len(wanted), "subclass", "subclasses")
    examples = counted(sum(len(one.names) for one in clips), "clip")
    context.say(f"{subclasses} with {examples}, in rounds of {rounds.group} runs each")
    if params.background is not None:
        wanted = _with_background(context, store, wanted, setting, rounds, params, kept)
    with context.progress("runs", rounds.runs * len(wanted)) as progress:
        courses = learn(
            wanted, setting, rounds, context.executor, kept.known(), kept.save, progress.advance, context.say
        )
    known = sum((course.key, number) in before for course in courses for number in course.used)
    with context.writer() as writer:
        writer.put_results("keyframe_runs", kept.table(courses), stage=context.key(), run=context.run)
        writer.put_results("queries", queries_table(courses, context.run), stage=context.key(), run=context.run)
        writer.commit()
    path = context.report_file("keyframes.html")
    outcomes = [course.outcome for course in courses]
    finished = {course.lesson.subclass: list(course.used.values()) for course in courses}
    title = "Keyframe queries learned from clips"
    remarks = [f"{one.subclass}: {remark}" for one in clips for remark in one.remarks]
    page = keyframes_page(title, outcomes, finished, store.feature_set, store.rate_hz, params.learner, remarks)
    write_page(page, path)
    context.say(f"report: {path.resolve()}")
    file = path.relative_to(context.store_path).as_posix()
    return {**_summary(context, courses, params.at_least, known), "files": [file]}


def _with_background(
    context: StageContext,
    store: Store,
    wanted: list[Lesson],
    setting: Setting,
    rounds: Rounds,
    params: Params,
    kept: KeptRuns,
) -> list[Lesson]:
    """Learn once without, and make what the queries find in the background further negatives."""
    assert params.background is not None
    takes = store.takes(params.background)
    if not takes.height:
        raise KinedexError(f"no take is background: the filter `{params.background}` selects none")
    own = {lesson.subclass for lesson in wanted}
    clips = takes.filter(pl.col("class").is_in(own))["name"].to_list()
    if clips:
        raise KinedexError(
            f"the filter `{params.background}` of `background` selects {counted(len(clips), 'clip')} of the classes "
            f"that are learned, such as {clips[0]}; background has none of them: add `AND class IS NULL`"
        )
    words = store.words(takes["take_id"].to_list())
    first = Rounds(min(rounds.runs, rounds.group), rounds.group, 1, 0.0)
    with context.progress("runs without background", first.runs * len(wanted)) as progress:
        courses = learn(
            wanted, setting, first, context.executor, kept.known(), kept.save, progress.advance, context.say
        )
    outcomes = [course.outcome for course in courses]
    mined = [
        mine(lesson, outcome, words, setting.features, params.background_clips)
        for lesson, outcome in zip(wanted, outcomes, strict=True)
    ]
    kept_clips = sum(len(lesson.background) for lesson, _ in mined)
    context.say(
        f"{counted(kept_clips, 'stretch', 'stretches')} of {counted(takes.height, 'background take')} are false hits, "
        "and negatives from now on"
    )
    cut = [f"{lesson.subclass} ({found})" for lesson, found in mined if found > len(lesson.background)]
    if cut:
        context.say(f"only the {params.background_clips} longest (`background_clips`) are negatives of: {few(cut)}")
    return [lesson for lesson, _ in mined]


def _summary(context: StageContext, courses: list[Course], at_least: AtLeast, known: int) -> dict[str, object]:
    outcomes = [course.outcome for course in courses]
    best: list[str] = [one.subclass for one in outcomes if one.consensus.origin == "best run"]
    if best:
        context.say(f"less fit than the {at_least} run, so the best run instead of the consensus: {few(best)}")
    lost = [one.subclass for one in outcomes if one.recall < 1.0]
    if lost:
        context.say(f"not every training clip is found: {few(lost)}")
    done = sum(len(course.used) for course in courses)
    settled = sum(course.settled for course in courses)
    queries = sum(len(one.chosen) for one in outcomes)
    clips = sum(len(one.clips) for one in outcomes)
    context.say(
        f"{queries} queries of {len(courses)} subclasses from {clips} clips; {done} runs"
        + (f", {known} of them known from before" if known else "")
        + (f"; {settled} subclasses settled early" if settled else "")
    )
    return {
        "queries": queries,
        "subclasses": len(courses),
        "clips": clips,
        "runs": done,
        "settled": settled,
        "best_runs": best,
        "incomplete": lost,
        "precision": round(sum(one.precision for one in outcomes) / len(outcomes), 6),
        "recall": round(sum(one.recall for one in outcomes) / len(outcomes), 6),
    }
