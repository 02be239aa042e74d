"""The parameters of annotation."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.classes import OWN
from kinedex.ops.templates.templates import Kind

CALIBRATED, DEFAULT_TAU = "calibrated", 0.13


class AnnotationParameters(BaseModel):
    """The parameters of the stage `annotate`, and of stages that repeat its work."""

    model_config = ConfigDict(extra="forbid")

    where: str = Field("class IS NULL", description="takes to annotate: a SQL filter over the columns of takes")
    method: Literal["thesis", "best"] = Field(
        "thesis",
        description="thesis: where templates fit below tau, frames get the label of the nearest class, and its runs "
        "grow to either side as long as the class does not fit worse there (labels may overlap); best: the templates "
        "in a row, with background between them, that explain all frames of a take best together (tau does not matter "
        "then)",
    )
    templates: Kind = Field("soft", description="which of the learned templates: soft or hard")
    delta: float = Field(
        0.05, ge=0, lt=0.5, description="template values within delta of 0 or 1 count, the rest are wildcards"
    )
    tau: Annotated[float, Field(gt=0, le=1)] | Literal["calibrated"] = Field(
        DEFAULT_TAU,
        description="method thesis: distances below tau make an annotation; 'calibrated': each class has the threshold "
        "that divides its training clips from others best, matched with templates of the other actors' clips",
    )
    tau_by_class: dict[str, Annotated[float, Field(gt=0, le=1)]] = Field(
        {}, description="method thesis: class → its own tau, instead of the common or the calibrated one"
    )
    min_seconds: float = Field(0, ge=0, allow_inf_nan=False, description="shorter segments are left out")
    classes: str = Field(
        OWN, description="'own': every subclass is a class; or a class file, by its shipped name or its path"
    )
    queries: list[str] | str | None = Field(
        None,
        description="keyframe queries that preselect frames: files, by shipped names or paths; none: all frames; where "
        "the pipeline learns queries too, the hits of either count",
    )
    store_curves: bool = Field(True, description="keep the distance curves, which the report draws")

    @property
    def common_tau(self) -> float:
        """The threshold of classes that have none of their own."""
        return DEFAULT_TAU if self.tau == CALIBRATED else float(self.tau)

    @property
    def query_files(self) -> list[str]:
        """The query files as a list."""
        return [self.queries] if isinstance(self.queries, str) else list(self.queries or ())
