"""The page of stabilised takes: before and after side by side, with the cameras and their rays."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect

from tests.browser.pages import BEYOND, SCROLLED, SMALL, WAIT_MS, is_drawn, opened, picture
from tests.pipelines.tracking.tracks import filmed_archive, run


@pytest.fixture(scope="module")
def report(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of one take that was filmed by simulated cameras."""
    folder = tmp_path_factory.mktemp("stabilised")
    filmed_archive(folder)
    run(folder)
    return folder / "store" / "results" / "reports" / "stabilise" / "stabilised.html"


@pytest.mark.parametrize(("size", "scheme"), [("desk", "light"), ("phone", "dark")])
def test_nothing_is_beyond_the_window_or_too_small(browser: Browser, report: Path, size: str, scheme: str) -> None:
    with opened(browser, report, size, scheme) as page:
        assert page.evaluate(BEYOND) == []
        if size == "desk":
            assert page.evaluate(SCROLLED) == []
        page.locator("canvas[data-start]").first.click()
        expect(page.locator("#player")).to_be_visible()
        assert page.evaluate(SMALL) == []


def test_a_click_plays_the_take_after_and_before_with_rays(browser: Browser, report: Path) -> None:
    with opened(browser, report, reduced_motion="reduce") as page:
        page.locator("canvas[data-start]").first.click()
        expect(page.locator("#player .title")).to_contain_text("x_al_hop_1_tracked", timeout=WAIT_MS)
        assert is_drawn(page, "#player canvas")
        before = picture(page, "#player canvas")
        rays = page.locator("#player .rays")
        expect(rays).to_be_visible()
        rays.check()
        assert picture(page, "#player canvas") != before
        rays.uncheck()
        assert picture(page, "#player canvas") == before
        assert page.locator("line.playhead").count() > 0
