"""This module derives logical constraints from marked regions of templates, and the terms that they add to tracking.

A region is an interval of columns whose entries fix some features (thesis, Section 6.4.1). In frames that are aligned
with these columns, the body is pulled towards a pose with these feature values (Section 6.4.2).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from kinedex.ops.arrays import F64, I64, Bool
from kinedex.ops.body.kinematic_chain import ChainBody, Poses, rotation_of, vector_of
from kinedex.ops.errors import ParameterError
from kinedex.ops.templates.templates import QuantisedTemplate

Constraint = Literal["foot_on_ground", "elbow_bent", "hand_to_front", "foot_to_front"]
Side = Literal["left", "right"]

CONSTRAINTS: tuple[Constraint, ...] = get_args(Constraint)
SIDES: tuple[Side, ...] = get_args(Side)

FEATURES: Mapping[Constraint, Mapping[str, bool]] = {
    "foot_on_ground": {"foot_fast": False, "foot_raised": False},
    "elbow_bent": {"elbow_bent": True},
    "hand_to_front": {"hand_forwards": True},
    "foot_to_front": {"foot_fast": True},
}
"""The features of each constraint, without the prefix l or r, and their values."""

MIN_COLUMNS = 3
"""Minimum number of columns of a region that is marked by default."""

GROUND_M, FRONT_M, BENT_RAD = 0.03, 0.05, 0.2
"""Standard deviations of a foot's height (m), of the forward movement of a hand or foot (m), and of flexion (rad)."""

BENT_AT_RAD = np.pi / 3
"""The smallest flexion of a bent elbow, in radians."""

GROUND_PERCENTILE = 10.0
"""Percentile of a joint's heights over the track that is its height when the foot stands."""

FRONT_SPEED: Mapping[Constraint, float] = {"hand_to_front": 1.3, "foot_to_front": 2.0}
"""Minimum speeds of forward movement in upper arm lengths per second: the weak thresholds of the features."""


@dataclass(frozen=True)
class Mark:
    """A marked region of a template.

    Attributes
    ----------
    constraint : str
        One of `CONSTRAINTS`.
    side : str
        "left" or "right".
    start, stop : int
        The half-open range of columns.
    name : str
        The name of the region in reports; empty for none.
    """

    constraint: Constraint
    side: Side
    start: int
    stop: int
    name: str = ""


@dataclass(frozen=True)
class MarkEdit:
    """A change to the default marks of a template.

    Attributes
    ----------
    constraint, side : str
        The constraint, and its side; None for both sides.
    columns : (int, int), optional
        The first and the last column, both included, from 0; None for all.
    remove : bool
        True to remove the marks in these columns, False to mark the columns.
    name : str
        The name of the region to mark.
    where : str
        The file and line of the edit, with which error messages begin.
    """

    constraint: Constraint
    side: Side | None = None
    columns: tuple[int, int] | None = None
    remove: bool = False
    name: str = ""
    where: str = ""


def template_marks(
    template: QuantisedTemplate, bits: Mapping[str, int], locomotion: bool = False, edits: Sequence[MarkEdit] = ()
) -> tuple[Mark, ...]:
    """Return the marked regions of a template.

    By default these are all runs of at least `MIN_COLUMNS` columns whose entries fix the features of a constraint.
    `foot_to_front` is only marked in locomotion, as its features do not imply a forward movement.

    Parameters
    ----------
    template : QuantisedTemplate
        A template of N columns.
    bits : mapping of str to int
        The bit of each feature by its name; constraints without their features are not marked by default.
    locomotion : bool, optional
        True for a motion in which the body moves forwards.
    edits : sequence of MarkEdit, optional
        Changes, applied in their order.

    Raises
    ------
    ParameterError
        If an edit names columns that the template does not have.
    """
    grids = {(c, s): _fixed(template, bits, c, s, locomotion) for c in CONSTRAINTS for s in SIDES}
    names: dict[tuple[Constraint, Side], list[tuple[int, int, str]]] = {}
    for edit in edits:
        first, last = edit.columns or (0, len(template) - 1)
        if not 0 <= first <= last < len(template):
            found = f"{edit.where}: columns {first} to {last}" if edit.where else f"columns {first} to {last}"
            raise ParameterError("columns of a mark", f"from 0 to {len(template) - 1}, those of its template", found)
        for side in SIDES if edit.side is None else (edit.side,):
            grids[edit.constraint, side][first : last + 1] = not edit.remove
            if edit.name and not edit.remove:
                names.setdefault((edit.constraint, side), []).append((first, last + 1, edit.name))
    marks = []
    for (constraint, side), marked in grids.items():
        for start, stop in _runs(marked):
            named = [name for a, b, name in names.get((constraint, side), []) if a < stop and start < b]
            marks.append(Mark(constraint, side, start, stop, named[-1] if named else ""))
    return tuple(marks)


