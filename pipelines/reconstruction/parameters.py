"""Parameters of the stages that reconstruct motion from depth images."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from kinedex.ops.depth.pose_database import DISTANCE_M


class PoseDatabaseParameters(BaseModel):
    """The parameters of the stage `pose_database`."""

    model_config = ConfigDict(extra="forbid")

    where: str = Field("class IS NOT NULL", description="takes that lend poses: a SQL filter over the columns of takes")
    distance_m: float = Field(
        DISTANCE_M,
        ge=0.001,
        le=1,
        description="a pose is dropped where a kept one is so near: root mean square over 20 joints in metres",
    )
