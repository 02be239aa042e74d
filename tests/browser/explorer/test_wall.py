"""The wall of an archive in a real browser: figures that move, in groups, by keys and clicks, in the address."""

from __future__ import annotations

import re

from playwright.sync_api import Page, expect

from tests.browser.explorer.conftest import Open


def active(page: Page) -> str:
    grid = page.get_by_role("grid", name="Takes")
    return str(page.locator(f"[id='{grid.get_attribute('aria-activedescendant')}'] .wall-name").text_content())


def picture(page: Page, take: str) -> str:
    return str(page.locator(".wall-take", has_text=take).locator("canvas").evaluate("one => one.toDataURL()"))


def test_takes_move_in_groups_and_keys_lead_to_them(open_page: Open) -> None:
    page = open_page("/?where=actor = 'al'")
    page.get_by_role("tab", name="Wall").click()
    expect(page.get_by_role("rowheader")).to_have_text(
        [re.compile(rf"^{one}1 take") for one in ("jig", "reel", "waltz", "none")]
    )
    expect(page.locator(".wall canvas")).to_have_count(4)
    page.get_by_role("grid", name="Takes").focus()
    page.keyboard.press("]")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowUp")
    assert active(page) == "x_al_waltz_1"
    page.keyboard.press("Control+Home")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("o")
    expect(page.get_by_role("rowheader")).to_have_count(1)
    expect(page.locator(".wall-amount")).to_contain_text("1 take")
    expect(page.get_by_role("button", name="Remove the filter class: reel")).to_be_visible()
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile("/take/x_al_reel_1"))
    page.go_back()
    expect(page.get_by_role("tab", name="Wall")).to_have_attribute("aria-selected", "true")
    expect(page.get_by_role("rowheader")).to_have_count(1)


def test_a_link_opens_the_same_wall_and_a_click_a_take(open_page: Open) -> None:
    page = open_page("/?view=wall&group=actor&size=small&sort=frames-&at=5")
    expect(page.get_by_role("rowheader")).to_have_text([re.compile("^al4 takes"), re.compile("^bo4 takes")])
    expect(page.locator(".wall-name").first).to_have_text("x_al_long_1")
    assert active(page) == "x_bo_jig_1"
    page.get_by_role("combobox", name="Grouped by").click()
    page.get_by_role("option", name="nothing").click()
    expect(page.get_by_role("rowheader")).to_have_count(0)
    page.locator(".wall-take", has_text="x_bo_reel_1").click()
    expect(page).to_have_url(re.compile("/take/x_bo_reel_1"))


def test_figures_rest_where_less_motion_is_preferred(open_page: Open) -> None:
    page = open_page()
    page.emulate_media(reduced_motion="reduce")
    page.get_by_role("tab", name="Wall").click()
    expect(page.locator(".wall canvas")).to_have_count(8)
    page.wait_for_function(
        "() => [...document.querySelectorAll('.wall canvas')].every(one => one.toDataURL().length > 1500)"
    )
    resting, active_one = picture(page, "x_bo_waltz_1"), picture(page, "x_al_jig_1")
    page.wait_for_function(
        "before => [...document.querySelectorAll('.wall canvas')].every(one => one.toDataURL() !== before)",
        arg=active_one,
    )  # the figure of the active take moves
    assert picture(page, "x_bo_waltz_1") == resting
    page.set_viewport_size({"width": 390, "height": 844})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
