"""Tables of results on a terminal."""

from __future__ import annotations

import io
from typing import Literal

import pytest
from rich.console import Console

from kinedex.console.terminal import Terminal
from kinedex.pipelines.engine.display import Line, ResultTable


def printed(*parts: ResultTable | Line, width: int = 80) -> str:
    """Return what a terminal shows of results."""
    out = io.StringIO()
    Terminal(Console(file=out, width=width)).show(*parts)
    return out.getvalue()


def test_results_have_texts_to_the_left_numbers_to_the_right_and_nothing_that_rich_would_obey() -> None:
    table = ResultTable(("take", "mean"), title="[all]", caption="in [mm]")
    table.add("[b]a\x1b", "1.0", tone="main")
    table.add("all", "10.0", section=True)
    text = printed(Line("[first]", "main"), table)
    assert [line.split() for line in text.splitlines() if line.strip(" ─")] == [
        ["[first]"], ["[all]"], ["take", "mean"], ["[b]a\\x1b", "1.0"], ["all", "10.0"], ["in", "[mm]"]
    ]  # fmt: skip
    assert "all        10.0" in text


@pytest.mark.parametrize("layout", ["close", "tall"])
def test_numbers_of_a_close_table_stay_whole_where_the_terminal_is_narrow(layout: Literal["close", "tall"]) -> None:
    table = ResultTable(("", *(f"F {number}" for number in range(8))), layout=layout)
    table.add("a method with a long name", *["0.86–0.86"] * 4, *["0.5"] * 4)
    text = printed(table, width=72)
    assert text.count("0.86–0.86") == 4
    assert "…" not in text
