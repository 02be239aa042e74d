"""This module generates performances, which are clips or long takes of one actor, as angle tables of AMC files.

Coloured noise adds the sway of a body and the errors of a capture system.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.errors import ParameterError
from kinedex.ops.synth import exercises, floor, gait, strikes
from kinedex.ops.synth.body import Actor
from kinedex.ops.synth.filler import fill
from kinedex.ops.synth.score import CHANNELS, Score, curves
from kinedex.ops.synth.solve import solve

Span = tuple[float, float]


# Standard deviations of the sway of channels in their own units (leg lengths, arm lengths, degrees).
_SWAY = {
    "px": 0.008, "py": 0.004, "pz": 0.010, "yaw": 1.2, "pitch": 1.0, "roll": 0.7,
    "bend": 2.4, "side": 1.6, "twist": 3.2, "nod": 2.5, "look": 4.0, "tilt": 1.5,
    "hx": 0.030, "hy": 0.022, "hz": 0.034, "swivel": 5.0, "wrist": 6.0, "hroll": 8.0, "knee": 1.0,
}  # fmt: skip


RATE_HZ = 120.0

UNASKED = 0.02
"""Fraction of a long take that consists of unlabelled filler motions between the labelled motions."""
HURRY = (0.10, 0.30)
"""Range in seconds of the time by which a motion begins before the previous motion has come to rest."""
INTERRUPTED = 0.6
"""Fraction of clips that begin during another movement instead of in standing."""


@dataclass(frozen=True)
class Motion:
    """A motion subclass, with functions that perform it in an example clip and in a long take.

    Attributes
    ----------
    label : str
        The class to which the motion belongs.
    seconds : float
        Mean duration of an example in seconds.
    example, scene : Callable[[Score], Span]
        Functions that write the motion to a score, in a clip and in a take, and return the start and the end of the
        labelled part in seconds.
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
    """Return a function that performs a motion repeatedly and returns the time range of `times` of its repetitions."""

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
    """Return a function that performs a gait and returns the time range of `steps` steps, starting with `first`."""

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


def coloured(
    rng: np.random.Generator, frames: int, columns: int, rate_hz: float, corner_hz: float, slope: float
) -> F64:
    """Draw noise of unit variance whose spectrum is flat below a corner frequency and falls by a power law above it.

    Returns
    -------
    float64 array (frames, columns)
    """
    # longer than requested, so that the end is not correlated with the start (the noise is periodic)
    size = frames + round(2 * rate_hz)
    spectrum = np.fft.rfft(rng.standard_normal((columns, size)), axis=1)
    frequency = np.fft.rfftfreq(size, 1 / rate_hz)
    gain = 1.0 / (1.0 + (frequency / corner_hz) ** slope)
    gain[0] = 0.0
    scale = np.sqrt(size / (gain[0] ** 2 + 2 * (gain[1:] ** 2).sum()))
    noise: F64 = np.fft.irfft(spectrum * (gain * scale), size, axis=1)[:, :frames].T
    return noise


def sway(rng: np.random.Generator, channels: F64, rate_hz: float, amount: float) -> F64:
    """Add the sway and small movements of a living body to channels; the feet are not changed."""
    result = channels.copy()
    names = [name for name in CHANNELS if _spread(name) > 0]
    slow = coloured(rng, len(channels), len(names), rate_hz, 0.35, 2.0)
    quick = coloured(rng, len(channels), len(names), rate_hz, 2.2, 3.0)
    for i, name in enumerate(names):
        result[:, CHANNELS.index(name)] += amount * _spread(name) * (1.0 * slow[:, i] + 0.4 * quick[:, i])
    return result


def _spread(name: str) -> float:
    return _SWAY.get(name, _SWAY.get(name[1:], 0.0) if name[0] in "lr" else 0.0)


def capture(rng: np.random.Generator, angles: F64, rate_hz: float, amount: float) -> F64:
    """Add the errors of a capture system to angles: slow drift and fine jitter; the root moves by millimetres."""
    drift = coloured(rng, len(angles), angles.shape[1], rate_hz, 0.15, 2.0)
    jitter = coloured(rng, len(angles), angles.shape[1], rate_hz, 5.0, 2.0)
    noise = amount * (0.45 * drift + 0.07 * jitter)
    noise[:, :3] *= 0.0035
    noise[:, 3:6] *= 0.5
    return angles + noise


@dataclass(frozen=True)
class PerformedMotion:
    """A label: source frames [start, stop) in which a class is performed."""

    label: str
    start: int
    stop: int


@dataclass(frozen=True)
class Performance:
    """An angle table in metres and degrees (see `ops.synth.solve.columns`), and the labels of its motions."""

    angles: F64
    labels: tuple[PerformedMotion, ...]


def motion_named(name: str) -> Motion:
    """Return the motion of the subclass with this name."""
    for known in MOTIONS:
        if known.name == name:
            return known
    raise ParameterError("motion", "one of " + ", ".join(m.name for m in MOTIONS), name)


