"""Feature sets: the YAML definition of the features, their bits, and the subsets that words are split into."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.configs import Located, config_path, load_yaml
from kinedex.catalog.plugins import Plugins
from kinedex.ops.body.feature_rules import COMPARISONS, JOINTS_OF, Primitive, Rule, Term
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.templates.mirror import rearrange
from kinedex.ops.words import MOST_FEATURES

PRIMITIVES: Plugins[Primitive] = Plugins("kinedex.primitives", "primitive", dict.fromkeys(JOINTS_OF, ""))
"""All primitives of features by name: those of `JOINTS_OF`, and those of plugins."""


@dataclass(frozen=True)
class Feature:
    """A feature with its number (its bit is number − 1), name, description and rule."""

    number: int
    name: str
    description: str
    rule: Rule


@dataclass(frozen=True)
class WordSet:
    """A range of consecutive features whose bits form one kind of word; `first` is the lowest feature number."""

    name: str
    first: int
    count: int

    @property
    def numbers(self) -> range:
        """Return the numbers of the set's features."""
        return range(self.first, self.first + self.count)

    @property
    def mask(self) -> int:
        """The mask of the set's features, with the bits of a whole word."""
        return ((1 << self.count) - 1) << (self.first - 1)


class AffectedFeatures(NamedTuple):
    """The features that are affected when joints are unknown.

    Attributes
    ----------
    unknown : tuple of Feature
        Those that name one of the joints, are scaled by a length that nothing stands for, or measure from the lowest or
        highest joint of a body whose lowest joints are among them.
    narrowed : tuple of Feature
        Known features that measure from the lowest or highest of the remaining joints.
    scaled : tuple of Feature
        Known features that are scaled by another length.
    """

    unknown: tuple[Feature, ...]
    narrowed: tuple[Feature, ...]
    scaled: tuple[Feature, ...]


@dataclass(frozen=True)
class FeatureSet:
    """The features of a kind of body and the word sets that they are split into.

    Attributes
    ----------
    mirror : tuple[tuple[int, int], ...]
        Pairs of feature numbers that swap when left and right are exchanged; all other features stay.
    ground : tuple[tuple[str, ...], ...]
        Groups of joints. Where one joint of each is known, so is the lowest point of the body; without groups all
        joints must be known.
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
    def mirror_order(self) -> npt.NDArray[np.int64]:
        """Return the source bit of each bit of a mirrored word, int64 (f,), from 0; it is its own inverse."""
        order = np.arange(len(self.features))
        for one, other in self.mirror:
            order[[one - 1, other - 1]] = other - 1, one - 1
        return order

    @cached_property
    def encoded(self) -> dict[str, Any]:
        """Return the set as manifests write it; cached, since every version of a store repeats it."""
        return asdict(self)

    def mirrored(self, words: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
        """Exchange left and right in words; invalid frames stay invalid.

        Where a rule names a limb or a joint of one side for both twins, as the papers' do (F1 and F2 measure both hands
        against the left hip), the words of the motion in a true mirror can differ from these by a few frames.

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

    def known(self, unknown: Iterable[str]) -> int:
        """Return the mask of the features that are known of a body without some joints, with the bits of a word.

        Parameters
        ----------
        unknown : iterable of str
            The joints that the body lacks.

        Returns
        -------
        int
            The mask, with all bits for a body that lacks none.
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


class _StandIn(BaseModel):
    model_config = ConfigDict(extra="forbid")
    factor: float = Field(gt=0)
    length: list[tuple[str, str]]


class _FeatureFile(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str
    version: int = Field(ge=1)
    description: str = ""
    joints: list[str]
    lengths: dict[str, list[tuple[str, str]]]
    sets: dict[str, tuple[int, int]]
    mirror: list[tuple[int, int]] = []
    ground: list[list[str]] = []
    stand_ins: dict[str, list[_StandIn]] = {}
    features: dict[int, dict[str, Any]]


class _FeatureEntry(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    description: str
    quantity: dict[str, Any]
    length: str | None = None
    when: str
    weak: float | tuple[float, float]
    strong: float | tuple[float, float]


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
        At the first fault, with its file, line and key.

    Examples
    --------
    >>> kinedex.load_feature_set().feature("rknee_bent").number
    20
    """
    located = load_yaml(config_path("features", name_or_path))
    located.mapping()
    parsed = located.model(_FeatureFile)
    numbers = sorted(parsed.features)
    if numbers != list(range(1, len(numbers) + 1)) or len(numbers) > MOST_FEATURES:
        raise located.error(f"features must be numbered 1, 2, 3, … without gaps, at most {MOST_FEATURES}", "features")
    for name in parsed.stand_ins:
        if name not in parsed.lengths:
            raise located.error(f"no length '{name}'{did_you_mean(name, parsed.lengths)}", "stand_ins", name)
    features = tuple(_feature(located, parsed, number) for number in numbers)
    names = [feature.name for feature in features]
    for feature in features:
        if names.count(feature.name) > 1:
            raise located.error(f"two features are named '{feature.name}'", "features", feature.number)
    return FeatureSet(
        name=parsed.name,
        version=parsed.version,
        description=parsed.description,
        digest=_digest(parsed),
        joints=tuple(parsed.joints),
        features=features,
        sets=_sets(located, parsed, len(features)),
        mirror=_mirror(located, parsed, len(features)),
        ground=_ground(located, parsed),
    )


