"""The contract of a stage: its name, its parameters, the stages it builds on, what it reads, and what it makes."""

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
"""The role of the stage that brings the takes in."""


@dataclass(frozen=True)
class Input:
    """A role that another stage of the pipeline plays for a stage.

    Attributes
    ----------
    stage : str
        The kind of stage that can play it.
    optional : bool
        The stage can do without it.
    """

    stage: str
    optional: bool = False


class Stage(ABC, Generic[Parameters]):
    """One kind of stage; subclasses have no state.

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
        The roles that other stages play.
    commits_once : bool
        True if all that `run` makes is committed at once, together with `StoreWriter.forget_stage`: until then the
        stage counts as done, and what it made before is shown.
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
            What the record of the stage keeps, as JSON values. `files` are paths within the store that must stay,
            `left_out` is the number of source files that were not read.

        Raises
        ------
        KinedexError
            The stage cannot finish; what it committed before stays.
        """

    def with_remembered(self, params: Parameters, unset: frozenset[str], store: Store) -> Parameters:
        """Return the parameters, with what the store remembers of earlier runs in place of those that nobody gave."""
        return params

    def examine(self, params: Parameters, store: Store) -> None:
        """Look at the store before a run; an `AcceptError` reports what the user has to accept first."""

    def reading(self, params: Parameters, store: Store) -> Reading | None:
        """Return a digest of the takes that the stage reads; None means that it depends on all takes of the store."""
        return None

    def external_digest(self, params: Parameters, store: Store | None) -> str:
        """Return a hash of all that the stage reads outside the store; `store` is None before it is made."""
        return ""

    def named_parts(self, params: Parameters) -> Sequence[tuple[Plugins[Any], str]]:
        """Return the parts that the parameters name and that can be of plugins, each with the table of its kind."""
        return ()

    def is_current(self, store: Store) -> bool:
        """Return whether what the stage made is still in place, apart from results and `files`."""
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
    "pose_database": "kinedex.pipelines.stages.pose_database:PoseDatabase",
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
"""The built-in stages, in the form of entry points."""

STAGES: Plugins[type[Stage[BaseModel]]] = Plugins("kinedex.stages", "stage", BUILT_IN)
"""All stages by name: built in, and of plugins."""


def load_stage(name: str) -> Stage[BaseModel]:
    """Import a stage.

    Raises
    ------
    KinedexError
        No stage has this name, or it is of a plugin that cannot be used.
    """
    found = STAGES.load(name)
    if not (isinstance(found, type) and issubclass(found, Stage) and getattr(found, "name", None) == name):
        raise KinedexError(
            f"the stage '{name}' of {STAGES.distribution(name)} must be a subclass of "
            f"kinedex.pipelines.engine.stage.Stage whose `name` is '{name}', and is {found!r}"
        )
    return found()
