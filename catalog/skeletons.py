"""Skeleton mappings: how the joints of a source's skeleton become the named joints that features speak of."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, model_validator

from catalog.configs import Located, config_names, config_path, load_yaml
from ops.errors import SourceError, did_you_mean

F64 = npt.NDArray[np.float64]
Format: TypeAlias = Literal["acclaim", "bvh", "positions"]
Axis: TypeAlias = Literal["x", "y", "z", "-x", "-y", "-z"]


class _Mix(BaseModel):
    model_config = ConfigDict(extra="forbid")
    virtual: dict[str, float] | None = Field(None, min_length=1)
    nodes: dict[str, float] | None = Field(None, min_length=1)

    @model_validator(mode="after")
    def _one(self) -> _Mix:
        if (self.virtual is None) == (self.nodes is None):
            raise ValueError("expected `virtual` (weights over named joints) or `nodes` (weights over nodes)")
        return self


class _Root(BaseModel):
    model_config = ConfigDict(extra="forbid")
    up: Axis
    facing: Axis


class _SkeletonFile(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str
    description: str = ""
    format: Format
    up: Axis = "y"
    handedness: Literal["right", "left"] = "right"
    facing: Axis = "z"
    root_axes: _Root | None = None
    unit_m: Any  # a number of metres or `guess`; pydantic's messages about either-or are of no use to anybody
    strip_prefix: str | None = None
    bones: dict[str, dict[str, float]] = Field(default_factory=dict)
    order: list[str] = Field(default_factory=list)
    joints: dict[str, Any]  # see `_mix`


@dataclass(frozen=True)
class Mix:
    """A fixed linear combination of nodes of a skeleton, or (`of_joints`) of other named joints."""

    weights: tuple[tuple[str, float], ...]
    of_joints: bool = False

    @property
    def node(self) -> str | None:
        """The node that this is, where it is just one."""
        return self.weights[0][0] if len(self.weights) == 1 and not self.of_joints else None

    def __str__(self) -> str:
        return " ".join(f"{weight:+g} {name}" for name, weight in self.weights)


@dataclass(frozen=True)
class SkeletonMapping:
    """One mapping file.

    joints: named joint → what it may be, the first that a skeleton can supply counts; None: such a skeleton has none.
    unit_m: metres of one unit, None where it is to be guessed. axes: (3, 3), turns source coordinates into X, Y up, Z
    (right-handed). root_axes: (3, 3), the same for the axes of the root node itself.
    bones: node → weights over the offsets of other nodes, which it is given where the file leaves its own at zero.
    order: the points of files that do not name theirs, in order; empty where these cannot be read.
    """

    name: str
    path: Path
    digest: str
    format: Format
    unit_m: float | None
    axes: F64
    root_axes: F64
    strip_prefix: str | None
    bones: dict[str, dict[str, float]]
    joints: dict[str, tuple[Mix | None, ...]]
    order: tuple[str, ...] = ()

    def places(self, nodes: Mapping[str, int]) -> dict[str, int]:
        """Node name → index, by the names that the mapping uses; what a stripped prefix makes ambiguous is left out."""
        if self.strip_prefix is None:
            return dict(nodes)
        short: dict[str, list[int]] = {}
        for name, index in nodes.items():
            found = re.match(self.strip_prefix, name)
            short.setdefault(name[found.end() :] if found else name, []).append(index)
        return {name: indices[0] for name, indices in short.items() if len(indices) == 1} | dict(nodes)

    def fit(self, nodes: Mapping[str, int]) -> Fit:
        """Find the named joints in a skeleton, given as node name → index."""
        places = self.places(nodes)
        found: dict[str, Mix | None] = {}
        missing: dict[str, str] = {}
        # Virtual joints last: what they are made of is never virtual itself.
        for joint in sorted(self.joints, key=lambda joint: any(mix and mix.of_joints for mix in self.joints[joint])):
            for mix in self.joints[joint]:
                there: Mapping[str, object] = found if mix and mix.of_joints else places
                if mix is None or all(there.get(name) is not None for name, _ in mix.weights):
                    found[joint] = mix
                    break
            else:
                names = [name for mix in self.joints[joint] if mix and not mix.of_joints for name, _ in mix.weights]
                missing[f"joint '{joint}'"] = next((name for name in names if name not in places), joint)
        for bone, weights in self.bones.items():
            lacking = [name for name in (bone, *weights) if name not in places]
            if lacking:
                missing[f"bone '{bone}'"] = lacking[0]
        return Fit(self, places, found, missing)

    def apply(self, source: str | Path, nodes: Mapping[str, int], positions: F64, joints: tuple[str, ...]) -> F64:
        """Pick and build the named joints.

        Parameters
        ----------
        source: the file that errors name. nodes: node name → index. positions: float64 (nodes, 3, T).
        joints: the named joints wanted, in order.

        Returns
        -------
        float64 (len(joints), 3, T), Y up; NaN for a joint that the skeleton does not have.

        Raises
        ------
        SourceError: the skeleton lacks a node that the mapping names.
        """
        fit = self.fit(nodes)
        fit.check(source)
        return fit.apply(positions, joints)


@dataclass(frozen=True)
class Fit:
    """A mapping laid over one skeleton.

    places: node name → index, under the names that the mapping uses. joints: named joint → what it is here.
    missing: what the mapping cannot make here (a joint, a bone) → the first node that it would need.
    """

    mapping: SkeletonMapping
    places: dict[str, int]
    joints: dict[str, Mix | None]
    missing: dict[str, str]

    @property
    def named(self) -> int:
        """How many joints the skeleton itself supplies."""
        return sum(mix is not None and not mix.of_joints for mix in self.joints.values())

    @property
    def root(self) -> int:
        """The index of the node whose turns are those of the body: that of joint `root`, else the skeleton's first."""
        mix = self.joints.get("root")
        return self.places[mix.node] if mix is not None and mix.node is not None else 0

    @property
    def nodes(self) -> tuple[int, ...]:
        """The indices of the nodes that the named joints are made of."""
        own = [mix for mix in self.joints.values() if mix is not None and not mix.of_joints]
        return tuple(sorted({self.places[name] for mix in own for name, _ in mix.weights}))

    @property
    def unknown(self) -> tuple[str, ...]:
        """The joints that the skeleton does not have."""
        return tuple(joint for joint, mix in self.joints.items() if mix is None)

    @property
    def virtual(self) -> dict[str, Mix]:
        """The joints that are built from others, and how."""
        return {joint: mix for joint, mix in self.joints.items() if mix is not None and mix.node is None}

    def check(self, source: str | Path) -> None:
        """Raise a SourceError that names `source` and the first node that is missing, if there is one."""
        for what, node in self.missing.items():
            raise SourceError(
                source,
                f"the skeleton has no '{node}', which mapping '{self.mapping.name}' ({self.mapping.path}) takes for "
                f"{what}{did_you_mean(node, self.places)}",
            )

    def apply(self, positions: F64, joints: tuple[str, ...]) -> F64:
        """The named joints (len(joints), 3, T), Y up, from the positions (nodes, 3, T) of the skeleton's nodes."""
        tracks: dict[str, F64] = {}
        frames = positions.shape[2]
        for joint, mix in self.joints.items():  # in the order of `fit`: what a virtual joint needs is there before it
            if mix is None:
                tracks[joint] = np.full((3, frames), np.nan)
            elif mix.node is not None:
                tracks[joint] = positions[self.places[mix.node]]
            else:
                of = tracks if mix.of_joints else {name: positions[self.places[name]] for name, _ in mix.weights}
                with np.errstate(over="ignore", invalid="ignore"):  # faulty numbers become infinite, and are refused
                    tracks[joint] = np.sum([weight * of[name] for name, weight in mix.weights], axis=0)
        result = np.stack([tracks[joint] for joint in joints])
        if not np.array_equal(self.mapping.axes, np.eye(3)):
            result = np.einsum("ab,jbt->jat", self.mapping.axes, result)
        return np.ascontiguousarray(result)


