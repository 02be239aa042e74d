"""This module defines the end effectors, and the joints by which poses from depth images are compared (Eq. 8.1)."""

from __future__ import annotations

from itertools import permutations

import numpy as np

from kinedex.ops.arrays import F64, Bool
from kinedex.ops.body.joint_tree import JOINTS

END_EFFECTORS = np.array([JOINTS.index(name) for name in ("lfingers", "rfingers", "ltoes", "rtoes", "headtop")])
"""The five end effectors (E⁵ in Section 8.3.3 of the thesis): hands, feet, and the top of the head."""

UNCOMPARED = ("lclavicle", "rclavicle", "belly", "head")
"""Joints that distances and errors ignore; for example, clavicles coincide with the neck in Acclaim skeletons."""

COMPARED = np.array([k for k, name in enumerate(JOINTS) if name not in UNCOMPARED])
"""The indices of the J = 20 joints that distances and errors use."""


FOUND_M = 0.2
"""Distance in metres below which an extremum counts as the detection of an end effector."""


def are_ends_found(extrema: F64, poses: F64) -> Bool:
    """Return a mask of frames whose five end effectors are matched one to one by extrema (thesis, Section 8.5.1).

    Parameters
    ----------
    extrema : float64 array (T, 5, 3)
        The first five geodesic extrema of each frame in metres; NaN where there are fewer.
    poses : float64 array (T, 24, 3)
        The true joints in the same axes.

    Returns
    -------
    bool array (T,)
        True where each of the five end effectors is nearer than `FOUND_M` to a different extremum.
    """
    apart = np.linalg.norm(extrema[:, None] - poses[:, END_EFFECTORS, None], axis=3)
    near = apart < FOUND_M
    found = np.zeros(len(poses), np.bool_)
    for order in permutations(range(len(END_EFFECTORS))):
        found |= near[:, np.arange(len(order)), order].all(axis=1)
    return found
