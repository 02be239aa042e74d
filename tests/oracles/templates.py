"""Template learning in plain lists, written from the papers: hard with 0, 0.5 and 1, soft with real numbers."""

from __future__ import annotations

import math
import statistics
from fractions import Fraction
from itertools import pairwise

from tests.oracles import warping

Column = list[float]
Weighted = tuple[list[Column], list[float]]


def soft_cost(x: Column, y: Column) -> float:
    return sum(abs(a - b) for a, b in zip(x, y, strict=True)) / len(x)


def hard_cost(x: Column, y: Column) -> float:
    return sum(abs(a - b) for a, b in zip(x, y, strict=True) if a != 0.5 and b != 0.5)


def hard_sum(x: Column, y: Column) -> Column:
    """Eq. 3.1: equal entries stay, different ones become 0.5."""
    return [a if a == b else 0.5 for a, b in zip(x, y, strict=True)]


def soft_mean(x: Column, y: Column, x_weight: float, y_weight: float) -> Column:
    return [(a * x_weight + b * y_weight) / (x_weight + y_weight) for a, b in zip(x, y, strict=True)]


def align(kind: str, reference: Weighted, other: Weighted) -> tuple[float, list[tuple[int, int]]]:
    cost = soft_cost if kind == "soft" else hard_cost
    matrix = [[cost(x, y) for y in other[0]] for x in reference[0]]
    return warping.align(matrix, reference[1], other[1])


def average(kind: str, reference: Weighted, others: list[Weighted]) -> Weighted:
    """Warp the others to the reference's length and average column by column; nothing is rebalanced."""
    columns, weights = [list(column) for column in reference[0]], list(reference[1])
    sums = [[weight * x for x in column] for column, weight in zip(columns, weights, strict=True)]
    for other in others:
        _, path = align(kind, reference, other)
        for k, m in path:
            share = other[1][m] / sum(1 for _, used in path if used == m)
            weights[k] += share
            sums[k] = [total + share * x for total, x in zip(sums[k], other[0][m], strict=True)]
            columns[k] = hard_sum(columns[k], other[0][m])
    if kind == "soft":
        columns = [[total / weight for total in row] for row, weight in zip(sums, weights, strict=True)]
    return columns, [weight / (len(others) + 1) for weight in weights]


def expand(template: Weighted) -> Weighted:
    columns: list[Column] = []
    weights: list[float] = []
    for column, weight in zip(*template, strict=True):
        copies = round(round(weight, 9)) if weight >= 1.5 - 1e-9 else 1
        for _ in range(copies):
            columns.append(column)
            weights.append(weight / copies)
    return columns, weights


def contract(kind: str, template: Weighted) -> Weighted:
    columns, weights = list(template[0]), list(template[1])
    while len(weights) > 1:
        light = [k for k, weight in enumerate(weights) if weight < 0.75 - 1e-9]
        if not light:
            break
        k = light[0]
        neighbours = [n for n in (k - 1, k + 1) if 0 <= n < len(weights)]
        if len(neighbours) == 2 and weights[k - 1] <= weights[k + 1] + 1e-9:
            neighbours = [k - 1]
        a, b = sorted([k, neighbours[-1]])
        if kind == "hard":
            columns[a : b + 1] = [hard_sum(columns[a], columns[b])]
        else:
            columns[a : b + 1] = [soft_mean(columns[a], columns[b], weights[a], weights[b])]
        weights[a : b + 1] = [weights[a] + weights[b]]
    return columns, weights


def rebalance(kind: str, template: Weighted) -> Weighted:
    return expand(contract(kind, expand(template)))


def learn(kind: str, clips: list[list[Column]]) -> tuple[Weighted, list[float]]:
    """Return the class template and the largest relative pair cost before each round and after the last."""
    return _rounds(kind, [(clip, [1.0] * len(clip)) for clip in clips], list(range(len(clips))))


def _rounds(kind: str, templates: list[Weighted], references: list[int]) -> tuple[Weighted, list[float]]:
    costs: list[float] = []
    if len(templates) == 1:
        return templates[0], [0.0]
    while True:
        pairs = [(a, b) for a in references for b in range(len(templates)) if a != b]
        largest = max(
            align(kind, templates[a], templates[b])[0] / min(sum(templates[a][1]), sum(templates[b][1]))
            for a, b in pairs
        )
        costs.append(largest)
        rounds = len(costs) - 1
        if rounds and (largest < 0.005 or abs(largest - costs[-2]) <= 1e-9 or rounds == 10):
            return templates[0], costs
        templates = [
            rebalance(kind, average(kind, templates[a], templates[:a] + templates[a + 1 :])) for a in references
        ]
        references = list(range(len(templates)))


def evenly_drawn(lengths: list[int], actors: list[str], count: int) -> list[int]:
    """Return the middle one of each of `count` equal parts of the clips by actor and length."""
    row = sorted(range(len(lengths)), key=lambda place: (actors[place], lengths[place], place))
    count = min(count, len(row))
    edges = [Fraction(part * len(row), count) for part in range(count + 1)]
    return sorted(row[math.floor((low + high) / 2)] for low, high in pairwise(edges))


def learn_many(
    kind: str, clips: list[list[Column]], actors: list[str], most: int, references: int
) -> tuple[Weighted, list[float], list[float]]:
    """Return the template of a large class, the costs of `learn` and the cost of each clip to the references."""
    lengths = [len(clip) for clip in clips]
    drawn = evenly_drawn(lengths, actors, most)
    of_drawn = evenly_drawn([lengths[i] for i in drawn], [actors[i] for i in drawn], references)
    every: list[Weighted] = [(clip, [1.0] * len(clip)) for clip in clips]
    first, costs = _rounds(kind, [every[i] for i in drawn], of_drawn)
    rest = [every[i] for i in range(len(clips)) if i not in drawn]
    columns, weights = [list(column) for column in first[0]], [weight * len(drawn) for weight in first[1]]
    for other in rest:
        _, path = align(kind, first, other)
        for k, m in path:
            share = other[1][m] / sum(1 for _, used in path if used == m)
            mixed = soft_mean(columns[k], other[0][m], weights[k], share)
            columns[k] = mixed if kind == "soft" else hard_sum(columns[k], other[0][m])
            weights[k] += share
    template = rebalance(kind, (columns, [weight / len(clips) for weight in weights]))
    compared = 1 if kind == "soft" else len(clips[0][0])
    clip_costs = []
    for place, clip in enumerate(every):
        others = [every[drawn[i]] for i in of_drawn if drawn[i] != place]
        shares = [2 * align(kind, clip, one)[0] / (len(clip[0]) + len(one[0])) / compared for one in others]
        clip_costs.append(statistics.median(shares))
    return template, costs, clip_costs


def classical_cost(kind: str, values: list[Column], clip: list[Column]) -> float:
    """Return the DTW cost between a template and a clip, all columns of weight 1."""
    return align(kind, (values, [1.0] * len(values)), (clip, [1.0] * len(clip)))[0]
