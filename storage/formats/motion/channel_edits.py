"""Change the channels of a motion file: mirror them, move them to the origin, or resample them.

Numbers that a change does not affect keep their text; a negated number only loses or gets its minus sign.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.mirrored_nodes import mirrored_nodes
from kinedex.catalog.skeletons.skeleton_fit import Fit
from kinedex.ops.body import kinematics as k
from kinedex.ops.body import transforms
from kinedex.ops.body.euler import euler_angles, matrices_of
from kinedex.ops.body.facing_direction import mirrored_positions, placement_of, turn_about_y
from kinedex.ops.errors import KinedexError, ParameterError, SourceError
from kinedex.storage.formats.motion.channel_cuts import SourceCut

F64 = npt.NDArray[np.float64]
Tokens = list[list[bytes]]

_KINDS = ("Xrotation", "Yrotation", "Zrotation", "Xposition", "Yposition", "Zposition", "length")
_MIN_DECIMALS, _MAX_DECIMALS = 4, 12
_PAIRS = ("hip", "shoulder")
_DECIMALS = re.compile(rb"\.([0-9]*)")


@dataclass(frozen=True)
class Figure:
    """The nodes of the person that a cut holds, in the file's own units of length.

    Attributes
    ----------
    path : Path
        The file.
    nodes : tuple of Node
        Parents first; the columns of their steps count from 0.
    fit : Fit
        The skeleton mapping that fits them, with the file's actual vertical axis.
    angle : float
        Radians per unit of the file's angles.
    scale : float
        The ratio of the nodes' lengths to the file's.
    """

    path: Path
    nodes: tuple[k.Node, ...]
    fit: Fit
    angle: float
    scale: float = 1.0

    @property
    def kinds(self) -> list[int]:
        """The kind of each column (a rotation or translation axis), see `ops.body.kinematics`."""
        found = {step.column: step.kind for node in self.nodes for step in node.steps}
        return [found[column] for column in range(len(found))]

    @property
    def rest(self) -> F64:
        """The offsets (N, 3) of the nodes at rest, in the world's axes."""
        turned: list[F64] = []
        offsets = np.zeros((len(self.nodes), 3))
        for i, node in enumerate(self.nodes):
            turned.append(node.frame if node.parent < 0 else turned[node.parent] @ node.frame)
            offsets[i] = turned[i] @ node.after + (
                node.before if node.parent < 0 else turned[node.parent] @ node.before
            )
        return offsets

    def values(self, tokens: Tokens) -> F64:
        """Return the numbers of some frames (T, C), in radians and the unit of the nodes."""
        factors = [self.angle if kind <= k.ROTATE_Z else self.scale for kind in self.kinds]
        return np.array(tokens, np.bytes_).astype(np.float64).reshape(len(tokens), -1) * factors


@dataclass(frozen=True)
class MirrorPlane:
    """The plane at which a body is mirrored, and the partner of each node.

    Attributes
    ----------
    axis : int
        The axis of the file, 0, 1 or 2, normal to the plane.
    image : tuple of int
        Node → the same node on the other side, or itself.
    """

    axis: int
    image: tuple[int, ...]

    def flips(self, kind: int) -> bool:
        """Return whether a channel is negated: rotations about in-plane axes, and translations along the normal."""
        return (kind % 3 != self.axis) == (kind <= k.ROTATE_Z) and kind != k.STRETCH


def mirror_plane(figure: Figure) -> MirrorPlane:
    """Return the plane at which a body is mirrored.

    Raises
    ------
    SourceError
        A node has no partner on the other side, or one with other channels.
    """
    nodes, fit = figure.nodes, figure.fit
    names = [node.name for node in nodes]
    image = mirrored_nodes(figure.path, names, [node.parent for node in nodes], fit)
    for i, other in enumerate(image):
        kinds, others = ([_KINDS[step.kind] for step in _in_columns(nodes[at])] for at in (i, other))
        if kinds != others:
            raise SourceError(
                figure.path,
                f"cannot be mirrored: '{names[i]}' has the channels {' '.join(kinds) or 'none'}, its partner "
                f"'{names[other]}' {' '.join(others) or 'none'}; mirror the 24 joints instead (kinedex export "
                "--joints)",
            )
    axis = int(np.argmax(np.abs(fit.mapping.root_axes[0])))
    if fit.recognised:  # the root's own axes are unknown: use the sides of the rest pose
        rest = figure.rest
        signs = 1.0 - 2.0 * np.eye(3)
        axis = int(np.argmin([np.abs(rest[list(image)] * sign - rest).sum() for sign in signs]))
    return MirrorPlane(axis, image)


