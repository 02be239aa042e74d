"""Define the base class `Stage`, which declares name, parameters and inputs of a stage, and runs it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeVar

from pydantic import BaseModel

from kinedex.catalog.plugins import Plugins
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading
from kinedex.storage.store.store import Store

Parameters = TypeVar("Parameters", bound=BaseModel)

TAKES = "takes"
"""The input role of the stage that ingests the takes."""


@dataclass(frozen=True)
class Input:
    """An input role of a stage, which another stage of the pipeline fills.

    Attributes
    ----------
    stage : str
        The kind of stage that can fill it.
    optional : bool
        True if the stage can run without it.
    """

    stage: str
    optional: bool = False


class Stage(ABC, Generic[Parameters]):
    """Base class of the kinds of stages; instances have no state.

    A stage is skipped where the store holds a record with its fingerprint. The fingerprint consists of the code that
    `run` reaches, the plugins of `named_parts`, the parameters, `external_digest`, the fingerprints of the inputs, and
    the store's takes: those of `reading`, or all of them.

    Attributes
    ----------
    name : str
        The name in pipeline files.
    parameters : type
        A pydantic model; each field has a description.
    inputs : mapping of str to Input
        The input roles, by name, that other stages fill.
    commits_once : bool
        True if `run` commits all results at once, together with `StoreWriter.forget_stage`. Until this commit, the
        stage counts as done, and its earlier results are shown.
    """

    name: ClassVar[str]
    parameters: type[Parameters]
    inputs: ClassVar[Mapping[str, Input]] = {}
    commits_once: ClassVar[bool] = False

    @abstractmethod
    def run(self, context: StageContext, params: Parameters) -> dict[str, object]:
        """Do the work and commit it.

        Parameters
        ----------
        context : StageContext
            The store, the executor, and the place of the stage in its pipeline.
        params : Parameters
            The validated parameters.

        Returns
        -------
        dict
            The stage's record, as JSON values. `files` are paths within the store that must be kept,
            `left_out` is the number of source files that were not read.

        Raises
        ------
        KinedexError
            The stage failed; results that it has committed are kept.
        """

    def with_remembered(self, params: Parameters, unset: frozenset[str], store: Store) -> Parameters:
        """Return the parameters, with remembered values of earlier runs in place of those that the user left unset."""
        return params

    def examine(self, params: Parameters, store: Store) -> None:
        """Check the store before a run; raise an `AcceptError` for a change that the user has to accept first."""

    def reading(self, params: Parameters, store: Store) -> Reading | None:
        """Return a digest of the takes that the stage reads; None if it depends on all takes of the store."""
        return None

    def external_digest(self, params: Parameters, store: Store | None) -> str:
        """Return a hash of all data outside the store that the stage reads; `store` is None before it is created."""
        return ""

    def named_parts(self, params: Parameters) -> Sequence[tuple[Plugins[Any], str]]:
        """Return the parts that the parameters name and plugins can provide, as tables of parts and names in them."""
        return ()

    def is_current(self, store: Store) -> bool:
        """Return whether the stage's outputs other than results and `files` are still in place."""
        return True


BUILT_IN = {
    "ingest": "kinedex.pipelines.stages.ingest:Ingest",
    "index": "kinedex.pipelines.stages.index:Index",
    "learn_templates": "kinedex.pipelines.stages.learn_templates:LearnTemplates",
    "learn_keyframes": "kinedex.pipelines.stages.learn_keyframes:LearnKeyframes",
    "rank": "kinedex.pipelines.stages.rank:Rank",
    "evaluate_ranking": "kinedex.pipelines.stages.evaluate_ranking:EvaluateRanking",
    "vary_stiffness": "kinedex.pipelines.stages.vary_stiffness:VaryStiffness",
    "report_retrieval": "kinedex.reports.stages.report_retrieval:ReportRetrieval",
    "annotate": "kinedex.pipelines.stages.annotate:Annotate",
    "evaluate": "kinedex.pipelines.stages.evaluate:Evaluate",
    "compare_methods": "kinedex.pipelines.stages.compare_methods:CompareMethods",
    "report": "kinedex.reports.stages.report:Report",
    "observe": "kinedex.pipelines.stages.observe:Observe",
    "track": "kinedex.pipelines.stages.track:Track",
    "stabilise": "kinedex.pipelines.stages.stabilise:Stabilise",
    "report_stabilised": "kinedex.reports.stages.report_stabilised:ReportStabilised",
    "evaluate_track": "kinedex.pipelines.stages.evaluate_track:EvaluateTrack",
    "pose_database": "kinedex.pipelines.stages.pose_database:BuildPoseDatabase",
    "reconstruct": "kinedex.pipelines.stages.reconstruct:Reconstruct",
    "evaluate_reconstruction": "kinedex.pipelines.stages.evaluate_reconstruction:EvaluateReconstruction",
    "report_reconstruction": "kinedex.reports.stages.report_reconstruction:ReportReconstruction",
    "read_imu": "kinedex.pipelines.stages.read_imu:ReadImu",
    "limb_orientations": "kinedex.pipelines.stages.limb_orientations:LimbOrientations",
    "synchronise": "kinedex.pipelines.stages.synchronise:Synchronise",
    "calibrate_sensors": "kinedex.pipelines.stages.calibrate_sensors:CalibrateSensors",
    "limb_errors": "kinedex.pipelines.stages.limb_errors:LimbErrors",
    "evaluate_limb_errors": "kinedex.pipelines.stages.evaluate_limb_errors:EvaluateLimbErrors",
    "simulate_imu": "kinedex.pipelines.stages.simulate_imu:SimulateImu",
    "break_track": "kinedex.pipelines.stages.break_track:BreakTrack",
    "report_limb_errors": "kinedex.reports.stages.report_limb_errors:ReportLimbErrors",
}
"""The built-in stages by name, as "module:class"."""

STAGES: Plugins[type[Stage[BaseModel]]] = Plugins("kinedex.stages", "stage", BUILT_IN)
"""All stages by name, both built-in ones and those of plugins."""


def load_stage(name: str) -> Stage[BaseModel]:
    """Import a stage.

    Raises
    ------
    KinedexError
        No stage has this name, or the plugin that provides it cannot be used.
    """
    found = STAGES.load(name)
    if not (isinstance(found, type) and issubclass(found, Stage) and getattr(found, "name", None) == name):
        raise KinedexError(
            f"the stage '{name}' of {STAGES.distribution(name)} must be a subclass of "
            f"kinedex.pipelines.engine.stage.Stage whose `name` is '{name}', and is {found!r}"
        )
    return found()
