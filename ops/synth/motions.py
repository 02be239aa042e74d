"""This module lists the motion classes of the synthetic archive."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from kinedex.ops.synth import exercises, floor, gait, strikes
from kinedex.ops.synth.score import Score

Span = tuple[float, float]


@dataclass(frozen=True)
class Motion:
    """A motion subclass, with the functions that write it as an example clip and within a long take.

    Attributes
    ----------
    label : str
        The class it belongs to.
    seconds : float
        Average duration of an example.
    example, scene : Callable[[Score], Span]
        Functions that write the motion and return begin and end of the label, in seconds.
    before, after : str
        Posture at the start and at the end: "stand", "sit" or "lie".
    """

    name: str
    label: str
    seconds: float
    example: Callable[[Score], Span]
    scene: Callable[[Score], Span]
    before: str = "stand"
    after: str = "stand"


def _once(write: Callable[[Score], None]) -> Callable[[Score], Span]:
    """Return a function that performs a motion once and returns its start and end."""

    def perform(score: Score) -> Span:
        begin = score.now
        write(score)
        return begin, score.now

    return perform


def _some_of(write: Callable[[Score, int], list[float]], times: int) -> Callable[[Score], Span]:
    """Return a function that performs a motion with extra repetitions and returns the range of `times` of them."""

    def perform(score: Score) -> Span:
        before, behind = (int(value) for value in score.rng.integers(0, 2, size=2))
        moments = write(score, before + times + behind)
        return moments[before], moments[before + times]

    return perform


def _all_of(write: Callable[[Score, int], list[float]], least: int, most: int) -> Callable[[Score], Span]:
    """Return a function that performs a random number of repetitions, from standing to standing."""

    def perform(score: Score) -> Span:
        begin = score.now
        write(score, int(score.rng.integers((least + most) // 2, most + 1)))
        return begin, score.now

    return perform


def _cut_from_gait(style: gait.Gait, first: str, steps: int) -> Callable[[Score], Span]:
    """Return a function that performs a gait and returns the range of `steps` steps that begin with foot `first`."""

    def perform(score: Score) -> Span:
        lead = int(score.rng.integers(2, 4))
        starts_with = first if lead % 2 == 0 else ("r" if first == "l" else "l")
        times = gait.go(score, style, starts_with, lead + steps, curve=score.about(0.0, 10.0))
        return times[lead], times[lead + steps]

    return perform


def _go_somewhere(style: gait.Gait, first: str, least: int, most: int) -> Callable[[Score], Span]:
    """Return a function that performs an even number of steps, from standing to standing, back towards the centre."""

    def perform(score: Score) -> Span:
        steps = 2 * int(score.rng.integers(least, most + 1))
        x, z, yaw = score.standing()
        away = (math.degrees(math.atan2(-x, -z)) - yaw + 180.0) % 360.0 - 180.0
        homewards = min(max(away, -140.0), 140.0) / steps * min(1.0, math.hypot(x, z) / 3.0)
        times = gait.go(score, style, first, steps, curve=score.about(homewards, 4.0))
        return times[0], times[-1]

    return perform


def _kick(score: Score, times: int, side: str) -> list[float]:
    return strikes.kick(score, side, times)


def _punch(score: Score, times: int, side: str) -> list[float]:
    return strikes.punch(score, side, times)


def _gaits() -> list[Motion]:
    kinds = [
        ("walk4StepsLstart", "walk", gait.WALK, "l", 4, 2.1, (4, 7)),
        ("jog4StepsLstart", "jog", gait.JOG, "l", 4, 1.5, (6, 9)),
    ]
    return [
        Motion(name, label, seconds, _cut_from_gait(style, first, steps), _go_somewhere(style, first, *scene))
        for name, label, style, first, steps, seconds, scene in kinds
    ]


def _single(
    name: str, seconds: float, write: Callable[[Score], None], before: str = "stand", after: str = "stand"
) -> Motion:
    perform = _once(write)
    return Motion(name, name, seconds, perform, perform, before, after)


def _repeated(
    name: str, label: str, seconds: float, write: Callable[[Score, int], list[float]], times: int, most: int
) -> Motion:
    full = f"{name}{times}Reps"
    return Motion(full, label, seconds * times, _some_of(write, times), _all_of(write, times, most))


MOTIONS: tuple[Motion, ...] = (
    *_gaits(),
    _repeated("kickLeft", "kickLeft", 1.5, partial(_kick, side="l"), 1, 5),
    _repeated("kickRight", "kickRight", 1.5, partial(_kick, side="r"), 1, 5),
    _repeated("punchLeft", "punch", 0.9, partial(_punch, side="l"), 1, 8),
    _repeated("punchRight", "punch", 0.9, partial(_punch, side="r"), 1, 8),
    _repeated("elbowToKnee", "elbowToKnee", 1.7, exercises.elbow_to_knee, 1, 5),
    _repeated("squat", "squat", 1.7, exercises.squat, 1, 6),
    _repeated("jumpingJack", "jumpingJack", 1.0, exercises.jumping_jack, 1, 8),
    _repeated("armCirclesRight", "armCircles", 1.25, exercises.arm_circles, 1, 7),
    _single("spinLeft", 3.0, gait.spin),
    _single("cartwheelLeft", 2.4, exercises.cartwheel),
    _single("sitDown", 1.7, floor.sit_down, after="sit"),
    _single("standUp", 1.5, floor.stand_up, before="sit"),
    _single("lieDown", 4.3, floor.lie_down, after="lie"),
    _single("getUp", 3.6, floor.get_up, before="lie"),
)
"""All motion subclasses, in the order in which they are written to the archive."""
