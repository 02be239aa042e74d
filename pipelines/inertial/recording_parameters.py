"""The parameters of the stage `read_imu`."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from kinedex.catalog.sensorsets import FASTEST_HZ, SLOWEST_HZ
from kinedex.pipelines.engine.file_parameters import NamesFile


class ReadImuParameters(BaseModel):
    """The parameters of the stage `read_imu`."""

    model_config = ConfigDict(extra="forbid")

    source: Annotated[str, NamesFile("data")] = Field(
        min_length=1, description="the folder of recordings, with sensor files at any depth"
    )
    sensors: Annotated[str | None, NamesFile("sensors")] = Field(
        None, description="the file of sensors: sensor → limb, units, axes, world, columns; a shipped name or a path"
    )
    match: str = Field(
        r"(?P<take>.+)/[^/]+$",
        description="a regular expression for the path of a file below the source: its group `take` is the name of the "
        "take; files with the same group `recording`, if it has one, share a clock",
    )
    orientation: Literal["file", "estimate"] = Field(
        "file", description="file: the files' own orientations, where they have any; estimate: always of raw readings"
    )
    rate_hz: float | None = Field(
        None, ge=SLOWEST_HZ, le=FASTEST_HZ, allow_inf_nan=False,
        description="samples per second of files that state neither them nor times",
    )  # fmt: skip

    @field_validator("match")
    @classmethod
    def _is_pattern(cls, text: str) -> str:
        try:
            pattern = re.compile(text)
        except re.error as fault:
            raise ValueError(f"is no regular expression: {fault}") from None
        if "take" not in pattern.groupindex:
            raise ValueError("must have a group `take`, as in (?P<take>[^/]+)/[^/]+$")
        return text
