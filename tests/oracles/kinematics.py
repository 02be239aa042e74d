"""Naive twin of forward kinematics: the Acclaim rules frame by frame, as the format's description states them."""

from __future__ import annotations

import math

import numpy as np


def turn(axis: str, degrees: float) -> np.ndarray:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return {
        "X": np.array([[1, 0, 0], [0, c, -s], [0, s, c]]),
        "Y": np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]),
        "Z": np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
    }[axis]


def in_order(angles: dict[str, float], order: str) -> np.ndarray:
    """The first listed axis is applied first."""
    matrix = np.eye(3)
    for axis in order:
        matrix = turn(axis, angles.get(axis, 0.0)) @ matrix
    return matrix


def pose(skeleton: dict, frame: dict[str, list[float]], metres: float) -> dict[str, np.ndarray]:
    """Positions of the far ends of all bones for one AMC frame, with L = C · M · C⁻¹.

    skeleton: root_order, root_axis, root_orientation, root_position, bones {name: parent, direction, length, axis,
    order, dofs}, parents first.
    """
    values = dict(zip(skeleton["root_order"], frame["root"], strict=True))
    angles = {dof[1].upper(): value for dof, value in values.items() if dof[0] == "r"}
    order = "".join(dof[1].upper() for dof in skeleton["root_order"] if dof[0] == "r")
    c = in_order(dict(zip("XYZ", skeleton["root_orientation"], strict=True)), skeleton["root_axis"])
    orientation = {"root": in_order(angles, order) @ c}
    moved = np.array([values.get("t" + axis, 0.0) for axis in "xyz"])
    position = {"root": (moved + np.array(skeleton["root_position"])) * metres}
    for name, bone in skeleton["bones"].items():
        values = dict(zip(bone["dofs"], frame.get(name, []), strict=True))
        angles = {dof[1].upper(): value for dof, value in values.items() if dof[0] == "r"}
        order = "".join(dof[1].upper() for dof in bone["dofs"] if dof[0] == "r")
        c = in_order(dict(zip("XYZ", bone["axis"], strict=True)), bone["order"])
        local = c @ in_order(angles, order) @ np.linalg.inv(c)
        orientation[name] = orientation[bone["parent"]] @ local
        direction = np.array(bone["direction"], float)
        size = np.linalg.norm(direction)
        vector = direction / size * (bone["length"] + values.get("l", 0.0)) if size else np.zeros(3)
        start = position[bone["parent"]]
        shift = np.array([values.get("t" + axis, 0.0) for axis in "xyz"])
        start = start + orientation[bone["parent"]] @ c @ shift * metres
        position[name] = start + orientation[name] @ vector * metres
    return position
