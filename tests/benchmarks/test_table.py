"""The table of benchmarks: what is a rate, what is an amount, and how much better than something else."""

from __future__ import annotations

from benchmarks.harness import Figure


def test_what_is_timed_has_a_rate_and_is_so_many_times_as_fast() -> None:
    figure = Figure("words to runs", 8.0, "M frames", 0.5, "plain Python", 5.0)
    assert (figure.shown, figure.rate, figure.ratio) == ("16 M frames/s", 16.0, 10.0)


def test_memory_has_no_rate_and_is_so_many_times_as_small() -> None:
    figure = Figure("bit slices", 2.5, "GiB", None, "words", other_amount=5.0)
    assert (figure.shown, figure.rate, figure.ratio) == ("2.5 GiB", None, 2.0)
    assert Figure("slope", 0.4, "", None).shown == "0.4"


def test_what_was_left_out_shows_nothing() -> None:
    figure = Figure("BVH files", 0.0, "MB", None, "left out: no files")
    assert (figure.shown, figure.ratio) == ("–", None)
