"""This module defines scores, which describe a performance by keyframes on channels, and evaluates smooth curves.

The channels describe the pelvis, the feet, the spine, the head and the hands, not joint angles. Lengths of pelvis and
feet are in leg lengths of the actor, lengths of the hands in arm lengths, and angles in degrees, so that a motion can
be performed by every body.

- The pelvis has px, py and pz in the world, where py is relative to upright standing, and the angles yaw (positive to
  the left), pitch (forwards) and roll (to the right).
- Each foot (l, r) has x, y and z of its ball in the world, or of its ankle where free = 1, and the angles yaw, pitch
  (heel up) and knee (turned outwards). Where free = 0 the foot keeps its angle in the world, where free = 1 it hangs
  from the shin.
- The spine has bend (forwards), side (to the right) and twist (to the left); neck and head have nod, tilt and look for
  the same directions.
- Each hand has hx (outwards), hy (up) and hz (forwards) of the wrist relative to the shoulder in the frame of the
  chest, swivel of the elbow about the line from shoulder to wrist, wrist (flexion) and hroll (rotation of the hand).
"""

from __future__ import annotations

import math

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.synth.body import Actor

PELVIS = ("px", "py", "pz", "yaw", "pitch", "roll")
FOOT = ("x", "y", "z", "yaw", "pitch", "knee", "free")
TRUNK = ("bend", "side", "twist")
HEAD = ("nod", "look", "tilt")
HAND = ("hx", "hy", "hz", "swivel", "wrist", "hroll")

CHANNELS: tuple[str, ...] = (
    *PELVIS,
    *("l" + part for part in FOOT),
    *("r" + part for part in FOOT),
    *TRUNK,
    *HEAD,
    *("l" + part for part in HAND),
    *("r" + part for part in HAND),
)
INDEX: dict[str, int] = {name: i for i, name in enumerate(CHANNELS)}

# Channels of one body part share their timing errors, so that the part is early or late as a whole.
GROUP: dict[str, str] = dict.fromkeys(PELVIS, "pelvis")
GROUP |= {side + part: side + "foot" for side in "lr" for part in FOOT}
GROUP |= dict.fromkeys(TRUNK, "trunk") | dict.fromkeys(HEAD, "head")
GROUP |= {side + part: side + "hand" for side in "lr" for part in HAND}


_SHORTEST = 0.035
"""Minimum time in seconds between two keys of a channel, as closer keys would require implausible speeds."""

# Standard deviations between repetitions of the trunk, head and hands, in the channels' own units.
_OFF = {
    "bend": 7.0, "side": 5.0, "twist": 12.0, "nod": 6.0, "look": 8.0, "tilt": 2.5, "pitch": 2.5, "roll": 1.2,
    "lhx": 0.04, "lhy": 0.03, "lhz": 0.05, "lswivel": 10.0, "lhroll": 15.0,
    "rhx": 0.04, "rhy": 0.03, "rhz": 0.05, "rswivel": 10.0, "rhroll": 15.0,
}  # fmt: skip


