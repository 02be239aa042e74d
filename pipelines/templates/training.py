"""Make the templates that parameters describe, by learning from clips, reading files or combining templates."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import polars as pl
from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.template_files import read_templates
from kinedex.ops.arrays import F64
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.templates.derived_templates import joined
from kinedex.ops.templates.templates import Kind, LearnedTemplate, NamedTemplate
from kinedex.pipelines.engine.file_parameters import NamesFile
from kinedex.pipelines.labels.unmatched_labels import UnmatchedLabels
from kinedex.pipelines.templates.examples import ExampleParameters, examples_of
from kinedex.pipelines.templates.template_learning import (
    SubclassTemplate,
    TrainingClips,
    as_subclass_template,
    example_clips,
)
from kinedex.storage.store.store import Store


class Combination(BaseModel):
    """A motion that consists of other motions in sequence."""

    model_config = ConfigDict(extra="forbid")

    parts: list[str] = Field(min_length=2, description="subclasses, in their order in time")
    gap: int = Field(
        0, ge=0, description="columns of wildcards between two parts: about gap/2 to 2 gap frames of anything"
    )


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


def with_given_templates(
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


def feature_weights(weights: Mapping[str, float], feature_set: FeatureSet) -> F64 | None:
    """Return the weights of all features from those of some features.

    Parameters
    ----------
    weights : mapping of str to float
        Features by name or number; the others have the weight 1.
    feature_set : FeatureSet
        The f features.

    Returns
    -------
    float64 array (f,), optional
        The weights; None if no feature is named.

    Raises
    ------
    KinedexError
        There is no such feature, one is named twice, or all weights are 0.
    """
    if not weights:
        return None
    result = np.ones(len(feature_set.features))
    named: dict[int, str] = {}
    for name, weight in weights.items():
        number = feature_set.feature(name).number
        if number in named:
            raise KinedexError(f"weights: '{named[number]}' and '{name}' are the same feature")
        named[number] = name
        result[number - 1] = weight
    if not result.any():
        raise KinedexError("weights: at least one feature must count, all weights are 0")
    return result


def with_mirrored(
    clips: Sequence[TrainingClips], mirror: Mapping[str, str], feature_set: FeatureSet
) -> list[TrainingClips]:
    """Add the clips of classes, with left and right exchanged, to the classes of the mirrored motions.

    Parameters
    ----------
    clips : sequence of TrainingClips
        The clips of each class.
    mirror : mapping of str to str
        A class, and the class that its mirrored clips are examples of. In a class that has other clips, mirrored clips
        come after them. A class can be its own mirror image.
    feature_set : FeatureSet
        The features, with their mirror images.

    Returns
    -------
    list of TrainingClips
        The clips of each class, sorted by class.

    Raises
    ------
    KinedexError
        A class has no clips, or two classes have the same mirrored class.
    """
    known = {one.subclass: one for one in clips}
    found = dict(known)
    given: dict[str, str] = {}
    for source, target in mirror.items():
        if source not in known:
            raise KinedexError(f"mirror: there are no clips of '{source}'{did_you_mean(source, known)}")
        if target in given:
            raise KinedexError(f"mirror: '{target}' is the mirror image of both '{given[target]}' and '{source}'")
        given[target] = source
        one = known[source]
        words = tuple(feature_set.mirrored(clip) for clip in one.words)
        own = known.get(target, TrainingClips(target, (), ()))
        found[target] = replace(
            own,
            names=own.names + one.names,
            words=own.words + words,
            mirrored=len(one.names),
            source=source,
            takes=own.of_takes + one.of_takes,
            actors=own.of_actors + one.of_actors,
            starts=own.of_starts + one.of_starts,
            known=own.known & int(feature_set.mirrored(np.array([one.known], np.uint64))[0]),
        )
    return [found[name] for name in sorted(found)]


def templates_of_files(files: Iterable[str], feature_set: FeatureSet) -> list[tuple[str, NamedTemplate]]:
    """Read the templates of template files, each with the path of its file.

    Raises
    ------
    ConfigError
        A file is invalid.
    KinedexError
        Two templates have the same name.
    """
    found: dict[str, tuple[str, NamedTemplate]] = {}
    for file in files:
        for one in read_templates(Path(file), feature_set):
            if one.name in found:
                raise KinedexError(f"template_files: '{one.name}' stands in {found[one.name][0]} and in {file}")
            found[one.name] = (file, one)
    return list(found.values())


def combined(
    templates: Sequence[SubclassTemplate], combinations: Mapping[str, Combination], kinds: Sequence[Kind]
) -> list[SubclassTemplate]:
    """Make the templates of motions that consist of other motions in sequence.

    Parameters
    ----------
    templates : sequence of SubclassTemplate
        The templates of the parts.
    combinations : mapping of str to Combination
        The combinations by their names.
    kinds : sequence of {"soft", "hard"}
        The kinds of templates to make.

    Raises
    ------
    KinedexError
        A part has no template, or another template has the same name.
    """
    known = {(one.subclass, one.kind): one for one in templates}
    names = sorted({one.subclass for one in templates})
    found = []
    for name, combination in combinations.items():
        if name in names:
            raise KinedexError(f"combine: '{name}' has a template already; choose another name")
        for part in combination.parts:
            if part not in names:
                raise KinedexError(f"combine: '{name}' needs a template of '{part}'{did_you_mean(part, names)}")
        for kind in kinds:
            parts = [known[part, kind] for part in combination.parts]
            template = joined([one.learned.template for one in parts], combination.gap)
            between = f" with {combination.gap} columns of anything between" if combination.gap else ""
            origin = f"{', then '.join(combination.parts)}{between}"
            clips = tuple(dict.fromkeys(clip for one in parts for clip in one.clips))
            found.append(SubclassTemplate(name, kind, LearnedTemplate(template, 0, ()), clips, origin))
    return found
