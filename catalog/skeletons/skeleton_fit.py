"""A skeleton mapping, and its fit to the nodes, points or markers of one source.

A mapping may name the sources of the orientations of limbs: nodes that turn with them, or markers.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from kinedex.catalog.configs import Located
from kinedex.catalog.limbs import LIMB_NAMES, LIMBS
from kinedex.ops.arrays import F64
from kinedex.ops.errors import SourceError, did_you_mean

_OF_NODES = ("acclaim", "bvh", "amass")


SEEN = ("positions", "c3d")
"""Formats whose nodes may be missing in some frames."""

_ALIKE = 0.75  # High, because joint names are short: `root` and `Foot_R` already have a similarity of 0.6.

Format: TypeAlias = Literal["acclaim", "bvh", "positions", "c3d", "amass"]
Axis: TypeAlias = Literal["x", "y", "z", "-x", "-y", "-z"]


@dataclass(frozen=True)
class LimbSource:
    """The source of a limb's orientation.

    Attributes
    ----------
    node : str or None
        The node that turns with the limb.
    markers : tuple of str
        The markers on the limb, three or more, or none.
    axis : tuple of str
        The named joints from which and to which its long axis runs; empty for those of the limb.
    """

    node: str | None = None
    markers: tuple[str, ...] = ()
    axis: tuple[str, ...] = ()

    def ends(self, limb: str) -> tuple[str, str]:
        """Return the near and the far joint of the limb's long axis."""
        if self.axis:
            return self.axis[0], self.axis[1]
        return LIMBS[limb].near, LIMBS[limb].far


class LimbEntry(BaseModel):
    """An entry of `limbs` in a mapping file."""

    model_config = ConfigDict(extra="forbid")
    node: str | None = None
    markers: list[str] | None = Field(None, min_length=3)
    axis: list[str] | None = Field(None, min_length=2, max_length=2)

    @model_validator(mode="after")
    def _one(self) -> LimbEntry:
        if self.node is not None and self.markers is not None:
            raise ValueError("expected `node` or `markers`, not both")
        if self.node is None and self.markers is None and self.axis is None:
            raise ValueError("expected `node` (a node that turns with the limb), `markers` (three or more), or `axis`")
        return self


def limb_sources(
    located: Located, entries: Mapping[str, LimbEntry], form: str, joints: Sequence[str]
) -> dict[str, LimbSource]:
    """Return the sources that a mapping file names for limbs.

    Parameters
    ----------
    located : Located
        The mapping file.
    entries : mapping of str to LimbEntry
        Its `limbs`.
    form : str
        Its format.
    joints : sequence of str
        The named joints.

    Raises
    ------
    ConfigError
        There is no such limb or joint, or the format has no nodes that turn, or no markers.
    """
    found = {}
    for limb, entry in entries.items():
        if limb not in LIMBS:
            raise located.error(
                f"no limb of that name{did_you_mean(limb, LIMB_NAMES)}; the limbs are {', '.join(LIMB_NAMES)}",
                "limbs", limb,
            )  # fmt: skip
        if entry.node is not None and form not in _OF_NODES:
            raise located.error(f"points of format {form} do not turn; give `markers`", "limbs", limb, "node")
        if entry.markers is not None and form in _OF_NODES:
            raise located.error(f"format {form} has no markers; give `node`", "limbs", limb, "markers")
        twice = [name for name in entry.markers or () if (entry.markers or []).count(name) > 1]
        if twice:
            raise located.error(f"'{twice[0]}' is listed twice", "limbs", limb, "markers")
        for joint in entry.axis or ():
            if joint not in joints:
                raise located.error(f"no joint is named '{joint}'{did_you_mean(joint, joints)}", "limbs", limb, "axis")
        if entry.axis and entry.axis[0] == entry.axis[1]:
            raise located.error("the axis must run between two joints", "limbs", limb, "axis")
        found[limb] = LimbSource(entry.node, tuple(entry.markers or ()), tuple(entry.axis or ()))
    return found


