"""This module defines the synthetic body: the bones of an Acclaim skeleton in the proportions of one actor."""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass

import numpy as np

PARENTS: dict[str, str] = {
    "lhipjoint": "root",
    "lfemur": "lhipjoint",
    "ltibia": "lfemur",
    "lfoot": "ltibia",
    "ltoes": "lfoot",
    "rhipjoint": "root",
    "rfemur": "rhipjoint",
    "rtibia": "rfemur",
    "rfoot": "rtibia",
    "rtoes": "rfoot",
    "lowerback": "root",
    "upperback": "lowerback",
    "thorax": "upperback",
    "lowerneck": "thorax",
    "upperneck": "lowerneck",
    "head": "upperneck",
    "lclavicle": "thorax",
    "lhumerus": "lclavicle",
    "lradius": "lhumerus",
    "lwrist": "lradius",
    "lhand": "lwrist",
    "lfingers": "lhand",
    "lthumb": "lwrist",
    "rclavicle": "thorax",
    "rhumerus": "rclavicle",
    "rradius": "rhumerus",
    "rwrist": "rradius",
    "rhand": "rwrist",
    "rfingers": "rhand",
    "rthumb": "rwrist",
}
"""The parent of every bone, in the order in which the bones are numbered; parents come first."""

_DOFS = {
    "femur": "rx ry rz",
    "tibia": "rx",
    "foot": "rx rz",
    "toes": "rx",
    "clavicle": "ry rz",
    "humerus": "rx ry rz",
    "radius": "rx",
    "wrist": "ry",
    "hand": "rx rz",
    "fingers": "rx",
    "thumb": "rx rz",
}
SPINE = ("lowerback", "upperback", "thorax")
NECK = ("lowerneck", "upperneck", "head")

# Limb lengths in metres of an actor of size 1; "hip" is the offset from the root to a hip joint.
_LENGTHS = {
    "hipjoint": 0.150,
    "femur": 0.412,
    "tibia": 0.392,
    "foot": 0.136,
    "toes": 0.064,
    "lowerback": 0.142,
    "upperback": 0.148,
    "thorax": 0.150,
    "lowerneck": 0.080,
    "upperneck": 0.082,
    "head": 0.085,
    "clavicle": 0.205,
    "humerus": 0.286,
    "radius": 0.172,
    "wrist": 0.086,
    "hand": 0.062,
    "fingers": 0.050,
    "thumb": 0.072,
}
_GROUPS = {
    "leg": ("femur", "tibia"),
    "foot": ("foot", "toes"),
    "spine": (*SPINE, *NECK),
    "arm": ("humerus", "radius", "wrist", "hand", "fingers", "thumb"),
    "shoulder": ("clavicle",),
    "hip": ("hipjoint",),
}

BALL_HEIGHT = 0.028
"""Height in metres above the floor of the ball of a foot that stands flat."""
FOOT_SLOPE = math.radians(37.0)
"""Slope in radians of the foot bone, from ankle to ball, of a foot that stands flat."""

_NAMES = ("al", "bo", "cy", "di", "ed", "fi", "gu", "ha", "io", "jo", "ka", "lu", "mo", "ny", "ov", "pa")


@dataclass(frozen=True)
class Bone:
    """A bone: rest direction (unit vector), length in metres, axis angles in degrees (XYZ) and degrees of freedom."""

    name: str
    parent: str
    direction: tuple[float, float, float]
    length: float
    axis: tuple[float, float, float]
    dofs: tuple[str, ...]


@dataclass(frozen=True)
class Body:
    """The skeleton of one actor."""

    bones: tuple[Bone, ...]

    def bone(self, name: str) -> Bone:
        """Return the bone of this name."""
        return next(bone for bone in self.bones if bone.name == name)

    def length(self, *names: str) -> float:
        """Return the total length of the given bones in metres."""
        return sum(self.bone(name).length for name in names)

    @property
    def leg(self) -> float:
        """Return the length from hip to ankle of the shorter leg in metres, the unit of all motion on the floor."""
        return min(self.length("lfemur", "ltibia"), self.length("rfemur", "rtibia"))

    @property
    def ankle_height(self) -> float:
        """Return the height in metres of the ankle above the floor if the foot stands flat."""
        return BALL_HEIGHT + math.sin(FOOT_SLOPE) * self.bone("lfoot").length

    @property
    def standing_root_height(self) -> float:
        """Return the height in metres of the root above the floor with straight legs."""
        hip = self.bone("lhipjoint")
        return self.leg + self.ankle_height - hip.direction[1] * hip.length


