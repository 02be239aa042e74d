"""The parameters of annotation methods and of the stage `annotate`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pkgutil import resolve_name
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from kinedex.catalog.classes import OWN
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.templates.templates import Kind
from kinedex.pipelines.annotation.methods import METHODS, AnnotationMethod, annotation_method
from kinedex.pipelines.engine.file_parameters import NamesFile

CALIBRATED: Literal["calibrated"] = "calibrated"
DEFAULT_TAU = 0.13

Threshold = Annotated[float, Field(gt=0, le=1)]


def least_frames(min_seconds: float, rate_hz: float) -> int:
    """Return the smallest number of frames of a segment that lasts at least `min_seconds`."""
    return math.ceil(round(min_seconds * rate_hz, 9))


class MethodParameters(BaseModel):
    """The parameters of an annotation method, for the stage `annotate` and for comparisons of methods.

    Every field that changes segments must be a part of the `Annotator` (`Preparation.annotator`), whose hash decides
    which takes are annotated again. Otherwise takes would keep the segments of an earlier value of the field.
    """

    model_config = ConfigDict(extra="forbid")

    method: str = Field(
        "thesis",
        description="thesis: where templates fit below tau, frames get the label of the nearest class, and its runs "
        "grow to either side as long as the class does not fit worse there (labels may overlap); best: the templates "
        "in a row, with background between them, that explain all frames of a take best together (tau does not matter "
        "then); numeric: joint positions compared with those of the examples, without templates and thresholds",
    )
    templates: Kind = Field("soft", description="which of the learned templates: soft or hard")
    delta: float = Field(
        0.05, ge=0, lt=0.5, description="template values within delta of 0 or 1 count, the rest are wildcards"
    )
    tau: Threshold | Literal["calibrated"] = Field(
        DEFAULT_TAU,
        description="method thesis: distances below tau make an annotation; 'calibrated': each class has the threshold "
        "that divides its training clips from others best, matched with templates of the other actors' clips",
    )
    tau_by_class: dict[str, Threshold] = Field(
        {}, description="method thesis: class → its own tau, instead of the common or the calibrated one"
    )
    min_seconds: float = Field(0, ge=0, allow_inf_nan=False, description="shorter segments are dropped")
    queries: Annotated[list[str] | str | None, NamesFile("queries")] = Field(
        None,
        description="keyframe queries that preselect frames: files, by shipped names or paths; none: all frames; where "
        "the pipeline learns queries too, the hits of either count",
    )

    @field_validator("method")
    @classmethod
    def _known_method(cls, name: str) -> str:
        if name not in METHODS:
            raise ValueError(f"must be a method: {', '.join(METHODS)}{did_you_mean(name, METHODS, 0.7)}")
        return name

    @property
    def annotation_method(self) -> type[AnnotationMethod]:
        """The annotation method that the parameter `method` names."""
        return annotation_method(self.method)

    @property
    def common_tau(self) -> float:
        """The threshold τ of classes without a threshold of their own."""
        return DEFAULT_TAU if self.tau == CALIBRATED else float(self.tau)

    @property
    def query_files(self) -> list[str]:
        """The query files as a list."""
        return [self.queries] if isinstance(self.queries, str) else list(self.queries or ())

    def thresholds(self, classes: Sequence[str], calibrated: Mapping[str, float]) -> dict[str, float]:
        """Return the threshold of each class: that of `tau_by_class`, else the calibrated one, else the common one.

        Raises
        ------
        KinedexError
            `tau_by_class` names no class.
        """
        wrong = sorted(set(self.tau_by_class) - set(classes))
        if wrong:
            raise KinedexError(f"tau_by_class: no class is named '{wrong[0]}'{did_you_mean(wrong[0], classes)}")
        return {name: self.tau_by_class.get(name, calibrated.get(name, self.common_tau)) for name in classes}

    def without_effect(self) -> list[str]:
        """Return a remark on settings that the method does not use, if there are any."""
        asked = ["`tau: calibrated`"] * (self.tau == CALIBRATED) + ["`tau_by_class`"] * bool(self.tau_by_class)
        if self.annotation_method.needs.thresholds or not asked:
            return []
        have = "has" if len(asked) == 1 else "have"
        return [f"{' and '.join(asked)} {have} no effect with `method: {self.method}`, which uses no thresholds"]


class AnnotationParameters(MethodParameters):
    """The parameters of the stage `annotate`, and of stages that repeat its annotation."""

    where: str = Field("class IS NULL", description="takes to annotate: a SQL filter over the columns of takes")
    classes: Annotated[str, NamesFile("classes")] = Field(
        OWN, description="'own': every subclass is a class; or a class file, by its shipped name or its path"
    )
    each_example: bool = Field(
        False,
        description="method best: every example is a template, every interval that people have rejected is a template "
        "that assigns no label, and the background is learned from all takes; for archives with few labels",
    )
    store_curves: bool = Field(True, description="keep the distance curves, which the report draws")

    @property
    def annotation_method(self) -> type[AnnotationMethod]:
        """The annotation method that `method` names, or the one that makes each example a template.

        Raises
        ------
        KinedexError
            The method has no form in which each example is a template.
        """
        method = annotation_method(self.method)
        if not self.each_example:
            return method
        if not method.offers.each_example:
            raise KinedexError(
                f"`each_example` is for `method: best`, and the method is '{self.method}': change one of them"
            )
        found: type[AnnotationMethod] = resolve_name(method.offers.each_example)
        return found
