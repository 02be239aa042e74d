"""The parameters of a comparison: methods by name, and splits of an archive into takes to learn from and annotate."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from kinedex.catalog.classes import OWN
from kinedex.pipelines.annotation.parameters import MethodParameters
from kinedex.pipelines.engine.file_parameters import NamesFile
from kinedex.pipelines.evaluation.ground_truth import GroundTruthParameters

LEARNED = "learned"
"""The value of `queries`, in place of query files, by which queries are learned from the clips of each fold."""

Metric = Literal["frames", "segments", "overlap", "boundaries", "joined"]
METRICS: tuple[Metric, ...] = ("frames", "segments", "overlap", "boundaries", "joined")
Filter = Annotated[str, Field(min_length=1)]


class Method(MethodParameters):
    """A named annotation method with its parameters."""

    name: str = Field(min_length=1)
    queries: Annotated[list[str] | str | None, NamesFile("queries")] = Field(
        None, description="none: all frames; query files; or 'learned': in each fold from its own training clips"
    )

    @property
    def learned_queries(self) -> bool:
        """True if queries are learned in each fold."""
        return self.queries == LEARNED

    @property
    def query_files(self) -> list[str]:
        """The query files as a list; empty if queries are learned."""
        return [] if self.learned_queries else super().query_files

    @property
    def preselects(self) -> bool:
        """True if templates are matched only within the hits of keyframe queries."""
        return self.learned_queries or bool(self.query_files)

    @property
    def uses_templates(self) -> bool:
        """True if templates are learned: the method needs them, or the margins of keyframe queries do."""
        return self.preselects or self.annotation_method.needs.templates != "none"

    def at(self, tau: float) -> Method:
        """Return the method with another threshold, which becomes part of its name."""
        return self.model_copy(update={"tau": tau, "tau_by_class": {}, "name": f"{self.curve_name} τ = {tau:g}"})

    @property
    def curve_name(self) -> str:
        """The name of a curve over τ, shared by all methods that differ only in τ."""
        how = "without keyframes"
        if self.preselects:
            how = (
                "with learned keyframes" if self.learned_queries else f"with keyframes of {', '.join(self.query_files)}"
            )
        least = f", segments of {self.min_seconds:g} s and more" if self.min_seconds else ""
        return f"{self.method}, {how}, {self.templates} templates, δ = {self.delta:g}{least}"


class Split(BaseModel):
    """The takes to learn from and to annotate, as one fold, a fold for each value of a column, or k folds."""

    model_config = ConfigDict(extra="forbid")

    name: str = Field(min_length=1)
    train: Filter = Field(
        "class IS NOT NULL",
        description="takes to learn from, a SQL filter over the columns of takes; where the method is that of the "
        "stage annotate, those of the stage learn_templates unless given",
    )
    test: Filter = Field(
        "class IS NULL",
        description="takes to annotate, a SQL filter; where the method is that of the stage annotate, its takes unless "
        "given",
    )
    leave_out: str | None = Field(
        None,
        description="a column of takes: for each value among the takes to annotate there is a fold whose training "
        "takes have other values",
    )
    folds: int | None = Field(
        None, ge=2, description="the number of folds of takes, each annotated with templates of the other folds"
    )
    clips_as_takes: bool = Field(
        False,
        description="the takes to annotate are clips, whose class is the truth; they are laid end to end in a drawn "
        "order, so that archives with few long takes can be evaluated for every actor",
    )
    clips_a_take: int = Field(9, ge=1, description="the number of clips of a take")
    most_clips: int = Field(
        4,
        ge=1,
        description="the largest number of clips of a class in each order, for every value of `divide_by` (such as "
        "actor), as a take has clips of one value",
    )
    orders: int = Field(3, ge=1, description="the number of orders in which clips are laid end to end")
    seed: int = Field(0, ge=0, description="the seed of drawn orders, and of folds of takes")

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if self.leave_out is not None and self.folds is not None:
            raise ValueError("`leave_out` and `folds` exclude each other; make two splits of it")
        return self

    @property
    def kind(self) -> str:
        """The kind of split, as text for people."""
        if self.leave_out is not None:
            return f"leave one {self.leave_out} out"
        return f"{self.folds} folds of takes" if self.folds is not None else "fixed"


class ComparisonParameters(GroundTruthParameters):
    """The parameters of the stage `compare_methods`; templates are learned with the parameters of `learn_templates`."""

    title: str = Field("Methods compared", description="the title of the report")
    methods: list[Method] = Field(
        [],
        description="annotation methods, each with a name; unless given, the method, the classes and the takes of the "
        "stage annotate",
    )
    splits: list[Split] = Field(min_length=1, description="takes to learn from, and takes to annotate")
    classes: Annotated[str, NamesFile("classes")] = Field(
        OWN, description="'own': every subclass is a class; or a class file"
    )
    divide_by: str = Field(
        "actor",
        description="the column of takes that Table 5.2 is divided by (in the metrics, scope 'group'); of clips laid "
        "end to end, those of one take have the same value",
    )
    taus: list[float] = Field(
        [],
        description="thresholds of the sweep (thesis, Figure 5.6), for all methods that use one",
    )
    metrics: list[Metric] = Field(
        list(METRICS),
        description="measures of the report: frames and segments (thesis, 5.4), overlap (mAP at IoU 0.1 to 0.7), "
        "boundaries, and joined: overlap and boundaries once more where touching segments of one class are one",
    )

    embed: Literal["auto", "all", "none"] | list[str] = Field(
        "auto",
        description="takes whose motion the page carries, so that a click on a segment shows it: auto (as many as keep "
        "the page below 20 MB), all that have a timeline, none, or a list of names",
    )

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        for what, names in (("methods", [m.name for m in self.methods]), ("splits", [s.name for s in self.splits])):
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise ValueError(f"{what}: two are named '{twice[0]}'")
        return self

    @property
    def distinct(self) -> list[Method]:
        """The methods, without those that differ from an earlier one only in name."""
        settings = [_setting(method) for method in self.methods]
        return [method for index, method in enumerate(self.methods) if settings[index] not in settings[:index]]

    @property
    def query_files(self) -> list[str]:
        """The distinct query files of all methods."""
        return list(dict.fromkeys(name for method in self.methods for name in method.query_files))


def _setting(method: Method) -> dict[str, object]:
    """Return everything that determines the results of a method."""
    fields = method.model_dump(exclude={"name", "queries"}) | {"queries": method.query_files}
    if not method.annotation_method.needs.thresholds:
        del fields["tau"], fields["tau_by_class"]
    return fields | {"learned": method.learned_queries}
