"""Skeleton mappings turn the joints of a source's skeleton into the named joints that features refer to.

`WatchedMappings` record a reader's last request, so that a mapping can be proposed for a file that is rejected.
Mappings and vocabularies of names that users wrote are added to the shipped ones.
"""

from __future__ import annotations

import hashlib
import json
import re
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from kinedex.catalog.configs import Located, config_names, config_path, load_yaml, parse_yaml, read_text
from kinedex.catalog.skeletons.body_evidence import Evidence
from kinedex.catalog.skeletons.recognition.landmarks import Landmarks, landmarks_with
from kinedex.catalog.skeletons.recognition.names import LONGEST_PREFIX, Vocabulary, load_vocabulary, parse_vocabulary
from kinedex.catalog.skeletons.recognition.points import doubted_labels, recognise_points
from kinedex.catalog.skeletons.recognition.recognised_tree import recognise_tree
from kinedex.catalog.skeletons.renamed_nodes import renamed_fit
from kinedex.catalog.skeletons.skeleton_fit import (
    KINDS,
    Axis,
    Fit,
    Format,
    LimbEntry,
    Mix,
    SkeletonMapping,
    limb_sources,
)
from kinedex.ops.arrays import F64
from kinedex.ops.body.joint_tree import JOINT_PARENTS
from kinedex.ops.errors import ConfigError, SourceError, did_you_mean

__all__ = ["Fit", "Format", "Mappings", "Mix", "SkeletonMapping", "load_mappings", "load_skeleton", "stripping"]


_WAY_OUT = "write one with `kinedex mapping new FILE -o my.yaml`, and give it by `skeletons`"

ENDINGS = (".yaml", ".yml")


class _Aside(BaseModel):
    model_config = ConfigDict(extra="forbid")
    plane: list[str | _Mix] = Field(min_length=3, max_length=3)
    times: float
    kind: Literal["normal", "chord", "hinge"] = "normal"


class _Mix(BaseModel):
    model_config = ConfigDict(extra="forbid")
    virtual: dict[str, float] | None = Field(None, min_length=1)
    nodes: dict[str, float] | None = Field(None, min_length=1)
    aside: _Aside | None = None

    @model_validator(mode="after")
    def _one(self) -> _Mix:
        if (self.virtual is None) == (self.nodes is None):
            raise ValueError("expected `virtual` (weights over named joints) or `nodes` (weights over nodes)")
        if self.aside is not None and self.nodes is None:
            raise ValueError("`aside` goes with `nodes`, whose plane it leaves")
        return self


class _Root(BaseModel):
    model_config = ConfigDict(extra="forbid")
    up: Axis
    facing: Axis


_ONLY: dict[str, tuple[Format, ...]] = {
    "bones": ("acclaim", "bvh"),
    "root_axes": ("acclaim", "bvh", "amass"),
    "order": ("positions",),
    "screen": ("c3d",),
}
"""The formats for which a key is meaningful, for keys that some formats do not have."""


