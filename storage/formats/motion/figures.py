"""Make bodies of figures: trees of nodes in a scene with their transforms over time.

The readers of glTF, FBX and MVNX files give figures in metres with Y up, by the units and axes that the files state.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.body_evidence import SAMPLED_FRAMES, Evidence
from kinedex.catalog.skeletons.limb_doubts import limb_doubts
from kinedex.catalog.skeletons.mappings import Fit, Format, Mappings
from kinedex.catalog.skeletons.recognition.node_places import (
    exchange_warning,
    exchanged_names,
    twist_nodes,
    with_exchanged,
)
from kinedex.ops.body import kinematics
from kinedex.ops.body.transforms import global_transforms, without_scale
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.mapped_body import (
    UnitStatement,
    mapped_orientation,
    recognition_evidence,
    recognition_warnings,
    refuse_far,
    to_metres,
    turned_upright,
)
from kinedex.storage.formats.motion.points import root_orientation
from kinedex.storage.formats.motion.reader import Body, MotionFile, Reader, ReadSettings, body_bytes

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]

BLOCK_FRAMES = 1024
"""The largest number of frames that are posed at once."""

MAX_FREE_FRAMES = 100_000
"""The number of frames that any clip may have; a longer one must have keys in a hundredth of its frames."""

_NO_LENGTH_M, _APART_M = 1e-5, 0.01

_LEVEL, _UPRIGHT = 3.0, 35.0  # largest tilt of hips and of spine, in degrees, in an upright rest pose


class Poses(Protocol):
    """The motion of a figure: positions of its nodes and rotations of some of them, in metres with Y up."""

    def at(self, frames: I64, oriented: Sequence[int]) -> tuple[F64, F64]:
        """Return the positions (N, 3, K) in K frames, and the rotations (M, 9, K) of M nodes from their rest pose."""
        ...


@dataclass(frozen=True)
class ScenePoses:
    """The poses of a figure whose nodes have transforms relative to their parents.

    Attributes
    ----------
    parents : tuple of int
        Index of the parent of each of M nodes: the figure's nodes and all their ancestors.
    shown : tuple of int
        Indices of the figure's N nodes among these.
    local : callable
        Returns rotation with scale (M, K, 3, 3), and positions (M, K, 3), of all M nodes relative to their parents at K
        times in seconds.
    start : float
        Time of the first frame in seconds.
    rate_hz : float
        Frames per second.
    axes : float64 array (3, 3)
        The matrix from the scene's axes and unit to metres with Y up.
    rest : float64 array (N, 3, 3)
        The rotations of the nodes in the rest pose, in the scene's axes.
    """

    parents: tuple[int, ...]
    shown: tuple[int, ...]
    local: Callable[[F64], tuple[F64, F64]]
    start: float
    rate_hz: float
    axes: F64
    rest: F64

    def at(self, frames: I64, oriented: Sequence[int]) -> tuple[F64, F64]:
        """Return the positions of the nodes (N, 3, K), and the rotations (M, 9, K) of some from their rest pose."""
        with np.errstate(over="ignore", invalid="ignore"):  # joints with such numbers are refused later as too far away
            whole, positions = global_transforms(self.parents, *self.local(self.start + frames / self.rate_hz))
            shown = positions[list(self.shown)] @ self.axes.T
        nodes = list(oriented)
        turned = without_scale(whole[[self.shown[node] for node in nodes]])
        turned = turned @ self.rest[nodes].transpose(0, 2, 1)[:, None]
        axes = self.axes / np.cbrt(abs(np.linalg.det(self.axes)))  # the axes may be a reflection
        rows = (axes @ turned @ axes.T).reshape(*turned.shape[:2], 9).transpose(0, 2, 1)
        return np.ascontiguousarray(shown.transpose(0, 2, 1)), rows


@dataclass(frozen=True)
class Figure:
    """A tree of named nodes with its motion.

    Attributes
    ----------
    names : tuple of str
        Names of N nodes, all different.
    parents : tuple of int
        Index of each node's parent, which precedes it; −1 for a root.
    rest : float64 array (N, 3)
        Positions of the nodes in the rest pose, in metres, Y up.
    poses : Poses
        The motion.
    frames : int
        The number of frames.
    rate_hz : float
        Frames per second that the file states or that its times suggest.
    evidence : tuple of str
        Sentences on how the file was read, for `kinedex inspect`.
    warnings : tuple of str
        Warnings about the file.
    upright : bool
        True if, by the format's definition, all nodes are unrotated when the body stands upright and faces forward.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    rest: F64
    poses: Poses
    frames: int
    rate_hz: float
    evidence: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    upright: bool = False


