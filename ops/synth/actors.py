"""This module defines the actors of the synthetic archive by their proportions and their manner of moving."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from kinedex.ops.synth.body import Body, build_body

_NAMES = ("al", "bo", "cy", "di", "ed", "fi", "gu", "ha", "io", "jo", "ka", "lu", "mo", "ny", "ov", "pa")


@dataclass(frozen=True)
class Actor:
    """An actor: body proportions, posture, and variation between repetitions.

    Attributes
    ----------
    tempo, range : float
        Factors on speed and size of every motion.
    unsteady : float
        Relative standard deviation of both between repetitions.
    loose : float
        Standard deviation in seconds of the timing of a hand, the trunk or the head.
    careless : float
        Standard deviation of the targets of hands, in arm lengths.
    manner : float
        Factor on the variation of a motion between repetitions.
    restless : float
        Factor on sway, fidgeting and noise.
    swing : float
        Factor on the swing of the arms.
    hang_out, hang_down, hang_ahead : float
        Position of the hanging hands.
    stoop, lean, nod : float
        Trunk and head in standing, degrees.
    stance, toes_out : float
        The feet in standing.
    over_toes : float
        Distance of the pelvis ahead of the balls of the feet.
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
        """Return one of several ways to do something, with probability `steady` the actor's usual one."""
        usual = choices[int(self.habit(what, 0.0, len(choices) - 1e-9))]
        return usual if rng.random() < steady else choices[int(rng.integers(len(choices)))]


def actor_name(number: int) -> str:
    """Return the two-letter name of the actor with this number, counted from 0."""
    if number < len(_NAMES):
        return _NAMES[number]
    every = [a + b for a in "abcdefghijklmnopqrstuvwxyz" for b in "abcdefghijklmnopqrstuvwxyz"]
    return [name for name in every if name not in _NAMES][number - len(_NAMES)]


def cast(number: int, seed: int) -> Actor:
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
