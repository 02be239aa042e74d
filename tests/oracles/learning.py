"""Naive twins of keyframe learning: hits frame by frame, fitness from sets, and parents from a wheel."""

from __future__ import annotations

from collections.abc import Sequence

NO_WORD = 2**64 - 1


def has_hit(
    words: Sequence[int], masks: Sequence[int], values: Sequence[int], gaps: Sequence[tuple[int, float]]
) -> bool:
    """Return whether a chain of frames meets the keyframes under the gaps: every frame against every earlier one."""
    reached = [n for n, word in enumerate(words) if word != NO_WORD and word & masks[0] == values[0]]
    for mask, value, (low, high) in zip(masks[1:], values[1:], gaps, strict=True):
        matching = [n for n, word in enumerate(words) if word != NO_WORD and word & mask == value]
        reached = [n for n in matching if any(low <= n - before <= high for before in reached)]
    return bool(reached)


def has_judged_hit(
    words: Sequence[int], masks: Sequence[int], values: Sequence[int], gaps: Sequence[tuple[int, float]], steady: int
) -> bool:
    """The same where a feature counts only if it holds for `steady` frames before and after."""

    def meets(n: int, mask: int, value: int) -> bool:
        if words[n] == NO_WORD:
            return False
        nearby = range(max(0, n - steady), min(len(words), n + steady + 1))
        return not mask or all(words[m] != NO_WORD and words[m] & mask == value for m in nearby)

    reached = [n for n in range(len(words)) if meets(n, masks[0], values[0])]
    for mask, value, (low, high) in zip(masks[1:], values[1:], gaps, strict=True):
        matching = [n for n in range(len(words)) if meets(n, mask, value)]
        reached = [n for n in matching if any(low <= n - before <= high for before in reached)]
    return bool(reached)


def fitness(retrieved: set[int], positive: set[int], beta: float) -> tuple[float, float, float]:
    """Return precision, recall and F_beta from sets of clips (thesis, Eq. 4.9 to 4.11); 0 where they divide by zero."""
    right = len(retrieved & positive)
    precision = right / len(retrieved) if retrieved else 0.0
    recall = right / len(positive) if positive else 0.0
    below = beta**2 * precision + recall
    return precision, recall, (1 + beta**2) * precision * recall / below if below else 0.0


def universal_sampling(fitness: Sequence[float], count: int, offset: float) -> list[int]:
    """Select by Baker's wheel: `count` pointers at equal distances, the first at `offset` (0 to 1) of a distance."""
    total = sum(fitness)
    if total <= 0:
        fitness, total = [1.0] * len(fitness), float(len(fitness))
    chosen = []
    for number in range(count):
        pointer = (offset + number) * total / count
        passed = 0.0
        for index, one in enumerate(fitness):
            passed += one
            if pointer < passed or index == len(fitness) - 1:
                chosen.append(index)
                break
    return chosen
