"""The page that asks, in a browser: by example with verdicts by keys, by keyframes while editing, and by SQL."""

from __future__ import annotations

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
    page.get_by_role("button", name="More like these, less like those").click()
    expect(page.get_by_role("heading", name="Less like these 1")).to_be_visible()
    assert "less=" in page.url
    expect(page.get_by_label("The same by command")).to_contain_text("kinedex rank")
    page.go_back()
    expect(page.get_by_role("heading", name="Like this")).to_be_visible()


def test_keyframes_answer_while_they_are_edited_and_name_the_line_of_a_fault(open_page: Open) -> None:
    text = "low:\n  keyframes:\n    - {on: [lknee_bent]}\n"
    page = open_page(f"/ask?way=keyframes&yaml={quote(text)}")
    status = page.get_by_role("region", name="Hits").get_by_role("status").first
    expect(status).to_contain_text("intervals in")
    page.get_by_role("button", name="lknee_bent: on").first.click()
    expect(page.get_by_label("The same as YAML")).to_have_value("low:\n  keyframes:\n    - {off: [lknee_bent]}\n")
    page.get_by_label("The same as YAML").fill("low:\n  keyframes:\n    - {on: [no_such]}\n")
    expect(page.get_by_role("alert").filter(has_text="Line 3")).to_contain_text("no_such")


def test_rows_of_sql_scroll_and_intervals_are_hits(open_page: Open) -> None:
    page = open_page(f"/ask?way=sql&sql={quote('SELECT name AS take, 0 AS start, 9 AS stop FROM takes')}")
    expect(page.get_by_role("listbox", name="Hits, the best first")).to_be_visible()
    page.get_by_role("textbox", name="SQL").fill("SELECT i, i * i AS square FROM range(30000) r(i)")
    page.keyboard.press("Control+Enter")
    rows = page.get_by_role("table", name="Rows")
    expect(rows).to_have_attribute("aria-rowcount", "30001")
    rows.evaluate("element => { element.scrollTop = element.scrollHeight }")
    expect(rows.get_by_role("cell", name="29999", exact=True)).to_be_visible()
    page.get_by_role("textbox", name="SQL").fill("DROP TABLE takes")
    page.keyboard.press("Control+Enter")
    expect(page.get_by_role("alert").filter(has_text="only queries that read")).to_be_visible()
