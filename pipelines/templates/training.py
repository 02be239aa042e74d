"""The templates of a store as parameters describe them: from clips, from files, and made of other templates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import polars as pl
from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import KinedexError
from kinedex.ops.templates.templates import Kind
from kinedex.pipelines.templates.learning import SubclassTemplate, TrainingClips, training_clips, training_takes
from kinedex.pipelines.templates.recipes import (
    Combination,
    combined,
    feature_weights,
    given_templates,
    templates_of_files,
    with_mirrored,
)
from kinedex.storage.store.store import Store


class TemplateParameters(BaseModel):
    """The parameters of the stage `learn_templates`, and of stages that repeat its work."""

    model_config = ConfigDict(extra="forbid")

    where: str = Field(
        "class IS NOT NULL",
        description="takes to learn from: a SQL filter over the columns of takes; they are grouped by `class`",
    )
    methods: list[Kind] = Field(
        ["soft", "hard"], min_length=1, description="soft: shares of the clips; hard: what all clips have in common"
    )
    weights: dict[str, Annotated[float, Field(ge=0, allow_inf_nan=False)]] = Field(
        {},
        description="feature → how much it counts where clips are aligned and in distance curves, 1 unless given; one "
        "of weight 0 counts nowhere",
    )
    mirror: dict[str, str] = Field(
        {}, description="class → the class that its clips are examples of with left and right exchanged"
    )
    combine: dict[str, Combination] = Field(
        {}, description="new class → {parts: [class, …], gap: columns of anything between them}"
    )
    template_files: list[str] = Field(
        [], description="template files (.yaml, .csv): their templates are taken in the place of learned ones"
    )

    @property
    def kinds(self) -> list[Kind]:
        """The methods, each once."""
        return list(dict.fromkeys(self.methods))


def takes_to_learn_from(store: Store, params: TemplateParameters) -> pl.DataFrame:
    """The training takes; there may be none where all templates come from files."""
    takes = store.takes(params.where)
    return takes if params.template_files and not takes.height else training_takes(store, params.where)


def clips_to_learn_from(store: Store, params: TemplateParameters, takes: pl.DataFrame) -> list[TrainingClips]:
    """The clips of every subclass that is learned: mirrored ones included, those with a template of a file left out."""
    given = {one.name for _, one in templates_of_files(params.template_files, store.feature_set)}
    clips = with_mirrored(training_clips(store, takes), params.mirror, store.feature_set)
    return [one for one in clips if one.subclass not in given]


def completed(
    learned: Sequence[SubclassTemplate],
    params: TemplateParameters,
    feature_set: FeatureSet,
    kinds: Sequence[Kind] | None = None,
    *,
    where_possible: bool = False,
) -> list[SubclassTemplate]:
    """Learned templates with those of files and those made of others, by subclass and kind.

    Parameters
    ----------
    kinds: None takes all methods. where_possible: leave out what is made of templates that are not there.

    Raises
    ------
    KinedexError: there is none at all, or one that is needed for another is missing.
    """
    kinds = params.kinds if kinds is None else list(kinds)
    counts = feature_weights(params.weights, feature_set)
    files = templates_of_files(params.template_files, feature_set)
    every = [*learned, *given_templates(files, kinds, counts)]
    names = {one.subclass for one in every}
    wanted = {name: one for name, one in params.combine.items() if not where_possible or names.issuperset(one.parts)}
    every += combined(every, wanted, kinds)
    if not every:
        raise KinedexError("there is no template: no clip to learn from, and none in `template_files`")
    return sorted(every, key=lambda one: (one.subclass, kinds.index(one.kind)))
