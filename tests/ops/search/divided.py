"""Segments of the axis divided by take, as searches return them."""

from __future__ import annotations

import numpy as np

from kinedex.ops.ranges import TakeRanges, from_axis
from kinedex.ops.words import I64


def ranges_by_take(segments: I64, takes: int) -> TakeRanges:
    """Divide ascending segments of the axis by take."""
    index, ranges = from_axis(segments)
    assert not len(index) or index[-1] < takes
    return TakeRanges(np.searchsorted(index, np.arange(takes + 1)).astype(np.int64), ranges)