def _rest(name: str, splay: float, palm: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return rest direction and axis angles of a bone; the left side is at +X, and the body faces +Z."""
    side = {"l": 1.0, "r": -1.0}[name[0]]
    part = name[1:]
    slant = math.radians(splay)
    down = (side * math.sin(slant), -math.cos(slant), 0.0)
    if part == "hipjoint":
        return (side * 0.71, -0.655, 0.26), (0.0, 0.0, 0.0)
    if part in ("femur", "tibia"):
        return down, (0.0, 0.0, side * splay)
    if part == "foot":
        fall = math.sin(FOOT_SLOPE)
        return (down[0] * fall, down[1] * fall, math.cos(FOOT_SLOPE)), (-90.0, 0.0, side * splay)
    if part == "toes":
        return (0.0, 0.0, 1.0), (-90.0, 0.0, side * splay)
    if part == "clavicle":
        return (side * 0.985, 0.160, -0.060), (0.0, 0.0, 0.0)
    if part in ("humerus", "radius"):
        return (side, 0.0, 0.0), (180.0, -side * palm, -side * 90.0)
    if part == "thumb":
        return (side * math.sqrt(0.5), 0.0, math.sqrt(0.5)), (-90.0, side * 45.0, 0.0)
    return (side, 0.0, 0.0), (0.0, side * 90.0, side * 90.0)


_TRUNK = {
    "lowerback": (0.0, 0.955, -0.297),
    "upperback": (0.0, 0.999, -0.030),
    "thorax": (0.0, 0.996, 0.085),
    "lowerneck": (0.0, 0.990, 0.130),
    "upperneck": (0.0, 0.990, -0.125),
    "head": (0.0, 0.998, -0.055),
}


def build_body(scale: dict[str, float], *, splay: float = 20.0, palm: float = 30.0, asymmetry: float = 0.0) -> Body:
    """Build a body in the proportions of one actor.

    Parameters
    ----------
    scale : dict[str, float]
        Factor of the limb lengths of each group: leg, foot, spine, arm, shoulder, hip.
    splay : float
        Spread of the legs in the rest position, in degrees.
    palm : float
        Rotation of the elbow's axis in the rest position, in degrees.
    asymmetry : float
        Relative difference in length between the left and the right limbs.

    Returns
    -------
    Body
        The body; its root is the origin of the rest position, Y up, facing +Z.
    """
    factor = {part: scale[group] for group, parts in _GROUPS.items() for part in parts}
    bones = []
    for name, parent in PARENTS.items():
        if name in _TRUNK:
            length, direction, axis = _LENGTHS[name] * factor[name], _TRUNK[name], (0.0, 0.0, 0.0)
            dofs: tuple[str, ...] = ("rx", "ry", "rz")
        else:
            part = name[1:]
            uneven = 1.0 + (asymmetry if name[0] == "l" else -asymmetry) / 2
            length = _LENGTHS[part] * factor[part] * uneven
            direction, axis = _rest(name, splay, palm)
            dofs = tuple(_DOFS[part].split()) if part in _DOFS else ()
        norm = math.sqrt(sum(value * value for value in direction))
        unit = (direction[0] / norm, direction[1] / norm, direction[2] / norm)
        bones.append(Bone(name, parent, unit, length, axis, dofs))
    return Body(tuple(bones))


@dataclass(frozen=True)
class Actor:
    """An actor: body proportions, posture, and variation between repetitions.

    Attributes
    ----------
    tempo, range : float
        Factors of the speed and the size of every motion.
    unsteady : float
        Relative standard deviation of speed and size between repetitions.
    loose : float
        Standard deviation in seconds of the timing of a hand, the trunk or the head.
    careless : float
        Standard deviation of the target positions of hands, in arm lengths.
    manner : float
        Factor of the variation of a motion between repetitions.
    restless : float
        Factor of sway, fidgeting and noise.
    swing : float
        Factor of the swing of the arms.
    hang_out, hang_down, hang_ahead : float
        Position of the hanging hands relative to the shoulders: outwards, down and forwards.
    stoop, lean, nod : float
        Angles of trunk and head in standing, in degrees.
    stance, toes_out : float
        Half the distance between the feet, and their outward rotation, in standing.
    over_toes : float
        Distance of the pelvis in front of the balls of the feet.
    """

    name: str
    seed: int
    body: Body
    tempo: float
    range: float
    unsteady: float
    loose: float
    careless: float
    manner: float
    restless: float
    swing: float
    hang_out: float
    hang_down: float
    hang_ahead: float
    stoop: float
    lean: float
    nod: float
    stance: float
    toes_out: float
    over_toes: float

    def habit(self, what: str, low: float, high: float) -> float:
        """Return a uniform random number in [low, high) that is always the same for this actor and property."""
        rng = np.random.default_rng([self.seed, zlib.crc32(what.encode())])
        return float(rng.uniform(low, high))

    def likes(self, what: str, *choices: str, steady: float, rng: np.random.Generator) -> str:
        """Return one of several ways to perform a motion: with probability `steady` the usual way of this actor."""
        usual = choices[int(self.habit(what, 0.0, len(choices) - 1e-9))]
        return usual if rng.random() < steady else choices[int(rng.integers(len(choices)))]


def actor_name(number: int) -> str:
    """Return the two-letter name of the actor with this number, counted from 0."""
    if number < len(_NAMES):
        return _NAMES[number]
    every = [a + b for a in "abcdefghijklmnopqrstuvwxyz" for b in "abcdefghijklmnopqrstuvwxyz"]
    return [name for name in every if name not in _NAMES][number - len(_NAMES)]


def draw_actor(number: int, seed: int) -> Actor:
    """Draw the actor with this number, counted from 0; the same seed gives the same actor."""
    rng = np.random.default_rng([seed, 7, number])
    size = float(np.clip(rng.normal(1.0, 0.055), 0.87, 1.13))
    scale = {part: size * float(rng.normal(1.0, 0.03)) for part in ("leg", "foot", "spine", "arm", "shoulder", "hip")}
    body = build_body(
        scale, splay=float(rng.uniform(16, 22)), palm=float(rng.uniform(25, 35)), asymmetry=float(rng.normal(0, 0.01))
    )
    # Tall bodies move more slowly; a random factor adds to this. It is stratified, so that even a few actors differ.
    strata = (number * 0.381966 + rng.uniform(0.0, 0.25)) % 1.0
    tempo = (1.16 - 0.32 * strata) / size**0.5
    return Actor(
        name=actor_name(number),
        seed=seed * 1000 + number,
        body=body,
        tempo=tempo,
        range=float(rng.uniform(0.86, 1.12)),
        unsteady=float(rng.uniform(0.08, 0.15)),
        loose=float(rng.uniform(0.025, 0.05)),
        careless=float(rng.uniform(0.035, 0.06)),
        manner=float(rng.uniform(0.8, 1.4)),
        restless=float(rng.uniform(0.8, 1.4)),
        swing=float(rng.uniform(0.7, 1.5)),
        hang_out=float(rng.uniform(0.10, 0.24)),
        hang_down=float(rng.uniform(0.925, 0.97)),
        hang_ahead=float(rng.uniform(0.0, 0.2)),
        stoop=float(rng.uniform(-3, 12)),
        lean=float(rng.normal(0, 1.5)),
        nod=float(rng.uniform(-8, 14)),
        stance=float(rng.uniform(0.11, 0.19)),
        toes_out=float(rng.uniform(2, 16)),
        over_toes=float(rng.uniform(-0.13, -0.07)),
    )