@dataclass(frozen=True)
class Mappings:
    """The mappings that one archive is read with: one chosen by the user, or all that are shipped, by format."""

    of_format: dict[Format, tuple[SkeletonMapping, ...]] = field(default_factory=dict)

    def digest(self, form: Format) -> str:
        """A hash of the mappings of one format, which the takes read with them depend on."""
        return " ".join(mapping.digest for mapping in self.of_format.get(form, ()))

    def detect(self, source: str | Path, form: Format, nodes: Mapping[str, int]) -> Fit:
        """The mapping that fits a skeleton: all its nodes occur there, and it supplies the most joints.

        Where there is only one mapping of the format, it is taken, and what it lacks is an error.

        Raises
        ------
        SourceError: none fits (the message names the nearest and what it lacks), or two fit equally well.
        """
        fits = [mapping.fit(nodes) for mapping in self.of_format.get(form, ())]
        if len(fits) == 1:
            fits[0].check(source)
            return fits[0]
        whole = [fit for fit in fits if not fit.missing]
        best = [fit for fit in whole if fit.named == max(other.named for other in whole)]
        if len(best) == 1:
            return best[0]
        way_out = "give one by `skeleton`, a shipped name or a .yaml file of your own"
        if best:
            names = ", ".join(f"'{fit.mapping.name}'" for fit in best)
            raise SourceError(source, f"mappings {names} fit this skeleton equally well; {way_out}")
        near = self.nearest(form, nodes)
        if near is None:
            raise SourceError(source, f"no skeleton mapping for {form} files; {way_out}")
        raise SourceError(
            source,
            f"no skeleton mapping fits; the nearest, '{near.mapping.name}', finds {len(near.joints)} joints and lacks "
            f"{_listed([f'{node} (for {what})' for what, node in near.missing.items()])}; the skeleton has "
            f"{_listed(list(nodes))}; {way_out}",
        )

    def names_in_order(self, source: str | Path, count: int) -> tuple[str, ...]:
        """The names of the points of a file that does not name them: those of the mapping with as many in its `order`.

        Raises
        ------
        SourceError: no mapping has as many, or several have and give them different names.
        """
        orders = {mapping.order for mapping in self.of_format.get("positions", ()) if mapping.order}
        fitting = [order for order in orders if len(order) == count]
        if len(fitting) == 1:
            return fitting[0]
        known = ", ".join(str(number) for number in sorted({len(order) for order in orders})) or "none"
        raise SourceError(
            source,
            f"does not name its {count} joints, and {'no' if not fitting else 'more than one'} mapping has as many in "
            f"its `order` (there are: {known}); give one of your own by `skeleton`, or add an array `names`",
        )

    def nearest(self, form: Format, nodes: Mapping[str, int]) -> Fit | None:
        """The mapping that lacks the least in a skeleton, and of these the one that finds the most joints."""
        fits = [mapping.fit(nodes) for mapping in self.of_format.get(form, ())]
        return min(fits, key=lambda fit: (len(fit.missing), -fit.named), default=None)


