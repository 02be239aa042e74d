"""Positions of a synthetic body's bones, computed by the oracle of forward kinematics."""

from __future__ import annotations

import numpy as np

from kinedex.ops.synth.body import Body
from kinedex.ops.synth.solve import columns
from tests.oracles.kinematics import pose


def places(body: Body, angles: np.ndarray) -> dict[str, np.ndarray]:
    """Far end of the root and of every bone in each row of an angle table, (T, 3), metres."""
    skeleton = {
        "root_order": ("tx", "ty", "tz", "rx", "ry", "rz"),
        "root_axis": "XYZ",
        "root_orientation": (0.0, 0.0, 0.0),
        "root_position": (0.0, 0.0, 0.0),
        "bones": {
            bone.name: {
                "parent": bone.parent, "direction": bone.direction, "length": bone.length, "axis": bone.axis,
                "order": "XYZ", "dofs": bone.dofs,
            }
            for bone in body.bones
        },
    }  # fmt: skip
    ends: dict[str, list[np.ndarray]] = {}
    for row in angles:
        frame, column = {}, 0
        for name, dofs in columns(body):
            frame[name] = list(row[column : column + len(dofs)])
            column += len(dofs)
        for name, place in pose(skeleton, frame, 1.0).items():
            ends.setdefault(name, []).append(place)
    return {name: np.array(rows) for name, rows in ends.items()}