@dataclass(frozen=True)
class Mix:
    """A fixed linear combination of nodes of a skeleton, or (`of_joints`) of other named joints.

    Attributes
    ----------
    plane, out : tuple of str or Mix, float
        Nodes a, b, c, or combinations of nodes, and the offset of the joint along (b − a) × (c − a), the normal of
        their plane, in units of |b − a|, for joints that lie beneath the markers on the skin.
    """

    weights: tuple[tuple[str, float], ...]
    of_joints: bool = False
    plane: tuple[str | Mix, ...] = ()
    out: float = 0.0

    @cached_property
    def node(self) -> str | None:
        """Return the node, if the combination has only one; else None."""
        return self.weights[0][0] if len(self.weights) == 1 and not self.of_joints and not self.plane else None

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Return all nodes (or joints) of the combination."""
        corners = [name for part in self.plane for name in ((part,) if isinstance(part, str) else part.names)]
        return tuple(dict.fromkeys([*(name for name, _ in self.weights), *corners]))

    def __str__(self) -> str:
        mixed = " ".join(f"{weight:+g} {name}" for name, weight in self.weights)
        return f"{mixed} {self.out:+g} aside of {'-'.join(map(str, self.plane))}" if self.plane else mixed

    def apply(self, positions: Mapping[str, F64], hand: float) -> F64:
        """Compute the position (3, T) from those of the nodes; `hand` is 1 for right-handed axes, else −1."""
        with np.errstate(over="ignore", invalid="ignore"):  # Invalid numbers become infinite and are refused later.
            mixed: F64 = np.sum([weight * positions[name] for name, weight in self.weights], axis=0)
            if self.plane:
                a, b, c = (
                    positions[part] if isinstance(part, str) else part.apply(positions, hand) for part in self.plane
                )
                mixed = mixed + self._offset(b - a, c - a, hand)
        return mixed

    def _offset(self, first: F64, second: F64, hand: float) -> F64:
        """Return the offset (3, T) of the point, from the vectors b − a and c − a, (3, T) each."""
        normal = np.cross(first, second, axis=0)
        far = np.linalg.norm(first, axis=0) / np.maximum(np.linalg.norm(normal, axis=0), np.finfo(float).tiny)
        return np.asarray(hand * self.out * far * normal)


@dataclass(frozen=True)
class Chord(Mix):
    """A combination whose point p lies in the plane of a, b and c, off a, where p − a and p − b are perpendicular.

    The point lies on the other side of the line from a to b than c does. So a knee lies between its outer marker a, the
    hip b and a marker c on the thigh, and an ankle likewise (R. Davis et al., Human Movement Science 10 (1991),
    575-587). `out` is the distance from a in units of |b − a|.
    """

    def _offset(self, first: F64, second: F64, hand: float) -> F64:
        square = np.maximum((first * first).sum(axis=0), np.finfo(float).tiny)
        across = second - (first * second).sum(axis=0) / square * first
        far = np.sqrt(square) / np.maximum(np.linalg.norm(across, axis=0), np.finfo(float).tiny)
        return np.asarray(self.out**2 * first - self.out * np.sqrt(1.0 - self.out**2) * far * across)


_BENT = (0.1, 0.2)  # sines of the angle at a; below the first, the axis of a hinge is not determined


@dataclass(frozen=True)
class Hinge(Mix):
    """A combination whose offset is along the axis of a hinge at a, the normal of the plane of a, b and c.

    In a limb that is almost straight the normal is not determined, so that the offset decreases to 0.
    """

    def _offset(self, first: F64, second: F64, hand: float) -> F64:
        normal = np.cross(first, second, axis=0)
        lengths = np.linalg.norm(first, axis=0) * np.linalg.norm(second, axis=0)
        sine = np.linalg.norm(normal, axis=0) / np.maximum(lengths, np.finfo(float).tiny)
        bent = np.where(np.isnan(sine), np.nan, np.clip((sine - _BENT[0]) / (_BENT[1] - _BENT[0]), 0.0, 1.0))
        return np.asarray(bent * super()._offset(first, second, hand))


KINDS: dict[str, type[Mix]] = {"normal": Mix, "chord": Chord, "hinge": Hinge}
"""The kinds of offsets in YAML."""

_KEPT_FITS: dict[tuple[int, tuple[tuple[str, int], ...]], Fit] = {}
"""Fits by the identity of their mapping, which they keep alive, and the nodes."""

_MAX_KEPT = 64


@dataclass(frozen=True)
class SkeletonMapping:
    """The content of a mapping file.

    Attributes
    ----------
    joints : dict[str, tuple[Mix or None, ...]]
        The alternatives for each named joint; the first that a skeleton supplies, or that is visible in a frame,
        is used; None if such skeletons lack the joint.
    unit_m : float or None
        Metres of one unit; None to guess it.
    axes : float64 array
        Shape (3, 3); rotates source coordinates into X, Y up, Z (right-handed).
    root_axes : float64 array
        Shape (3, 3); the same for the axes of the root node itself.
    bones : dict[str, dict[str, float]]
        Weights over the offsets of other nodes that replace a node's own offset where the file has zero.
    order : tuple of str
        The names of the points of files without names, in order; empty if such files cannot be read.
    aliases : Mapping[str, tuple of str]
        Other names of a node; the first that occurs is used.
    screen : bool
        If True, the vertical axis that a file states replaces the mapping's own.
    only : str, optional
        Regular expression that a file's name or the name of a node must contain for the mapping to be detected.
    limbs : Mapping[str, LimbSource]
        Nodes, markers and axes of limbs where these do not follow from the joints.
    estimated, rough : Mapping[str, str], tuple of str
        As in `Fit`, as the mapping file states them.
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
    screen: bool = False
    aliases: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    only: str | None = None
    limbs: Mapping[str, LimbSource] = field(default_factory=dict)
    estimated: Mapping[str, str] = field(default_factory=dict)
    rough: tuple[str, ...] = ()

    def is_for(self, source: str | Path, nodes: Iterable[str]) -> bool:
        """Return True if `only` is None, or if it matches the file's name or a node's, so that detection may use it."""
        return self.only is None or any(re.search(self.only, name) for name in (Path(source).name, *nodes))

    def indices(self, nodes: Mapping[str, int]) -> dict[str, int]:
        """Return the index of each node by the name that the mapping uses, excluding names that become ambiguous."""
        short = self._short(nodes)
        positions = {name: nodes[whole[0]] for name, whole in short.items() if len(whole) == 1} | dict(nodes)
        for name, others in self.aliases.items():
            there = next((positions[other] for other in others if other in positions), None)
            if there is not None:
                positions.setdefault(name, there)
        return positions

    def shared(self, nodes: Iterable[str]) -> dict[str, list[str]]:
        """Return the names that become ambiguous without their prefix, each with its nodes."""
        return {name: whole for name, whole in self._short(nodes).items() if len(whole) > 1}

    def _short(self, nodes: Iterable[str]) -> dict[str, list[str]]:
        """Return the node names without their prefix, each with its nodes."""
        short: dict[str, list[str]] = {}
        for name in nodes if self.strip_prefix is not None else ():
            found = re.match(self.strip_prefix or "", name)
            short.setdefault(name[found.end() :] if found else name, []).append(name)
        return short

    def fit(self, nodes: Mapping[str, int]) -> Fit:
        """Find the named joints in a skeleton, given as a dict from node name to index.

        The last fits are cached, because most files of an archive have the same nodes.
        """
        key = (id(self), tuple(nodes.items()))
        kept = _KEPT_FITS.get(key)
        if kept is None:
            if len(_KEPT_FITS) >= _MAX_KEPT:
                _KEPT_FITS.clear()
            kept = _KEPT_FITS[key] = self._fit(nodes)
        return kept

    def _fit(self, nodes: Mapping[str, int]) -> Fit:
        positions = self.indices(nodes)
        found: dict[str, Mix | None] = {}
        instead: dict[str, tuple[Mix, ...]] = {}
        missing: dict[str, str] = {}
        # Virtual joints come last; their parts are never virtual themselves.
        for joint in sorted(self.joints, key=lambda joint: any(mix and mix.of_joints for mix in self.joints[joint])):
            usable = []
            for mix in self.joints[joint]:
                there: Mapping[str, object] = found if mix and mix.of_joints else positions
                if mix is None or all(there.get(name) is not None for name in mix.names):
                    usable.append(mix)
            if usable:
                found[joint] = usable[0]
                if self.format in SEEN and None not in usable and len(usable) > 1:
                    instead[joint] = tuple(mix for mix in usable[1:] if mix is not None)
            else:
                names = [name for mix in self.joints[joint] if mix and not mix.of_joints for name in mix.names]
                missing[f"joint '{joint}'"] = next((name for name in names if name not in positions), joint)
        for bone, weights in self.bones.items():
            lacking = [name for name in (bone, *weights) if name not in positions]
            if lacking:
                missing[f"bone '{bone}'"] = lacking[0]
        estimated = {joint: how for joint, how in self.estimated.items() if found.get(joint) is not None}
        rough = tuple(joint for joint in self.rough if joint in estimated)
        return Fit(self, positions, found, missing, instead, estimated=estimated, rough=rough)

    def apply(self, source: str | Path, nodes: Mapping[str, int], positions: F64, joints: tuple[str, ...]) -> F64:
        """Compute the positions of the named joints from the positions of the nodes.

        Parameters
        ----------
        source : path
            The file that errors name.
        nodes : Mapping[str, int]
            Node name → index.
        positions : float64 array (nodes, 3, T)
            The positions of the nodes, in the file's axes.
        joints : tuple of str
            The named joints wanted, in order.

        Returns
        -------
        float64 array (len(joints), 3, T)
            Y up; NaN for a joint that the skeleton does not have.

        Raises
        ------
        SourceError
            If the skeleton lacks a node that the mapping names.
        """
        fit = self.fit(nodes)
        fit.check(source)
        return fit.apply(positions, joints)


