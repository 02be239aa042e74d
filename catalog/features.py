"""Define feature sets: the features that form a word, the word sets, and the effect of unknown joints on features."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kinedex.catalog.feature_definitions import PRIMITIVES, Feature, WordSet
from kinedex.ops.arrays import I64, U64
from kinedex.ops.body.feature_rules import JOINTS_OF, Primitive, Rule, Term
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.words import MAX_FEATURES, rearrange


class AffectedFeatures(NamedTuple):
    """The features that are affected when joints are unknown.

    Attributes
    ----------
    unknown : tuple of Feature
        Features that cannot be computed: they name one of the joints, are scaled by an unknown length without a
        stand-in, or measure from the lowest or highest joint of a body whose lowest joints are unknown.
    narrowed : tuple of Feature
        Known features that measure from the lowest or highest joint, which is now that of the known joints.
    scaled : tuple of Feature
        Known features that are scaled by a stand-in for an unknown length.
    """

    unknown: tuple[Feature, ...]
    narrowed: tuple[Feature, ...]
    scaled: tuple[Feature, ...]


def _is_noisy(term: Term) -> bool:
    """Return whether noise of some millimetres changes a term by as much as motion does."""
    velocity = term.primitive in ("vplane", "vnplane")
    return term.primitive in ("speed", "turn_rate") or (velocity and not term.window_ms)


@dataclass(frozen=True)
class FeatureSet:
    """The features of a kind of body and the word sets that they are split into.

    Attributes
    ----------
    mirror : tuple[tuple[int, int], ...]
        Pairs of feature numbers that swap when left and right are exchanged; all other features stay.
    ground : tuple[tuple[str, ...], ...]
        Groups of joints. The lowest point of a body counts as known if one joint of each group is known. Without
        groups, all joints must be known.
    """

    name: str
    version: int
    description: str
    digest: str
    joints: tuple[str, ...]
    features: tuple[Feature, ...]
    sets: dict[str, WordSet]
    mirror: tuple[tuple[int, int], ...] = ()
    ground: tuple[tuple[str, ...], ...] = ()

    @cached_property
    def mirror_order(self) -> I64:
        """Return for each bit of a mirrored word the bit of the word that it comes from, int64 (f,)."""
        order = np.arange(len(self.features))
        for one, other in self.mirror:
            order[[one - 1, other - 1]] = other - 1, one - 1
        return order

    @cached_property
    def encoded(self) -> dict[str, Any]:
        """Return the feature set as it is written in manifests; cached, since every version of a store repeats it."""
        return asdict(self)

    def mirrored(self, words: U64) -> U64:
        """Exchange left and right in words; invalid frames stay invalid.

        Some rules of the papers use a joint of the same side for the left and for the right feature: F1 and F2 measure
        both hands against the left hip. The words of a motion that is really mirrored can therefore differ from the
        result in a few frames.

        Parameters
        ----------
        words : uint64 array (T,)
            The words of a motion.

        Returns
        -------
        uint64 array (T,)
            The words of its mirror image.
        """
        return rearrange(words, self.mirror_order)

    def mirrored_number(self, number: int) -> int:
        """Return the number of a feature's mirror image, which is the feature itself if it has no counterpart.

        Parameters
        ----------
        number : int
            The number of the feature, from 1.

        Returns
        -------
        int
            The number of its mirror image.
        """
        return int(self.mirror_order[number - 1]) + 1

    @cached_property
    def plugin_primitives(self) -> dict[str, Primitive]:
        """Return the primitives of plugins that the rules use.

        Returns
        -------
        dict of str to Primitive
            The primitives by name; empty where the rules use none.

        Raises
        ------
        KinedexError
            If a plugin is not installed, or cannot be imported.
        """
        used = {term.primitive for rule in self.rules for term in rule.terms}
        return {name: PRIMITIVES.load(name) for name in sorted(used - JOINTS_OF.keys())}

    @property
    def rules(self) -> tuple[Rule, ...]:
        """Return the rules in bit order."""
        return tuple(feature.rule for feature in self.features)

    def feature(self, name_or_number: str | int) -> Feature:
        """Return a feature by its name, its number, or a text such as "F7".

        Parameters
        ----------
        name_or_number : str or int
            The name, the number from 1, or the number behind an F.

        Returns
        -------
        Feature
            Number, name, description and rule.

        Raises
        ------
        KinedexError
            If there is no such feature; the message names the nearest.
        """
        text = str(name_or_number).strip()
        digits = text[1:] if text[:1] in "Ff" and text[1:].isdigit() else text
        if digits.isdigit():
            if 1 <= int(digits) <= len(self.features):
                return self.features[int(digits) - 1]
            raise KinedexError(f"no feature {text}: {self.name} has F1 to F{len(self.features)}")
        for feature in self.features:
            if feature.name == text:
                return feature
        raise KinedexError(f"no feature '{text}'{did_you_mean(text, [f.name for f in self.features])}")

    def word_set(self, name: str) -> WordSet:
        """Return a word set by its name.

        Parameters
        ----------
        name : str
            The name of the set.

        Returns
        -------
        WordSet
            The set.

        Raises
        ------
        KinedexError
            If there is no such set; the message names the nearest.
        """
        if name not in self.sets:
            raise KinedexError(f"no feature set '{name}'{did_you_mean(name, self.sets)}")
        return self.sets[name]

    def without(self, joints: Iterable[str]) -> AffectedFeatures:
        """Return the features that are affected when joints are unknown.

        Parameters
        ----------
        joints : iterable of str
            The names of the unknown joints.

        Returns
        -------
        AffectedFeatures
            Unknown features, and those that are known without the joints.
        """
        names = {joint for joint in joints if joint in self.joints}
        if not names:
            return AffectedFeatures((), (), ())
        lost = {self.joints.index(joint) for joint in names}
        standing = bool(self.ground) and all(set(group) - names for group in self.ground)
        unknown, narrowed, scaled = [], [], []
        for feature in self.features:
            fixed, several = feature.rule.joints(range(len(self.joints)))
            lengths = feature.rule.length_joints
            if lost & fixed or (lost & several and not standing) or (lengths and all(lost & own for own in lengths)):
                unknown.append(feature)
                continue
            if lost & several:
                narrowed.append(feature)
            if lengths and lost & lengths[0]:
                scaled.append(feature)
        return AffectedFeatures(tuple(unknown), tuple(narrowed), tuple(scaled))

    @property
    def every_bit(self) -> int:
        """The mask of all features, with the bits of a word."""
        return (1 << len(self.features)) - 1

    @property
    def steady(self) -> int:
        """Return the mask of the features that noise of some millimetres hardly changes, with the bits of a word.

        These are all but speeds and rates of turning, and velocities from one frame to the next. They are the same
        wherever the body is, and also if its root is kept in place.
        """
        numbers = [one.number for one in self.features if not any(map(_is_noisy, one.rule.terms))]
        return sum(1 << (number - 1) for number in numbers)

    def known(self, unknown: Iterable[str]) -> int:
        """Return the mask of the features that are known for a body without certain joints, with the bits of a word.

        Parameters
        ----------
        unknown : iterable of str
            The joints that the body lacks.

        Returns
        -------
        int
            The mask; all bits are set for a body that lacks no joint.
        """
        return self.every_bit & ~sum(1 << (feature.number - 1) for feature in self.without(unknown).unknown)

    def named(self, mask: int) -> list[str]:
        """Return the names of the features of a mask, in the order of their numbers.

        Parameters
        ----------
        mask : int
            Bits as in a word.

        Returns
        -------
        list of str
            The names.
        """
        return [feature.name for feature in self.features if mask >> (feature.number - 1) & 1]

    def set_of(self, number: int) -> WordSet:
        """Return the word set that a feature belongs to.

        Parameters
        ----------
        number : int
            The number of the feature, from 1.

        Returns
        -------
        WordSet
            The set.
        """
        return next(s for s in self.sets.values() if number in s.numbers)


@lru_cache(maxsize=8)
def load_feature_set(name_or_path: str | Path = "body40") -> FeatureSet:
    """Read a feature set.

    Parameters
    ----------
    name_or_path : str or Path
        A shipped name of `configs/features`, or the path of a YAML file.

    Returns
    -------
    FeatureSet
        The features, their names, rules and bits.

    Raises
    ------
    ConfigError
        If the file is invalid; the message has the file, line and key of the first fault.

    Examples
    --------
    >>> kinedex.load_feature_set().feature("rknee_bent").number
    20
    """
    # a store keeps its feature set, so YAML is read only when a store is made
    from kinedex.catalog.configs import config_path, load_yaml
    from kinedex.catalog.feature_files import FeatureFile, digest_of, feature_of, ground_of, mirror_of, sets_of

    located = load_yaml(config_path("features", name_or_path))
    located.mapping()
    parsed = located.model(FeatureFile)
    numbers = sorted(parsed.features)
    if numbers != list(range(1, len(numbers) + 1)) or len(numbers) > MAX_FEATURES:
        raise located.error(f"features must be numbered 1, 2, 3, … without gaps, at most {MAX_FEATURES}", "features")
    for name in parsed.stand_ins:
        if name not in parsed.lengths:
            raise located.error(f"no length '{name}'{did_you_mean(name, parsed.lengths)}", "stand_ins", name)
    features = tuple(feature_of(located, parsed, number) for number in numbers)
    names = [feature.name for feature in features]
    for feature in features:
        if names.count(feature.name) > 1:
            raise located.error(f"two features are named '{feature.name}'", "features", feature.number)
    return FeatureSet(
        name=parsed.name,
        version=parsed.version,
        description=parsed.description,
        digest=digest_of(parsed),
        joints=tuple(parsed.joints),
        features=features,
        sets=sets_of(located, parsed, len(features)),
        mirror=mirror_of(located, parsed, len(features)),
        ground=ground_of(located, parsed),
    )
