"""The cones of the design's table as a simulated body, for tests of the kernels alone."""

from __future__ import annotations

import numpy as np

from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.simulation.depth_rays import Clothes, Flesh

Mixture = dict[str, float]

MIDDLE = (
    ("pelvis", {"lhip": 1.0}, {"rhip": 1.0}, 0.100, 0.100),
    ("trunk", {"root": 1.0}, {"neck": 1.0}, 0.110, 0.085),
    ("neck", {"neck": 1.0}, {"head": 1.0}, 0.055, 0.055),
    ("head", {"head": 0.8, "headtop": 0.2}, {"headtop": 1.0}, 0.090, 0.095),
)
SIDES = (
    ("side", {"hip": 0.6, "root": 0.4}, {"shoulder": 0.62, "neck": 0.38}, 0.095, 0.090),
    ("shoulder", {"neck": 0.7, "shoulder": 0.3}, {"shoulder": 1.0}, 0.065, 0.060),
    ("upper arm", {"shoulder": 1.0}, {"elbow": 1.0}, 0.054, 0.044),
    ("forearm", {"elbow": 1.0}, {"wrist": 1.0}, 0.043, 0.032),
    ("hand", {"wrist": 1.0}, {"fingers": 1.0}, 0.034, 0.024),
    ("thigh", {"hip": 1.0}, {"knee": 1.0}, 0.085, 0.060),
    ("shank", {"knee": 1.0}, {"ankle": 1.0}, 0.058, 0.040),
    ("foot", {"ankle": 1.0}, {"toes": 1.0}, 0.042, 0.030),
)


def weights(mixture: Mixture, side: str = "") -> np.ndarray:
    """Return the weights (24,) of a mixture of joints of a side."""
    found = np.zeros(len(JOINTS))
    for joint, part in mixture.items():
        found[JOINTS.index(joint if joint in JOINTS else side + joint)] = part
    return found


def table_flesh(factors: tuple[float, float] = (1.0, 1.0), waves_m: float = 0.0, folds_m: float = 0.0) -> Flesh:
    """Return the twenty cones with one factor per kind of part."""
    rows = [(name, a, b, ra, rb, "") for name, a, b, ra, rb in MIDDLE]
    rows += [(name, a, b, ra, rb, side) for side in "lr" for name, a, b, ra, rb in SIDES]
    kinds = [*dict.fromkeys(row[0] for row in rows)]
    ends = np.array([[weights(a, side), weights(b, side)] for _, a, b, _, _, side in rows])
    cones = len(rows)
    return Flesh(
        ends,
        np.zeros((cones, 2)),
        np.zeros((cones, 2), np.int64),
        np.zeros(cones),
        np.array([[ra, rb] for _, _, _, ra, rb, _ in rows]),
        np.array([kinds.index(row[0]) for row in rows]),
        np.tile(factors, (len(kinds), 1)).astype(float),
        Clothes(waves_m, np.full(cones, folds_m), np.full(cones, 0.1)),
    )
