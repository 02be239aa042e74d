"""Read the files that define bodies to be fitted to depth images: round cones, surface samples, pivots and height."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.configs import Located, config_path, load_yaml
from kinedex.ops.arrays import I64
from kinedex.ops.body.joint_tree import JOINTS, PARENTS
from kinedex.ops.depth.cones import ConeBody, moved_joints
from kinedex.ops.errors import did_you_mean

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Mixture = str | dict[str, Positive]

_SUM = 1e-6


class _Height(BaseModel):
    model_config = ConfigDict(extra="forbid")
    radii_at: Positive
    plus: float = Field(0.0, ge=0, allow_inf_nan=False)
    bones: dict[str, Positive] = Field(min_length=1)


class _Cone(BaseModel):
    model_config = ConfigDict(extra="forbid")
    start: Mixture = Field(alias="from")
    end: Mixture = Field(alias="to")
    radii: tuple[Positive, Positive]
    samples: list[Share] = []
    angles: list[Annotated[float, Field(ge=-3.2, le=3.2)]] = Field([0.0], min_length=1)


class _BodyFile(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str
    description: str = ""
    height: _Height
    pivots: dict[str, Annotated[float, Field(ge=0, allow_inf_nan=False)]] = Field(min_length=1)
    cones: dict[str, _Cone] = Field(min_length=1)


def load_body(name: str | Path = "cones20") -> ConeBody:
    """Read the definition of a body that can be fitted to depth images.

    Parameters
    ----------
    name : str or Path, optional
        The name of a shipped file of `configs/bodies`, or the path of one.

    Raises
    ------
    ConfigError
        There is no such file, or it is invalid; the message names the line.
    """
    return _load(config_path("bodies", name))


@lru_cache(maxsize=8)
def _load(path: Path) -> ConeBody:
    return parse_body(load_yaml(path))


def standing_height(bone_lengths: npt.ArrayLike) -> float:
    """Return the standing height of an actor in metres, computed by the rule of the shipped body.

    Parameters
    ----------
    bone_lengths : float64 array (24,)
        The length in metres of the bone that ends at each joint; 0 for the root.
    """
    return load_body().standing_height(bone_lengths)


def parse_body(located: Located) -> ConeBody:
    """Return the body of a parsed file.

    Raises
    ------
    ConfigError
        The file is invalid; the message names the line, the key and what was expected.
    """
    file = located.model(_BodyFile)
    pivots = _pivots(located, file)
    for name, cone in file.cones.items():
        _check_chain(located, name, cone, pivots)
    most = max(len(mixture) for cone in file.cones.values() for mixture in (_shares(cone.start), _shares(cone.end)))
    joints, shares = np.zeros((len(file.cones), 2, most), np.int64), np.zeros((len(file.cones), 2, most))
    for c, cone in enumerate(file.cones.values()):
        for e, mixture in enumerate((_shares(cone.start), _shares(cone.end))):
            for m, (joint, share) in enumerate(mixture.items()):
                joints[c, e, m], shares[c, e, m] = JOINTS.index(joint), share
    bones = np.zeros(len(JOINTS))
    for name, factor in file.height.bones.items():
        bones[_joint(located, name, "height", "bones", name)] = factor
    samples = [
        (c, place, angle)
        for c, cone in enumerate(file.cones.values())
        for place in cone.samples
        for angle in cone.angles
    ]
    if not samples:
        raise located.error("must have `samples` in at least one cone", "cones")
    return ConeBody(
        file.name,
        tuple(file.cones),
        joints,
        shares,
        np.array([cone.radii for cone in file.cones.values()]),
        file.height.radii_at,
        bones,
        file.height.plus,
        np.array([c for c, _, _ in samples], np.int64),
        np.array([place for _, place, _ in samples]),
        np.array([angle for _, _, angle in samples]),
        pivots,
        np.array(list(file.pivots.values())),
    )


def _pivots(located: Located, file: _BodyFile) -> I64:
    """Return the indices of the pivot joints; raise an error unless the root is first and parents precede children."""
    pivots: list[int] = []
    for name in file.pivots:
        joint = _joint(located, name, "pivots", name)
        if not pivots and joint != 0:
            raise located.error(f"must begin with '{JOINTS[0]}', which moves the whole body", "pivots", name)
        if pivots and PARENTS[joint] not in pivots:
            above = JOINTS[PARENTS[joint]]
            raise located.error(f"must come after '{above}', the joint that it hangs from", "pivots", name)
        if joint not in PARENTS:
            raise located.error("must be a joint with another one below it", "pivots", name)
        pivots.append(joint)
    missing = sorted({JOINTS[parent] for parent in PARENTS[1:]} - set(file.pivots))
    if missing:
        raise located.error(f"must have every joint with another one below it; {', '.join(missing)} missing", "pivots")
    return np.array(pivots, np.int64)


def _check_chain(located: Located, name: str, cone: _Cone, pivots: I64) -> None:
    """Raise an error if an end is not a mixture of joints, or if the pivots that move the cone form no single chain."""
    joints = []
    for key, end in (("from", cone.start), ("to", cone.end)):
        mixture = _shares(end)
        joints += [_joint(located, joint, "cones", name, key) for joint in mixture]
        if abs(sum(mixture.values()) - 1.0) > _SUM:
            raise located.error(f"must have shares that add up to 1, got {sum(mixture.values()):g}", "cones", name, key)
    if _shares(cone.start) == _shares(cone.end):
        raise located.error("must be between two places", "cones", name)
    moved = moved_joints(pivots)
    moving = [k for k in range(len(pivots)) if moved[k, joints].any()]
    for upper, lower in pairwise(moving):
        if not moved[upper, pivots[lower]]:
            one, other = JOINTS[pivots[upper]], JOINTS[pivots[lower]]
            message = f"must have joints that hang one below the other, and '{one}' and '{other}' move different ones"
            raise located.error(message, "cones", name)


def _shares(mixture: Mixture) -> dict[str, float]:
    return {mixture: 1.0} if isinstance(mixture, str) else mixture


def _joint(located: Located, name: str, *keys: str) -> int:
    if name not in JOINTS:
        raise located.error(f"must be a named joint, got '{name}'{did_you_mean(name, JOINTS)}", *keys)
    return JOINTS.index(name)
