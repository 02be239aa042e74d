"""The motion classes of the synthetic archive, by name."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from ops.synth import exercises, floor, gait, strikes
from ops.synth.score import Score

Span = tuple[float, float]


@dataclass(frozen=True)
class Motion:
    """One subclass: how it is performed once as an example, and how it appears in a long take.

    label: the class it belongs to. seconds: what an example lasts on the average. example, scene: write the
    motion and return begin and end of what is labelled, in seconds. before, after: "stand", "sit" or "lie", how
    the performer begins and ends.
    """

    name: str
    label: str
    seconds: float
    example: Callable[[Score], Span]
    scene: Callable[[Score], Span]
    before: str = "stand"
    after: str = "stand"


def _timed(write: Callable[[Score], None], times: int) -> Callable[[Score], Span]:
    """Perform a motion some times in a row."""

    def perform(score: Score) -> Span:
        begin = score.now
        for _ in range(times):
            write(score)
        return begin, score.now

    return perform


def _cut_from_gait(style: gait.Gait, first: str, steps: int) -> Callable[[Score], Span]:
    """Go, and cut out so many steps from one that this foot begins."""

    def perform(score: Score) -> Span:
        lead = int(score.rng.integers(2, 4))
        starts_with = first if lead % 2 == 0 else ("r" if first == "l" else "l")
        times = gait.go(score, style, starts_with, lead + steps, curve=score.about(0.0, 10.0))
        return times[lead], times[lead + steps]

    return perform


def _go_somewhere(style: gait.Gait, least: int, most: int) -> Callable[[Score], Span]:
    """Go so many steps, from standing to standing, on a curve that leads back to the middle of the room."""

    def perform(score: Score) -> Span:
        steps = int(score.rng.integers(least, most + 1))
        x, z, yaw = score.standing()
        away = (math.degrees(math.atan2(-x, -z)) - yaw + 180.0) % 360.0 - 180.0
        homewards = min(max(away, -140.0), 140.0) / steps * min(1.0, math.hypot(x, z) / 3.0)
        times = gait.go(score, style, "lr"[int(score.rng.integers(2))], steps, curve=score.about(homewards, 4.0))
        return times[0], times[-1]

    return perform


def _gaits() -> list[Motion]:
    kinds = [
        ("walk4StepsLstart", "walk", gait.WALK, "l", 4, 2.1, (5, 9)),
        ("jog4StepsLstart", "jog", gait.JOG, "l", 4, 1.5, (5, 10)),
        ("sneak2StepsLstart", "sneak", gait.SNEAK, "l", 2, 2.0, (3, 5)),
    ]
    return [
        Motion(name, label, seconds, _cut_from_gait(style, first, steps), _go_somewhere(style, *scene))
        for name, label, style, first, steps, seconds, scene in kinds
    ]


def _repeated(
    name: str, seconds: float, write: Callable[[Score], None], times: int = 1, label: str = "",
    before: str = "stand", after: str = "stand",
) -> Motion:  # fmt: skip
    perform = _timed(write, times)
    return Motion(name, label or name, seconds, perform, perform, before, after)


MOTIONS: tuple[Motion, ...] = (
    *_gaits(),
    _repeated("spinLeft", 3.0, gait.spin),
    _repeated("kickLeft2Reps", 3.1, partial(strikes.kick, side="l"), 2, "kickLeft"),
    _repeated("kickRight2Reps", 3.1, partial(strikes.kick, side="r"), 2, "kickRight"),
    _repeated("punchLeft2Reps", 2.8, partial(strikes.punch, side="l"), 2, "punch"),
    _repeated("punchRight2Reps", 2.8, partial(strikes.punch, side="r"), 2, "punch"),
    _repeated("elbowToKnee", 2.4, exercises.elbow_to_knee),
    _repeated("squat2Reps", 3.6, exercises.squat, 2, "squat"),
    _repeated("jumpingJack3Reps", 3.5, exercises.jumping_jack, 3, "jumpingJack"),
    _repeated("armCircles3Reps", 3.7, exercises.arm_circles, 3, "armCircles"),
    _repeated("cartwheelLeft", 2.4, exercises.cartwheel),
    _repeated("depositFloor", 2.1, floor.deposit_floor),
    _repeated("sitDown", 1.7, floor.sit_down, after="sit"),
    _repeated("standUp", 1.5, floor.stand_up, before="sit"),
    _repeated("lieDown", 3.4, floor.lie_down, after="lie"),
    _repeated("getUp", 3.1, floor.get_up, before="lie"),
)
"""All subclasses, in the order in which they are written."""
