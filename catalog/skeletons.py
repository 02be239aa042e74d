"""Skeleton mappings: how the joints of a source's skeleton become the named joints that features speak of."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field

from catalog.configs import Located, config_path, load_yaml
from ops.errors import SourceError, did_you_mean

F64 = npt.NDArray[np.float64]


class _Virtual(BaseModel):
    model_config = ConfigDict(extra="forbid")
    virtual: dict[str, float] = Field(min_length=1)


class _SkeletonFile(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str
    description: str = ""
    format: Literal["acclaim"]
    up: Literal["x", "y", "z"] = "y"
    handedness: Literal["right", "left"] = "right"
    facing: Literal["x", "y", "z"] = "z"
    unit_m: float = Field(gt=0)
    joints: dict[str, str | _Virtual | None]


@dataclass(frozen=True)
class SkeletonMapping:
    """One mapping file.

    joints: named joint → a node of the source's skeleton, or weights over other named joints (a virtual joint), or None
    where the skeleton has no such joint. axes: (3, 3), turns source coordinates into X, Y up, Z (right-handed).
    """

    name: str
    path: Path
    digest: str
    unit_m: float
    axes: F64
    joints: dict[str, str | dict[str, float] | None]

    def apply(self, source: str, nodes: dict[str, int], positions: F64, joints: tuple[str, ...]) -> F64:
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
        result = np.full((len(joints), 3, positions.shape[2]), np.nan)
        for i, joint in enumerate(joints):
            node = self.joints.get(joint)
            if isinstance(node, str):
                if node not in nodes:
                    raise SourceError(
                        source,
                        f"the skeleton has no '{node}', which mapping '{self.name}' ({self.path}) takes for joint "
                        f"'{joint}'{did_you_mean(node, nodes)}",
                    )
                result[i] = positions[nodes[node]]
        for i, joint in enumerate(joints):
            weights = self.joints.get(joint)
            if isinstance(weights, dict):
                result[i] = sum(weight * result[joints.index(other)] for other, weight in weights.items())
        if not np.array_equal(self.axes, np.eye(3)):
            result = np.einsum("ab,jbt->jat", self.axes, result)
        return np.ascontiguousarray(result)


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
    targets = {joint: _target(located, parsed, joint) for joint in parsed.joints}
    digest = hashlib.sha256(json.dumps(parsed.model_dump(), sort_keys=True).encode()).hexdigest()[:16]
    return SkeletonMapping(parsed.name, located.path, digest, parsed.unit_m, _axes(located, parsed), targets)


def _target(located: Located, parsed: _SkeletonFile, joint: str) -> str | dict[str, float] | None:
    value = parsed.joints[joint]
    if not isinstance(value, _Virtual):
        return value
    for other in value.virtual:
        if not isinstance(parsed.joints.get(other), str):
            raise located.error(
                f"a virtual joint is made of joints that the skeleton has; '{other}' is none"
                f"{did_you_mean(other, [name for name, node in parsed.joints.items() if isinstance(node, str)])}",
                "joints", joint,
            )  # fmt: skip
    if abs(sum(value.virtual.values()) - 1.0) > 1e-9:
        raise located.error(f"the weights must add up to 1, got {sum(value.virtual.values()):g}", "joints", joint)
    return dict(value.virtual)


def _axes(located: Located, parsed: _SkeletonFile) -> F64:
    """The turn that takes the mapping's axes to ours: its up to +Y, its facing to +Z."""
    if parsed.up == parsed.facing:
        raise located.error("up and facing must be different axes", "facing")
    up, facing = np.eye(3)["xyz".index(parsed.up)], np.eye(3)["xyz".index(parsed.facing)]
    side = np.cross(up, facing) * (1.0 if parsed.handedness == "right" else -1.0)
    return np.stack([side, up, facing])
