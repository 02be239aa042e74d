"""This module generates performances, a clip or a long take of one actor, as the angle table of an AMC file."""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.errors import ParameterError
from kinedex.ops.synth import floor
from kinedex.ops.synth.actors import Actor
from kinedex.ops.synth.filler import fill
from kinedex.ops.synth.motions import MOTIONS, Motion
from kinedex.ops.synth.noise import capture, sway
from kinedex.ops.synth.score import Score, curves
from kinedex.ops.synth.solve import solve

RATE_HZ = 120.0

UNASKED = 0.02
"""Share of a long take with unlabelled filler motions between the labelled ones."""
HURRY = (0.10, 0.30)
"""Range in seconds by which the next motion begins before the last one has come to rest."""
INTERRUPTED = 0.6
"""Share of clips that begin out of another movement instead of standing."""


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


def motion(name: str) -> Motion:
    """Return the motion of the subclass with this name."""
    for known in MOTIONS:
        if known.name == name:
            return known
    raise ParameterError("motion", "one of " + ", ".join(m.name for m in MOTIONS), name)


def perform_clip(actor: Actor, name: str, number: int, seed: int) -> Performance:
    """Generate a clip of one motion, cut out as an editor would.

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
    what = motion(name)
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
        Shortest duration, seconds.
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
            # Every motion is performed once, in random order, before any is repeated.
            pool = [MOTIONS[i] for i in rng.permutation(len(MOTIONS)) if MOTIONS[i].before == "stand"]
        if unasked < UNASKED * score.now:
            unasked += _pause(score)
        what = pool.pop()
        _perform(score, what, spans)
        if what.after != "stand":
            _perform(score, motion("standUp" if what.after == "sit" else "getUp"), spans)
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
    """Return the frames that an editor would cut out from begin to end, slightly early or late at random."""
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
