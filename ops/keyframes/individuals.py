"""A keyframe query as it is learned: an individual of the genetic algorithm (thesis, 4.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinedex.ops.errors import ParameterError
from kinedex.ops.words import I64, U64


@dataclass(frozen=True)
class Individual:
    """A keyframe query over whole words: K keyframes at template columns, and the gaps between them (thesis, 4.1).

    masks, values: uint64 (K,), bit i - 1 is F_i. positions: int64 (K,), template columns, never falling. lows, highs:
    int64 (K - 1,), the admissible gaps in frames, both ends included.
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
        """How many entries its keyframes fix together."""
        return int(np.bitwise_count(self.masks).sum())

    @property
    def gaps(self) -> list[tuple[int, int]]:
        """The gaps as `ops.search.keyframes.search` takes them."""
        return list(zip(self.lows.tolist(), self.highs.tolist(), strict=True))

    def key(self) -> tuple[bytes, ...]:
        """The same for queries that are the same."""
        return tuple(part.tobytes() for part in (self.masks, self.values, self.positions, self.lows, self.highs))
