"""Read results printed in publications, which kinedex's evaluations are compared with."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.configs import config_path, load_yaml

_Share = Annotated[float, Field(ge=0.0, le=1.0)]
_Degrees = Annotated[float, Field(ge=0.0, le=180.0)]


class PublishedScore(BaseModel):
    """Precision and recall over frames, as a publication prints them."""

    model_config = ConfigDict(extra="forbid")
    name: str = Field(description="group of limbs, limb, or all")
    annotator: str = Field(description="the name that the annotator's has to end with")
    tau_deg: _Degrees = Field(description="the error above which frames are wrong")
    p1: _Share = Field(description="precision by frames")
    r1: _Share = Field(description="recall by frames")


class PublishedError(BaseModel):
    """Mean and standard deviation of a limb's error, as a publication prints them."""

    model_config = ConfigDict(extra="forbid")
    mean_deg: _Degrees = Field(description="mean error")
    sd_deg: _Degrees = Field(description="its standard deviation")


class PublishedResults(BaseModel):
    """The printed results of one publication."""

    model_config = ConfigDict(extra="forbid")
    source: str = Field(description="publication, section, and what it was measured on")
    figures: list[PublishedScore] = Field(default_factory=list)
    limbs: dict[str, PublishedError] = Field(default_factory=dict, description="limb → its error")

    def score(self, name: str, annotator: str, tau_deg: float) -> PublishedScore | None:
        """Return the printed score of a group or limb for an annotator and a threshold; None if there is none."""
        words = annotator.split()
        return next(
            (
                one
                for one in self.figures
                if one.name == name and words and one.annotator == words[-1] and one.tau_deg == tau_deg
            ),
            None,
        )


def load_published(name_or_path: str | Path) -> PublishedResults:
    """Read printed results from `configs/printed/` or from a user's file.

    Parameters
    ----------
    name_or_path : str or Path
        A shipped name such as chapter7, or the path of a .yaml file.

    Raises
    ------
    ConfigError
        There is no such file, or it is invalid; the message names line and key.
    """
    located = load_yaml(config_path("printed", name_or_path))
    located.mapping()
    return located.model(PublishedResults)