class _SkeletonFile(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str
    description: str = ""
    format: Format
    up: Axis = "y"
    handedness: Literal["right", "left"] = "right"
    facing: Axis = "z"
    root_axes: _Root | None = None
    unit_m: Any  # A number of metres or `guess`; checked below, because pydantic's messages about unions are unhelpful.
    strip_prefix: str | None = None
    only: str | None = None
    bones: dict[str, dict[str, float]] = Field(default_factory=dict)
    order: list[str] = Field(default_factory=list)
    screen: bool | None = None
    aliases: dict[str, list[str]] = Field(default_factory=dict)
    limbs: dict[str, LimbEntry] = Field(default_factory=dict)
    joints: dict[str, Any]  # see `_mix`
    estimated: dict[str, str] = Field(default_factory=dict)
    rough: list[str] = Field(default_factory=list)


@dataclass(frozen=True)
class Mappings:
    """The mappings that an archive is read with.

    Attributes
    ----------
    of_format : dict of str to tuple of SkeletonMapping
        Format → all shipped mappings, or the one that the user chose.
    own : dict of str to tuple of SkeletonMapping
        Format → the user's mappings, which are preferred if their names fit.
    forced : tuple of str
        The formats for which the user chose one mapping.
    vocabulary : Vocabulary, optional
        The names by which trees are recognised; the shipped ones by default.
    landmarks : Landmarks, optional
        The labels by which points are recognised; the shipped ones by default.
    vocabulary_digest : str
        A hash of the names and labels that the user added.
    """

    of_format: dict[Format, tuple[SkeletonMapping, ...]] = field(default_factory=dict)
    own: dict[Format, tuple[SkeletonMapping, ...]] = field(default_factory=dict)
    forced: tuple[Format, ...] = ()
    vocabulary: Vocabulary | None = None
    landmarks: Landmarks | None = None
    vocabulary_digest: str = ""

    def of(self, form: Format) -> tuple[SkeletonMapping, ...]:
        """Return all mappings of a format, the user's first."""
        return (*self.own.get(form, ()), *self.of_format.get(form, ()))

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the named joints that the mappings define."""
        first = next((mappings[0] for mappings in self.of_format.values() if mappings), None)
        return tuple(JOINT_PARENTS) if first is None else tuple(first.joints)

    def digest(self, form: Format) -> str:
        """Return a hash of the mappings of one format, on which the takes read with them depend."""
        own = self.own.get(form, ())
        mark = ["own", *(mapping.digest for mapping in own)] if own else []
        names = ["names", self.vocabulary_digest] if self.vocabulary_digest else []
        return " ".join([*(mapping.digest for mapping in self.of_format.get(form, ())), *mark, *names])

    def exact(self, source: str | Path, form: Format, nodes: Mapping[str, int]) -> Fit | None:
        """Return the fit of the mapping whose nodes all occur in a skeleton, as in `detect`; None if there is none."""
        fits = [mapping.fit(nodes) for mapping in self.own.get(form, ()) if mapping.is_for(source, nodes)]
        # a mapping for certain files goes before those for all files with its names
        own = _best(source, [fit for fit in fits if fit.mapping.only is not None]) or _best(source, fits)
        if own is not None:
            return own
        usable = [mapping for mapping in self.of_format.get(form, ()) if self._may_fit(mapping, source, nodes)]
        fits = [mapping.fit(nodes) for mapping in usable]
        if len(fits) == 1 and (form in self.forced or fits[0].mapping.only is None):
            fits[0].check(source, self.stripped(form, nodes) if fits[0].missing else "")
            return fits[0]
        return _best(source, fits)

    def _only_names(self, mapping: SkeletonMapping) -> bool:
        """Return whether a mapping is shipped, not forced, and has an `order` that names the points of nameless files.

        For such a mapping the body is recognised from these names.
        """
        return self._is_shipped(mapping) and bool(mapping.order)

    def _is_shipped(self, mapping: SkeletonMapping) -> bool:
        """Return whether a mapping comes with kinedex, and was not chosen by the user."""
        return mapping.format not in self.forced and mapping not in self.own.get(mapping.format, ())

    def _may_fit(self, mapping: SkeletonMapping, source: str | Path, nodes: Iterable[str]) -> bool:
        """Return whether a mapping may be used for a file: its `only` admits the file, or the user chose it."""
        return mapping.format in self.forced or mapping.is_for(source, nodes)

    def recognised(self, source: str | Path, form: Format, evidence: Evidence) -> Fit:
        """Return the fit that recognition makes, by the tree of the nodes or, without one, by their positions.

        If a tree lacks only a few names of a mapping, and nodes with unknown names are in their places, the mapping is
        used instead.

        Raises
        ------
        SourceError
            If no body is recognised.
        """
        if evidence.parents is None:
            return recognise_points(source, evidence, self.joints, form, self.landmarks)
        if (fit := self.renamed(form, evidence, source)) is not None:
            return fit
        return recognise_tree(source, evidence, self.joints, form, self.vocabulary)

    def renamed(self, form: Format, evidence: Evidence, source: str | Path = "") -> Fit | None:
        """Return the fit of a mapping of which a few nodes have other names in a tree; None if there is none."""
        if form in self.forced:
            return None
        return renamed_fit(
            [mapping for mapping in self.of(form) if self._may_fit(mapping, source, evidence.names)], evidence
        )

    def completed(self, fit: Fit, evidence: Evidence | None) -> Fit:
        """Return a fit in which joints that lack their own node use a node of another name.

        Fits that lack nothing, fits of a user's mapping and fits of points are returned unchanged.
        """
        if evidence is None or evidence.parents is None or not fit.fallen or not self._is_shipped(fit.mapping):
            return fit
        return renamed_fit([fit.mapping], evidence) or fit

    def detect(
        self, source: str | Path, form: Format, nodes: Mapping[str, int], evidence: Evidence | None = None
    ) -> Fit:
        """Return the fit of the mapping whose nodes all occur in a skeleton and that supplies the most joints.

        A user's mapping is preferred to all shipped ones. If the format has only one mapping, it is used,
        and any node that it lacks is an error.

        Parameters
        ----------
        source : str or Path
            The file that errors name.
        form : str
            The format of the mappings to try.
        nodes : Mapping[str, int]
            Node name → index.
        evidence : Evidence, optional
            Tree and places of the nodes, by which a body is recognised that no mapping fits.

        Raises
        ------
        SourceError
            If none fits (the message names the nearest and what it lacks), or two fit equally well.
        """
        fit = self.exact(source, form, nodes)
        if fit is not None and (evidence is None or not self._only_names(fit.mapping)):
            fit = self.completed(fit, evidence)
            points = evidence is not None and evidence.parents is None and self._is_shipped(fit.mapping)
            return doubted_labels(fit, evidence, self.joints, self.landmarks) if points and evidence else fit
        if evidence is not None:
            return self.recognised(source, form, evidence)
        near = self.nearest(form, nodes)
        if near is None:
            raise SourceError(source, f"no skeleton mapping for {form} files; {_WAY_OUT}")
        has = (
            f"file has the markers {_listed(list(nodes), 24)}"
            if form == "c3d"
            else f"skeleton has {_listed(list(nodes))}"
        )
        more = f"the {has}{self._several(form, nodes)}{self.stripped(form, nodes)}; {_WAY_OUT}"
        if not near.known:
            raise SourceError(source, f"no skeleton mapping fits; none is near: none knows any of its names; {more}")
        lacks = _listed([f"{node} (for {what})" for what, node in near.missing.items()])
        raise SourceError(
            source,
            f"no skeleton mapping fits; the nearest, {near.called}, finds "
            f"{len(near.joints) - len(near.unknown)} joints and lacks {lacks}; {more}",
        )

    def without_prefix(self, form: Format, nodes: Mapping[str, int]) -> tuple[str, SkeletonMapping] | None:
        """Return a prefix that most names share and a mapping that fits without it; None if there is no such pair."""
        for prefix in _prefixes(list(nodes)):
            short = {name.removeprefix(prefix): index for name, index in nodes.items()}
            fits = [mapping.fit(short) for mapping in self.of(form)]
            whole = [fit for fit in fits if not fit.missing]
            if whole and len(short) == len(nodes):
                return prefix, max(whole, key=lambda fit: fit.named).mapping
        return None

    def stripped(self, form: Format, nodes: Mapping[str, int]) -> str:
        """Return a clause for messages about names that a mapping would fit without their prefix."""
        found = self.without_prefix(form, nodes)
        if found is None:
            return ""
        prefix, mapping = found
        return f"; without '{prefix}' its names fit '{mapping.name}': copy {mapping.path}, with {stripping(*found)}"

    def _several(self, form: Format, nodes: Iterable[str]) -> str:
        """Return a clause for messages about a file of several figures whose joints differ only by a prefix."""
        found = [mapping.shared(nodes) for mapping in self.of(form)]
        most = max(found, key=len, default={})
        if not most:
            return ""
        name, whole = next(iter(most.items()))
        differ = f"names that differ by their prefix only, as {' and '.join(whole[:2])} ({name})"
        return f"; of {differ}, none is taken: write one figure a file"

    def names_in_order(self, source: str | Path, count: int) -> tuple[str, tuple[str, ...]]:
        """Return the name of the mapping whose `order` has as many points as a file without names, and this order.

        Mappings of the user take precedence over shipped ones.

        Raises
        ------
        SourceError
            If no mapping has as many, or several of the same precedence have and give them different names.
        """
        orders = {mapping.order: mapping.name for mapping in self.of("positions")[::-1] if mapping.order}
        own = {mapping.order for mapping in self.own.get("positions", ())}
        fitting = [order for order in orders if len(order) == count]
        fitting = [order for order in fitting if order in own] or fitting
        if len(fitting) == 1:
            return orders[fitting[0]], fitting[0]
        known = ", ".join(str(number) for number in sorted({len(order) for order in orders})) or "none"
        raise SourceError(
            source,
            f"does not name its {count} joints, and {'no' if not fitting else 'more than one'} mapping has as many in "
            f"its `order` (there are: {known}); give one of your own by `skeletons`, or add an array `names`",
        )

    def nearest(self, form: Format, nodes: Mapping[str, int]) -> Fit | None:
        """Return the fit that finds the most joints in a skeleton, knows the most of its nodes, and lacks the fewest.

        If no mapping knows any node, the names without a common prefix are tried. The result is None for a format
        without mappings.
        """
        near = self._nearest(form, nodes)
        for prefix in _prefixes(list(nodes)) if near is not None and not near.known else ():
            other = self._nearest(form, {name.removeprefix(prefix): index for name, index in nodes.items()})
            if other is not None and other.known:
                return replace(other, prefix=prefix)
        return near

    def _nearest(self, form: Format, nodes: Mapping[str, int]) -> Fit | None:
        fits = [mapping.fit(nodes) for mapping in self.of(form) if self._may_fit(mapping, "", nodes)]
        return min(fits, key=lambda fit: (-fit.named, -fit.known, len(fit.missing) + len(fit.unknown)), default=None)


def _best(source: str | Path, fits: Sequence[Fit]) -> Fit | None:
    """Return the fit that lacks no node and supplies the most joints; None if each lacks a node.

    Raises
    ------
    SourceError
        Two fit equally well.
    """
    whole = [fit for fit in fits if not fit.missing and fit.named]  # one without joints would fit every file
    best = [fit for fit in whole if fit.named == max(other.named for other in whole)]
    if len(best) > 1:
        names = ", ".join(f"'{fit.mapping.name}'" for fit in best)
        raise SourceError(source, f"mappings {names} fit this skeleton equally well; give one by `skeleton`")
    return best[0] if best else None


def stripping(prefix: str, mapping: SkeletonMapping) -> str:
    """Return the `strip_prefix` line to add to a copy of a mapping so that it ignores a prefix."""
    pattern = re.escape(prefix) + (f"(?:{mapping.strip_prefix})?" if mapping.strip_prefix is not None else "")
    return f"`strip_prefix: '{pattern}'`"


def _prefixes(names: Sequence[str]) -> list[str]:
    """Return the beginning that all names share, and those of over half of them that end with a mark such as _ or :."""
    marks = Counter(
        name[: mark.end()] for name in names for mark in re.finditer(r"[^A-Za-z0-9]", name[:LONGEST_PREFIX])
    )
    usual = [prefix for prefix, count in marks.most_common() if 2 * count > len(names)]
    first, last = min(names, default=""), max(names, default="")
    same = next((i for i, pair in enumerate(zip(first, last, strict=False)) if pair[0] != pair[1]), len(first))
    return [prefix for prefix in dict.fromkeys([first[:same], *usual]) if prefix]


def _listed(names: Sequence[str], most: int = 6) -> str:
    shown = ", ".join(names[:most])
    return f"{shown} and {len(names) - most} more" if len(names) > most else shown


def load_mappings(choice: str | Path, joints: tuple[str, ...]) -> Mappings:
    """Load the mappings for an archive: all shipped ones (`auto`), or one by name or path for files of its format.

    Raises
    ------
    ConfigError
        If there is no such mapping, or its file is invalid; the message names the line.
    """
    chosen = None if choice == "auto" else load_skeleton(choice, joints)
    of_format: dict[Format, tuple[SkeletonMapping, ...]] = {}
    for name in config_names("skeletons"):
        mapping = load_skeleton(name, joints)
        if chosen is None or mapping.format != chosen.format:
            of_format[mapping.format] = (*of_format.get(mapping.format, ()), mapping)
    if chosen is not None:
        of_format[chosen.format] = (chosen,)
    return Mappings(of_format, forced=() if chosen is None else (chosen.format,))


def load_skeleton(name_or_path: str | Path, joints: tuple[str, ...]) -> SkeletonMapping:
    """Read a mapping from `configs/skeletons/` or from a user's file.

    Parameters
    ----------
    joints : tuple of str
        The named joints of the feature set; a mapping must define each of them, or set it to `null`.

    Raises
    ------
    ConfigError
        At the first fault, with its file, line and key.
    """
    path = config_path("skeletons", name_or_path)
    stat = path.stat()
    return _load_skeleton(path, (stat.st_size, stat.st_mtime_ns), joints)


@lru_cache(maxsize=64)
def _load_skeleton(path: Path, _stamp: tuple[int, int], joints: tuple[str, ...]) -> SkeletonMapping:
    return parse_skeleton(load_yaml(path), joints)


def parse_skeleton(located: Located, joints: tuple[str, ...]) -> SkeletonMapping:
    """Return the mapping of a parsed file; parameters and errors as for `load_skeleton`."""
    located.mapping()
    parsed = located.model(_SkeletonFile)
    for joint in parsed.joints:
        if joint not in joints:
            raise located.error(f"no joint of that name{did_you_mean(joint, joints)}", "joints", joint)
    missing = [joint for joint in joints if joint not in parsed.joints]
    if missing:
        raise located.error(
            f"joint '{missing[0]}' is missing; write `{missing[0]}: null` if the skeleton has none", "joints"
        )
    unit_m = parsed.unit_m
    number = isinstance(unit_m, (int, float)) and not isinstance(unit_m, bool)
    if unit_m != "guess" and not (number and 0 < unit_m <= sys.float_info.max):
        raise located.error(f"must be a positive number of metres, or guess; got {unit_m!r}", "unit_m")
    if parsed.format == "acclaim" and parsed.unit_m == "guess":
        raise located.error("an ASF file states its unit; give the metres of one inch, 0.0254", "unit_m")
    for key, formats in _ONLY.items():
        if getattr(parsed, key) and parsed.format not in formats:
            raise located.error(f"means nothing for format {parsed.format}", key)
    for key in ("strip_prefix", "only"):
        try:
            re.compile(getattr(parsed, key) or "")
        except re.error as fault:
            raise located.error(f"is no regular expression: {fault}", key) from None
    _check_estimated(located, parsed)
    axes = _axes(located, parsed.up, parsed.facing, parsed.handedness, "facing")
    own = parsed.root_axes
    choices = {joint: _choices(located, parsed, joint) for joint in parsed.joints}
    return SkeletonMapping(
        name=parsed.name,
        path=located.path,
        digest=_digest(parsed),
        format=parsed.format,
        unit_m=None if unit_m == "guess" else float(unit_m),
        axes=axes,
        root_axes=_axes(located, own.up, own.facing, parsed.handedness, "root_axes") if own else axes,
        strip_prefix=parsed.strip_prefix,
        only=parsed.only,
        bones=parsed.bones,
        joints=choices,
        order=tuple(parsed.order),
        aliases={name: tuple(others) for name, others in parsed.aliases.items()},
        screen=parsed.format == "c3d" and parsed.screen is not False,
        limbs=limb_sources(located, parsed.limbs, parsed.format, joints),
        estimated=parsed.estimated,
        rough=tuple(parsed.rough),
    )


def _digest(parsed: _SkeletonFile) -> str:
    """Return a hash of the parts of a mapping on which takes depend."""
    # no take depends on `limbs`; keys that came later count only where they are given, so that takes are not read again
    unused = {"limbs", *(key for key in ("estimated", "rough") if not getattr(parsed, key))}
    return hashlib.sha256(json.dumps(parsed.model_dump(exclude=unused), sort_keys=True).encode()).hexdigest()[:16]


def _check_estimated(located: Located, parsed: _SkeletonFile) -> None:
    """Raise a ConfigError if the mapping lacks a joint of `estimated`, or if a joint of `rough` is not estimated."""
    for joint in parsed.estimated:
        if parsed.joints.get(joint) is None:
            raise located.error("no joint of that name is made by this mapping", "estimated", joint)
    for number, joint in enumerate(parsed.rough):
        if joint not in parsed.estimated:
            raise located.error(f"'{joint}' is not among the joints of `estimated`", "rough", number)


def _choices(located: Located, parsed: _SkeletonFile, joint: str) -> tuple[Mix | None, ...]:
    value = parsed.joints[joint]
    if value == []:
        raise located.error("expected at least one choice in the list", "joints", joint)
    return tuple(_mix(located, parsed, joint, part) for part in (value if isinstance(value, list) else [value]))


def _mix(located: Located, parsed: _SkeletonFile, joint: str, value: object) -> Mix | None:
    if value is None or isinstance(value, str):
        return None if value is None else Mix(((value, 1.0),))
    if not isinstance(value, dict):
        raise located.error(f"expected a node, nodes, virtual, null or a list of these; got {value!r}", "joints", joint)
    mix = located.model(_Mix, "joints", joint, data=value)
    weights = mix.virtual or mix.nodes or {}
    above = list(parsed.joints)[: list(parsed.joints).index(joint)]
    direct = [
        name for name, what in parsed.joints.items() if what is not None and (name in above or not _has_virtual(what))
    ]
    for other in mix.virtual or ():
        if other not in direct:
            raise located.error(
                f"a virtual joint is made of joints that the skeleton has, or virtual ones above it; '{other}' is none"
                f"{did_you_mean(other, direct)}",
                "joints", joint,
            )  # fmt: skip
    if mix.virtual is None:
        return _of_nodes(located, joint, mix)
    _check_weights(located, joint, weights)
    return Mix(tuple(weights.items()), of_joints=True)


def _of_nodes(located: Located, joint: str, mix: _Mix) -> Mix:
    """Return a combination of nodes; the corners of its plane may be such combinations, too."""
    if mix.nodes is None:
        raise located.error("a plane goes through nodes or `nodes`, not through `virtual` joints", "joints", joint)
    _check_weights(located, joint, mix.nodes)
    weights = tuple(mix.nodes.items())
    if mix.aside is None:
        return Mix(weights)
    if mix.aside.kind == "chord" and not -1.0 < mix.aside.times < 1.0:
        raise located.error(f"a chord's `times` must lie between -1 and 1, got {mix.aside.times:g}", "joints", joint)
    plane = tuple(part if isinstance(part, str) else _of_nodes(located, joint, part) for part in mix.aside.plane)
    return KINDS[mix.aside.kind](weights, plane=plane, out=mix.aside.times)


def _check_weights(located: Located, joint: str, weights: Mapping[str, float]) -> None:
    if abs(sum(weights.values()) - 1.0) > 1e-9:
        raise located.error(f"the weights must add up to 1, got {sum(weights.values()):g}", "joints", joint)


def _has_virtual(what: object) -> bool:
    return any(isinstance(part, dict) and "virtual" in part for part in (what if isinstance(what, list) else [what]))


def _axes(located: Located, up: Axis, facing: Axis, handedness: str, key: str) -> F64:
    """Return the matrix (3, 3) that takes a mapping's up axis to +Y and its facing axis to +Z.

    It is a rotation for right-handed axes, and includes a reflection for left-handed ones.
    """
    if up[-1] == facing[-1]:
        raise located.error("up and facing must be different axes", key)
    upward, forward = (np.eye(3)["xyz".index(axis[-1])] * (-1.0 if axis[0] == "-" else 1.0) for axis in (up, facing))
    side = np.cross(upward, forward) * (1.0 if handedness == "right" else -1.0)
    return np.stack([side, upward, forward])


@dataclass
class MappingRequest:
    """The body for which a reader last requested a mapping.

    Attributes
    ----------
    form : str, optional
        The format; None if the reader requested nothing.
    nodes : dict of str to int
        Node name → index.
    evidence : Evidence, optional
        Tree and places of the nodes.
    fit : Fit, optional
        The answer; None if no body was recognised.
    """

    form: Format | None = None
    nodes: dict[str, int] = field(default_factory=dict)
    evidence: Evidence | None = None
    fit: Fit | None = None


@dataclass(frozen=True)
class WatchedMappings(Mappings):
    """Mappings that record the last request of a reader, and their answer."""

    question: MappingRequest = field(default_factory=MappingRequest)

    @classmethod
    def of_mappings(cls, mappings: Mappings) -> WatchedMappings:
        """Return mappings that behave like the given mappings."""
        return cls(**{one.name: getattr(mappings, one.name) for one in fields(Mappings)})

    def exact(self, source: str | Path, form: Format, nodes: Mapping[str, int]) -> Fit | None:
        """Record the nodes, and return the fit of the mapping whose nodes all occur among them; None for no mapping."""
        self.question.form, self.question.nodes, self.question.fit = form, dict(nodes), None
        self.question.fit = super().exact(source, form, nodes)
        return self.question.fit

    def detect(
        self, source: str | Path, form: Format, nodes: Mapping[str, int], evidence: Evidence | None = None
    ) -> Fit:
        """Record the evidence, and return the fit of the mapping whose nodes all occur in a skeleton, as `Mappings`."""
        self.question.evidence = evidence
        return super().detect(source, form, nodes, evidence)

    def recognised(self, source: str | Path, form: Format, evidence: Evidence) -> Fit:
        """Record the evidence, and return the fit that recognition makes."""
        self.question.form, self.question.evidence = form, evidence
        self.question.fit = super().recognised(source, form, evidence)
        return self.question.fit


@dataclass(frozen=True)
class OwnFile:
    """A file with a mapping or a vocabulary that a user wrote.

    Attributes
    ----------
    path : Path
        The file, which errors name.
    text : str
        Its content.
    stored : bool
        True if a store holds it; a file of the same name that the user gives overrides it.
    """

    path: Path
    text: str
    stored: bool = False


def own_files(positions: Iterable[str | Path]) -> tuple[OwnFile, ...]:
    """Read files with mappings or vocabularies that a user wrote.

    Parameters
    ----------
    positions : iterable of path
        YAML files, and folders whose YAML files are all read.

    Raises
    ------
    ConfigError
        There is no such file or folder, or a folder holds no YAML file.
    """
    found: list[Path] = []
    for place in (Path(one).expanduser() for one in positions):
        if place.is_dir():
            inside = sorted(path for path in place.iterdir() if path.suffix.lower() in ENDINGS)
            if not inside:
                raise ConfigError(place, "the folder holds no .yaml file; expected skeleton mappings")
            found += inside
        elif place.is_file():
            found.append(place)
        else:
            raise ConfigError(place, "no such file or folder; expected a skeleton mapping, or a folder of them")
    return tuple(OwnFile(path, read_text(path)) for path in dict.fromkeys(found))


def with_own(mappings: Mappings, files: Iterable[OwnFile], joints: tuple[str, ...]) -> Mappings:
    """Add mappings and vocabularies that a user wrote to the mappings of an archive.

    Parameters
    ----------
    mappings : Mappings
        The mappings of an archive, by `load_mappings`.
    files : iterable of OwnFile
        Mappings, which are preferred to all others if their names fit, and vocabularies, whose names are added to the
        shipped ones.
    joints : tuple of str
        The named joints of the feature set.

    Raises
    ------
    ConfigError
        A file is neither, or is invalid, or two of the files have the same name.
    """
    own: dict[Format, tuple[SkeletonMapping, ...]] = {}
    vocabularies: list[Vocabulary] = []
    labels: list[Located] = []
    digests: list[str] = []
    names: dict[str, Path] = {}
    for file in sorted(files, key=lambda one: one.stored):
        found = parse_own(file, joints)
        if found.name in names:
            if file.stored:
                continue
            taken = names[found.name]
            raise ConfigError(file.path, f"{taken} has the name '{found.name}', too; rename one", key="name")
        names[found.name] = file.path
        if not isinstance(found.content, SkeletonMapping):
            vocabularies += [found.content] if isinstance(found.content, Vocabulary) else []
            labels += [found.content] if isinstance(found.content, Located) else []
            digests.append(hashlib.sha256(file.text.encode()).hexdigest()[:16])
        elif found.content.format not in mappings.forced:
            own[found.content.format] = (*own.get(found.content.format, ()), found.content)
    vocabulary = load_vocabulary("joints").merged(vocabularies) if vocabularies else None
    landmarks = landmarks_with(labels) if labels else None
    return replace(mappings, own=own, vocabulary=vocabulary, landmarks=landmarks, vocabulary_digest=" ".join(digests))


@dataclass(frozen=True)
class Own:
    """A mapping or vocabulary that a user wrote, parsed.

    Attributes
    ----------
    name : str
        Its name.
    content : SkeletonMapping, Vocabulary or Located
        Its content; labels of landmarks stay parsed YAML.
    """

    name: str
    content: SkeletonMapping | Vocabulary | Located


def parse_own(file: OwnFile, joints: tuple[str, ...]) -> Own:
    """Parse a mapping or vocabulary that a user wrote.

    Parameters
    ----------
    file : OwnFile
        The file.
    joints : tuple of str
        The named joints of the feature set.

    Raises
    ------
    ConfigError
        The file is neither a mapping nor a vocabulary of names or labels, or it is invalid.
    """
    located = parse_yaml(file.text, file.path)
    keys = located.mapping()
    if "terms" in keys:
        vocabulary = parse_vocabulary(located, tuple(load_vocabulary("joints").terms))
        return Own(str(keys.get("name") or file.path.stem), vocabulary)
    if {"skin", "centres"} & keys.keys():
        landmarks_with([located])
        return Own(str(keys.get("name") or file.path.stem), located)
    if "joints" not in keys:
        raise located.error(
            "expected a skeleton mapping (`joints`), names of nodes (`terms`) or labels of markers (`skin`, `centres`)"
        )
    mapping = parse_skeleton(located, joints)
    return Own(mapping.name, mapping)
