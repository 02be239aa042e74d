"""The parameters of the stages `synchronise` and `calibrate_sensors`."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, create_model

Seconds = Annotated[float, Field(allow_inf_nan=False)]


class SynchroniseParameters(BaseModel):
    """The parameters of the stage `synchronise`."""

    model_config = ConfigDict(extra="forbid")

    offset_s: Literal["auto"] | Seconds = Field(
        "auto", description="what is added to a take's time to get the sensor's, in seconds; found unless given"
    )
    longest_s: float | None = Field(
        None, gt=0, allow_inf_nan=False, description="offsets beyond ± this many seconds are excluded"
    )
    clock: Literal["constant", "drift"] = Field(
        "constant", description="drift: the sensors' clocks run faster or slower, for recordings above 5 minutes"
    )


class CalibrationSettings(BaseModel):
    """The settings of a calibration; those named by Python keywords are fields of `CalibrateParameters` only."""

    model_config = ConfigDict(extra="forbid")

    wearing: list[str] = Field(
        ["actor"],
        description="columns of takes that tell one wearing of the sensors from another; a take without any of these "
        "values is one by itself",
    )
    vertical: Literal["known", "free"] = Field(
        "known", description="known: the take's Y axis is gravity's vertical; free: its tilt is found"
    )
    heading: Literal["auto", "fixed", "drift"] = Field(
        "auto",
        description="drift: a slow drift of each sensor's heading is corrected; auto: where one has no magnetometer, "
        "unless `global` is shared",
    )
    seed: int = Field(0, ge=0, description="seed of the guesses that a calibration begins with")

    @property
    def source(self) -> str:
        """The takes used for calibration: `take`, `actor`, or the name of a take."""
        return str(getattr(self, "from"))

    @property
    def world(self) -> str:
        """The value of the parameter `global`."""
        return str(getattr(self, "global"))


_RESERVED: dict[str, Any] = {
    "from": (
        str,
        Field(
            "take",
            min_length=1,
            description="take: each take by itself; actor: all takes of one wearing together; or the name of a take",
        ),
    ),
    "global": (
        Literal["auto", "shared", "per_sensor"],
        Field(
            "auto",
            description="shared: one rotation between the worlds of sensors and take; per_sensor: one for each sensor; "
            "auto: shared where all have magnetometers",
        ),
    ),
}

CalibrateParameters: type[CalibrationSettings] = create_model(
    "CalibrateParameters", __base__=CalibrationSettings, __module__=__name__, **_RESERVED
)
CalibrateParameters.__doc__ = "The parameters of the stage `calibrate_sensors`."