class FigureReader(Reader):
    """A reader of files whose bodies are figures in a scene; subclasses define `figure`."""

    format: ClassVar[Format] = "bvh"

    def relevant_settings(self, settings: ReadSettings) -> object:
        """Return the rate that replaces the file's, the only setting that affects the result."""
        return settings.override_rate_hz

    @abstractmethod
    def figure(self, file: MotionFile, settings: ReadSettings) -> Figure:
        """Return the figure of the file's chosen person, before any mapping.

        Raises
        ------
        SourceError
            The file is damaged or holds no motion; the error names the place of the first fault.
        """

    def read(self, file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings) -> Body:
        """Read a person of a file.

        The file's unit and axes take precedence over those of the mapping; a unit that gives no human height is
        replaced by a guess.

        Raises
        ------
        SourceError
            The file is damaged, holds no motion of a skeleton, its body is not recognised, its unit cannot be guessed,
            or a joint is implausibly far away.
        """
        path, figure = file.path, self.figure(file, settings)
        warnings = list(figure.warnings)
        rate_hz = settings.rate_of(figure.rate_hz, warnings)
        figure, fit, positions, turned, upturned, bones = fitted_figure(path, figure, mappings, joints)
        if bones:
            warnings.append(
                f"bones {', '.join(bones)} have no length in the file; mapping '{fit.mapping.name}' gives them one"
            )
        found = [*recognition_evidence(fit), *upturned]
        stated = UnitStatement(1.0, "it states", settings.session_unit_m)
        unit = to_metres(path, positions, stated, joints, warnings, found)
        refuse_far(path, positions, joints, fit.unknown)
        return Body(
            positions=positions,
            orientation=_orientation(fit, figure, turned, positions, joints, bool(upturned)),
            rate_hz=rate_hz,
            unit=unit,
            skeleton=fit.mapping.name,
            up=fit.up,
            unknown=fit.unknown,
            warnings=(*warnings, *recognition_warnings(fit), *limb_doubts(positions, joints)),
            estimated=tuple(fit.estimated),
            confidence=fit.confidence,
            evidence=(*figure.evidence, *found),
        )


def refuse_many_frames(path: Path, frames: int, keys: int) -> None:
    """Raise SourceError if a few keys claim a motion of implausible length."""
    most = max(MAX_FREE_FRAMES, 100 * keys)
    if frames > most:
        raise SourceError(path, f"its {keys} key times make {frames} frames, more than {most}: a time must be wrong")


def figure_bytes(frames: int, nodes: int, joints: int) -> int:
    """Estimate the memory in bytes of a figure's body, and of the nodes of a block of frames while it is read."""
    return body_bytes(frames, joints) + min(frames, _at_once(nodes)) * (600 * nodes + 96 * joints)


