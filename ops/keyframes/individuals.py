"""Individuals are keyframe queries while the genetic algorithm learns them (thesis, Section 4.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinedex.ops.errors import ParameterError
from kinedex.ops.words import I64, U64


@dataclass(frozen=True)
class Individual:
    """A keyframe query over complete words: K keyframes at template columns, and the gaps between them.

    Parameters
    ----------
    masks, values : uint64 array (K,)
        The keyframes; bit i - 1 is F_i.
    positions : int64 array (K,)
        Their template columns, in non-descending order.
    lows, highs : int64 array (K - 1,)
        The admissible gaps in frames, both ends included (thesis, Eq. 4.3 and 4.4).

    Raises
    ------
    ParameterError
        If the lengths do not match, a gap is not a range, or a value has bits outside its mask.
    """

    masks: U64
    values: U64
    positions: I64
    lows: I64
    highs: I64

    def __post_init__(self) -> None:
        count = len(self.masks)
        if not count or len(self.values) != count or len(self.positions) != count:
            raise ParameterError("query", "one mask, value and position a keyframe, and one keyframe at least", count)
        if len(self.lows) != count - 1 or len(self.highs) != count - 1:
            raise ParameterError("query", f"{count - 1} gaps, one fewer than keyframes", len(self.lows))
        if np.any(self.lows < 0) or np.any(self.lows > self.highs):
            raise ParameterError("gap", "a range [low, high] of frames with 0 <= low <= high", (self.lows, self.highs))
        if np.any(self.values & ~self.masks):
            raise ParameterError("value", "0 wherever mask is 0", "a value behind a wildcard")

    def __len__(self) -> int:
        return len(self.masks)

    @property
    def fixed(self) -> int:
        """Return the number of entries that the keyframes fix in total."""
        return int(np.bitwise_count(self.masks).sum())

    @property
    def gaps(self) -> list[tuple[int, int]]:
        """Return the gaps as pairs (low, high), as searches expect them."""
        return list(zip(self.lows.tolist(), self.highs.tolist(), strict=True))

    def key(self) -> tuple[bytes, ...]:
        """Return a hashable key that is equal for equal individuals."""
        return tuple(part.tobytes() for part in (self.masks, self.values, self.positions, self.lows, self.highs))
