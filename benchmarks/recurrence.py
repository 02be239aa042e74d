"""`python -m benchmarks.recurrence`: the recurrence in 8 bits as `coarse_path_cost` has it, and as `path_cost` would.

Both kernels go over the rows of `ops.distances.sweep` for 20 templates of 250 columns.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numba as nb
import numpy as np

from benchmarks.harness import Figure, calibrate, seconds, show
from kinedex.console.terminal import make_console
from kinedex.ops.arrays import U8
from kinedex.ops.distances.recurrence import COARSE_CAP, coarse_path_cost
from kinedex.ops.distances.sweep import SLOTS, aligned_bytes

ROWS, FRAMES, WORDS = 80, 20_000, 500


@nb.njit(inline="always")
def saturated(one, other):  # type: ignore[no-untyped-def]
    """Add two numbers of 8 bits; the sum stops at `COARSE_CAP`."""
    total = np.uint8(one + other)
    return total if total >= other else np.uint8(COARSE_CAP)


@nb.njit(inline="always")
def unfactored(straight, slow, fast, cost):  # type: ignore[no-untyped-def]
    """Return the cost of a path as `path_cost` does, with additions that stop."""
    single = saturated(straight if straight < slow else slow, cost)
    double = saturated(fast, saturated(cost, cost))
    return double if double < single else single


def kernel(cell: Callable[..., np.uint8]) -> Callable[[U8, U8], None]:
    """Compile the loop over frames and rows for one form of the recurrence."""

    @nb.njit(nogil=True)
    def rows(table: U8, state: U8) -> None:
        before, behind, here = state[0], state[1], state[2]
        for frame in range(FRAMES):
            cost = table[frame % WORDS]
            for n in range(table.shape[1]):
                here[n + 2 * SLOTS] = cell(behind[n + SLOTS], before[n + SLOTS], behind[n], cost[n])
            before, behind, here = behind, here, before

    return rows  # type: ignore[no-any-return]


def figures() -> list[Figure]:
    """Time both forms on the same costs."""
    table = aligned_bytes((WORDS, ROWS * SLOTS))
    table[:] = np.random.default_rng(0).integers(0, 4, table.shape)
    state = aligned_bytes((3, (ROWS + 2) * SLOTS), 0)
    ours, other = (seconds(partial(kernel(cell), table, state), 20) for cell in (coarse_path_cost, unfactored))
    cells = table.shape[1] * FRAMES / 1e9
    return [Figure("coarse_path_cost, 8 bits", cells, "G cells", ours, "path_cost with additions that stop", other)]


if __name__ == "__main__":
    make_console().print(show([calibrate(), *figures(), calibrate()]))
