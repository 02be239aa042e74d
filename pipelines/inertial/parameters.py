"""The parameters of the stages `limb_orientations`, `simulate_imu` and `break_track`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from kinedex.catalog.limbs import chosen_limbs
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.file_parameters import NamesFile


def known_limbs(limbs: list[str]) -> list[str]:
    """Check names of limbs or groups, and return them; a ValueError for an unknown name suggests the nearest."""
    try:
        chosen_limbs(limbs)
    except KinedexError as fault:
        raise ValueError(str(fault)) from None
    return limbs


class LimbOrientationsParameters(BaseModel):
    """The parameters of the stage `limb_orientations`."""

    model_config = ConfigDict(extra="forbid")

    where: str | None = Field(
        None,
        description="SQL filter over the columns of takes: those whose limbs are read; unless given, those that wear "
        "sensors by read_imu, and all in a pipeline without it",
    )
    limbs: list[str] = Field(
        default_factory=list,
        description="limbs, or groups of them (trunk, head, arms, hands, legs), that are read; all unless given",
    )

    @field_validator("limbs")
    @classmethod
    def _known(cls, limbs: list[str]) -> list[str]:
        return known_limbs(limbs)

    @property
    def chosen(self) -> tuple[str, ...]:
        """The names of the selected limbs."""
        return chosen_limbs(self.limbs)


class SimulateImuParameters(BaseModel):
    """The parameters of the stage `simulate_imu`."""

    model_config = ConfigDict(extra="forbid")

    where: str = Field("true", description="SQL filter over the columns of takes: those that wear sensors")
    limbs: list[str] = Field(
        default_factory=list,
        description="limbs, or groups of them, that wear a sensor; all whose orientation is known unless given",
    )
    grade: Annotated[str, NamesFile("imu_grades")] = Field(
        "good",
        description="errors of the sensors: perfect, good, cheap, one of a device, or a path to a .yaml file",
    )
    rate_hz: float = Field(100.0, ge=1.0, le=10_000.0, description="samples per second")
    seed: int = Field(0, ge=0, description="seed of mounts, headings, clocks and errors")
    format: Literal["parquet", "npz", "xsens-txt"] = Field("parquet", description="form of the files")
    window_s: float = Field(2.0, gt=0, le=3600, description="seconds of the windows of windows.csv")
    step_s: float = Field(1.0, gt=0, le=3600, description="seconds from one window to the next")
    lever_m: Annotated[list[float], Field(min_length=3, max_length=3)] = Field(
        default_factory=lambda: [0.0, 0.0, 0.0],
        description="from the middle of a limb to its sensor, in metres and in the limb's own axes",
    )
    stand_s: float = Field(
        0.0, ge=0, le=60, description="seconds that the actor rests in the first pose before a piece, and in the last"
    )
    mount: Literal["random", "limb"] = Field(
        "random", description="the turn between sensor and limb: drawn for each actor and limb, or none"
    )
    declination_deg: float = Field(0.0, ge=-180, le=180, description="degrees from X of F_GI to magnetic north")

    @field_validator("limbs")
    @classmethod
    def _known(cls, limbs: list[str]) -> list[str]:
        return known_limbs(limbs)


class BreakTrackParameters(BaseModel):
    """The parameters of the stage `break_track`, which puts simulated tracking errors into the limbs of takes."""

    model_config = ConfigDict(extra="forbid")

    where: str = Field("true", description="SQL filter over the columns of takes: those that are broken")
    limbs: list[str] = Field(
        default_factory=lambda: ["arms", "hands", "legs"],
        description="limbs, or groups of them, that errors are put into; the others stay as they are",
    )
    noise_deg: float = Field(
        0.0, ge=0, le=90, description="smooth noise of all limbs below 6 Hz, root mean square degrees"
    )
    annotators: int = Field(2, ge=0, le=20, description="simulated annotators, each with a threshold of its own")
    seed: int = Field(0, ge=0, description="seed of errors, noise and annotators")

    @field_validator("limbs")
    @classmethod
    def _known(cls, limbs: list[str]) -> list[str]:
        return known_limbs(limbs)
