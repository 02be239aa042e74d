"""The parameters of tracking, stabilisation, and their evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from kinedex.ops.errors import KinedexError
from kinedex.ops.priors.stabilisation import GUARD, Settings
from kinedex.ops.templates.templates import Kind
from kinedex.ops.tracking.take_tracker import Loss
from kinedex.pipelines.engine.file_parameters import NamesFile, StageParameters
from kinedex.pipelines.tracking.chain_tracker import TrackSettings

Priors = Literal["archive", "pose", "logical"]


class ObserveParameters(StageParameters):
    """The parameters of the stage `observe`."""

    recordings: Annotated[str, NamesFile("file")] = Field(
        min_length=1, description="the recordings file: name → files, calibration, rate, body, truth"
    )
    only: list[str] = Field([], description="names of recordings to read; all of the file unless given")


class TrackParameters(StageParameters):
    """The parameters of the stage `track`."""

    tracker: Literal["take", "frames"] = Field(
        "take",
        description="take: all frames at once; frames: one after the other, as the thesis has it",
    )
    loss: Loss = Field(
        "geman_mcclure", description="geman_mcclure, which outliers hardly move, or squares; of the tracker take"
    )
    sigma_px: float | None = Field(
        None, gt=0, le=1000,
        description="standard deviation of a keypoint in pixels; measured in each recording, 5 at least, unless given",
    )  # fmt: skip
    sigma_m: float = Field(0.02, gt=0, le=10, description="standard deviation of a joint of a 3D track in metres")

    def settings(self, measured_px: float) -> TrackSettings:
        """Return the settings of the tracker for a recording with a given standard deviation of keypoints in pixels."""
        return TrackSettings(self.tracker, self.loss, self.sigma_px or measured_px)


class PriorParameters(StageParameters):
    """The parameters of priors."""

    templates: Kind = Field("soft", description="which of the learned templates: soft or hard")
    delta: float = Field(0.05, ge=0, lt=0.5, description="template values within delta of 0 or 1 count")
    tau: float = Field(0.13, ge=1e-6, le=1, description="distances below tau make a hit")
    priors: list[Priors] | None = Field(
        None,
        min_length=1,
        description="archive: poses of example clips; pose: poses of better hits in the same take; logical: feet on "
        "the ground, bent elbows, hands and feet to the front. Unless given, archive; for silhouettes alone pose and "
        "logical",
    )
    rounds: int = Field(2, ge=1, le=20, description="the most rounds")
    guard: float | None = Field(
        GUARD, gt=0, description="priors that raise the cost of the observations by more are withdrawn; null: never"
    )
    weights: dict[str, Annotated[float, Field(ge=0, allow_inf_nan=False)]] = Field(
        {}, description="factors of the weights of kinds of priors, 1 unless given"
    )
    classes: Annotated[str, NamesFile("classes")] = Field(
        "own", description="class file with `locomotion:` and `marks:`; own: neither"
    )

    def settings(self, silhouettes_only: bool, words_rate_hz: float) -> Settings:
        """Return the settings for the rounds of stabilisation.

        Parameters
        ----------
        silhouettes_only : bool
            True for a recording without keypoints.
        words_rate_hz : float
            Frames per second of words.
        """
        kinds = self.priors or (["pose", "logical"] if silhouettes_only else ["archive"])
        guard = float("inf") if self.guard is None else self.guard
        return Settings(tuple(dict.fromkeys(kinds)), self.tau, self.rounds, guard, self.weights, words_rate_hz)


class StabiliseParameters(PriorParameters):
    """The parameters of the stage `stabilise`."""

    takes: list[str] = Field(
        [], description="takes to stabilise: tracked ones, or any; those of the stage track unless given"
    )
    body: str = Field(
        "estimate", description="of 3D tracks: a take of the actor whose bone lengths count, or estimate: its own"
    )
    sigma_m: float = Field(0.02, gt=0, le=10, description="standard deviation of a joint of a 3D track in metres")


def stabilise_parameters(given: Mapping[str, object]) -> StabiliseParameters:
    """Return parameters with values given by the user.

    Raises
    ------
    KinedexError
        A value is invalid; the message names it and the expected values.
    """
    try:
        return StabiliseParameters.model_validate(dict(given))
    except ValidationError as fault:
        first = fault.errors()[0]
        wrong = f"{first['msg'][0].lower()}{first['msg'][1:]}".removeprefix("input ")
        raise KinedexError(f"{first['loc'][0]}: {wrong}, got {first['input']!r}") from None
