"""This module defines the tree of the 24 named joints: the parent of each joint."""

from __future__ import annotations

import numpy as np

JOINT_PARENTS = {
    "root": None, "lhip": "root", "lknee": "lhip", "lankle": "lknee", "ltoes": "lankle",
    "rhip": "root", "rknee": "rhip", "rankle": "rknee", "rtoes": "rankle",
    "belly": "root", "chest": "belly", "neck": "chest", "head": "neck", "headtop": "head",
    "lclavicle": "neck", "lshoulder": "lclavicle", "lelbow": "lshoulder", "lwrist": "lelbow", "lfingers": "lwrist",
    "rclavicle": "neck", "rshoulder": "rclavicle", "relbow": "rshoulder", "rwrist": "relbow", "rfingers": "rwrist",
}  # fmt: skip
"""The parent of each named joint; None for the root. Parents come before their children."""

JOINTS = tuple(JOINT_PARENTS)
"""The 24 named joints in their order, parents before children."""

PARENTS = np.array([-1 if parent is None else JOINTS.index(parent) for parent in JOINT_PARENTS.values()], np.int64)
"""The index of the parent of each of `JOINTS`; −1 for the root."""
