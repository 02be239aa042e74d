"""The report of an annotation, as people see it: at a desk and on a phone, light and dark, on paper, in motion."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect

from tests.browser.pages import BEYOND, SCROLLED, SMALL, WAIT_MS, is_drawn, opened, picture


@pytest.fixture(scope="module")
def report(store: Path) -> Path:
    return store / "results" / "reports" / "dances" / "report.html"


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", ["desk", "phone"])
def test_nothing_is_beyond_the_window_or_cut_off(browser: Browser, report: Path, size: str, scheme: str) -> None:
    with opened(browser, report, size, scheme) as page:
        page.evaluate("for (const fold of document.querySelectorAll('details')) fold.open = true")
        assert page.evaluate(BEYOND) == []
        if size == "desk":
            assert page.evaluate(SCROLLED) == []


def test_a_finger_hits_every_button(browser: Browser, report: Path) -> None:
    with opened(browser, report, "phone", has_touch=True) as page:
        page.evaluate("for (const fold of document.querySelectorAll('details')) fold.open = true")
        page.locator("rect.playable").first.tap()
        expect(page.locator("#player")).to_be_visible()
        assert page.evaluate(SMALL) == []


def test_the_player_plays_and_stops_and_its_playhead_moves(browser: Browser, report: Path) -> None:
    with opened(browser, report) as page:
        page.locator("rect.playable").first.click()
        expect(page.locator("#player")).to_be_visible()
        assert is_drawn(page, "#player canvas")
        head = page.locator("line.playhead").first
        page.wait_for_function("x => document.querySelector('line.playhead').getAttribute('x1') !== x",
                               arg=head.get_attribute("x1"), timeout=WAIT_MS)  # fmt: skip
        play = page.locator("#player .play")
        expect(play).to_have_text("pause")
        play.click()
        expect(play).to_have_text("play")
        before = picture(page, "#player canvas")
        page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
        assert picture(page, "#player canvas") == before
        page.keyboard.press("Escape")
        expect(page.locator("#player")).to_be_hidden()
        assert page.locator("line.playhead").count() == 0


def test_who_wants_no_motion_gets_none(browser: Browser, report: Path) -> None:
    with opened(browser, report, reduced_motion="reduce") as page:
        page.locator("rect.playable").first.click()
        expect(page.locator("#player .play")).to_have_text("play")


def test_a_table_sorts_by_a_click_on_a_head_and_back(browser: Browser, report: Path) -> None:
    with opened(browser, report) as page:
        page.evaluate("for (const fold of document.querySelectorAll('details')) fold.open = true")
        table = page.locator("table.sortable").first
        head = table.locator("th button").first
        names = "table => [...table.tBodies[0].rows].map(row => row.cells[0].textContent.trim())"
        head.click()
        first = table.evaluate(names)
        head.click()
        assert table.evaluate(names) == first[::-1]
        assert len(first) > 1


def test_paper_gets_the_folded_parts_and_the_whole_command(browser: Browser, report: Path) -> None:
    with opened(browser, report) as page:
        page.emulate_media(media="print")
        page.evaluate("dispatchEvent(new Event('beforeprint'))")
        assert page.locator("details:not([open])").count() == 0
        command = page.locator("#provenance pre").first
        assert command.evaluate("one => one.scrollWidth <= one.clientWidth + 1")
        expect(page.locator("#player")).to_be_hidden()
        pdf = page.pdf(format="A4")
        assert pdf.startswith(b"%PDF")
        assert len(pdf) > 10_000
