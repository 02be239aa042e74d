"""Make bodies of figures: trees of nodes in a scene with their transforms over time.

The readers of glTF, FBX and MVNX files give figures in metres with Y up, by the units and axes that the files state.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from kinedex.catalog.skeletons.body_evidence import SAMPLED_FRAMES, Evidence
from kinedex.catalog.skeletons.limb_doubts import limb_doubts
from kinedex.catalog.skeletons.mappings import Fit, Format, Mappings
from kinedex.catalog.skeletons.recognition.node_places import (
    exchange_warning,
    exchanged_names,
    twist_nodes,
    with_exchanged,
)
from kinedex.catalog.skeletons.root_units import OTHER_ROOT_UNIT, root_factor
from kinedex.ops.arrays import F64
from kinedex.ops.body import kinematics
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.figure_bones import (
    RestoredBone,
    bones_of_body,
    bones_of_mapping,
    lengthen,
    measured_offsets,
    with_bones,
)
from kinedex.storage.formats.motion.figure_poses import Figure
from kinedex.storage.formats.motion.mapped_body import (
    UnitStatement,
    mapped_orientation,
    recognition_evidence,
    recognition_warnings,
    refuse_far,
    skips_spine,
    to_metres,
    turned_upright,
)
from kinedex.storage.formats.motion.points import root_orientation
from kinedex.storage.formats.motion.reader import Body, MotionFile, Reader, ReadSettings, body_bytes

BLOCK_FRAMES = 1024
"""The largest number of frames that are posed at once."""

MAX_FREE_FRAMES = 100_000
"""The number of frames that any clip may have; a longer one must have keys in a hundredth of its frames."""

_APART_M = 0.01

_LEVEL, _UPRIGHT = 3.0, 35.0  # largest tilt of hips and of spine, in degrees, in an upright rest pose


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
    """Return the number of frames that are posed at once, so that their nodes take some 100 MB in usual scenes."""
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
        The bones that the mapping gives a length.
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
    lost, of_body = bones_of_body(figure, measured_offsets(figure, places))
    if of_body:
        places, turns = figure.poses.at(sampled, [bone.parent for bone in of_body])
        lengthen(places, of_body, turns)
        figure = with_bones(figure, of_body)
    offsets = measured_offsets(figure, places)
    evidence = _evidence(figure, places, offsets)
    nodes = {name: i for i, name in enumerate(figure.names) if not name.endswith("_end") or offsets[i].any()}
    fit = mappings.detect(path, "bvh", nodes, evidence)
    if skips_spine(fit, figure.parents, offsets, twist_nodes(figure.names, figure.parents)):
        fit = mappings.recognised(path, "bvh", evidence)
    fit = lost.marked(fit, figure.names) if lost is not None else fit
    fit = replace(fit, doubts=(*doubts, *fit.doubts)) if doubts else fit
    of_mapping = bones_of_mapping(figure, fit, places)
    figure = with_bones(figure, of_mapping)
    positions, root, turned = _posed(figure, fit, joints, [*of_body, *of_mapping])
    fit, upturned = (fit, ()) if figure.upright else turned_upright(fit, figure.rest, positions, joints)
    factor = None if figure.upright else root_factor(positions, joints)
    if factor is not None:
        positions += (factor - 1.0) * (fit.mapping.axes @ root)
        doubt = f"{OTHER_ROOT_UNIT}: times {factor:.4g} the feet stand on the floor; it is read so"
        fit = replace(fit, doubts=(*fit.doubts, doubt))
    names = tuple(figure.names[bone.members[0]] for bone in of_mapping)
    return FittedFigure(figure, fit, positions, turned, upturned, names)


def _evidence(figure: Figure, positions: F64, offsets: F64) -> Evidence:
    """Return the evidence for recognising a figure; bones whose length is a rounding error have length 0."""
    positions = positions.copy()
    for node, above in enumerate(figure.parents):
        if above >= 0 and not offsets[node].any():
            positions[node] = positions[above]
    return Evidence(figure.names, positions, figure.parents, offsets, "y" if figure.upright else None, 1.0)


def _posed(figure: Figure, fit: Fit, joints: tuple[str, ...], bones: Sequence[RestoredBone]) -> tuple[F64, F64, F64]:
    """Return the joints (J, 3, T), and the root node's place (3, T) and rotation from its rest pose (9, T)."""
    positions, turned = np.empty((len(joints), 3, figure.frames)), np.empty((9, figure.frames))
    root = np.empty((3, figure.frames))
    step = _at_once(len(figure.names))
    for start in range(0, figure.frames, step):
        part = np.arange(start, min(start + step, figure.frames))
        places, rotations = figure.poses.at(part, [fit.root, *(bone.parent for bone in bones)])
        turned[:, part] = rotations[0]
        lengthen(places, bones, rotations[1:])
        root[:, part] = places[fit.root]
        positions[:, :, part] = fit.apply(places, joints)
    return positions, root, turned


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
