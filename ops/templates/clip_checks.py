"""Find faults in the clips of a class: too few clips, very different lengths, or a clip unlike all others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kinedex.ops.wording import name_list

FEW = 3
"""The number of clips below which the clips of a class hardly show which features vary."""

UNLIKE_LENGTH = 2.0
"""The ratio of a clip's length to the median of its class, or its inverse, above which the clip gets a remark.

A warping path of a distance curve cannot be stretched further either.
"""

LONELY_TIMES, LONELY_SPREADS, LONELY_EXCESS = 1.5, 5.0, 0.05
"""The criteria for outliers: a multiple of the median cost, median absolute deviations above it, and an excess.

Four of the 188 training clips of HDM05 are outliers (one jog, two of lying down, one of sneaking).
"""


def clip_remarks(names: Sequence[str], lengths: Sequence[int], costs: Sequence[float]) -> tuple[str, ...]:
    """Return remarks on the clips of one class.

    Parameters
    ----------
    names : sequence of str
        The names of the clips.
    lengths : sequence of int
        The lengths of the clips, in frames.
    costs : sequence of float
        The cost of aligning each clip with the others (`LearnedTemplate.clip_costs`).

    Returns
    -------
    tuple of str
        Sentences without the name of the class; empty if the clips pass all checks.
    """
    if len(names) == 1:
        return ("one clip only, which then is the template",)
    remarks = []
    if len(names) < FEW:
        remarks.append(f"{len(names)} clips only: what two clips do not vary in counts as essential")
    median = float(np.median(lengths))
    unlike = [
        f"{name} ({length} frames)"
        for name, length in zip(names, lengths, strict=True)
        if length > UNLIKE_LENGTH * median or UNLIKE_LENGTH * length < median
    ]
    if unlike:
        remarks.append(f"clips of very different length, the median being {median:g} frames: {name_list(unlike)}")
    lonely = [f"{names[index]} (cost {costs[index]:.3f})" for index in far_clips(costs)]
    if lonely:
        typical = float(np.median(costs))
        remarks.append(f"clips far from all others, whose median cost is {typical:.3f}: {name_list(lonely)}")
    return tuple(remarks)


def far_clips(costs: Sequence[float]) -> list[int]:
    """Return the indices of clips that are far from all others; an empty list for fewer than four clips."""
    limit = far_limit(costs)
    return [] if limit is None else [index for index, cost in enumerate(costs) if cost >= limit]


def far_limit(costs: Sequence[float]) -> float | None:
    """Return the lowest cost at which a clip is far from all others; None for fewer than four clips.

    Parameters
    ----------
    costs : sequence of float
        The cost of aligning each clip with the others.

    Examples
    --------
    >>> round(far_limit([0.10, 0.11, 0.12, 0.11, 0.30]), 3)
    0.165
    """
    if len(costs) <= FEW:
        return None
    median = float(np.median(costs))
    spread = float(np.median(np.abs(np.asarray(costs) - median)))
    return max(LONELY_TIMES * median, median + LONELY_SPREADS * spread, median + LONELY_EXCESS)
