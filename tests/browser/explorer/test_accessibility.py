"""Every page of the explorer by the rules of axe: names, roles, landmarks and contrast, in light and in dark."""

from __future__ import annotations

import pytest
from playwright.sync_api import Page, expect

from kinedex.explorer.application import BUILT
from tests.browser.explorer.conftest import Open
from tests.browser.explorer.test_map import MAP_MS

AXE = BUILT.parent / "page" / "node_modules" / "axe-core" / "axe.min.js"

PAGES = [
    "/?group=class",
    "/?view=quality",
    "/?view=wall",
    "/?view=map",
    "/?view=map&table=1",
    "/take/x_al_long_1",
    "/ask?take=x_al_jig_1&from=0&to=20&tau=0.5",
    "/label",
    "/label?take=x_al_long_1",
    "/label?view=learn",
    "/templates",
    "/templates?template=reel&other=jig&tau=0.1",
    "/templates?view=queries",
    "/runs",
    "/runs?view=start&pipeline=annotate",
    "/runs?view=methods",
    "/doubts",
    "/export",
]

COUNT = """
window.openRequests = 0;
const ask = window.fetch;
window.fetch = (...words) => {
  if (String(words[0].url ?? words[0]).includes('/api/events')) return ask(...words);
  window.openRequests += 1;
  return ask(...words).finally(() => { window.openRequests -= 1; });
};
"""
"""Counts the requests of a page that have no answer yet; the stream of events never ends."""

REST = """() => {
  const moves = (one) => one.playState === 'running' && isFinite(one.effect.getComputedTiming().endTime);
  const now = performance.now();
  if (window.openRequests > 0 || document.getAnimations().some(moves)) window.busy = now;
  return now - window.busy > 150;
}"""
"""True once a page has asked for nothing and nothing in it has moved for a while: contrast is that of what is seen."""


def rest(page: Page) -> None:
    """Wait until a page has come to rest after what was done to it."""
    page.evaluate("window.busy = performance.now()")
    page.wait_for_function(REST, polling=40)


def violations(page: Page) -> list[str]:
    """Return the rules that a page breaks, each with the element and what to do."""
    if page.evaluate("typeof axe") == "undefined":
        page.evaluate(AXE.read_text(encoding="utf-8") + ";0")
    found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")
    return [
        f"{rule['id']}: {node['target']}: {node['failureSummary']}"
        for rule in found["violations"]
        for node in rule["nodes"]
    ]


@pytest.fixture(autouse=True)
def needs_axe() -> None:
    if not AXE.is_file():
        pytest.skip("axe-core is not installed (make page)")


@pytest.mark.slow
def test_pages_keep_the_rules(open_page: Open) -> None:
    page = open_page()
    page.context.add_init_script(COUNT)
    origin = page.url.rstrip("/")
    faults = []
    for path in PAGES:
        page.goto(origin + path)
        expect(page.locator("main .page, main .take")).not_to_have_count(0)
        if "view=map" in path:  # a process computes it first
            expect(page.locator(".map-about")).to_be_visible(timeout=MAP_MS)
        rest(page)
        faults += [f"{path}, light: {fault}" for fault in violations(page)]
        # the page follows the system at once: it need not be loaded again
        page.emulate_media(color_scheme="dark")
        expect(page.locator("html")).to_have_attribute("data-mantine-color-scheme", "dark")
        rest(page)  # colours fade from one to the other
        faults += [f"{path}, dark: {fault}" for fault in violations(page)]
        page.emulate_media(color_scheme="light")
    assert not faults, "\n".join(faults)


def test_filters_columns_and_keys_keep_the_rules(open_page: Open) -> None:
    page = open_page()
    expect(page.get_by_role("gridcell").first).to_be_visible()
    page.keyboard.press("f")
    page.get_by_role("combobox", name="Column").fill("class")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    expect(page.get_by_role("checkbox").first).to_be_visible()
    rest(page)  # the opening of what floats is animated
    faults = violations(page)
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Columns").click()
    expect(page.get_by_role("checkbox", name="seconds")).to_be_visible()
    rest(page)
    faults += violations(page)
    page.keyboard.press("Escape")
    page.keyboard.press("?")
    expect(page.get_by_role("dialog", name="Keys")).to_be_visible()
    rest(page)
    faults += violations(page)
    assert not faults, "\n".join(faults)
