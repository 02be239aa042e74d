"""The actors of the synthetic archive, with their proportions and their manner of moving."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from kinedex.ops.synth.body import Body, build_body

_NAMES = ("al", "bo", "cy", "di", "ed", "fi", "gu", "ha", "io", "jo", "ka", "lu", "mo", "ny", "ov", "pa")


@dataclass(frozen=True)
class Actor:
    """One actor: a body, a way to stand, and how steadily motions are repeated.

    Attributes
    ----------
    tempo, range : float
        Factors on speed and size of every motion.
    unsteady : float
        Relative spread of both between repetitions.
    loose : float
        Spread in seconds by which a hand, the trunk or the head is early or late.
    careless : float
        Spread of places that hands go to, in arm lengths.
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
        """Return this actor's lasting preference in a matter, between two values."""
        rng = np.random.default_rng([self.seed, zlib.crc32(what.encode())])
        return float(rng.uniform(low, high))

    def likes(self, what: str, *choices: str, steady: float, rng: np.random.Generator) -> str:
        """Return the manner in which this actor does something, another than the habitual one with 1 − steady."""
        usual = choices[int(self.habit(what, 0.0, len(choices) - 1e-9))]
        return usual if rng.random() < steady else choices[int(rng.integers(len(choices)))]


def actor_name(number: int) -> str:
    """Return the two letters of the actor with this number, from 0."""
    if number < len(_NAMES):
        return _NAMES[number]
    every = [a + b for a in "abcdefghijklmnopqrstuvwxyz" for b in "abcdefghijklmnopqrstuvwxyz"]
    return [name for name in every if name not in _NAMES][number - len(_NAMES)]


def cast(number: int, seed: int) -> Actor:
    """Draw the actor with this number, from 0; the same seed gives the same actor."""
    rng = np.random.default_rng([seed, 7, number])
    size = float(np.clip(rng.normal(1.0, 0.055), 0.87, 1.13))
    scale = {part: size * float(rng.normal(1.0, 0.03)) for part in ("leg", "foot", "spine", "arm", "shoulder", "hip")}
    body = build_body(
        scale, splay=float(rng.uniform(16, 22)), palm=float(rng.uniform(25, 35)), asymmetry=float(rng.normal(0, 0.01))
    )
    # A tall body swings slower; temper adds the rest. Drawn in strata, so that few actors differ already.
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