def _in_columns(node: k.Node) -> list[k.Step]:
    return sorted(node.steps, key=lambda step: step.column)


def edited(figure: Figure, cut: SourceCut, tokens: Tokens, plane: MirrorPlane | None) -> Tokens:
    """Return the numbers of a cut, as text, after the requested changes.

    Parameters
    ----------
    figure : Figure
        The nodes.
    cut : SourceCut
        The changes.
    tokens : list of list of bytes
        The numbers of the source in the frames of the cut.
    plane : MirrorPlane or None
        The mirror plane; None to keep the sides.

    Raises
    ------
    KinedexError
        A change cannot be expressed with the channels of the root.
    """
    turn, shift = np.eye(3), np.zeros(3)
    if plane is not None:
        turn = _upright(figure.fit, plane)
    if cut.in_place:
        first = cut.inner[0] - cut.start if cut.inner is not None else 0
        turn, shift = _to_origin(figure, cut, tokens[first], plane, turn)
    if plane is not None:
        tokens = mirrored_tokens(figure, plane, tokens)
    if shift.any() or not np.array_equal(turn, np.eye(3)):
        tokens = _moved(figure, tokens, turn, shift)
    if cut.rate_hz is not None and cut.rate_hz != cut.source_rate_hz:
        tokens = _resampled(figure, tokens, cut.source_rate_hz, cut.rate_hz)
    return tokens


def negated(number: bytes) -> bytes:
    """Negate the text of a number; negating twice gives the text back, except for a plus sign."""
    return number[1:] if number.startswith(b"-") else b"-" + number.removeprefix(b"+")


def mirrored_tokens(figure: Figure, plane: MirrorPlane, tokens: Tokens) -> Tokens:
    """Return the numbers of the mirror image, which are those of the other side, some of them negated.

    With S the reflection, a node's rotation R becomes S · R · S, a product of rotations about the same axes, with the
    same angle about the normal of the plane and the negated angle about the others.
    """
    source, flips = list(range(len(figure.kinds))), [False] * len(figure.kinds)
    for node, other in zip(figure.nodes, plane.image, strict=True):
        for to, origin in zip(_in_columns(node), _in_columns(figure.nodes[other]), strict=True):
            source[to.column], flips[to.column] = origin.column, plane.flips(to.kind)
    pairs = list(zip(source, flips, strict=True))
    return [[negated(row[column]) if flip else row[column] for column, flip in pairs] for row in tokens]


def _upright(fit: Fit, plane: MirrorPlane) -> F64:
    """Return the rotation (3, 3) that keeps up up after mirroring: the identity unless the mirror plane is level."""
    axes = np.abs(fit.mapping.axes)
    if int(np.argmax(axes[1])) != plane.axis:
        return np.eye(3)
    signs = np.ones(3)
    signs[[plane.axis, int(np.argmax(axes[0]))]] = -1.0
    return np.diag(signs)


def _to_origin(
    figure: Figure, cut: SourceCut, row: list[bytes], plane: MirrorPlane | None, turn: F64
) -> tuple[F64, F64]:
    """Return the rotation and translation, in the file's axes, that put a frame's body at the origin, facing +Z."""
    joints, axes = tuple(figure.fit.joints), figure.fit.mapping.axes
    found, _ = k.forward(figure.nodes, figure.values([row]))
    positions = figure.fit.apply(found, joints)[:, :, 0]
    if plane is not None:
        reflection = np.diag(1.0 - 2.0 * np.eye(3)[plane.axis])
        positions = (
            mirrored_positions(positions[None], joints)[0] * [-1.0, 1.0, 1.0] @ (axes @ turn @ reflection @ axes.T).T
        )
    known = dict(zip(joints, positions, strict=True))
    gap = np.full(3, np.nan)
    left, right = (np.stack([known.get(f"{side}{pair}", gap) for pair in _PAIRS]) for side in "lr")
    try:
        placement = placement_of(known.get("root", gap), left, right)
    except ParameterError:
        raise KinedexError(
            f"{cut.source}: cannot be put at the origin, since its root, or its hips and shoulders, are not known; "
            "export it without `in_place`"
        ) from None
    back = axes.T @ turn_about_y(np.eye(3), -placement.yaw).T @ axes
    return back @ turn, -back @ axes.T @ [placement.x, 0.0, placement.z]


