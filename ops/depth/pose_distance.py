"""The distance of two poses over the joints that depth images are judged by (thesis, Eq. 8.1)."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import numpy.typing as npt

from kinedex.ops.body.joint_tree import JOINTS

F64 = npt.NDArray[np.float64]

END_EFFECTORS = np.array([JOINTS.index(name) for name in ("lfingers", "rfingers", "ltoes", "rtoes", "headtop")])
"""The joints E⁵ of the thesis, 8.3.3: hands, feet, and the top of the head."""

UNCOMPARED = ("lclavicle", "rclavicle", "belly", "head")
"""Joints that distances and errors leave out: clavicles coincide with the neck in Acclaim skeletons."""

COMPARED = np.array([k for k, name in enumerate(JOINTS) if name not in UNCOMPARED])
"""The J = 20 joints of distances and errors."""


FOUND_M = 0.2
"""An end of the body is found where an extremum is nearer to it than this."""


def are_ends_found(extrema: F64, poses: F64) -> npt.NDArray[np.bool_]:
    """Return whether the five ends of bodies have an extremum each, one to one (thesis, Section 8.5.1).

    Parameters
    ----------
    extrema : float64 array (T, 5, 3)
        The first five geodesic extrema of each frame in metres; NaN where there are fewer.
    poses : float64 array (T, 24, 3)
        The true joints in the same axes.

    Returns
    -------
    bool array (T,)
        True where all five ends are nearer than `FOUND_M` to an extremum of their own.
    """
    apart = np.linalg.norm(extrema[:, None] - poses[:, END_EFFECTORS, None], axis=3)
    near = apart < FOUND_M
    found = np.zeros(len(poses), np.bool_)
    for order in permutations(range(len(END_EFFECTORS))):
        found |= near[:, np.arange(len(order)), order].all(axis=1)
    return found


def pose_distance(pose: F64, others: F64) -> F64:
    """Return the root mean square distance of the compared joints.

    The thesis prints ‖P₁ − P₂‖ / J, with which a joint that is 10 cm away gives 0.5 cm; the root mean square is 2.2 cm.

    Parameters
    ----------
    pose : float64 array (24, 3)
        A pose in metres.
    others : float64 array (…, 24, 3)
        Other poses in metres.

    Returns
    -------
    float64 array (…)
        d_P in metres.
    """
    apart = np.asarray(others)[..., COMPARED, :] - np.asarray(pose)[COMPARED]
    return np.asarray(np.sqrt((apart**2).sum(axis=(-2, -1))) / math.sqrt(len(COMPARED)))