def _fixed(
    template: QuantisedTemplate, bits: Mapping[str, int], constraint: Constraint, side: Side, locomotion: bool
) -> Bool:
    """Return a mask (N,) of the columns that fix all features of a constraint, without runs below `MIN_COLUMNS`."""
    fixed = np.ones(len(template), np.bool_)
    features = {side[0] + name: value for name, value in FEATURES[constraint].items()}
    if not features.keys() <= bits.keys() or (constraint == "foot_to_front" and not locomotion):
        return np.zeros(len(template), np.bool_)
    for name, value in features.items():
        bit = np.uint64(1 << bits[name])
        fixed &= (template.mask & bit != 0) & ((template.value & bit != 0) == value)
    for start, stop in _runs(fixed):
        if stop - start < MIN_COLUMNS:
            fixed[start:stop] = False
    return fixed


def _runs(marked: Bool) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(marked, prepend=False, append=False)).reshape(-1, 2).tolist()
    return [(start, stop) for start, stop in edges]


class PositionPulls(NamedTuple):
    """Terms that pull joints towards positions, see `ops.tracking.observations.PriorTerms`, for hits of quality 1."""

    frames: I64
    joints: I64
    directions: F64
    targets: F64
    weights: F64


def ground_pulls(body: ChainBody, positions: F64, standing: Bool, side: Side) -> PositionPulls:
    """Return the terms that pull the joints of a foot to their heights when the foot stands (thesis, Eq. 6.7).

    Parameters
    ----------
    body : ChainBody
        The body.
    positions : float64 array (J, 3, T)
        The joints of the track in metres, Y up.
    standing : bool array (T,)
        The frames in which the foot is on the ground.
    side : str
        "left" or "right".
    """
    frames = np.flatnonzero(standing)
    parts = []
    for name in ("ankle", "toes"):
        joint = body.chain.joint(side[0] + name)
        floor = np.percentile(positions[joint, 1], GROUND_PERCENTILE)
        up = np.tile([0.0, 1.0, 0.0], (len(frames), 1))
        parts.append(_pulls(frames, joint, up, np.full(len(frames), floor), GROUND_M))
    return joined(parts)


def front_pulls(
    body: ChainBody, poses: Poses, positions: F64, moving: Bool, constraint: Constraint, side: Side, rate_hz: float
) -> PositionPulls:
    """Return the terms that pull a hand or foot forwards if it moves more slowly than its feature requires.

    Parameters
    ----------
    body : ChainBody
        The body.
    poses : Poses
        The poses of the track.
    positions : float64 array (J, 3, T)
        The joints of the track in metres, Y up.
    moving : bool array (T,)
        The frames in which the joint moves to the front.
    constraint : str
        "hand_to_front" or "foot_to_front".
    side : str
        "left" or "right".
    rate_hz : float
        Frames per second.
    """
    chain = body.chain
    joint = chain.joint(side[0] + ("wrist" if constraint == "hand_to_front" else "ankle"))
    arm = np.linalg.norm(body.offsets[chain.joint(side[0] + "elbow")])
    forwards = poses.rotations[:, 0, :, 2] * [1.0, 0.0, 1.0]
    lengths = np.linalg.norm(forwards, axis=1)
    forwards = forwards / np.maximum(lengths, 1e-9)[:, None]
    apart = (positions[joint] - positions[chain.joint("root")]).T
    way = np.einsum("ta,ta->t", np.diff(apart, axis=0, prepend=apart[:1]), forwards)
    missing = FRONT_SPEED[constraint] * arm / rate_hz - way
    slow = moving & (missing > 0) & (lengths > 1e-3)
    slow[:1] = False
    frames = np.flatnonzero(slow)
    at = np.einsum("ta,ta->t", positions[joint].T[frames], forwards[frames])
    return _pulls(frames, joint, forwards[frames], at + missing[frames], FRONT_M)


def _pulls(frames: I64, joint: int, directions: F64, targets: F64, sigma_m: float) -> PositionPulls:
    joints = np.full(len(frames), joint, np.int64)
    return PositionPulls(frames, joints, directions, targets, np.full(len(frames), sigma_m**-2.0))


def joined(parts: Sequence[PositionPulls]) -> PositionPulls:
    """Concatenate terms, sorted by frame; terms of the same frame keep their order."""
    if not parts:
        none = np.zeros(0, np.int64)
        return PositionPulls(none, none, np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    order = np.argsort(columns[0], kind="stable")
    return PositionPulls(*(column[order] for column in columns))


def straight_elbow(body: ChainBody, poses: Poses, bent: Bool, side: Side) -> tuple[int, Bool, F64]:
    """Return the node of an elbow, the frames in which it is too straight, and the rotation towards which it is pulled.

    Parameters
    ----------
    body : ChainBody
        The body.
    poses : Poses
        The poses of the track.
    bent : bool array (T,)
        The frames in which the elbow should be bent.
    side : str
        "left" or "right".

    Returns
    -------
    node : int
        The node of the elbow.
    straight : bool array (T,)
        The frames with less flexion than `BENT_AT_RAD`.
    target : float64 array (3, 3)
        The rotation of the node at the flexion `BENT_AT_RAD`.
    """
    node = body.chain.nodes.index(side[0] + "elbow")
    axis = body.chain.axes_of(node)[0]
    straight = np.zeros(len(bent), np.bool_)
    for t in np.flatnonzero(bent).tolist():
        straight[t] = axis.sign * vector_of(poses.rotations[t, node])[axis.direction] < BENT_AT_RAD
    vector = np.zeros(3)
    vector[axis.direction] = axis.sign * BENT_AT_RAD
    return node, straight, rotation_of(vector)
