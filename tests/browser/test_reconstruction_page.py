"""The page of takes made from depth: nothing beyond the window, and a click plays the take."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect

from kinedex.pipelines.engine.runner import run_pipeline
from tests.browser.pages import BEYOND, SCROLLED, SMALL, WAIT_MS, is_drawn, opened
from tests.pipelines.reconstruction.recordings import PATTERNS, filmed_by_depth


@pytest.fixture(scope="module")
def report(browser: Browser, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of two takes that were filmed by a simulated depth camera."""
    folder = tmp_path_factory.mktemp("reconstruction")
    filmed_by_depth(folder)
    settings = {
        "source": str(folder / "source"),
        "recordings": str(folder / "rec" / "recordings.yaml"),
        "patterns": PATTERNS,
        "reconstruct.direction": "forward",
    }
    run_pipeline("reconstruct", folder / "store", settings=settings, executor="serial")
    return folder / "store" / "results" / "reports" / "reconstruct" / "reconstruction.html"


@pytest.mark.parametrize(("size", "scheme"), [("desk", "light"), ("phone", "dark")])
def test_nothing_is_beyond_the_window_or_too_small(browser: Browser, report: Path, size: str, scheme: str) -> None:
    with opened(browser, report, size, scheme) as page:
        assert page.evaluate(BEYOND) == []
        if size == "desk":
            assert page.evaluate(SCROLLED) == []
        page.locator("canvas[data-start]").first.click()
        expect(page.locator("#player")).to_be_visible()
        assert page.evaluate(SMALL) == []


def test_a_click_on_a_lent_interval_plays_it_without_rays(browser: Browser, report: Path) -> None:
    with opened(browser, report, reduced_motion="reduce") as page:
        lent = page.locator("rect.lent").first
        assert ", frame " in (lent.locator("title").text_content() or "")
        lent.click()
        expect(page.locator("#player .title")).to_contain_text("· pose from the archive", timeout=WAIT_MS)
        assert is_drawn(page, "#player canvas")
        expect(page.locator("#player .rays")).to_be_hidden()


def test_a_jump_is_played_beside_the_truth(browser: Browser, report: Path) -> None:
    with opened(browser, report, reduced_motion="reduce") as page:
        page.locator(".jumps button.see").first.click()
        title = page.locator("#player .title")
        expect(title).to_contain_text("jump to x_", timeout=WAIT_MS)
        expect(title).to_contain_text("beside it x_")
        assert is_drawn(page, "#player canvas")
