"""What an evaluation is: methods by name, and splits of an archive into what is learned from and what is annotated."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from kinedex.ops.templates.templates import Kind

LEARNED = "learned"
"""In place of query files: the queries are learned in each fold, from the fold's own training clips."""

Metric = Literal["frames", "segments", "overlap", "boundaries", "joined"]
METRICS: tuple[Metric, ...] = ("frames", "segments", "overlap", "boundaries", "joined")
Filter = Annotated[str, Field(min_length=1)]


class Method(BaseModel):
    """One way to annotate; the parameters are those of the stage `annotate`."""

    model_config = ConfigDict(extra="forbid")

    name: str = Field(min_length=1)
    method: Literal["thesis", "best"] = "thesis"
    templates: Kind = "soft"
    delta: float = Field(0.05, ge=0, lt=0.5)
    tau: Annotated[float, Field(gt=0, le=1)] | Literal["calibrated"] = 0.13
    tau_by_class: dict[str, Annotated[float, Field(gt=0, le=1)]] = {}
    min_seconds: float = Field(0, ge=0, allow_inf_nan=False)
    queries: list[str] | str | None = Field(
        None, description="none: all frames; query files; or 'learned': in each fold from its own training clips"
    )

    @property
    def learned_queries(self) -> bool:
        """Whether queries are learned in each fold."""
        return self.queries == LEARNED

    @property
    def query_files(self) -> list[str]:
        """The query files as a list; none where queries are learned, or there are none."""
        if self.learned_queries:
            return []
        return [self.queries] if isinstance(self.queries, str) else list(self.queries or ())

    @property
    def preselects(self) -> bool:
        """Whether keyframe queries say where templates are matched."""
        return self.learned_queries or bool(self.query_files)

    def at(self, tau: float) -> Method:
        """The same method at another threshold, named after it."""
        return self.model_copy(update={"tau": tau, "tau_by_class": {}, "name": f"{self.curve_name} τ = {tau:g}"})

    @property
    def curve_name(self) -> str:
        """What methods that differ in τ alone have in common, for the sweep."""
        how = "without keyframes"
        if self.preselects:
            how = (
                "with learned keyframes" if self.learned_queries else f"with keyframes of {', '.join(self.query_files)}"
            )
        least = f", segments of {self.min_seconds:g} s and more" if self.min_seconds else ""
        return f"{self.method}, {how}, {self.templates} templates, δ = {self.delta:g}{least}"


class Split(BaseModel):
    """Takes to learn from and takes to annotate; one fold, or one for each value of a column, or k by take."""

    model_config = ConfigDict(extra="forbid")

    name: str = Field(min_length=1)
    train: Filter = Field(
        "class IS NOT NULL", description="takes to learn from, a SQL filter over the columns of takes"
    )
    test: Filter = Field("class IS NULL", description="takes to annotate, a SQL filter")
    leave_out: str | None = Field(
        None, description="a column of takes: each value among the takes to annotate is left out of the training once"
    )
    folds: int | None = Field(None, ge=2, description="so many folds by take, each left out of the training once")
    clips_as_takes: bool = Field(
        False,
        description="the takes to annotate are clips, whose class is the truth; they are laid end to end in a drawn "
        "order, so that archives with few long takes can be evaluated for every actor",
    )
    clips_a_take: int = Field(9, ge=1, description="so many clips make a take")
    most_clips: int = Field(
        4,
        ge=1,
        description="so many clips of a class at most in each order, so that none fills it; of every value of "
        "`divide_by` (such as actor) on its own, as a take has clips of one value",
    )
    orders: int = Field(3, ge=1, description="how often clips are drawn and laid out")
    seed: int = Field(0, ge=0, description="what drawn orders, and folds by take, follow from")

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if self.leave_out is not None and self.folds is not None:
            raise ValueError("`leave_out` and `folds` exclude each other; make two splits of it")
        return self

    @property
    def kind(self) -> str:
        """The kind of split in words."""
        if self.leave_out is not None:
            return f"leave one {self.leave_out} out"
        return f"{self.folds} folds by take" if self.folds is not None else "fixed"