class Score:
    """The keys of one performance on all channels, which motions append in order of time.

    `now` is the time in seconds at which the next motion begins. Motions are written relative to an anchor, which is
    the midpoint between the feet and their direction when the motion begins. Each motion therefore continues where the
    previous motion ended.
    """

    def __init__(self, actor: Actor, rng: np.random.Generator) -> None:
        self.actor = actor
        self.rng = rng
        self.now = 0.0
        self.pace = 1.0
        self.size = 1.0
        self.keys: list[list[tuple[float, float]]] = [[(0.0, 0.0)] for _ in CHANNELS]
        self.late: dict[str, float] = {}
        self.manner: dict[str, float] = {}
        self.wound = 0.0  # full turns of the roll so far, in degrees: after a cartwheel the body stands upright at 360
        self.anchor = (0.0, 0.0, 0.0)
        width = actor.stance
        self.place(lx=width, rx=-width, lyaw=actor.toes_out, ryaw=-actor.toes_out, lknee=4.0, rknee=4.0)
        self.place(pz=actor.over_toes, py=-0.012, **self.rest("l"), **self.rest("r"), **self.rest_trunk())

    # ---- variation ----------------------------------------------------------------------------------------
    def begin(self, what: str = "") -> None:
        """Begin a motion: set the anchor to the actor's position, and draw the variation of this repetition.

        Parameters
        ----------
        what : str
            The name of the motion; a part of the variation is always the same for an actor and a motion.
        """
        self.anchor = self.standing()
        actor = self.actor
        self.pace = actor.tempo * math.exp(self.rng.normal(0.0, actor.unsteady))
        self.size = actor.range * math.exp(self.rng.normal(0.0, 0.8 * actor.unsteady))
        self.late = {group: float(self.rng.normal(0.0, actor.loose)) for group in sorted(set(GROUP.values()))}
        self.late["lfoot"] = self.late["rfoot"] = self.late["pelvis"] = 0.0
        self.manner = {name: self._manner(what, name) for name in _OFF}

    def _manner(self, what: str, name: str) -> float:
        """Return the offset of a channel in this repetition: mostly the actor's habit, partly random."""
        spread = _OFF[name] * self.actor.manner
        lasting = self.actor.habit(f"{what}.{name}", -1.7, 1.7) if what else 0.0
        return spread * (0.9 * lasting + 0.6 * float(self.rng.normal()))

    def beat(self, seconds: float) -> float:
        """Return the duration of a movement for this actor, at random about a given standard duration."""
        return seconds / self.pace * math.exp(self.rng.normal(0.0, 0.6 * self.actor.unsteady))

    def vary(self, value: float, spread: float = 0.12) -> float:
        """Return a value with the actor's scale and a relative random variation."""
        return value * self.size * (1.0 + self.rng.normal(0.0, spread))

    def about(self, value: float, spread: float) -> float:
        """Return a value with an absolute random variation, in its own unit."""
        return value + float(self.rng.normal(0.0, spread))

    # ---- keys ---------------------------------------------------------------------------------------------
    def value(self, name: str) -> float:
        """Return the last value that was written to a channel."""
        return self.keys[INDEX[name]][-1][1]

    def place(self, **targets: float) -> None:
        """Set channels at the current time, without interpolation from earlier values."""
        for name, value in targets.items():
            self._put(name, self.now, value)

    def move(self, start: float, stop: float, **targets: float) -> None:
        """Move channels to targets between two times, in seconds from `now`; these end ongoing ones."""
        for name, target in targets.items():
            value = target + self.manner.get(name, 0.0) + (self.wound if name == "roll" else 0.0)
            late = self.late.get(GROUP[name], 0.0)
            begin = self.now + start + late
            last, held = self.keys[INDEX[name]][-1]
            if begin > last + 0.06:
                self._put(name, begin, held)
            elif begin < last - 0.06:
                self._interrupt(name, begin)
            self._put(name, self.now + stop + late, value)

    def _interrupt(self, name: str, time: float) -> None:
        """Cut off an ongoing movement at a time, so that the next one continues from the value reached."""
        keys = self.keys[INDEX[name]]
        while len(keys) > 2 and keys[-2][0] + _SHORTEST >= time:
            keys.pop()
        if len(keys) > 1 and keys[-2][0] + _SHORTEST < time:
            (begin, first), (end, last) = keys[-2:]
            done = (time - begin) / (end - begin)
            keys[-1] = (time, first + (last - first) * done * done * (3.0 - 2.0 * done))

    def _put(self, name: str, time: float, value: float) -> None:
        keys = self.keys[INDEX[name]]
        if time <= keys[-1][0] + _SHORTEST:
            if len(keys) == 1 or time <= keys[-1][0]:
                keys[-1] = (keys[-1][0], value)
            else:
                keys[-1] = (time, value)
            return
        keys.append((time, value))

    # ---- places -------------------------------------------------------------------------------------------
    def standing(self) -> tuple[float, float, float]:
        """Return the midpoint between the feet, x and z in leg lengths, and their direction, yaw in degrees."""
        x = (self.value("lx") + self.value("rx")) / 2
        z = (self.value("lz") + self.value("rz")) / 2
        yaw = (self.value("lyaw") + self.value("ryaw")) / 2
        return x, z, yaw

    def room(self, x: float, z: float) -> tuple[float, float]:
        """Return the world coordinates of a position given relative to the anchor: x to the left, z to the front."""
        ox, oz, yaw = self.anchor
        s, c = math.sin(math.radians(yaw)), math.cos(math.radians(yaw))
        return ox + x * c + z * s, oz - x * s + z * c

    def pelvis(self, start: float, stop: float, x: float, z: float, yaw: float | None = None, **others: float) -> None:
        """Move the pelvis over a position relative to the anchor; yaw is also relative to the anchor."""
        px, pz = self.room(x, z + self.actor.over_toes)
        if yaw is not None:
            others["yaw"] = self.anchor[2] + yaw
        self.move(start, stop, px=px, pz=pz, **others)

    def step(
        self, side: str, start: float, stop: float, place: tuple[float, float], yaw: float = 0.0, lift: float = 0.08,
        heel: float = 30.0, strike: float = -12.0,
    ) -> None:  # fmt: skip
        """Lift a foot and put it down at a position relative to the anchor, heel first for a negative `strike`."""
        fx, fz = self.room(*place)
        out = self.actor.toes_out if side == "l" else -self.actor.toes_out
        span = stop - start
        lift = lift * math.exp(self.rng.normal(0.0, 0.15))
        self.move(start, stop, **{side + "x": fx, side + "z": fz, side + "yaw": self.anchor[2] + yaw + out})
        self.move(start - 0.25 * span, start + 0.12 * span, **{side + "pitch": heel})
        self.move(start, start + 0.4 * span, **{side + "y": lift, side + "free": 0.0})
        self.move(start + 0.4 * span, stop, **{side + "y": 0.0})
        self.move(start + 0.25 * span, stop - 0.1 * span, **{side + "pitch": strike})
        self.move(stop, stop + 0.3 * span, **{side + "pitch": 0.0})

    # ---- poses --------------------------------------------------------------------------------------------
    def rest(self, side: str) -> dict[str, float]:
        """Return the position of the relaxed hanging hand of one side, with a small random variation."""
        actor = self.actor
        place = {
            "hx": self.about(actor.hang_out, 0.03), "hy": self.about(-actor.hang_down, 0.015),
            "hz": self.about(actor.hang_ahead, 0.05), "swivel": self.about(10.0, 8.0),
            "wrist": self.about(8.0, 6.0), "hroll": self.about(0.0, 12.0),
        }  # fmt: skip
        return {side + name: value for name, value in place.items()}

    def rest_trunk(self) -> dict[str, float]:
        """Return the posture of trunk and head in standing."""
        actor = self.actor
        return {
            "bend": self.about(actor.stoop, 2.0), "side": self.about(actor.lean, 1.0), "twist": self.about(0.0, 2.0),
            "nod": self.about(actor.nod, 4.0), "look": self.about(0.0, 6.0), "tilt": self.about(0.0, 2.0),
        }  # fmt: skip

    def relax(self, start: float, stop: float, *parts: str) -> None:
        """Move arms ("l", "r"), trunk ("trunk"), or all of them without arguments, back to the standing posture."""
        for part in parts or ("l", "r", "trunk"):
            self.move(start, stop, **(self.rest_trunk() if part == "trunk" else self.rest(part)))

    def hand(self, side: str, start: float, stop: float, x: float, y: float, z: float, **others: float) -> None:
        """Move a hand to a position relative to its shoulder, in arm lengths: outwards, up, forwards."""
        spread = self.actor.careless
        targets = {"hx": self.about(x, spread), "hy": self.about(y, spread), "hz": self.about(z, spread)} | others
        self.move(start, stop, **{side + name: value for name, value in targets.items()})

    def hands(self, start: float, stop: float, x: float, y: float, z: float, **others: float) -> None:
        """Move both hands to mirrored positions."""
        for side in "lr":
            self.hand(side, start, stop, x, y, z, **others)

    def stand(self, start: float, stop: float, *parts: str) -> None:
        """Move the given parts, or all of the body, back to upright standing over the feet."""
        x, z, yaw = self.standing()
        s, c = math.sin(math.radians(yaw)), math.cos(math.radians(yaw))
        over = self.actor.over_toes
        self.move(
            start, stop, px=x + over * s, pz=z + over * c, py=-0.012, yaw=yaw, pitch=self.about(0.0, 1.5),
            roll=self.about(0.0, 1.0), lknee=self.about(4.0, 2.0), rknee=self.about(4.0, 2.0),
        )  # fmt: skip
        self.relax(start, stop, *parts)

    def hurry(self, seconds: float) -> None:
        """Move `now` back by a number of seconds, so that the next motion begins before the last one ends."""
        self.now -= seconds

    def after(self, seconds: float) -> None:
        """Move `now` forward by a number of seconds, so that the next motion begins later."""
        self.now += seconds


