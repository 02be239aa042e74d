"""Write warnings about takes whose quality figures exceed their limits.

A figure outside its limits gives a warning and never an error: a body with the proportions of a cartoon figure is
ingested, and the warning names what is unusual.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from kinedex.catalog.quality_figures import FIGURES, RATE_ADVICE
from kinedex.ops.body.plausibility import Plausibility
from kinedex.ops.body.tempo import TYPICAL_HZ, usual_rate

POSE_S = 0.5
"""Shortest duration in seconds at which a file without motion gets a warning; shorter files are taken for poses."""

JERKY_M_S3 = 2500.0
"""Limit of 2π · `tempo_hz` · `acceleration_m_s2` for human motion in m/s³; Bandai has 1,205 at most, a sprint 1,995."""


def quality_columns(figures: Plausibility) -> dict[str, Any]:
    """Return the values of a take's columns of quality figures, by name; None for a figure that is not known."""
    values = {figure.name: getattr(figures, figure.name) for figure in FIGURES}
    return {name: None if value != value else value for name, value in values.items()}


def quality_warnings(figures: Plausibility, rate_hz: float) -> list[str]:
    """Return a sentence for each figure outside its limits, with the value, the limits and advice.

    Parameters
    ----------
    figures : Plausibility
        The figures of a take.
    rate_hz : float
        The frame rate of the take, in frames per second, as it is read.
    """
    return [*_up(figures), *_beyond(figures), *_pace(figures, rate_hz)]


def _up(figures: Plausibility) -> Iterator[str]:
    if figures.up_axis not in ("", "y"):
        yield (
            f"the body stands along {figures.up_axis}, not along y (confidence {figures.up_confidence:.2f}): the file "
            f"has another vertical axis; state `up: {figures.up_axis}` in a skeleton mapping whose `up` is y"
        )


def _beyond(figures: Plausibility) -> Iterator[str]:
    for figure in FIGURES:
        value = getattr(figures, figure.name)
        if figure.advice and figure.off(value):
            shown = f"{value:.3g}{f' {figure.unit}' if figure.unit else ''}"
            yield f"{figure.name} is {shown}, expected {figure.limits()} ({figure.meaning}); {figure.advice}"


def _pace(figures: Plausibility, rate_hz: float) -> Iterator[str]:
    """Yield warnings about a take that is motionless, repeats frames, or is too fast or too slow for a person."""
    limit = {figure.name: figure for figure in FIGURES}
    if limit["repeated_share"].off(figures.repeated_share):
        share = figures.repeated_share
        if share > 0.99:
            if figures.seconds >= POSE_S:
                yield "nothing moves: all frames are equal; the file holds a pose, or its motion was lost in the export"
            return
        yield (
            f"{100 * share:.0f} % of its frames are equal to the one before: the motion was frozen where tracking was "
            f"lost, or comes from {usual_rate(rate_hz * (1 - share)):g} Hz; features of speed suffer from it"
        )
    tempo, force = figures.tempo_hz, figures.acceleration_m_s2
    jerky = tempo == tempo and 6.2832 * tempo * force > JERKY_M_S3
    names = [name for name in ("speed_m_s", "tempo_hz", "acceleration_m_s2") if limit[name].off(getattr(figures, name))]
    if names == ["speed_m_s"] and figures.speed_m_s < 1:
        yield f"nothing moves: the mean speed of its joints is {figures.speed_m_s:.2g} m/s"
    elif names or jerky:
        shown = [f"{name} {getattr(figures, name):.3g} (expected {limit[name].limits()})" for name in names]
        slow = tempo < (limit["tempo_hz"].low or 0)
        shown = shown or [f"hands and feet turn {tempo:.2g} times a second with {force:.0f} m/s²"]
        likely = f", such as --rate {usual_rate(rate_hz * TYPICAL_HZ / tempo):g}" if tempo > 0 else ""
        yield (
            f"at {rate_hz:g} Hz the motion is too {'slow' if slow else 'fast'} for a person: {', '.join(shown)}; "
            f"{RATE_ADVICE}{likely}"
        )