def _digest(parsed: _FeatureFile) -> str:
    """Return a hash of what the words of a whole body depend on, without mirror, ground and stand-ins."""
    text = json.dumps(
        parsed.model_dump(exclude={"mirror", "ground", "stand_ins"}), sort_keys=True, separators=(",", ":")
    )
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _sets(located: Located, parsed: _FeatureFile, count: int) -> dict[str, WordSet]:
    expected = 1
    result = {}
    for name, (first, last) in parsed.sets.items():
        if first != expected or last < first or last > count:
            raise located.error(
                f"the sets must split features 1 to {count} without gap or overlap, in order; got {first} to {last}",
                "sets",
                name,
            )
        result[name] = WordSet(name, first, last - first + 1)
        expected = last + 1
    if expected != count + 1:
        raise located.error(f"features {expected} to {count} are in no set", "sets")
    return result


def _mirror(located: Located, parsed: _FeatureFile, count: int) -> tuple[tuple[int, int], ...]:
    seen: set[int] = set()
    for place, pair in enumerate(parsed.mirror):
        for number in pair:
            if not 1 <= number <= count:
                raise located.error(f"no feature {number}: there are F1 to F{count}", "mirror", place)
            if number in seen:
                raise located.error(f"feature {number} stands twice; a feature has one twin at most", "mirror", place)
            seen.add(number)
    return tuple(parsed.mirror)


def _ground(located: Located, parsed: _FeatureFile) -> tuple[tuple[str, ...], ...]:
    for place, group in enumerate(parsed.ground):
        for joint in group:
            _joint(located, parsed, joint, "ground", place)
    return tuple(tuple(group) for group in parsed.ground)


def _feature(located: Located, parsed: _FeatureFile, number: int) -> Feature:
    key = ("features", number)
    entry = located.model(_FeatureEntry, *key)
    if entry.when not in COMPARISONS:
        raise located.error(f"must be one of {', '.join(COMPARISONS)}, got {entry.when!r}", *key, "when")
    length: tuple[tuple[int, int], ...] = ()
    if entry.length is not None:
        if entry.length not in parsed.lengths:
            raise located.error(
                f"no length '{entry.length}'{did_you_mean(entry.length, parsed.lengths)}", *key, "length"
            )
        length = _pairs(located, parsed, parsed.lengths[entry.length], "lengths", entry.length)
    others = parsed.stand_ins.get(entry.length or "", [])
    stand_ins = tuple(
        (one.factor, _pairs(located, parsed, one.length, "stand_ins", str(entry.length), place))
        for place, one in enumerate(others)
    )
    rule = Rule(
        terms=_terms(located, parsed, entry.quantity, (*key, "quantity")),
        comparison=COMPARISONS[entry.when],
        weak=_bounds(located, entry, entry.weak, (*key, "weak")),
        strong=_bounds(located, entry, entry.strong, (*key, "strong")),
        length=length,
        stand_ins=stand_ins,
    )
    return Feature(number, entry.name, entry.description, rule)