def curves(score: Score, rate_hz: float, stop: float) -> F64:
    """Interpolate the keys of every channel by monotone cubics, smooth the corners, and sample the curves.

    Parameters
    ----------
    score : Score
        The keys.
    rate_hz : float
        Frames per second.
    stop : float
        End of the performance in seconds.

    Returns
    -------
    float64 array (T, C)
        The values of the C channels (`CHANNELS`) in each of the T frames before `stop`.
    """
    times = np.arange(round(stop * rate_hz)) / rate_hz
    result = np.empty((len(times), len(CHANNELS)))
    for i, keys in enumerate(score.keys):
        table = np.array(keys)
        result[:, i] = _monotone(table[:, 0], table[:, 1], times)
    return _rounded(result, 0.028 * rate_hz)


def _monotone(knots: F64, values: F64, times: F64) -> F64:
    """Interpolate by monotone cubics without overshoot (Fritsch and Carlson); constant outside the knots."""
    if len(knots) == 1:
        return np.full(len(times), values[0])
    gaps = np.diff(knots)
    slopes = np.diff(values) / gaps
    tangents = np.zeros(len(knots))
    same = slopes[1:] * slopes[:-1] > 0
    first, second = 2 * gaps[1:] + gaps[:-1], gaps[1:] + 2 * gaps[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (first + second) / (first / slopes[:-1] + second / slopes[1:])
    tangents[1:-1] = np.where(same, mean, 0.0)
    at = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(gaps) - 1)
    gap = gaps[at]
    u = np.clip((times - knots[at]) / gap, 0.0, 1.0)
    v = 1.0 - u
    near = values[at] * (1 + 2 * u) * v * v + values[at + 1] * (1 + 2 * v) * u * u
    curve: F64 = near + gap * u * v * (tangents[at] * v - tangents[at + 1] * u)
    return curve


def _rounded(curves: F64, sigma: float) -> F64:
    """Smooth curves by a Gaussian with a standard deviation in frames; constant parts are not changed."""
    width = math.ceil(3 * sigma)
    weights = np.exp(-0.5 * (np.arange(-width, width + 1) / sigma) ** 2)
    weights /= weights.sum()
    padded = np.pad(curves, ((width, width), (0, 0)), mode="edge")
    result = np.zeros_like(curves)
    for i, weight in enumerate(weights):
        result += weight * padded[i : i + len(curves)]
    return result
