"""Naive twins of keyframe learning: hits frame by frame, fitness from sets, and the operators in words."""

from __future__ import annotations

from collections.abc import Sequence

NO_WORD = 2**64 - 1


def has_hit(
    words: Sequence[int], masks: Sequence[int], values: Sequence[int], gaps: Sequence[tuple[int, float]]
) -> bool:
    """Whether a chain of frames meets the keyframes under the gaps: every frame against every earlier one."""
    reached = [n for n, word in enumerate(words) if word != NO_WORD and word & masks[0] == values[0]]
    for mask, value, (low, high) in zip(masks[1:], values[1:], gaps, strict=True):
        matching = [n for n, word in enumerate(words) if word != NO_WORD and word & mask == value]
        reached = [n for n in matching if any(low <= n - before <= high for before in reached)]
    return bool(reached)


def has_judged_hit(
    words: Sequence[int], masks: Sequence[int], values: Sequence[int], gaps: Sequence[tuple[int, float]], steady: int
) -> bool:
    """The same where a feature counts only if it lasts (steady > 0), or already if it nearly does (steady < 0)."""

    def meets(n: int, mask: int, value: int) -> bool:
        if words[n] == NO_WORD:
            return False
        nearby = range(max(0, n - abs(steady)), min(len(words), n + abs(steady) + 1))
        for bit in range(mask.bit_length()):
            if mask >> bit & 1:
                agree = [words[m] != NO_WORD and words[m] >> bit & 1 == value >> bit & 1 for m in nearby]
                if not (all(agree) if steady > 0 else any(agree)):
                    return False
        return True

    reached = [n for n in range(len(words)) if meets(n, masks[0], values[0])]
    for mask, value, (low, high) in zip(masks[1:], values[1:], gaps, strict=True):
        matching = [n for n in range(len(words)) if meets(n, mask, value)]
        reached = [n for n in matching if any(low <= n - before <= high for before in reached)]
    return bool(reached)


def fitness(retrieved: set[int], positive: set[int], beta: float) -> tuple[float, float, float]:
    """Precision, recall and F_beta from sets of documents (Eq. 4.9 to 4.11); 0 where they divide by nothing."""
    right = len(retrieved & positive)
    precision = right / len(retrieved) if retrieved else 0.0
    recall = right / len(positive) if positive else 0.0
    below = beta**2 * precision + recall
    return precision, recall, (1 + beta**2) * precision * recall / below if below else 0.0


def universal_sampling(fitness: Sequence[float], count: int, offset: float) -> list[int]:
    """Baker's wheel: `count` pointers at equal distances, the first at `offset` (0 to 1) of a distance."""
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
