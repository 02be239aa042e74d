"""Templates that are not simply learned from clips of their class: from files, in the mirror, and combined."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.template_files import NamedTemplate, read_templates
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.templates.derived_templates import joined
from kinedex.ops.templates.templates import Kind, Learned
from kinedex.pipelines.templates.learning import SubclassTemplate, TrainingClips

F64 = npt.NDArray[np.float64]


class Combination(BaseModel):
    """A motion made of others, one after the other."""

    model_config = ConfigDict(extra="forbid")

    parts: list[str] = Field(min_length=2, description="subclasses, in their order in time")
    gap: int = Field(
        0, ge=0, description="columns of wildcards between two parts: about gap/2 to 2 gap frames of anything"
    )


def feature_weights(weights: Mapping[str, float], feature_set: FeatureSet) -> F64 | None:
    """The weight of every feature, float64 (f,), from those that are named; None where none is.

    Raises
    ------
    KinedexError: no such feature, named twice, or none that counts.
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
    """Add to classes the clips of others with left and right exchanged.

    Parameters
    ----------
    mirror: class → the class that its mirrored clips are examples of. A class that has clips of its own gets the
        mirrored ones behind them; a class can be its own mirror image.

    Raises
    ------
    KinedexError: no clip is of a class, or one class is given the clips of two.
    """
    known = {one.subclass: one for one in clips}
    found = dict(known)
    given: dict[str, str] = {}
    for source, target in mirror.items():
        if source not in known:
            raise KinedexError(f"mirror: there are no clips of '{source}'{did_you_mean(source, known)}")
        if target in given:
            raise KinedexError(
                f"mirror: '{target}' is said to be the mirror image of both '{given[target]}' and '{source}'"
            )
        given[target] = source
        one = known[source]
        words = tuple(feature_set.mirrored(clip) for clip in one.words)
        own = known.get(target, TrainingClips(target, (), ()))
        found[target] = replace(
            own, names=own.names + one.names, words=own.words + words, mirrored=len(one.names), source=source
        )
    return [found[name] for name in sorted(found)]


def templates_of_files(files: Iterable[str], feature_set: FeatureSet) -> list[tuple[str, NamedTemplate]]:
    """The templates of template files, each with the file it stands in.

    Raises
    ------
    ConfigError: a file is wrong. KinedexError: two templates have one name.
    """
    found: dict[str, tuple[str, NamedTemplate]] = {}
    for file in files:
        for one in read_templates(Path(file), feature_set):
            if one.name in found:
                raise KinedexError(f"template_files: '{one.name}' stands in {found[one.name][0]} and in {file}")
            found[one.name] = (file, one)
    return list(found.values())


def given_templates(
    given: Iterable[tuple[str, NamedTemplate]], kinds: Sequence[Kind], counts: F64 | None
) -> list[SubclassTemplate]:
    """Templates of files in the place of learned ones, for every kind; a template's own feature weights go first."""
    return [
        SubclassTemplate(
            one.name,
            kind,
            Learned(
                one.template
                if one.template.feature_weights is not None
                else replace(one.template, feature_weights=counts),
                0,
                (),
            ),
            (),
            f"from {Path(file).name}",
        )
        for file, one in given
        for kind in kinds
    ]


def combined(
    templates: Sequence[SubclassTemplate], combinations: Mapping[str, Combination], kinds: Sequence[Kind]
) -> list[SubclassTemplate]:
    """Templates of motions made of others.

    Raises
    ------
    KinedexError: a part has no template, or a template has the name already.
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
            found.append(SubclassTemplate(name, kind, Learned(template, 0, ()), clips, origin))
    return found
