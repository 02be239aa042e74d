"""Make the templates that parameters describe: learned from clips, read from files, or combined from others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import polars as pl
from pydantic import Field

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import KinedexError
from kinedex.ops.templates.templates import Kind
from kinedex.pipelines.engine.file_parameters import NamesFile
from kinedex.pipelines.labels.unmatched_labels import UnmatchedLabels
from kinedex.pipelines.templates.examples import ExampleParameters, examples_of
from kinedex.pipelines.templates.learning import SubclassTemplate, TrainingClips, as_subclass_template, example_clips
from kinedex.pipelines.templates.recipes import (
    Combination,
    combined,
    feature_weights,
    templates_of_files,
    with_mirrored,
)
from kinedex.storage.store.store import Store


class TemplateParameters(ExampleParameters):
    """The parameters of the stage `learn_templates`, and of stages that repeat its learning."""

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
    template_files: Annotated[list[str], NamesFile("file")] = Field(
        [], description="template files (.yaml, .csv): their templates are taken in the place of learned ones"
    )

    @property
    def kinds(self) -> list[Kind]:
        """The distinct learning methods."""
        return list(dict.fromkeys(self.methods))


@dataclass(frozen=True)
class TrainingMaterial:
    """The examples from which templates are learned.

    Attributes
    ----------
    takes : polars.DataFrame
        Rows of the takes that contain examples; empty if all templates come from files.
    clips : list of TrainingClips
        The examples of each subclass, including mirrored ones, without subclasses that have a template from a file.
    unused : list of str
        Subclasses with examples whose templates come from files.
    remarks : list of str
        Remarks on labels that were excluded.
    unmatched : tuple of UnmatchedLabels
        The labels of files that match no take.
    """

    takes: pl.DataFrame
    clips: list[TrainingClips]
    unused: list[str]
    remarks: list[str]
    unmatched: tuple[UnmatchedLabels, ...]


def training_material(store: Store, params: TemplateParameters) -> TrainingMaterial:
    """Return the examples of every subclass for which a template is learned.

    Parameters
    ----------
    store : Store
        The store that holds the takes.
    params : TemplateParameters
        The parameters; mirrored clips are included, and subclasses with a template from a file are excluded.

    Raises
    ------
    KinedexError
        There is no example and no template comes from a file, or a take has no class.
    """
    found = examples_of(store, params, required=not params.template_files)
    examples = found.examples
    given = {one.name for _, one in templates_of_files(params.template_files, store.feature_set)}
    clips = with_mirrored(example_clips(store, examples), params.mirror, store.feature_set)
    takes = store.takes().filter(pl.col("take_id").is_in({one.take_id for one in examples}))
    unused = sorted(given.intersection(one.label for one in examples))
    clips = [one for one in clips if one.subclass not in given]
    return TrainingMaterial(takes, clips, unused, found.remarks, found.unmatched)


def completed(
    learned: Sequence[SubclassTemplate],
    params: TemplateParameters,
    feature_set: FeatureSet,
    kinds: Sequence[Kind] | None = None,
    *,
    where_possible: bool = False,
) -> list[SubclassTemplate]:
    """Add the templates from files and combinations to learned ones.

    Parameters
    ----------
    learned : sequence of SubclassTemplate
        The learned templates.
    params : TemplateParameters
        The parameters, which name files and combinations.
    feature_set : FeatureSet
        The features of the templates.
    kinds : sequence of {"soft", "hard"}, optional
        The kinds of templates; by default those of `params`.
    where_possible : bool
        True to skip combinations of templates that are missing.

    Returns
    -------
    list of SubclassTemplate
        All templates, sorted by subclass and kind.

    Raises
    ------
    KinedexError
        There is no template at all, or a part of a combination has none.
    """
    kinds = params.kinds if kinds is None else list(kinds)
    weights = feature_weights(params.weights, feature_set)
    every = [
        *learned,
        *(
            as_subclass_template(one, kind, f"from {Path(file).name}", weights)
            for file, one in templates_of_files(params.template_files, feature_set)
            for kind in kinds
        ),
    ]
    names = {one.subclass for one in every}
    wanted = {name: one for name, one in params.combine.items() if not where_possible or names.issuperset(one.parts)}
    every += combined(every, wanted, kinds)
    if not every:
        raise KinedexError("there is no template: no clip to learn from, and none in `template_files`")
    return sorted(every, key=lambda one: (one.subclass, kinds.index(one.kind)))