def _pairs(
    located: Located, parsed: _FeatureFile, pairs: list[tuple[str, str]], *key: str | int
) -> tuple[tuple[int, int], ...]:
    return tuple((_joint(located, parsed, a, *key), _joint(located, parsed, b, *key)) for a, b in pairs)


def _bounds(
    located: Located, entry: _FeatureEntry, value: float | tuple[float, float], key: tuple[str | int, ...]
) -> tuple[float, float]:
    if isinstance(value, tuple) != (entry.when == "within"):
        expected = "a pair of bounds" if entry.when == "within" else "one number"
        raise located.error(f"'{entry.when}' takes {expected}, got {value!r}", *key)
    return value if isinstance(value, tuple) else (value, value)


def _terms(
    located: Located, parsed: _FeatureFile, quantity: dict[str, Any], key: tuple[str | int, ...]
) -> tuple[Term, ...]:
    if "sum" in quantity:
        parts = quantity["sum"]
        if len(quantity) > 1 or not isinstance(parts, list) or not parts:
            raise located.error("sum must be a list of [factor, primitive] and stand alone", *key)
        for part in parts:
            if not (isinstance(part, list) and len(part) == 2 and _is_number(part[0]) and isinstance(part[1], dict)):
                raise located.error(f"sum must be a list of [factor, primitive], got {part!r}", *key)
        return tuple(_term(located, parsed, part, float(factor), key) for factor, part in parts)
    return (_term(located, parsed, quantity, 1.0, key),)


def _term(
    located: Located, parsed: _FeatureFile, part: dict[str, Any], factor: float, key: tuple[str | int, ...]
) -> Term:
    options = {"window_ms", "without", "abs"}
    names = [name for name in part if name not in options]
    if len(names) != 1 or (names[0] not in JOINTS_OF and names[0] not in PRIMITIVES):
        wrong = next((name for name in names if name not in PRIMITIVES), "nothing")
        raise located.error(f"expected one primitive, got '{wrong}'{did_you_mean(wrong, PRIMITIVES)}", *key)
    primitive = names[0]
    plugin = None if primitive in JOINTS_OF else PRIMITIVES.load(primitive)
    for name in (primitive, "without"):
        if not isinstance(part.get(name, []), list):
            raise located.error(f"{name} must be a list of joints, got {part[name]!r}", *key)
    window_ms = part.get("window_ms", 0.0)
    if not _is_number(window_ms) or window_ms < 0:
        raise located.error(f"window_ms must be a number of milliseconds, got {window_ms!r}", *key)
    joints = tuple(_joint(located, parsed, name, *key) for name in part[primitive])
    wanted = plugin.joints if plugin is not None else JOINTS_OF[primitive]
    if wanted is None and not joints:
        raise located.error(f"{primitive} takes at least one joint", *key)
    if wanted is not None and len(joints) != wanted:
        raise located.error(f"{primitive} takes {wanted} joints, got {len(joints)}", *key)
    return Term(
        primitive=primitive,
        joints=joints,
        factor=factor,
        window_ms=float(window_ms),
        without=tuple(_joint(located, parsed, name, *key) for name in part.get("without", ())),
        absolute=bool(part.get("abs", False)),
    )


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e9


def _joint(located: Located, parsed: _FeatureFile, name: object, *key: str | int) -> int:
    if not isinstance(name, str) or name not in parsed.joints:
        raise located.error(f"no joint '{name}'{did_you_mean(str(name), parsed.joints)}", *key)
    return parsed.joints.index(name)
