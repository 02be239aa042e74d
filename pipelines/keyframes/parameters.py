"""The parameters of keyframe learning."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.classes import OWN
from kinedex.ops.keyframes.consensus import AGREEMENTS, AtLeast
from kinedex.ops.keyframes.training_task import EvolutionSettings, InitialGaps
from kinedex.pipelines.keyframes.learning import Learner, Setting, allowed_features
from kinedex.pipelines.keyframes.margins import Margins
from kinedex.pipelines.keyframes.runs import Rounds
from kinedex.storage.store.store import Store

Odds = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]


class KeyframeParameters(BaseModel):
    """The parameters of the stage `learn_keyframes`; the numbers of the thesis, Chapter 4, unless set.

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


def setting_of(params: KeyframeParameters, store: Store) -> Setting:
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
