"""The parameters of the stages `pose_database` and `reconstruct`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from kinedex.ops.depth.pose_fit import Form
from kinedex.ops.depth.thinned_poses import DISTANCE_M
from kinedex.ops.depth.tracker import Hypothesis, TrackerSettings
from kinedex.pipelines.engine.file_parameters import NamesFile, StageParameters

ESTIMATE = "estimate"
"""The value of `body` for a recording whose person's size is estimated from its first second."""


class PoseDatabaseParameters(StageParameters):
    """The parameters of the stage `pose_database`."""

    where: str = Field(
        "class IS NOT NULL",
        description="takes whose poses are used: a SQL filter over the columns of takes, without takes made from depth",
    )
    distance_m: float = Field(
        DISTANCE_M,
        ge=0.001,
        le=1,
        description="a pose is dropped where a kept one is so near: root mean square over 20 joints in metres",
    )


class ReconstructParameters(StageParameters):
    """The parameters of the stage `reconstruct`."""

    recordings: Annotated[str, NamesFile("file")] = Field(
        min_length=1, description="the recordings file: name → depth images, camera, background, rate, body, truth"
    )
    only: list[str] = Field([], description="names of recordings; all of the file unless given")
    form: Form = Field(
        "best", description="best, or printed: the thesis's, which goes forward and tries one candidate of the database"
    )
    hypotheses: list[Hypothesis] = Field(
        ["local", "database"],
        min_length=1,
        description="local: the pose before is followed; database: poses are looked up. Without database it gives "
        "only the pose of a start; without local it is not compared with the pose before",
    )
    candidates: int = Field(3, ge=1, le=20, description="poses of the database that are tried in a frame")
    direction: Literal["both", "forward"] = Field(
        "both", description="both: forwards and backwards in time, and in each frame the better one; forward: as live"
    )
    body: str = Field(
        ESTIMATE,
        min_length=1,
        description="a take of the person, whose bone lengths count, or estimate; the body of a recording goes before",
    )
    stride: int | None = Field(
        None, ge=1, le=16,
        description="every how many rows and columns a pixel is used; the least with at most 6,000 points unless given",
    )  # fmt: skip

    smooth_hz: float | None = Field(
        None, gt=0, le=1000, description="poses are smoothed over time: motion of this frequency keeps 0.7 of its "
        "amplitude; not at all unless given",
    )  # fmt: skip

    @property
    def both_ways(self) -> bool:
        """True if recordings are also tracked backwards."""
        return self.direction == "both" and self.form == "best"

    def settings(self, rate_hz: float) -> TrackerSettings:
        """Return the settings of the tracker for a recording with the given rate."""
        candidates = 1 if self.form == "printed" else self.candidates
        return TrackerSettings(self.form, tuple(dict.fromkeys(self.hypotheses)), candidates, rate_hz)
