"""The parameters of the stages that find and evaluate limb errors."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from kinedex.pipelines.engine.file_parameters import NamesFile

Degrees = Annotated[float, Field(ge=0, le=180, allow_inf_nan=False)]

TAUS = tuple(float(tau) for tau in range(5, 121, 5))
"""The thresholds in Figure 7.12 of the thesis, in degrees."""


class LimbErrorsParameters(BaseModel):
    """The parameters of the stage `limb_errors`."""

    model_config = ConfigDict(extra="forbid")

    tau: Literal["auto"] | Degrees = Field(
        45.0,
        description="the error in degrees above which a frame is wrong; auto: the median of a take's errors and four "
        "robust standard deviations, not below 15",
    )
    low: Degrees | None = Field(
        None, description="runs of wrong frames grow while the error is above this many degrees; off unless given"
    )
    gap_s: float = Field(0.0, ge=0, allow_inf_nan=False, description="gaps up to so many seconds are closed")
    min_s: float = Field(0.0, ge=0, allow_inf_nan=False, description="runs shorter than so many seconds are dropped")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.low is not None and self.tau != "auto" and self.low > self.tau:
            raise ValueError(f"low must be at most tau ({self.tau:g}), got {self.low:g}")
        if self.low is not None and self.tau == "auto" and self.low > 15.0:
            raise ValueError(f"low must be at most 15, the least value of tau: auto, got {self.low:g}")
        return self


class EvaluateLimbErrorsParameters(BaseModel):
    """The parameters of the stage `evaluate_limb_errors`."""

    model_config = ConfigDict(extra="forbid")

    ground_truth: Annotated[str | None, NamesFile("data")] = Field(
        None,
        description="label files with limbs: .csv (take, class, start, stop, limb, annotator), .json, .eaf (ELAN, "
        "tiers such as A1:lshank); a path or glob; unless given, those of the simulated annotators where takes were "
        "broken, else the labels that the store keeps",
    )
    taus: list[Degrees] = Field(
        list(TAUS), min_length=1, max_length=1000, description="the thresholds in degrees that are evaluated"
    )
    printed: Annotated[str | None, NamesFile("printed")] = Field(
        None, description="a .yaml file of printed figures that stand beside ours, such as chapter7; none unless given"
    )

    @field_validator("taus")
    @classmethod
    def _ascending(cls, taus: list[float]) -> list[float]:
        return sorted(set(taus))
