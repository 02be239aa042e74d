"""This module models the body surface in front of a simulated depth camera: round cones with clothes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64, I64
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.errors import ParameterError

REFERENCE_HEIGHT_M = 1.70
"""The standing height in metres of the body for which radii are given."""


@dataclass(frozen=True, eq=False)
class Clothes:
    """Clothes modelled as bumps of the surface.

    Attributes
    ----------
    waves_m : float
        Height w of waves in the axes of the camera, in metres: the radius grows by
        w sin(40x + φ) sin(37y + 2φ) sin(33z), with φ drawn from 0 to 6.
    folds_m, fold_length_m : float64 array (C,)
        Height h of the folds around each cone and the distance ℓ between two of them, in metres: where a point lies a
        metres along the axis, the radius grows by h sin²(π a / ℓ + ψ), with ψ drawn from 0 to π for each cone.
    """

    waves_m: float
    folds_m: F64
    fold_length_m: F64

    def __post_init__(self) -> None:
        if not 0 <= self.waves_m < np.inf or not ((self.folds_m >= 0) & np.isfinite(self.folds_m)).all():
            raise ParameterError("clothes", "bumps of 0 or more metres", [self.waves_m, self.folds_m.tolist()])
        if not (self.fold_length_m > 0).all():
            raise ParameterError("fold_length_m", "above 0", self.fold_length_m.tolist())


@dataclass(frozen=True, eq=False)
class Flesh:
    """C round cones on the joints of a body, before a person's sizes are drawn.

    The end e of cone c lies at Σ weights[c, e, j] · joint j + forward_m[c, e] · facing; the second end lies beyond_m[c]
    metres on in the direction from the joint beyond[c, 0] to the joint beyond[c, 1].

    Attributes
    ----------
    weights : float64 array (C, 2, 24)
        Weights of the joints, in the order of `JOINTS`.
    forward_m : float64 array (C, 2)
        Metres in front of these positions; negative behind them.
    beyond : int64 array (C, 2)
        Two joints.
    beyond_m : float64 array (C,)
        Metres in the direction from one to the other.
    radii : float64 array (C, 2)
        Radii in metres of a body that stands 1.70 m high.
    kinds : int64 array (C,)
        The kind of part of each cone; parts of a kind share a factor.
    factors : float64 array (K, 2)
        The smallest and the largest factor of the radii of each kind.
    clothes : Clothes
        Bumps of the surface.
    """

    weights: F64
    forward_m: F64
    beyond: I64
    beyond_m: F64
    radii: F64
    kinds: I64
    factors: F64
    clothes: Clothes


@dataclass(frozen=True, eq=False)
class Surface:
    """The sizes and bumps of the C cones of one person, in metres.

    Attributes
    ----------
    radii : float64 array (C, 2)
        Radii at both ends of each cone.
    wave_m, wave_phase : float
        Height and phase of waves.
    folds : float64 array (C, 3)
        Height, radians per metre and phase of the folds around each cone.
    """

    radii: F64
    wave_m: float
    wave_phase: float
    folds: F64

    @property
    def step(self) -> float:
        """Return the factor of a distance by which a ray may safely advance: 0.9, and less where folds are steep."""
        steepest = float((self.folds[:, 0] * self.folds[:, 1]).max(initial=0.0))
        return 0.9 / (1.0 + steepest)


def draw_surface(flesh: Flesh, height_m: float, generator: np.random.Generator) -> Surface:
    """Draw the sizes of a person's body parts and the phases of the clothes.

    Parameters
    ----------
    flesh : Flesh
        The cones.
    height_m : float
        Standing height of the person in metres.
    generator : numpy.random.Generator
        Draws factors and phases.
    """
    if not 0 < height_m < np.inf:
        raise ParameterError("height_m", "above 0", height_m)
    factors = generator.uniform(flesh.factors[:, 0], flesh.factors[:, 1])
    radii = flesh.radii * factors[flesh.kinds, None] * (height_m / REFERENCE_HEIGHT_M)
    phase = float(generator.uniform(0.0, 6.0))
    clothes = flesh.clothes
    turns = generator.uniform(0.0, np.pi, len(radii))
    folds = np.stack([clothes.folds_m, np.pi / clothes.fold_length_m, turns], axis=1)
    return Surface(np.ascontiguousarray(radii), clothes.waves_m, phase, np.ascontiguousarray(folds))


def facing(joints: F64) -> F64:
    """Return the horizontal unit vectors (…, 3) that bodies face, from joints (…, 24, 3) with Y up.

    They are perpendicular to the lines from the right to the left shoulder and hip; 0 where there is no such direction.
    """
    at = {name: joints[..., JOINTS.index(name), :] for name in ("lshoulder", "rshoulder", "lhip", "rhip")}
    across = (at["lshoulder"] - at["rshoulder"]) + (at["lhip"] - at["rhip"])
    ahead = np.cross(across, joints[..., JOINTS.index("neck"), :] - joints[..., JOINTS.index("root"), :])
    ahead[..., 1] = 0.0
    length = np.linalg.norm(ahead, axis=-1, keepdims=True)
    unit: F64 = np.divide(ahead, length, out=np.zeros_like(ahead), where=length > 0)
    return unit


def cone_ends(flesh: Flesh, joints: F64) -> F64:
    """Return the ends (T, C, 2, 3) of the cones' axes, from joints (T, 24, 3) in metres with Y up."""
    ends = np.einsum("cej,tjk->tcek", flesh.weights, joints)
    ends += flesh.forward_m[None, :, :, None] * facing(joints)[:, None, None, :]
    ways = joints[:, flesh.beyond[:, 1]] - joints[:, flesh.beyond[:, 0]]
    length = np.linalg.norm(ways, axis=-1, keepdims=True)
    ends[:, :, 1] += flesh.beyond_m[:, None] * np.divide(ways, length, out=np.zeros_like(ways), where=length > 0)
    found: F64 = ends
    return found
