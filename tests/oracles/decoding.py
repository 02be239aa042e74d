"""The best explanation of a short take by trying all there is: a recursion over segments and steps, without tables."""

from __future__ import annotations

import math
from functools import lru_cache

Column = tuple[float, ...]
NEVER = -math.inf


def likelihood(word: list[int], column: Column, smoothing: float) -> float:
    """P(word | column), features independent."""
    shares = [min(max(share, smoothing), 1 - smoothing) for share in column]
    return math.prod(share if bit else 1 - share for bit, share in zip(word, shares, strict=True))


def log_ratio(word: list[int], column: Column, usual: list[Column], smoothing: float, gain: float) -> float:
    """(log P(word | column) − log P(word | background)) / features, plus the gain; all postures are as usual."""
    common = sum(likelihood(word, posture, smoothing) for posture in usual) / len(usual)
    return math.log(likelihood(word, column, smoothing) / common) / len(column) + gain


def best_value(
    templates: list[list[Column]],
    usual: list[Column],
    words: list[list[int] | None],
    smoothing: float,
    entry: float,
    skip: float,
    gain: float,
    stay: float = 0.0,
    allowed: list[list[bool]] | None = None,
) -> float:
    """The greatest value of any explanation; a word that is None stands for an invalid frame."""

    def gained(template: int, column: int, frame: int) -> float:
        word = words[frame]
        if word is None or (allowed is not None and not allowed[template][frame]):
            return NEVER
        return log_ratio(word, templates[template][column], usual, smoothing, gain)

    @lru_cache(None)
    def within(template: int, column: int, frame: int) -> float:
        """The greatest value of all that follows a frame that is in a column (its own value is counted already)."""
        end = len(templates[template]) - 1
        best = from_here(frame + 1) if column == end else NEVER
        after = frame + 1
        if after < len(words):
            if column in (0, end):
                best = max(best, gained(template, column, after) - stay + within(template, column, after))
            for left_out in range(3):
                to = column + 1 + left_out
                if to <= end:
                    best = max(best, gained(template, to, after) - skip * left_out + within(template, to, after))
        for lasts in (2, 3):
            to, until = column + 1, frame + lasts
            if to <= end and until < len(words):
                spent = sum(gained(template, to, at) for at in range(after, until + 1))
                best = max(best, spent + within(template, to, until))
        return best

    @lru_cache(None)
    def from_here(frame: int) -> float:
        if frame >= len(words):
            return 0.0
        best = from_here(frame + 1)
        for template in range(len(templates)):
            best = max(best, gained(template, 0, frame) - entry + within(template, 0, frame))
        return best

    return from_here(0)