def _at_once(nodes: int) -> int:
    """Return the number of frames that are posed at once, for at most some 100 MB of node data."""
    return min(BLOCK_FRAMES, max(SAMPLED_FRAMES, 200_000 // nodes))


class FittedFigure(NamedTuple):
    """A figure with its skeleton mapping.

    Attributes
    ----------
    figure : Figure
        The figure, with a length for bones that lack one.
    fit : Fit
        The mapping, rotated if another axis than its own is up.
    positions : float64 array (J, 3, T)
        The named joints in metres.
    turned : float64 array (9, T)
        Rotations of the root from its rest pose, row by row.
    upturned : tuple of str
        The reasons for rotating the mapping.
    bones : tuple of str
        The bones that were given a length.
    """

    figure: Figure
    fit: Fit
    positions: F64
    turned: F64
    upturned: tuple[str, ...]
    bones: tuple[str, ...]


def fitted_figure(path: Path, figure: Figure, mappings: Mappings, joints: tuple[str, ...]) -> FittedFigure:
    """Return a figure with the mapping that fits its nodes.

    Raises
    ------
    SourceError
        No mapping fits, and no body is recognised.
    """
    sampled = np.unique(np.linspace(0, figure.frames - 1, SAMPLED_FRAMES).round().astype(np.int64))
    places, _ = figure.poses.at(sampled, [])
    pairs = exchanged_names(figure.names, figure.parents)
    doubts = exchange_warning(figure.names, pairs)
    figure = replace(figure, names=with_exchanged(figure.names, pairs)) if pairs else figure
    evidence = _evidence(figure, places)
    fit = mappings.detect(path, "bvh", {name: i for i, name in enumerate(figure.names)}, evidence)
    fit = replace(fit, doubts=(*doubts, *fit.doubts)) if doubts else fit
    bones = _lost_bones(figure, fit, places)
    if bones:
        rest = figure.rest.copy()
        for bone in bones:
            rest[list(bone.members)] += bone.way
        figure = replace(figure, rest=rest)
    positions, turned = _posed(figure, fit, joints, bones)
    fit, upturned = (fit, ()) if figure.upright else turned_upright(fit, figure.rest, positions, joints)
    return FittedFigure(
        figure, fit, positions, turned, upturned, tuple(figure.names[bone.members[0]] for bone in bones)
    )


def _evidence(figure: Figure, positions: F64) -> Evidence:
    """Return the evidence for recognising a figure; bones whose length is a rounding error have length 0."""
    positions, offsets = positions.copy(), figure.rest.copy()
    for node, above in enumerate(figure.parents):
        if above >= 0:
            offsets[node] -= figure.rest[above]
            if np.abs(positions[node] - positions[above]).max() < _NO_LENGTH_M:
                positions[node], offsets[node] = positions[above], 0.0
    return Evidence(figure.names, positions, figure.parents, offsets, "y" if figure.upright else None, 1.0)


@dataclass(frozen=True)
class _Bone:
    """A bone without length in the file: its node with all descendants, its parent, and its intended vector."""

    members: tuple[int, ...]
    parent: int
    way: F64


def _lost_bones(figure: Figure, fit: Fit, positions: F64) -> list[_Bone]:
    """Return the bones that have no length in sampled frames, but one in the mapping."""
    bones = []
    above = list(figure.parents)
    for i in sorted(twist_nodes(figure.names, figure.parents)):
        above = [figure.parents[i] if parent == i else parent for parent in above]
    for name, weights in fit.mapping.bones.items():
        node = fit.indices[name]
        parent = figure.parents[node]
        if parent < 0 or np.abs(positions[node] - positions[parent]).max() > _NO_LENGTH_M:
            continue
        others = [(weight, fit.indices[other]) for other, weight in weights.items()]
        way = sum(weight * (figure.rest[other] - figure.rest[above[other]]) for weight, other in others)
        members = [node]
        for i, one in enumerate(figure.parents):
            if one in members:
                members.append(i)
        bones.append(_Bone(tuple(members), parent, np.asarray(way)))
    return bones


def _posed(figure: Figure, fit: Fit, joints: tuple[str, ...], bones: Sequence[_Bone]) -> tuple[F64, F64]:
    """Return the joints (J, 3, T) and the root's rotation from its rest pose (9, T), computed in blocks of frames."""
    positions, turned = np.empty((len(joints), 3, figure.frames)), np.empty((9, figure.frames))
    step = _at_once(len(figure.names))
    for start in range(0, figure.frames, step):
        part = np.arange(start, min(start + step, figure.frames))
        places, rotations = figure.poses.at(part, [fit.root, *(bone.parent for bone in bones)])
        turned[:, part] = rotations[0]
        for bone, turn in zip(bones, rotations[1:], strict=True):
            places[list(bone.members)] += np.einsum("abk,b->ak", turn.reshape(3, 3, -1), bone.way)
        positions[:, :, part] = fit.apply(places, joints)
    return positions, turned


def _orientation(fit: Fit, figure: Figure, turned: F64, positions: F64, joints: tuple[str, ...], upturned: bool) -> F64:
    """Return the root's orientation: from the file if its rest pose is upright and faces forward, else from the body.

    A file's rest pose may be any pose of a clip. Then the hips and the base of the spine, which move with the root,
    show how far the root is rotated in it. A recognised body gets the orientation of its hips and spine.
    """
    if figure.upright and "root" not in fit.unknown:
        return kinematics.quaternions(turned)
    if {"lhip", "rhip", "root"} & set(fit.unknown):
        return mapped_orientation(fit, turned)
    if not fit.recognised and not upturned:
        rest = dict(zip(joints, fit.apply(figure.rest[:, :, None], joints), strict=True))
        across, up = rest["lhip"] - rest["rhip"], fit.mapping.axes @ _spine_base(fit, figure)[:, None]
        usual = fit.mapping.axes @ fit.mapping.root_axes.T
        if _angle(across[:, 0], usual[:, 0]) <= _LEVEL and _angle(up[:, 0], usual[:, 1]) <= _UPRIGHT:
            return mapped_orientation(fit, turned)
        own = kinematics.frames_along(across, up).reshape(3, 3)
        if np.isfinite(own).all():
            return kinematics.quaternions(turned, fit.mapping.axes, fit.mapping.axes.T @ own)
    return root_orientation(positions, joints, np.ones(positions.shape[2], np.bool_), [])


def _spine_base(fit: Fit, figure: Figure) -> F64:
    """Return the vector at rest from the root to the first spine node at another position, in the file's axes."""
    mix = fit.joints.get("chest")
    node = fit.indices[mix.names[0]] if mix is not None and not mix.of_joints else fit.root
    way: F64 = np.zeros(3)
    while node not in (fit.root, -1):
        further = figure.rest[node] - figure.rest[fit.root]
        way = further if np.linalg.norm(further) > _APART_M else way
        node = figure.parents[node]
    return way


def _angle(a: F64, b: F64) -> float:
    """Return the angle between two vectors in degrees; 180 if one has no length."""
    lengths = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.degrees(np.arccos(np.clip(a @ b / lengths, -1.0, 1.0)))) if lengths else 180.0