def _listed(names: Sequence[str], most: int = 6) -> str:
    shown = ", ".join(names[:most])
    return f"{shown} and {len(names) - most} more" if len(names) > most else shown


def load_mappings(choice: str | Path, joints: tuple[str, ...]) -> Mappings:
    """The mappings of an archive: `auto`, or one by its name or path, which counts for the files of its format.

    Raises
    ------
    ConfigError: there is no such mapping, or it is wrong.
    """
    chosen = None if choice == "auto" else load_skeleton(choice, joints)
    of_format: dict[Format, tuple[SkeletonMapping, ...]] = {}
    for name in config_names("skeletons"):
        mapping = load_skeleton(name, joints)
        if chosen is None or mapping.format != chosen.format:
            of_format[mapping.format] = (*of_format.get(mapping.format, ()), mapping)
    if chosen is not None:
        of_format[chosen.format] = (chosen,)
    return Mappings(of_format)


def load_skeleton(name_or_path: str | Path, joints: tuple[str, ...]) -> SkeletonMapping:
    """Read a mapping from `configs/skeletons/` or from a file of the user's own.

    Parameters
    ----------
    joints: the named joints of the feature set; a mapping must say of each what it is, or `null`.

    Raises
    ------
    ConfigError: file, line and key of the first fault.
    """
    located = load_yaml(config_path("skeletons", name_or_path))
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
    if unit_m != "guess" and not (number and 0 < unit_m < np.inf):
        raise located.error(f"must be a positive number of metres, or guess; got {unit_m!r}", "unit_m")
    if parsed.format == "acclaim" and parsed.unit_m == "guess":
        raise located.error("an ASF file states its unit; give the metres of one inch, 0.0254", "unit_m")
    for key in ("bones", "root_axes") if parsed.format == "positions" else ("order",):
        if getattr(parsed, key):
            raise located.error(f"means nothing for format {parsed.format}", key)
    if parsed.strip_prefix is not None:
        try:
            re.compile(parsed.strip_prefix)
        except re.error as fault:
            raise located.error(f"is no regular expression: {fault}", "strip_prefix") from None
    axes = _axes(located, parsed.up, parsed.facing, parsed.handedness, "facing")
    own = parsed.root_axes
    return SkeletonMapping(
        name=parsed.name,
        path=located.path,
        digest=hashlib.sha256(json.dumps(parsed.model_dump(), sort_keys=True).encode()).hexdigest()[:16],
        format=parsed.format,
        unit_m=None if unit_m == "guess" else float(unit_m),
        axes=axes,
        root_axes=_axes(located, own.up, own.facing, parsed.handedness, "root_axes") if own else axes,
        strip_prefix=parsed.strip_prefix,
        bones=parsed.bones,
        joints={joint: _choices(located, parsed, joint) for joint in parsed.joints},
        order=tuple(parsed.order),
    )


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
    direct = [name for name, what in parsed.joints.items() if what is not None and not _has_virtual(what)]
    for other in mix.virtual or ():
        if other not in direct:
            raise located.error(
                f"a virtual joint is made of joints that the skeleton has; '{other}' is none"
                f"{did_you_mean(other, direct)}",
                "joints", joint,
            )  # fmt: skip
    if abs(sum(weights.values()) - 1.0) > 1e-9:
        raise located.error(f"the weights must add up to 1, got {sum(weights.values()):g}", "joints", joint)
    return Mix(tuple(weights.items()), of_joints=mix.virtual is not None)


def _has_virtual(what: object) -> bool:
    return any(isinstance(part, dict) and "virtual" in part for part in (what if isinstance(what, list) else [what]))


def _axes(located: Located, up: Axis, facing: Axis, handedness: str, key: str) -> F64:
    """The turn that takes a mapping's axes to ours: its up to +Y, its facing to +Z."""
    if up[-1] == facing[-1]:
        raise located.error("up and facing must be different axes", key)
    upward, forward = (np.eye(3)["xyz".index(axis[-1])] * (-1.0 if axis[0] == "-" else 1.0) for axis in (up, facing))
    side = np.cross(upward, forward) * (1.0 if handedness == "right" else -1.0)
    return np.stack([side, upward, forward])
