"""The takes of an archive in a real browser: filters, SQL, totals and order by keys and clicks, in the address."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Locator, Page, expect

from tests.browser.explorer.conftest import WAIT_MS, Open


def names(page: Page) -> Locator:
    return page.locator(".grid-body .grid-cell:first-child")


def test_takes_are_filtered_by_keys_and_a_link_opens_the_same_view(open_page: Open) -> None:
    page = open_page()
    expect(page.get_by_role("gridcell", name="x_al_jig_1", exact=True)).to_be_visible()
    expect(page.locator(".amount [role=status]")).to_have_text(re.compile("^8 takes"))
    page.keyboard.press("f")
    page.get_by_role("combobox", name="Column").fill("actor")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    page.get_by_role("checkbox", name="al").check()
    expect(page.locator(".amount")).to_contain_text("4 takes")
    page.keyboard.press("Escape")
    page.get_by_role("button", name="reel", exact=True).click()
    expect(page.locator(".amount")).to_contain_text("1 take")
    expect(names(page)).to_have_text(["x_al_reel_1"])
    expect(page.get_by_role("button", name="reel", exact=True)).to_have_attribute("aria-pressed", "true")
    expect(page.locator(".shell-same code")).to_contain_text("kinedex sql")

    other = open_page(re.sub(r"^http://[^/]+", "", page.url))
    expect(other.locator(".amount")).to_contain_text("1 take")
    expect(other.get_by_role("button", name="Remove the filter actor: al")).to_be_visible()
    page.go_back()
    expect(page.locator(".amount")).to_contain_text("4 takes")
    page.keyboard.press("x")
    expect(page.locator(".amount")).to_contain_text("8 takes")


def test_sql_is_corrected_in_place(open_page: Open) -> None:
    page = open_page()
    expect(page.get_by_role("gridcell").first).to_be_visible()
    page.keyboard.press("/")
    condition = page.get_by_role("textbox", name="Condition of SQL over takes")
    condition.fill("clas = 'jig'")
    page.keyboard.press("Enter")
    expect(page.get_by_text('"clas" not found')).to_be_visible()
    expect(condition).to_have_attribute("aria-invalid", "true")
    expect(page.get_by_role("gridcell")).to_have_count(0)
    condition.fill("seconds > 3 ORDER BY x")
    page.keyboard.press("Enter")
    expect(page.get_by_text('at or near "ORDER": character 13, “ORDER BY x”')).to_be_visible()
    condition.fill("class = 'jig' AND seconds > 0.5")
    page.keyboard.press("Enter")
    expect(page.locator(".amount")).to_contain_text("2 takes")
    expect(condition).not_to_have_attribute("aria-invalid", "true")


def test_the_table_is_a_grid_for_keys_and_screen_readers(open_page: Open) -> None:
    page = open_page("/?columns=name,frames&sort=frames-")
    grid = page.get_by_role("grid", name="Takes")
    expect(grid).to_have_attribute("aria-rowcount", "9")
    expect(page.get_by_role("columnheader", name="frames")).to_have_attribute("aria-sort", "descending")
    for place, name in enumerate(("x_al_long_1", "x_bo_long_1")):
        expect(names(page).nth(place)).to_have_text(name)
    grid.focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    expect(page.get_by_role("columnheader", name="frames")).to_have_attribute("aria-sort", "none")
    page.keyboard.press("End")
    page.keyboard.press("Control+End")
    active = str(grid.get_attribute("aria-activedescendant"))
    expect(page.locator(f"[id='{active}']").locator("..")).to_have_attribute("aria-rowindex", "9")
    expect(page.locator("[aria-rowindex='9']")).to_contain_text("x_bo_waltz_1")  # rows come anew in the other order
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile("/take/x_bo_waltz_1"))


def test_the_table_has_its_takes_below_the_headings_of_their_groups(open_page: Open) -> None:
    page = open_page("/?group=class&sort=name-")
    grid = page.get_by_role("grid", name="Takes")
    headings = page.get_by_role("rowheader")
    expect(headings.first).to_contain_text("jig · 2 takes, ")
    expect(grid).to_have_attribute("aria-rowcount", "13")
    listed = [
        *("jig · ", "x_bo_jig_1", "x_al_jig_1", "reel · ", "x_bo_reel_1", "x_al_reel_1"),
        *("waltz · ", "x_bo_waltz_1", "x_al_waltz_1", "none · ", "x_bo_long_1", "x_al_long_1"),
    ]
    expect(names(page)).to_have_text([re.compile(f"^{one}" if one.endswith(" ") else f"^{one}$") for one in listed])
    grid.focus()
    page.keyboard.press("Control+End")
    page.keyboard.press("ArrowUp")
    page.keyboard.press("ArrowUp")
    page.keyboard.press("Enter")
    expect(page.locator(".amount")).to_contain_text("2 takes")
    expect(page.get_by_role("button", name="Remove the filter class: none")).to_be_visible()
    page.get_by_role("tab", name="Wall").click()
    expect(page.get_by_role("combobox", name="Grouped by")).to_have_value("class")


def test_what_is_to_be_looked_at_has_tabs_of_its_own(open_page: Open) -> None:
    page = open_page()
    page.get_by_role("tab", name="Duplicates").click()
    expect(page.get_by_text("Nobody has looked for duplicates yet")).to_be_visible()
    page.get_by_role("tab", name="Excluded files").click()
    expect(page.get_by_text("The last ingest has read all source files.")).to_be_visible()
    page.get_by_role("tab", name="Quality").click()
    expect(page.get_by_role("heading", name="Suspect takes")).to_be_visible()
    page.get_by_role("link").filter(has_text="height").or_(page.locator(".sheet a")).first.click()
    expect(page.get_by_role("textbox", name="Condition of SQL over takes")).not_to_have_value("")
    expect(page.locator(".amount")).not_to_contain_text(re.compile(r"^0 takes"))


def test_what_a_flag_means_is_read_by_keys(open_page: Open) -> None:
    page = open_page()
    expect(page.get_by_role("gridcell", name="x_al_jig_1", exact=True)).to_be_visible()
    note = page.get_by_role("note")
    expect(note).to_have_count(0)
    page.get_by_role("grid", name="Takes").focus()
    page.keyboard.press("End")
    expect(note).to_contain_text("figures of quality beyond their limits, or warnings of ingest")
    page.keyboard.press("Control+End")
    expect(note).to_contain_text("expected")
    assert note.bounding_box()["y"] > page.locator(".grid-body.active").bounding_box()["y"] + 20  # type: ignore[index]
    page.keyboard.press("Home")
    expect(note).to_have_count(0)


def test_an_address_that_names_nothing_says_so(open_page: Open) -> None:
    page = open_page("/runs/nobody%3F")
    expect(page.get_by_text("Nothing under Runs is named “nobody?”.")).to_be_visible()
    page.get_by_role("link", name="Open Runs").click()
    expect(page.get_by_role("heading", name="Runs", exact=True)).to_be_visible()
    origin = page.url.removesuffix("/runs")
    page.goto(f"{origin}/templates/nobody")
    page.get_by_role("link", name="Open Templates").click()
    expect(page.get_by_role("heading", name="Templates", exact=True)).to_be_visible()
    page.goto(f"{origin}/runs?view=start&pipeline=nobody")
    expect(page.get_by_text("No pipeline has the name “nobody”")).to_be_visible()
    page.goto(f"{origin}/ask?take=x_al_jig_1&from=20&to=10")
    expect(page.get_by_text("The interval has to end after it begins.")).to_be_visible()
    expect(page.get_by_role("textbox", name="From (s)")).to_have_value("0.67")
    page.locator(".chooser").get_by_label("Take").first.fill("nobody")
    expect(page.get_by_text("No take has this name.")).to_be_visible()


def test_a_page_opened_while_the_store_is_gone_recovers_by_itself(
    browser: Browser, store: Path, serve: Callable[..., str], tmp_path: Path
) -> None:
    here, away = tmp_path / "store", tmp_path / "away"
    shutil.copytree(store, here)
    address = serve(here, "--read-only")
    here.rename(away)
    context = browser.new_context()
    page = context.new_page()
    page.set_default_timeout(WAIT_MS)
    page.goto(address)
    expect(page.get_by_role("alert").first).to_be_visible()
    expect(page.get_by_role("status").first).to_contain_text("the store cannot be read")
    away.rename(here)
    expect(page.get_by_role("gridcell", name="x_al_jig_1", exact=True)).to_be_visible()
    expect(page.get_by_text("the store cannot be read")).to_have_count(0)
    page.goto(address.split("/?")[0] + "/label?take=x_al_long_1")
    expect(page.get_by_text("drag in a lane: select")).to_be_visible()
    expect(page.get_by_text("drag in a lane: draw")).to_have_count(0)
    page.keyboard.press("?")
    keys = page.get_by_role("dialog", name="Keys")
    expect(keys).to_contain_text("Choose the next label or annotation")
    expect(keys).not_to_contain_text("Split")
    context.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_shows_the_takes_without_a_page_that_is_too_wide(open_page: Open, scheme: str) -> None:
    page = open_page(width=390, height=844, scheme=scheme)
    expect(page.get_by_role("gridcell").first).to_be_visible()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert page.evaluate("document.querySelector('main').scrollWidth <= 390")


def test_all_keys_are_listed(open_page: Open) -> None:
    page = open_page()
    expect(page.get_by_role("gridcell").first).to_be_visible()
    page.keyboard.press("?")
    expect(page.get_by_role("dialog", name="Keys")).to_contain_text("Add a filter")
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_be_hidden()
    page.keyboard.press("g")
    page.keyboard.press("e")
    expect(page).to_have_url(re.compile("/export$"))
