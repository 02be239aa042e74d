"""Make templates from mirrored clips, files and combinations, and read the weights of features."""

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
    """A motion that consists of other motions in sequence."""

    model_config = ConfigDict(extra="forbid")

    parts: list[str] = Field(min_length=2, description="subclasses, in their order in time")
    gap: int = Field(
        0, ge=0, description="columns of wildcards between two parts: about gap/2 to 2 gap frames of anything"
    )


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
        A class, and the class that its mirrored clips are examples of. A class that has clips of its own gets the
        mirrored ones after them; a class can be its own mirror image.
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
            found.append(SubclassTemplate(name, kind, Learned(template, 0, ()), clips, origin))
    return found