def _moved(figure: Figure, tokens: Tokens, turn: F64, shift: F64) -> Tokens:
    """Return the numbers after rotating the body about the file's origin and translating it, by its root's channels."""
    root = figure.nodes[0]
    moves = [
        next((step.column for step in root.steps if step.kind == kind), -1) for kind in (k.MOVE_X, k.MOVE_Y, k.MOVE_Z)
    ]
    rotations = [step for step in root.steps if step.kind <= k.ROTATE_Z]
    if -1 in moves or len(rotations) != 3:
        has = " ".join(_KINDS[step.kind] for step in root.steps) or "none"
        raise SourceError(
            figure.path,
            f"cannot be moved or turned: its root '{root.name}' has the channels {has}, and needs three positions and "
            "three rotations; change the 24 joints instead (kinedex export --joints)",
        )
    values, columns = figure.values(tokens), [step.column for step in rotations]
    order = "".join("XYZ"[step.kind] for step in rotations)
    rotated = np.einsum("ab,tbc->tac", turn, matrices_of(values[:, columns], order))
    positions = (values[:, moves] + root.before) @ turn.T + shift - root.before
    values[:, columns] = euler_angles(rotated, order)
    values[:, moves] = positions
    return _texts(figure, values, tokens, [*moves, *columns])


def _resampled(figure: Figure, tokens: Tokens, before_hz: float, after_hz: float) -> Tokens:
    """Return the numbers at another rate; frames that coincide with a source frame keep its text.

    Three rotations of a node are interpolated together, by the shortest rotation; one or two angles, and positions,
    linearly.
    """
    frames = len(tokens)
    count = int(np.floor(round((frames - 1) * after_hz / before_hz, 9))) + 1
    at = np.arange(count) * (before_hz / after_hz)
    left = np.minimum(np.floor(np.round(at, 9)).astype(np.int64), frames - 1)
    share = np.where(at - left < 1e-9, 0.0, at - left)
    right = np.minimum(left + 1, frames - 1)
    values = figure.values(tokens)
    first, second = values[left], values[right]
    angles = np.array([kind <= k.ROTATE_Z for kind in figure.kinds])
    apart = second - first
    apart[:, angles] -= 2 * np.pi * np.round(apart[:, angles] / (2 * np.pi))
    mixed = first + share[:, None] * apart
    for node in figure.nodes:
        rotations = [step for step in node.steps if step.kind <= k.ROTATE_Z]
        if len(rotations) == 3:
            columns, order = [step.column for step in rotations], "".join("XYZ"[step.kind] for step in rotations)
            ends = [k.quaternions(matrices_of(one[:, columns], order).reshape(-1, 9).T).T for one in (first, second)]
            turned = transforms.rotations(transforms.slerp(ends[0], ends[1], share))
            mixed[:, columns] = euler_angles(turned, order, first[:, columns])
    texts = _texts(figure, mixed, [tokens[t] for t in left], range(len(angles)))
    return [tokens[t] if part == 0.0 else text for t, part, text in zip(left, share, texts, strict=True)]


def _texts(figure: Figure, values: F64, tokens: Tokens, columns: Sequence[int]) -> Tokens:
    """Return rows with new numbers in some columns, with as many decimals as the source has there."""
    rows = [list(row) for row in tokens]
    for column in columns:
        factor = figure.angle if figure.kinds[column] <= k.ROTATE_Z else figure.scale
        found = max((len(point[1]) for row in tokens if (point := _DECIMALS.search(row[column]))), default=0)
        decimals = min(max(found, _MIN_DECIMALS), _MAX_DECIMALS)
        for row, value in zip(rows, (values[:, column] / factor).tolist(), strict=True):
            row[column] = f"{value:.{decimals}f}".encode()
    return rows