def perform_clip(actor: Actor, name: str, number: int, seed: int) -> Performance:
    """Generate a clip of one motion, which begins and ends as an editor would cut it.

    Parameters
    ----------
    actor : Actor
        The performer.
    name : str
        The subclass.
    number : int
        Number of the repetition.
    seed : int
        Seed of the archive; the same four arguments give the same performance.

    Returns
    -------
    Performance
        The performance, labelled from its first to its last frame.
    """
    rng = np.random.default_rng([seed, 11, actor.seed % 1000, zlib.crc32(name.encode()), number])
    what = motion_named(name)
    score = Score(actor, rng)
    _prepare(score, what.before)
    score.hurry(_overlap(rng))
    begin, end = what.example(score)
    if what.scene is what.example:
        end -= _overlap(rng)
    score.after(0.5)
    table = _captured(score, rng)
    start, stop = _as_cut(rng, begin, end, len(table))
    return Performance(table[start:stop], (PerformedMotion(what.label, 0, stop - start),))


def perform_take(actor: Actor, seconds: float, number: int, seed: int) -> Performance:
    """Generate a take of motions one after the other, with fillers in between, of at least a given duration.

    Parameters
    ----------
    actor : Actor
        The performer.
    seconds : float
        The minimum duration in seconds.
    number : int
        Number of the take.
    seed : int
        Seed of the archive.

    Returns
    -------
    Performance
        A performance; its labels are sorted and do not overlap.
    """
    if not seconds > 0:
        raise ParameterError("seconds", "above 0", seconds)
    rng = np.random.default_rng([seed, 13, actor.seed % 1000, number])
    score = Score(actor, rng)
    _wait(score, 0.2)
    pool: list[Motion] = []
    unasked = -float(rng.uniform(0.0, 2.0))
    spans: list[tuple[Motion, float, float]] = []
    while score.now < seconds:
        if not pool:
            # Every motion is performed once, in random order, before a motion is repeated.
            pool = [MOTIONS[i] for i in rng.permutation(len(MOTIONS)) if MOTIONS[i].before == "stand"]
        if unasked < UNASKED * score.now:
            unasked += _pause(score)
        what = pool.pop()
        _perform(score, what, spans)
        if what.after != "stand":
            _perform(score, motion_named("standUp" if what.after == "sit" else "getUp"), spans)
    _wait(score, 0.3)
    table = _captured(score, rng)
    return Performance(table, _labels(rng, spans, len(table)))


def _prepare(score: Score, before: str) -> None:
    if before == "sit":
        floor.sit_down(score)
        floor.sit(score, float(score.rng.uniform(0.3, 0.9)))
    elif before == "lie":
        floor.lie_down(score)
        score.after(float(score.rng.uniform(0.2, 0.8)))
    elif score.rng.random() < INTERRUPTED:
        fill(score)
    else:
        _wait(score, 0.35)


def _wait(score: Score, seconds: float) -> None:
    score.begin()
    span = seconds * math.exp(float(score.rng.normal(0.0, 0.3)))
    score.stand(0.0, span)
    score.after(span)


def _pause(score: Score) -> float:
    """Add filler motions until the next labelled motion; return their duration in seconds."""
    begin = score.now
    fill(score)
    score.hurry(_overlap(score.rng))
    return score.now - begin


def _perform(score: Score, what: Motion, spans: list[tuple[Motion, float, float]]) -> None:
    """Add a labelled motion; the next motion begins slightly before this one ends."""
    begin, end = what.scene(score)
    score.hurry(_overlap(score.rng))
    spans.append((what, begin, min(end, score.now)))


def _overlap(rng: np.random.Generator) -> float:
    return float(rng.uniform(*HURRY))


def _captured(score: Score, rng: np.random.Generator) -> F64:
    actor = score.actor
    channels = sway(rng, curves(score, RATE_HZ, score.now), RATE_HZ, actor.restless)
    return capture(rng, solve(actor.body, channels), RATE_HZ, actor.restless)


def _as_cut(rng: np.random.Generator, begin: float, end: float, frames: int) -> tuple[int, int]:
    """Return the frames of a time range as an editor would cut them, randomly a little too early or too late."""
    start = round((begin + float(rng.normal(0.0, 0.05))) * RATE_HZ)
    stop = round((end + float(rng.normal(0.0, 0.06))) * RATE_HZ)
    start = min(max(start, 0), frames - 1)
    return start, min(max(stop, start + 1), frames)


def _labels(
    rng: np.random.Generator, spans: list[tuple[Motion, float, float]], frames: int
) -> tuple[PerformedMotion, ...]:
    labels: list[PerformedMotion] = []
    for what, begin, end in spans:
        start, stop = _as_cut(rng, begin, end, frames)
        start = max(start, labels[-1].stop if labels else 0)
        if stop > start:
            labels.append(PerformedMotion(what.label, start, stop))
    return tuple(labels)
