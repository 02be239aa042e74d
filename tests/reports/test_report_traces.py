"""The plot of the convergence of template learning."""

from __future__ import annotations

import pytest

from kinedex.reports.cards import HEIGHT, WIDTH, trace


def test_a_trace_falls_from_left_to_right_and_ends_below_the_threshold():
    found = trace([0.1, 0.02, 0.004])
    assert found is not None
    xs, ys, tips = zip(*found.dots, strict=True)
    assert list(xs) == sorted(xs)
    assert list(ys) == sorted(ys)  # down the screen
    assert ys[1] < found.threshold < ys[2]
    assert tips[0] == "before the first round: 0.1000"
    assert found.description.endswith("in 2 rounds: converged")


@pytest.mark.parametrize("costs", [(5.0, 0.0), (0.5, 0.5, 0.5), (1e-9, 0.0)])
def test_a_trace_stays_inside_its_plot(costs: tuple[float, ...]):
    found = trace(costs)
    assert found is not None
    assert all(0 <= x <= WIDTH and 0 <= y <= HEIGHT for x, y, _ in found.dots)


def test_nothing_is_drawn_where_nothing_was_averaged():
    assert trace([0.0]) is trace([]) is None
