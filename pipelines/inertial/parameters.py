"""The parameters of the stages that compare takes with inertial sensors."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, create_model, field_validator, model_validator

from kinedex.catalog.limbs import chosen_limbs
from kinedex.catalog.sensorsets import FASTEST_HZ, SLOWEST_HZ
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.file_parameters import NamesFile, StageParameters

Degrees = Annotated[float, Field(ge=0, le=180, allow_inf_nan=False)]

TAUS = tuple(float(tau) for tau in range(5, 121, 5))
"""The thresholds in Figure 7.12 of the thesis, in degrees."""


class LimbErrorsParameters(StageParameters):
    """The parameters of the stage `limb_errors`."""

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


class EvaluateLimbErrorsParameters(StageParameters):
    """The parameters of the stage `evaluate_limb_errors`."""

    ground_truth: Annotated[str | None, NamesFile("data")] = Field(
        None,
        description="label files with limbs: .csv (take, class, start, stop, limb, annotator), .json, .eaf (ELAN, "
        "tiers such as A1:lshank); a path or glob; unless given, those of the simulated annotators where takes were "
        "broken, else the labels that the store keeps",
    )
    taus: Annotated[list[Degrees], AfterValidator(lambda taus: sorted({*taus}))] = Field(
        list(TAUS), min_length=1, max_length=1000, description="the thresholds in degrees that are evaluated"
    )
    printed: Annotated[str | None, NamesFile("printed")] = Field(
        None, description="a .yaml file of printed results to show beside ours, such as chapter7; none unless given"
    )


class ReadImuParameters(StageParameters):
    """The parameters of the stage `read_imu`."""

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


Seconds = Annotated[float, Field(allow_inf_nan=False)]


class SynchroniseParameters(StageParameters):
    """The parameters of the stage `synchronise`."""

    offset_s: Literal["auto"] | Seconds = Field(
        "auto", description="what is added to a take's time to get the sensor's, in seconds; found unless given"
    )
    longest_s: float | None = Field(
        None, gt=0, allow_inf_nan=False, description="offsets beyond ± this many seconds are excluded"
    )
    clock: Literal["constant", "drift"] = Field(
        "constant", description="drift: the sensors' clocks run faster or slower, for recordings above 5 minutes"
    )


class CalibrationSettings(StageParameters):
    """The settings of a calibration; `from` and `global`, two keywords of Python, are in `CalibrateParameters`."""

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


def checked_limbs(limbs: list[str]) -> list[str]:
    """Check names of limbs or groups, and return them; a ValueError for an unknown name suggests the nearest."""
    try:
        chosen_limbs(limbs)
    except KinedexError as fault:
        raise ValueError(str(fault)) from None
    return limbs


Limbs = Annotated[list[str], AfterValidator(checked_limbs)]
"""Names of limbs or of groups of them."""


class LimbOrientationsParameters(StageParameters):
    """The parameters of the stage `limb_orientations`."""

    where: str | None = Field(
        None,
        description="SQL filter over the columns of takes: those whose limbs are read; unless given, the takes with a "
        "sensor that read_imu assigned to a limb, or all takes in a pipeline without read_imu",
    )
    limbs: Limbs = Field(
        default_factory=list,
        description="limbs, or groups of them (trunk, head, arms, hands, legs), that are read; all unless given",
    )

    @property
    def chosen(self) -> tuple[str, ...]:
        """The names of the selected limbs."""
        return chosen_limbs(self.limbs)


class SimulateImuParameters(StageParameters):
    """The parameters of the stage `simulate_imu`."""

    where: str = Field("true", description="SQL filter over the columns of takes: those that wear sensors")
    limbs: Limbs = Field(
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


class BreakTrackParameters(StageParameters):
    """The parameters of the stage `break_track`, which puts simulated tracking errors into the limbs of takes."""

    where: str = Field("true", description="SQL filter over the columns of takes: those that are broken")
    limbs: Limbs = Field(
        default_factory=lambda: ["arms", "hands", "legs"],
        description="limbs, or groups of them, that errors are put into; the others stay as they are",
    )
    noise_deg: float = Field(
        0.0, ge=0, le=90, description="smooth noise of all limbs below 6 Hz, root mean square degrees"
    )
    annotators: int = Field(2, ge=0, le=20, description="simulated annotators, each with a threshold of its own")
    seed: int = Field(0, ge=0, description="seed of errors, noise and annotators")
