"""The parameters of the stage `learn_keyframes`."""

from __future__ import annotations

from typing import Annotated

from pydantic import ConfigDict, Field

from kinedex.catalog.classes import OWN
from kinedex.ops.keyframes.consensus import AtLeast
from kinedex.ops.keyframes.margins import Margins
from kinedex.ops.keyframes.training_task import MAX_KEYFRAMES, EvolutionSettings
from kinedex.pipelines.engine.file_parameters import NamesFile
from kinedex.pipelines.keyframes.learning_runs import GROUP, PATIENCE, SETTLED, Rounds
from kinedex.pipelines.keyframes.query_learning import Learner, LearningSettings, allowed_features
from kinedex.pipelines.templates.examples import ExampleParameters
from kinedex.storage.store.store import Store


class KeyframeParameters(ExampleParameters):
    """The parameters of the stage `learn_keyframes`, with the values of the thesis (Chapter 4) as defaults.

    `configs/pipelines/keyframes.yaml` sets the values that are best for finding motions of people who are not in the
    training set. Other values are constants: `EvolutionSettings` has the values of the genetic algorithm as defaults,
    and `kinedex.pipelines.keyframes.learning_runs` has the values for rounds.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    classes: Annotated[str, NamesFile("classes")] = Field(
        OWN, description="a class file; clips of other subclasses of the same class are no negative clips"
    )
    sets: list[str] = Field([], description="feature sets that keyframes may use; all unless given")
    learner: Learner = Field("genetic", description="genetic; or, to compare with it, random or greedy")
    seed: int = Field(2012, ge=0, description="the seed of all random numbers, whatever the number of workers")

    population: int = Field(50, ge=1, description="M: individuals in a population")
    generations: int = Field(100, ge=0, description="G: generations of a run")
    runs: int = Field(100, ge=1, description="N: runs at most (the thesis: 100 to 500)")
    delta: float = Field(0.0, ge=0, lt=0.5, description="δ of the template whose columns become keyframes")
    least_keyframes: int = Field(
        2,
        ge=1,
        le=MAX_KEYFRAMES,
        description="least number of keyframes of an initial individual; recombination or consensus may give fewer",
    )

    alternatives: int = Field(1, ge=1, description="queries of a subclass: the consensus, then the best other runs")
    at_least: AtLeast = Field(
        "median", description="the run, median or best, that the consensus must be as fit as; else the best run is used"
    )
    margins: Margins = Field(
        "learned", description="frames around a hit: learned for each query, or shared by all queries of a subclass"
    )

    steady: int = Field(0, ge=0, description="frames before and after for which keyframes must hold in positive clips")
    tempo: float = Field(0.0, ge=0, description="positive clips must be hit even if faster or slower by this fraction")
    parsimony: float = Field(0.0, ge=0, description="the fitness that each fixed entry costs")
    gap_cost: float = Field(0.0, ge=0, description="the fitness that each frame between the ends of a gap costs")
    outside_cost: float = Field(
        0.0, ge=0, description="cost of the share of the template before the first and after the last keyframe"
    )
    open_share: float = Field(0.0, ge=0, le=1, description="share of entries that a generalisation may open at once")
    joins: int = Field(0, ge=0, description="how often all negative clips are joined in pairs as further negatives")

    def evolution(self) -> EvolutionSettings:
        """Return the settings of the genetic algorithm."""
        own = EvolutionSettings.__dataclass_fields__.keys() & type(self).model_fields.keys()
        return EvolutionSettings(**{name: getattr(self, name) for name in own})

    def rounds(self) -> Rounds:
        """Return the numbers of runs and rounds; the greedy learner is deterministic and runs once."""
        return Rounds(1 if self.learner == "greedy" else self.runs, GROUP, PATIENCE, SETTLED)


def setting_of(params: KeyframeParameters, store: Store) -> LearningSettings:
    """Return the learning parameters for the features of a store."""
    return LearningSettings(
        learner=params.learner,
        evolution=params.evolution(),
        delta=params.delta,
        allowed=allowed_features(store.feature_set, params.sets),
        features=len(store.feature_set.features),
        steady=params.steady,
        joins=params.joins,
        alternatives=params.alternatives,
        at_least=params.at_least,
        margins=params.margins,
        seed=params.seed,
    )
