"""The benchmark of the page drives a long table, motion that is scrubbed, takes that open, and questions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, expect

from benchmarks.explorer_browser import (
    anonymous_mib,
    asked,
    calibrate_page,
    first_rows,
    go,
    group_rows,
    loaded_files,
    new_page,
    open_rows,
    open_take,
    read_frames,
    recorded,
    scroll,
    scrub,
    show_take,
)
from benchmarks.explorer_browser import explorer as served
from kinedex.explorer.application import BUILT
from tests.browser.explorer.conftest import WAIT_MS

pytestmark = pytest.mark.slow

ROWS = "SELECT range AS number, 'row ' || range AS text, range % 7 AS rest FROM range(100000)"


def test_a_table_of_100000_rows_scrolls_and_is_read_in_the_order_of_its_rows(browser: Browser, explorer: str) -> None:
    base = explorer.split("/?")[0]
    with new_page(browser) as page:
        assert first_rows(page, explorer) > 0
        assert set(loaded_files(page)) <= {path.name for path in (BUILT / "assets").iterdir()}
        open_rows(page, base, ROWS)
        frames = recorded(page, lambda: scroll(page, jumps=5, pixels=800))
        assert len(frames.work_ms) > 10
        assert (frames.work_ms > 0).all()
        assert frames.wall_ms.sum() > 0.9 * frames.work_ms.sum()
        assert calibrate_page(page) > 0
        grid = page.get_by_role("grid", name="Rows")
        expect(grid).to_have_attribute("aria-rowcount", "100001")
        grid.focus()
        page.keyboard.press("ArrowDown")
        page.keyboard.press("Control+End")
        last = page.get_by_role("row").filter(has=page.get_by_role("gridcell", name="row 99999", exact=True))
        expect(last).to_have_attribute("aria-rowindex", "100001")
        expect(last).to_be_in_viewport()
        expect(last.locator(".active")).to_have_attribute("id", str(grid.get_attribute("aria-activedescendant")))
        for key in ("PageUp", "PageUp", "ArrowUp"):
            page.keyboard.press(key)
        page.wait_for_function(
            """() => {
              const lines = [...document.querySelectorAll('.grid-body')];
              const rows = lines.map((one) => Number(one.dataset.row));
              const inOrder = rows.every((row, i) => i === 0 || row === rows[i - 1] + 1);
              const texts = lines.every((one, i) => one.firstElementChild.textContent === String(rows[i]));
              return inOrder && texts && rows.length > 20 && rows.length < 80 && rows[0] < 99950;
            }""",
            timeout=WAIT_MS,
        )


def test_takes_open_and_are_scrubbed_and_questions_are_timed(browser: Browser, store: Path) -> None:
    with served(store) as server, new_page(browser) as page:
        assert first_rows(page, server.address) > 0
        assert server.ready_seconds > 0
        assert group_rows(page, server.base, "class") > 0
        expect(page.locator(".grid-heading").first).to_contain_text("jig · 2 takes")
        page.goto(server.base)
        assert anonymous_mib(server.process) > 10
        assert open_take(page, 0) > 0
        show_take(page, server.base, "x_al_long_1")
        assert len(recorded(page, lambda: scrub(page, 8)).work_ms) > 8
        page.goto(f"{server.base}/ask")
        trip = asked(page, "/api/ask/examples", lambda: go(page, "/ask?take=x_al_long_1&from=10&to=40"))
        assert 0 < trip.parsed < trip.shown


def test_work_since_the_frame_before_counts_for_the_next() -> None:
    main = {"pid": 1, "tid": 2}
    events = [
        {"name": "thread_name", "ph": "M", "args": {"name": "CrRendererMain"}, **main},
        *({"name": "AnimationFrame", "ph": "b", "ts": at, **main} for at in (20_500, 40_500)),
        *(
            {"name": "RunTask", "ph": "X", "ts": at, "dur": lasts, "tdur": own, **main}
            for at, lasts, own in (
                (10_000, 2_000, 1_000), (20_000, 5_000, 4_000), (26_000, 1_000, 1_000), (40_000, 3_000, 2_000),
                (50_000, 9_000, 9_000),
            )
        ),
        {"name": "RunTask", "ph": "X", "ts": 21_000, "dur": 7_000, "tdur": 7_000, "pid": 1, "tid": 3},
    ]  # fmt: skip
    frames = read_frames(events)
    np.testing.assert_allclose(frames.work_ms, [5, 3])
    np.testing.assert_allclose(frames.wall_ms, [7, 4])
    assert frames.seconds == 0.02
