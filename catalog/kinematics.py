"""Read files that define kinematic chains: nodes with their axes and joints, and the capsules of the body's surface."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.configs import Located, config_path, load_yaml
from kinedex.ops.body.capsules import Capsule, Surface
from kinedex.ops.body.kinematic_chain import Axis, JointRest, KinematicChain
from kinedex.ops.errors import did_you_mean

AxisName = Literal["x", "y", "z", "-x", "-y", "-z"]


class _Node(BaseModel):
    model_config = ConfigDict(extra="forbid")
    parent: str | None = None
    centre: str
    axes: list[AxisName] = Field(min_length=1, max_length=3)
    pull: float | None = Field(None, gt=0, allow_inf_nan=False)
    hinge: tuple[float, float] | None = None


class _Joint(BaseModel):
    model_config = ConfigDict(extra="forbid")
    node: str
    start: str | None = Field(None, alias="from")
    along: tuple[float, float, float] | None = None
    at: str | None = None
    measured: bool = False


class _Height(BaseModel):
    model_config = ConfigDict(extra="forbid")
    low: list[str] = Field(alias="from", min_length=1)
    high: str = Field(alias="to")
    metres: float = Field(gt=0, allow_inf_nan=False)


class _Capsule(BaseModel):
    model_config = ConfigDict(extra="forbid")
    start: str = Field(alias="from")
    end: str = Field(alias="to")
    radius: float = Field(gt=0, allow_inf_nan=False)


class _Surface(BaseModel):
    model_config = ConfigDict(extra="forbid")
    height: _Height
    capsules: list[_Capsule] = Field(min_length=1)


class _ChainFile(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str
    description: str = ""
    nodes: dict[str, _Node] = Field(min_length=1)
    joints: dict[str, _Joint] = Field(min_length=1)
    surface: _Surface | None = None


def load_kinematic_chain(name: str | Path = "body48") -> KinematicChain:
    """Read a kinematic chain.

    Parameters
    ----------
    name : str or Path, optional
        The name of a shipped file of `configs/kinematics`, or the path of one.

    Raises
    ------
    ConfigError
        There is no such file, or it is invalid; the message names the line.
    """
    return _load(config_path("kinematics", name))


@lru_cache(maxsize=8)
def _load(path: Path) -> KinematicChain:
    return parse_kinematic_chain(load_yaml(path))


def parse_kinematic_chain(located: Located) -> KinematicChain:
    """Return the kinematic chain of a parsed file.

    Raises
    ------
    ConfigError
        The file is invalid; the message names the line, the key and what was expected.
    """
    file = located.model(_ChainFile)
    nodes, joints = tuple(file.nodes), tuple(file.joints)
    for key, node in file.nodes.items():
        _check_node(located, file, key, node)
    for key, joint in file.joints.items():
        _check_joint(located, file, key, joint)
    for key, node in file.nodes.items():
        mover, above = file.joints[node.centre].node, node.parent or nodes[0]
        if mover != above:
            message = f"must be a joint that node '{above}' moves; '{node.centre}' is moved by '{mover}'"
            raise located.error(message, "nodes", key, "centre")
    rest = tuple(
        JointRest(nodes.index(joint.node), joints.index(joint.start or joint.at or name), joint.along, joint.measured)
        for name, joint in file.joints.items()
    )
    parents = tuple(-1 if node.parent is None else nodes.index(node.parent) for node in file.nodes.values())
    centres = tuple(joints.index(node.centre) for node in file.nodes.values())
    axes = tuple(_axis(k, axis, node) for k, node in enumerate(file.nodes.values()) for axis in node.axes)
    return KinematicChain(file.name, nodes, parents, centres, axes, joints, rest)


def load_surface(name: str | Path = "body48") -> Surface:
    """Read the capsules that form the surface of a kinematic chain.

    Parameters
    ----------
    name : str or Path, optional
        The name of a shipped file of `configs/kinematics`, or the path of one.

    Raises
    ------
    ConfigError
        There is no such file, it is invalid, or it has no `surface`; the message names the line.
    """
    return parse_surface(load_yaml(config_path("kinematics", name)))


def parse_surface(located: Located) -> Surface:
    """Return the surface of the kinematic chain of a parsed file.

    Raises
    ------
    ConfigError
        The file is invalid, or has no surface; the message names the line, the key and what was expected.
    """
    chain, file = parse_kinematic_chain(located), located.model(_ChainFile)
    if file.surface is None:
        message = "has no `surface`, which silhouettes need; copy that of configs/kinematics/body48.yaml"
        raise located.error(message)
    height = file.surface.height
    low = tuple(_surface_joint(located, chain, name, "height", "from", i) for i, name in enumerate(height.low))
    high = _surface_joint(located, chain, height.high, "height", "to")
    capsules = []
    for i, capsule in enumerate(file.surface.capsules):
        start = _surface_joint(located, chain, capsule.start, "capsules", i, "from")
        end = _surface_joint(located, chain, capsule.end, "capsules", i, "to")
        if start == end:
            raise located.error("must be between two joints", "surface", "capsules", i)
        capsules.append(Capsule(start, end, capsule.radius))
    return Surface(tuple(capsules), low, high, height.metres)


def _surface_joint(located: Located, chain: KinematicChain, name: str, *keys: str | int) -> int:
    if name not in chain.joints:
        near = did_you_mean(name, chain.joints)
        raise located.error(f"must be one of `joints`, got '{name}'{near}", "surface", *keys)
    return chain.joint(name)


def _axis(node: int, name: AxisName, settings: _Node) -> Axis:
    low, high = (-np.inf, np.inf) if settings.hinge is None else np.deg2rad(settings.hinge)
    pull = np.inf if settings.pull is None else settings.pull
    return Axis(node, "xyz".index(name[-1]), -1.0 if name[0] == "-" else 1.0, pull, (float(low), float(high)))


def _check_node(located: Located, file: _ChainFile, key: str, node: _Node) -> None:
    earlier = list(file.nodes)[: list(file.nodes).index(key)]
    if node.parent is None and earlier:
        raise located.error("must have a parent: only the first node has none", "nodes", key)
    if node.parent is not None and node.parent not in earlier:
        near = did_you_mean(node.parent, earlier)
        raise located.error(f"must be a node before it, got '{node.parent}'{near}", "nodes", key, "parent")
    if node.centre not in file.joints:
        near = did_you_mean(node.centre, file.joints)
        raise located.error(f"must be one of `joints`, got '{node.centre}'{near}", "nodes", key, "centre")
    if len({axis[-1] for axis in node.axes}) < len(node.axes):
        raise located.error(f"must name each axis once, got {', '.join(node.axes)}", "nodes", key, "axes")
    if node.hinge is not None and (len(node.axes) > 1 or not node.hinge[0] < node.hinge[1]):
        raise located.error("must be the least and the greatest turn of a node with one axis", "nodes", key, "hinge")


def _check_joint(located: Located, file: _ChainFile, key: str, joint: _Joint) -> None:
    if joint.node not in file.nodes:
        near = did_you_mean(joint.node, file.nodes)
        raise located.error(f"must be one of `nodes`, got '{joint.node}'{near}", "joints", key, "node")
    if [joint.along is not None, joint.at is not None, joint.measured].count(True) != 1:
        raise located.error("must have one of `along` (with `from`), `at` and `measured`", "joints", key)
    if (joint.along is None) != (joint.start is None):
        raise located.error("must have `along` and `from` together", "joints", key)
    for name, other in (("from", joint.start), ("at", joint.at)):
        if other is not None and other not in file.joints:
            near = did_you_mean(other, file.joints)
            raise located.error(f"must be one of `joints`, got '{other}'{near}", "joints", key, name)
