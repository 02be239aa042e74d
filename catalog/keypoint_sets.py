"""Read keypoint sets: the order of keypoints in the files of a pose estimator, and their positions on the body.

A set is a file of `configs/keypoints`. The positions of all keypoints are in `named.yaml`, which all sets share.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from kinedex.catalog.configs import Located, config_names, config_path, load_yaml
from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.ops.arrays import F64
from kinedex.ops.body.kinematic_chain import ChainBody, KinematicChain
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.tracking.observations import BodyPoints

NAMED = "named"
"""The keypoint set for files that name their keypoints, in any order."""

_LIMBS = tuple(
    (f"{side}_{start}", f"{side}_{end}")
    for start, end in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"), ("eye", "ear"))
    for side in ("left", "right")
)

MAX_KEYPOINTS = 1000
"""Maximum number of keypoints of a set."""


@dataclass(frozen=True)
class KeypointPlace:
    """The position of a keypoint on a body.

    Attributes
    ----------
    joint : str
        The named joint that the keypoint coincides with; empty if there is none.
    node : str
        The node of the kinematic chain that moves the keypoint.
    offset : tuple of (float, float, float)
        The position from the node's centre in the frame of the node, in metres or in lengths of `bone`.
    bone : str
        The joint, moved by the node, whose distance from the node's centre is the unit of the offset; empty for metres.
    middle : tuple of str
        Two joints, moved by the node, with the keypoint halfway between them; empty if `offset` gives the position.
    """

    joint: str = ""
    node: str = ""
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bone: str = ""
    middle: tuple[str, ...] = ()


@dataclass(frozen=True)
class KeypointSet:
    """The keypoints of a pose estimator.

    Attributes
    ----------
    name : str
        The name of the set.
    order : tuple of str
        Names of its keypoints in the order of files that do not name them; empty for the set `named`.
    positions : mapping of str to KeypointPlace
        The position on the body of each keypoint that has one, by name.
    by_count : bool
        True if the number of keypoints in a file suffices to recognise this set.
    """

    name: str
    order: tuple[str, ...]
    positions: Mapping[str, KeypointPlace]
    by_count: bool

    def body_points(self, names: Sequence[str], body: ChainBody) -> BodyPoints:
        """Return the positions of keypoints on a body.

        Parameters
        ----------
        names : sequence of str
            P keypoints, each with a position in this set.
        body : ChainBody
            The body.

        Returns
        -------
        BodyPoints
            Node, offset and joint of each keypoint.

        Raises
        ------
        KinedexError
            A keypoint has no position in this set.
        """
        chain = body.chain
        nodes, joints = np.zeros(len(names), np.int64), np.full(len(names), -1, np.int64)
        offsets = np.zeros((len(names), 3))
        for p, name in enumerate(names):
            if name not in self.positions:
                near = did_you_mean(name, self.positions)
                raise KinedexError(f"keypoint '{name}' has no place in the keypoint set '{self.name}'{near}")
            place = self.positions[name]
            if place.joint:
                joints[p] = chain.joint(place.joint)
                nodes[p], offsets[p] = chain.rest[joints[p]].node, body.offsets[joints[p]]
                continue
            nodes[p] = chain.nodes.index(place.node)
            if place.middle:
                offsets[p] = np.mean([body.offsets[chain.joint(joint)] for joint in place.middle], axis=0)
            else:
                unit_m = np.linalg.norm(body.offsets[chain.joint(place.bone)]) if place.bone else 1.0
                offsets[p] = unit_m * np.array(place.offset)
        return BodyPoints(nodes, offsets, joints)


class _Point(BaseModel):
    model_config = ConfigDict(extra="forbid")
    joint: str = ""
    node: str = ""
    offset: tuple[FiniteFloat, FiniteFloat, FiniteFloat] | None = None
    bone: str = ""
    middle: tuple[str, str] | None = None


class _SetFile(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str = Field(min_length=1)
    description: str = ""
    by_count: bool = True
    order: list[str] = Field([], max_length=MAX_KEYPOINTS)
    points: dict[str, str | dict[str, Any]] = {}


def load_keypoint_set(name: str | Path) -> KeypointSet:
    """Return a keypoint set for the body of `configs/kinematics/body48.yaml`.

    Parameters
    ----------
    name : str or Path
        The name of a shipped file of `configs/keypoints`, or the path of one.

    Raises
    ------
    ConfigError
        There is no such file, or it is invalid; the message names the line.
    """
    return _load(config_path("keypoints", name))


@lru_cache(maxsize=16)
def _load(path: Path) -> KeypointSet:
    return parse_keypoint_set(load_yaml(path), load_kinematic_chain())


def parse_keypoint_set(located: Located, chain: KinematicChain) -> KeypointSet:
    """Return the keypoint set of a parsed file.

    Parameters
    ----------
    located : Located
        The file.
    chain : KinematicChain
        The chain whose nodes and joints the file names.

    Raises
    ------
    ConfigError
        The file is invalid; the message names the line, the key and what was expected.
    """
    file = located.model(_SetFile)
    twice = next((i for i, name in enumerate(file.order) if name in file.order[:i]), None)
    if twice is not None:
        raise located.error(f"keypoint '{file.order[twice]}' stands twice", "order", twice)
    positions = {joint: KeypointPlace(joint=joint) for joint in chain.joints}
    if file.name != NAMED:
        positions |= load_keypoint_set(NAMED).positions
    positions |= {name: _place(located, chain, name, point) for name, point in file.points.items()}
    if file.order:
        unknown = next((name for name in file.points if name not in file.order), None)
        if unknown is not None:
            raise located.error(f"must be one of `order`{did_you_mean(unknown, file.order)}", "points", unknown)
        positions = {name: positions[name] for name in file.order if name in positions}
    return KeypointSet(file.name, tuple(file.order), positions, file.by_count and bool(file.order))


def _place(located: Located, chain: KinematicChain, name: str, point: str | dict[str, Any]) -> KeypointPlace:
    """Return the position of a keypoint; names of joints and nodes are checked against the chain."""
    at = ("points", name)
    given = located.model(_Point, *at, data={"joint": point} if isinstance(point, str) else point)
    named = {"joint": given.joint, "bone": given.bone}
    named |= {f"middle[{i}]": joint for i, joint in enumerate(given.middle or ())}
    for key, joint in named.items():
        if joint and joint not in chain.joints:
            near = did_you_mean(joint, chain.joints)
            raise located.error(f"{key} must be a joint of the body, got '{joint}'{near}", *at)
    if [bool(given.joint), bool(given.node), given.middle is not None].count(True) != 1:
        raise located.error("must be a joint, or have one of `node` (with `offset`) and `middle`", *at)
    if bool(given.node) != (given.offset is not None) or (given.bone and not given.node):
        raise located.error("must have `node` and `offset` together, and `bone` only with them", *at)
    movers = {joint: chain.nodes[chain.rest[chain.joint(joint)].node] for joint in named.values() if joint}
    if given.node and given.node not in chain.nodes:
        near = did_you_mean(given.node, chain.nodes)
        raise located.error(f"must be a node of the body, got '{given.node}'{near}", *at, "node")
    if given.bone and movers[given.bone] != given.node:
        raise located.error(f"must be a joint that '{given.node}' moves, got '{given.bone}'", *at, "bone")
    if given.middle and len({movers[joint] for joint in given.middle}) > 1:
        raise located.error(f"must be two joints that one node moves, got {' and '.join(given.middle)}", *at, "middle")
    node = movers[given.middle[0]] if given.middle else given.node
    return KeypointPlace(given.joint, node, given.offset or (0.0, 0.0, 0.0), given.bone, given.middle or ())


@lru_cache(maxsize=1)
def keypoint_sets_by_count() -> Mapping[int, tuple[KeypointSet, ...]]:
    """Return a dict from number of keypoints to the shipped sets that are recognised by this number."""
    shipped = [load_keypoint_set(name) for name in config_names("keypoints")]
    counts = sorted({len(one.order) for one in shipped if one.by_count})
    return {count: tuple(one for one in shipped if one.by_count and len(one.order) == count) for count in counts}


def likeliest_set(sets: Sequence[KeypointSet], points: F64) -> KeypointSet:
    """Return the keypoint set whose order makes the limbs shortest, among sets with the same number of keypoints.

    In a wrong order, many limbs would connect distant parts of the body.

    Parameters
    ----------
    sets : sequence of KeypointSet
        Sets with P keypoints.
    points : float64 array (N, P, 2) or (N, P, 3)
        Keypoints of N persons; NaN where a keypoint is missing.
    """
    lengths = []
    for one in sets:
        ends = [(one.order.index(a), one.order.index(b)) for a, b in _LIMBS if {a, b} <= {*one.order}]
        bones = np.array([np.linalg.norm(points[:, a] - points[:, b], axis=-1) for a, b in ends])
        seen = bones[np.isfinite(bones)]
        lengths.append(float(np.mean(seen)) if len(seen) else np.inf)
    return sets[int(np.argmin(lengths))]
