"""Read the limbs of a body at the source rate: rotations of their nodes, or positions of their markers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.limb_nodes import limb_markers, limb_nodes
from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.catalog.skeletons.skeleton_fit import Fit
from kinedex.ops.body import axisangle, kinematics
from kinedex.storage.formats.motion.acclaim import AcclaimReader, AmcFile, fitted_skeleton
from kinedex.storage.formats.motion.amass import AmassReader, Poses, fitted_poses, model_rotations
from kinedex.storage.formats.motion.body_models import BodyModel
from kinedex.storage.formats.motion.bvh import BvhReader, fitted_person
from kinedex.storage.formats.motion.bvh_parser import BvhFile
from kinedex.storage.formats.motion.c3d import C3dReader
from kinedex.storage.formats.motion.figure_poses import Figure
from kinedex.storage.formats.motion.figures import BLOCK_FRAMES, FigureReader, fitted_figure
from kinedex.storage.formats.motion.mapped_body import ParsedMotion
from kinedex.storage.formats.motion.points import PointsReader
from kinedex.storage.formats.motion.reader import Body, MotionFile, ReadSettings
from kinedex.storage.formats.motion.reader_table import reader_of
from kinedex.storage.formats.motion.unpacked_files import unpacked

F64 = npt.NDArray[np.float64]

_BLOCK_FRAMES = 4096


@dataclass(frozen=True, eq=False)
class BodyLimbs:
    """A body, with the rotations or markers of its limbs as far as its source has them.

    Attributes
    ----------
    body : Body
        The named joints at the source rate.
    rotations : dict of str to float64 array (T, 4)
        Limb → unit quaternions w x y z, from a frame fixed in the limb to the world (Y up).
    markers : dict of str to float64 array (T, M, 3)
        Limb → positions of its markers in metres, Y up; NaN where one is missing.
    ends : dict of str to tuple of str
        Limb → the joints of its long axis, if the mapping names others than the limb's own.
    """

    body: Body
    rotations: dict[str, F64] = field(default_factory=dict)
    markers: dict[str, F64] = field(default_factory=dict)
    ends: dict[str, tuple[str, str]] = field(default_factory=dict)


def read_body_limbs(
    file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings, limbs: Iterable[str]
) -> BodyLimbs:
    """Read a motion file as a body, with the rotations or the markers of limbs.

    For readers of plugins and files of joint positions, both are empty.

    Parameters
    ----------
    file : MotionFile
        The file.
    mappings : Mappings
        Skeleton mappings in which the file's nodes are looked up.
    joints : tuple of str
        The named joints, in the order of the body.
    settings : ReadSettings
        Settings of the user.
    limbs : iterable of str
        The limbs whose rotations or markers are returned.

    Raises
    ------
    SourceError
        The file cannot be read; the error names the place of the first fault.
    """
    with unpacked(file.path, file.skeleton) as copy:
        readable = replace(file, path=copy.path, skeleton=copy.skeleton)
        return _read_body_limbs(readable, mappings, joints, settings, limbs)


def _read_body_limbs(
    file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings, limbs: Iterable[str]
) -> BodyLimbs:
    """Read the body and the limbs of an ordinary file."""
    reader = reader_of(file.path)
    body = reader.read(file, mappings, joints, settings)
    wanted = set(limbs)
    if isinstance(reader, (C3dReader, PointsReader)):
        fitted = reader.fitted(file, mappings, settings)
        # the body's unit is a text: metres, and perhaps a remark
        scale = float(body.unit.split()[0])
        markers = {
            limb: np.ascontiguousarray(
                scale * np.einsum("ab,mbt->tma", fitted.fit.mapping.axes, fitted.points.positions[list(positions)])
            )
            for limb, positions in limb_markers(file.path, fitted.fit).items()
            if limb in wanted
        }
        return BodyLimbs(body, markers=markers, ends=_ends(fitted.fit))
    if isinstance(reader, AcclaimReader):
        skeleton, fit = fitted_skeleton(file, mappings)
        nodes = limb_nodes(skeleton.path, fit, [node.parent for node in skeleton.nodes], at_end=True)
        turned = _node_rotations(AmcFile(file.path, skeleton, file.data), skeleton.nodes, nodes, wanted)
    elif isinstance(reader, BvhReader):
        motion = BvhFile(file.path, file.data)
        person = fitted_person(motion, file.person, mappings, joints)
        fit = person.fit
        nodes = limb_nodes(file.path, fit, [node.parent for node in person.nodes], at_end=False)
        turned = _node_rotations(motion, person.nodes, nodes, wanted)
    elif isinstance(reader, AmassReader):
        poses, model, _, fit, _ = fitted_poses(file, mappings, joints, settings)
        nodes = limb_nodes(file.path, fit, model.parents, at_end=False)
        turned = _model_turns(poses, model, {limb: node for limb, node in nodes.items() if limb in wanted})
    elif isinstance(reader, FigureReader):
        figure, fit, *_ = fitted_figure(file.path, reader.figure(file, settings), mappings, joints)
        nodes = limb_nodes(file.path, fit, figure.parents, at_end=False)
        turned = _figure_turns(figure, {limb: node for limb, node in nodes.items() if limb in wanted})
    else:
        return BodyLimbs(body)
    # from the file's axes, matrices row by row, to quaternions in the world's, Y up
    axes = fit.mapping.axes
    rotations = {
        limb: np.ascontiguousarray(kinematics.quaternions(rows, axes, axes.T).T) for limb, rows in turned.items()
    }
    return BodyLimbs(body, rotations, ends=_ends(fit))


def _ends(fit: Fit) -> dict[str, tuple[str, str]]:
    return {limb: source.ends(limb) for limb, source in fit.mapping.limbs.items() if source.axis}


def _model_turns(poses: Poses, model: BodyModel, nodes: Mapping[str, int]) -> dict[str, F64]:
    """Return the rotations (9, T) of joints of a body model, by the names of their limbs."""
    frames = len(poses.rotations)
    turned = {limb: np.empty((9, frames)) for limb in nodes}
    for start in range(0, frames, _BLOCK_FRAMES):
        part = slice(start, start + _BLOCK_FRAMES)
        rotations = model_rotations(poses, model, part)
        whole: list[F64] = []
        for joint, parent in enumerate(model.parents):
            own = axisangle.matrices(rotations[:, joint])
            whole.append(own if parent < 0 else whole[parent] @ own)
        for limb in turned:
            turned[limb][:, part] = whole[nodes[limb]].reshape(-1, 9).T
    return turned


def _figure_turns(figure: Figure, nodes: Mapping[str, int]) -> dict[str, F64]:
    """Return the rotations (9, T) of nodes of a figure, by the names of their limbs."""
    turned = {limb: np.empty((9, figure.frames)) for limb in nodes}
    for start in range(0, figure.frames, BLOCK_FRAMES):
        part = np.arange(start, min(start + BLOCK_FRAMES, figure.frames))
        _, rotations = figure.poses.at(part, list(nodes.values()))
        for own, limb in zip(rotations, turned, strict=True):
            turned[limb][:, part] = own
    return turned


def _node_rotations(
    motion: ParsedMotion, chain: tuple[kinematics.Node, ...], nodes: Mapping[str, int], wanted: set[str]
) -> dict[str, F64]:
    """Return the rotations (9, T) of the nodes of limbs in the file's axes, matrices row by row."""
    turned = {limb: np.empty((9, motion.frames)) for limb in nodes if limb in wanted}
    at = 0
    for channels in motion.blocks():
        stop = min(at + len(channels), motion.frames)
        for limb, rows in turned.items():
            rows[:, at:stop] = kinematics.forward(chain, channels[: stop - at], nodes[limb], ())[1]
        at = stop
    return turned
