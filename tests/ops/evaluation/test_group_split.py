"""Groups are divided whole, and the shares are as near to the wanted ones as that allows."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from kinedex.ops.errors import ParameterError
from kinedex.ops.evaluation.group_split import split_groups

SHARES = (0.8, 0.1, 0.1)


def error(chosen: np.ndarray, sizes: np.ndarray, shares: tuple[float, ...]) -> float:
    return float(np.square(np.bincount(chosen, sizes, len(shares)) - np.array(shares) * sizes.sum()).sum())


@pytest.mark.parametrize("seed", range(5))
def test_few_groups_are_divided_in_the_best_of_all_ways(seed: int) -> None:
    sizes = np.random.default_rng(seed).uniform(1, 20, 6)
    ways = [np.array(way) for way in product(range(3), repeat=6) if len(set(way)) == 3]
    assert error(split_groups(sizes, SHARES), sizes, SHARES) == pytest.approx(
        min(error(way, sizes, SHARES) for way in ways)
    )


@pytest.mark.parametrize("seed", range(5))
def test_many_groups_come_near_to_the_shares(seed: int) -> None:
    sizes = np.random.default_rng(seed).uniform(1, 20, 60)
    reached = np.bincount(split_groups(sizes, SHARES), sizes, 3) / sizes.sum()
    np.testing.assert_allclose(reached, SHARES, atol=0.002)


def test_no_split_is_empty_however_uneven_the_groups_are() -> None:
    for sizes in ([1000.0, 1.0, 1.0], [1000.0, *[1.0] * 30], [1.0] * 3, [0.0] * 20):
        assert set(split_groups(sizes, SHARES).tolist()) == {0, 1, 2}


def test_fewer_groups_than_splits_are_refused() -> None:
    with pytest.raises(ParameterError, match="at least 3"):
        split_groups([1.0, 2.0], SHARES)
    with pytest.raises(ParameterError, match="above 0"):
        split_groups([1.0, 2.0], (1.0, 0.0))
