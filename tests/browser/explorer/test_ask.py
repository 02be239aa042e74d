"""The page that asks, in a browser: by example with verdicts by keys, by keyframes while editing, and by SQL."""

from __future__ import annotations

import json
import re
from urllib.parse import quote

from playwright.sync_api import expect

from tests.browser.explorer.conftest import Open

CLIP = "x_al_jig_1"
EXAMPLE = f"/ask?take={CLIP}&from=0&to=20&tau=0.5"


def test_hits_are_judged_by_keys_and_the_next_question_has_their_verdicts(open_page: Open) -> None:
    page = open_page(EXAMPLE)
    hits = page.get_by_role("listbox", name="Hits, the best first").get_by_role("option")
    expect(hits.first).to_be_visible()
    assert hits.count() > 2
    hits.first.focus()
    page.keyboard.press("y")
    page.keyboard.press("n")
    bar = page.get_by_role("toolbar", name="What to do with the hits")
    expect(bar).to_contain_text("1 accepted, 1 rejected")
    expect(page.get_by_role("complementary", name="The chosen hit")).to_contain_text("cost")
    page.reload()
    expect(bar).to_contain_text("1 accepted, 1 rejected")
    # how a hit fits stands beside it, while the pointer rests on it
    hits.last.hover()
    expect(page.locator(".fit-preview svg").first).to_be_visible()
    page.get_by_role("button", name="More like these, less like those").click()
    expect(page.get_by_role("heading", name="Less like these 1")).to_be_visible()
    # a place that was decided is marked in the next answer, whatever its ends are there
    expect(hits.filter(has_text="✓ yes").first).to_be_visible()
    expect(page.get_by_role("option", name=re.compile(" example, at ")).first).to_be_visible()
    assert "less=" in page.url
    expect(page.get_by_label("The same by command")).to_contain_text("kinedex rank")
    page.go_back()
    expect(page.get_by_role("heading", name="Like this")).to_be_visible()


def test_the_ends_of_the_example_are_moved_and_the_next_question_is_asked(open_page: Open) -> None:
    page = open_page(EXAMPLE)
    end = page.get_by_role("slider", name="The example ends")
    end.press("ArrowLeft")
    end.press("ArrowLeft")
    expect(page).to_have_url(re.compile("to=18"))
    expect(page.get_by_label("The same by command")).to_contain_text("--stop 18")


def test_what_a_search_leaves_is_saved_and_the_page_says_where(open_page: Open) -> None:
    page = open_page(EXAMPLE)
    expect(page.get_by_role("listbox", name="Hits, the best first").get_by_role("option").first).to_be_visible()
    for item, ending, command in (
        (re.compile("^Template"), "example.yaml", "kinedex rank"),
        (re.compile("^Query"), "query.yaml", "kinedex search"),
        (re.compile("^Intervals"), "ranges.csv", "kinedex export"),
    ):
        page.get_by_role("button", name="Save as…").click()
        with page.expect_download() as got:
            page.get_by_role("menuitem", name=item).click()
        assert got.value.suggested_filename == ending
        assert got.value.path().stat().st_size > 20
        expect(page.get_by_role("alert").filter(has_text=command)).to_be_visible()
    page.get_by_role("button", name="Save as…").click()
    page.get_by_role("menuitem", name="go to Export").click()
    expect(page).to_have_url(re.compile("/export.*hits="))


def test_filters_of_the_archive_limit_the_search_and_go_to_export(open_page: Open) -> None:
    page = open_page(f"/?where={quote('seconds > 0')}")
    page.get_by_role("link", name="Search these").click()
    expect(page).to_have_url(re.compile("/ask.where="))
    filters = json.dumps([{"column": "name", "values": [CLIP]}])
    page.goto(f"{page.url.split('/ask')[0]}{EXAMPLE}&filters={quote(filters)}")
    hits = page.get_by_role("listbox", name="Hits, the best first").get_by_role("option")
    expect(hits.first).to_be_visible()
    assert all(CLIP in (one.get_attribute("aria-label") or "") for one in hits.all())
    expect(page.get_by_label("The same by command")).to_contain_text("--where")
    page.get_by_role("link", name="Export these").click()
    expect(page).to_have_url(re.compile("/export.filters="))


def test_keyframes_answer_while_they_are_edited_and_name_the_line_of_a_fault(open_page: Open) -> None:
    text = "low:\n  keyframes:\n    - {on: [lknee_bent]}\n"
    page = open_page(f"/ask?way=keyframes&yaml={quote(text)}")
    status = page.get_by_role("region", name="Hits").get_by_role("status").first
    expect(status).to_contain_text("intervals in")
    page.get_by_role("button", name="lknee_bent: on").first.click()
    expect(page.get_by_label("The same as YAML")).to_have_value("low:\n  keyframes:\n    - {off: [lknee_bent]}\n")
    # by keys alone: features by the first letters of their names, and the time between poses
    page.get_by_role("combobox", name="Add a feature to pose 1").focus()
    page.keyboard.type("rknee_b")
    page.keyboard.press("Enter")
    page.get_by_role("button", name="Add a pose").press("Enter")
    page.get_by_role("slider", name="Time from pose 1 to pose 2: at least").press("ArrowRight")
    yaml = page.get_by_label("The same as YAML")
    expect(yaml).to_have_value(re.compile("on: .rknee_bent.*\n.*after: 4 to 30 frames"))
    expect(page.get_by_role("combobox", name="Add a feature to pose 1")).to_have_value("")
    page.get_by_label("The same as YAML").fill("low:\n  keyframes:\n    - {on: [no_such]}\n")
    expect(page.get_by_role("alert").filter(has_text="Line 3")).to_contain_text("no_such")


def test_rows_of_sql_scroll_and_intervals_are_hits(open_page: Open) -> None:
    page = open_page(f"/ask?way=sql&sql={quote('SELECT name AS take, 0 AS start, 9 AS stop FROM takes')}")
    expect(page.get_by_role("listbox", name="Hits, the best first")).to_be_visible()
    page.get_by_role("textbox", name="SQL").fill("SELECT i, i * i AS square FROM range(30000) r(i)")
    page.keyboard.press("Control+Enter")
    rows = page.get_by_role("grid", name="Rows")
    expect(rows).to_have_attribute("aria-rowcount", "30001")
    rows.evaluate("element => { element.scrollTop = element.scrollHeight }")
    expect(rows.get_by_role("gridcell", name="29999", exact=True)).to_be_visible()
    page.get_by_role("textbox", name="SQL").fill("DROP TABLE takes")
    page.keyboard.press("Control+Enter")
    expect(page.get_by_role("alert").filter(has_text="only queries that read")).to_be_visible()