def axes_of_up(up: str, mirrored: bool = False) -> F64:
    """Return the rotation (3, 3) that takes a vertical axis, such as "z" or "-y", to +Y.

    The next axis in cyclic order becomes +Z, which keeps the three right-handed; the hips determine where a body faces.
    Left-handed axes (`mirrored`) are reflected at the plane of these two.
    """
    index, sign = "xyz".index(up[-1]), -1.0 if up[0] == "-" else 1.0
    axes: F64 = np.eye(3)[[(index + 2) % 3, index, (index + 1) % 3]]
    axes[1:] *= sign
    axes[0] *= -1.0 if mirrored else 1.0
    return axes


@dataclass(frozen=True)
class Fit:
    """A mapping applied to one skeleton, or set of points or markers.

    Attributes
    ----------
    indices : dict[str, int]
        Node name → index, under the names that the mapping uses.
    joints : dict[str, Mix or None]
        The combination of nodes for each named joint.
    missing : dict[str, str]
        The joints and bones that cannot be built here, each with the first node that is missing.
    instead : dict[str, tuple of Mix]
        The alternatives for a named joint, in order, in frames where some of its nodes are not visible.
    prefix : str
        The prefix that was ignored, if the names fit no mapping with it.
    estimated : Mapping[str, str]
        The joints that the file does not hold and that are estimated, each with a phrase that describes how.
    rough : tuple of str
        The joints of these whose estimate may be more than 5 cm off.
    reasons : tuple of str
        Sentences on how the body was recognised, for `kinedex inspect`; empty for a mapping that the names fit exactly.
    doubts : tuple of str
        Warnings about labels that seem to be wrong.
    confidence : float
        The confidence from 0 to 1; 1 for a mapping that the names fit exactly.
    """

    mapping: SkeletonMapping
    indices: dict[str, int]
    joints: dict[str, Mix | None]
    missing: dict[str, str]
    instead: dict[str, tuple[Mix, ...]] = field(default_factory=dict)
    prefix: str = ""
    estimated: Mapping[str, str] = field(default_factory=dict)
    rough: tuple[str, ...] = ()
    reasons: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    confidence: float = 1.0

    @property
    def called(self) -> str:
        """Return the mapping's name for messages, with the prefix that was ignored."""
        return f"'{self.mapping.name}'" + (f" (without the prefix '{self.prefix}')" if self.prefix else "")

    @property
    def recognised(self) -> bool:
        """Return whether the mapping was made for this file, because no other one fits its names."""
        return bool(self.reasons)

    @property
    def named(self) -> int:
        """Return the number of joints that the skeleton itself supplies."""
        return sum(mix is not None and not mix.of_joints for mix in self.joints.values())

    @property
    def known(self) -> int:
        """Return the number of the skeleton's nodes that the mapping refers to."""
        mixes = [mix for choices in self.mapping.joints.values() for mix in choices if mix and not mix.of_joints]
        return len({name for mix in mixes for name in mix.names} & self.indices.keys())

    @cached_property
    def fallen(self) -> tuple[str, ...]:
        """Return the joints made by a later choice that uses other joints, or whose partner has its first choice."""
        found = []
        for joint, mix in self.joints.items():
            first = self.mapping.joints[joint][0]
            if mix is None or first is None or mix is first or first.of_joints:
                continue
            twin = f"{'r' if joint[0] == 'l' else 'l'}{joint[1:]}"
            even = joint[0] not in "lr" or self.joints.get(twin) is not self.mapping.joints.get(twin, (None,))[0]
            if mix.of_joints or not even:
                found.append(joint)
        return tuple(found)

    @cached_property
    def root(self) -> int:
        """Return the index of the node whose rotation is the body's: that of joint `root`, else the first node."""
        mix = self.joints.get("root")
        return self.indices[mix.node] if mix is not None and mix.node is not None else 0

    @cached_property
    def nodes(self) -> tuple[int, ...]:
        """Return the indices of the nodes from which the named joints are computed."""
        mixes = [*self.joints.values(), *(mix for others in self.instead.values() for mix in others)]
        own = [mix for mix in mixes if mix is not None and not mix.of_joints]
        return tuple(sorted({self.indices[name] for mix in own for name in mix.names}))

    @cached_property
    def unknown(self) -> tuple[str, ...]:
        """Return the joints that the skeleton does not have."""
        return tuple(joint for joint, mix in self.joints.items() if mix is None)

    @property
    def virtual(self) -> dict[str, Mix]:
        """Return the joints that are built from others, and how."""
        return {joint: mix for joint, mix in self.joints.items() if mix is not None and mix.node is None}

    @property
    def up(self) -> str:
        """The axis of the file that is vertical: "x", "y" or "z", with a minus where it points down."""
        row = self.mapping.axes[1]
        index = int(np.argmax(np.abs(row)))
        return ("-" if row[index] < 0 else "") + "xyz"[index]

    def upright(self, up: str | None) -> Fit:
        """Return the fit with the vertical axis that the file states (None: not stated), if the mapping allows it."""
        mapping = self.mapping
        if up is None or not mapping.screen or np.array_equal(mapping.axes[1], np.eye(3)["xyz".index(up)]):
            return self
        return replace(self, mapping=replace(mapping, axes=axes_of_up(up)))

    def check(self, source: str | Path, way_out: str = "") -> None:
        """Raise a SourceError that names `source`, the first node that is missing, if there is one, and a way out."""
        for what, node in self.missing.items():
            raise SourceError(
                source,
                f"the skeleton has no '{node}', which mapping '{self.mapping.name}' ({self.mapping.path}) takes for "
                f"{what}{did_you_mean(node, self.indices, _ALIKE)}{way_out}",
            )

    def apply(self, positions: F64, joints: tuple[str, ...], out: F64 | None = None) -> F64:
        """Return the named joints (len(joints), 3, T), Y up, from the positions (nodes, 3, T) of all nodes.

        They are put into `out` where it is given.
        """
        tracks: dict[str, F64] = {}
        frames, axes = positions.shape[2], self.mapping.axes
        plain = bool((axes == np.eye(3)).all())
        hand = 1.0 if plain else float(np.sign(np.linalg.det(axes)))
        for joint, mix in self.joints.items():  # The order of `fit` puts the parts of a virtual joint before it.
            tracks[joint] = np.full((3, frames), np.nan) if mix is None else self._track(mix, positions, tracks, hand)
            for other in self.instead.get(joint, ()):
                lost = np.isnan(tracks[joint]).any(axis=0)
                if not lost.any():
                    break
                tracks[joint] = np.where(lost, self._track(other, positions, tracks, hand), tracks[joint])
        result = np.empty((len(joints), 3, frames)) if out is None else out
        if plain:
            for place, joint in enumerate(joints):
                result[place] = tracks[joint]
        else:
            result[:] = np.einsum("ab,jbt->jat", axes, np.stack([tracks[joint] for joint in joints]))
        return result

    def _track(self, mix: Mix, positions: F64, tracks: Mapping[str, F64], hand: float) -> F64:
        if mix.node is not None:
            track: F64 = positions[self.indices[mix.node]]
            return track
        return mix.apply(tracks if mix.of_joints else {name: positions[self.indices[name]] for name in mix.names}, hand)
