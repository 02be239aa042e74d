"""The Label page in a browser: what a person draws, drags, undoes and accepts is in the store."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

import kinedex
from kinedex.explorer.application import BUILT
from tests.browser.explorer.conftest import WAIT_MS
from tests.pipelines.archives import write_archive

TAKE = "x_al_long_1"


class Explorer:
    """A server of a store; it can be killed and started again on the same port."""

    def __init__(self, store: Path) -> None:
        self.store = store
        self.port = 0
        self.start()

    def start(self) -> None:
        words = [sys.executable, "-m", "kinedex", "explore", str(self.store), "--no-browser", "--port", str(self.port)]
        self.process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        found = re.search(r"http://\S+:(\d+)/\?token=\S+", self.process.stdout.readline())
        assert found is not None
        self.address, self.port = found[0], int(found[1])

    def url(self, path: str) -> str:
        return f"http://127.0.0.1:{self.port}{path}"

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait(timeout=30)


@pytest.fixture(scope="module")
def explorer(store: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Explorer]:
    if not (BUILT / "index.html").is_file():
        missing = "the page of the explorer has not been built: run `make page`"
        if os.environ.get("KINEDEX_BROWSER") == "required":
            pytest.fail(missing)
        pytest.skip(missing)
    copy = tmp_path_factory.mktemp("label") / "store"
    shutil.copytree(store, copy)
    running = Explorer(copy)
    yield running
    running.kill()


@pytest.fixture
def page(browser: Browser, explorer: Explorer) -> Iterator[Page]:
    context = browser.new_context(viewport={"width": 1400, "height": 1000})
    page = context.new_page()
    page.set_default_timeout(WAIT_MS)
    page.faults = []  # type: ignore[attr-defined]
    page.on("pageerror", lambda fault: page.faults.append(fault))  # type: ignore[attr-defined]
    context.request.get(explorer.address)  # its cookie
    yield page
    assert page.faults == []  # type: ignore[attr-defined]
    context.close()


def labels(explorer: Explorer, where: str) -> list[tuple[object, ...]]:
    found = kinedex.open_store(explorer.store).labels.table(where).select("class", "start", "stop", "verdict", "origin")
    return found.rows()


def open_take(page: Page, explorer: Explorer) -> None:
    page.goto(explorer.url(f"/label?take={TAKE}&class=hop"))
    expect(page.locator(".label-annotation").first).to_be_visible()


def drag(page: Page, lane: str, start: float, stop: float) -> None:
    """Drag over shares of a lane."""
    box = page.locator(f'[data-lane="{lane}"]').bounding_box()
    assert box is not None
    y = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + start * box["width"], y)
    page.mouse.down()
    page.mouse.move(box["x"] + (start + stop) / 2 * box["width"], y)
    page.mouse.move(box["x"] + stop * box["width"], y)
    page.mouse.up()


def saved(page: Page) -> None:
    expect(page.get_by_test_id("saved")).to_contain_text("Saved")


def test_labels_are_drawn_dragged_undone_and_accepted(page: Page, explorer: Explorer) -> None:
    open_take(page, explorer)
    (frames,) = kinedex.open_store(explorer.store).takes(f"name = '{TAKE}'")["frames"].to_list()
    drag(page, "new", 0.25, 0.5)
    saved(page)
    ((_, start, stop, verdict, origin),) = labels(explorer, "class = 'hop'")
    assert abs(int(str(start)) - frames / 4) <= 2
    assert abs(int(str(stop)) - frames / 2) <= 2
    assert (verdict, origin) == ("positive", "drawn")
    drag(page, "labels/hop", 0.499, 0.75)  # its end
    saved(page)
    expect(page.locator(".label-label")).to_have_count(1)
    ((_, same, later, _, origin),) = labels(explorer, "class = 'hop'")
    assert (same, origin) == (start, "corrected")
    assert abs(int(str(later)) - 3 * frames / 4) <= 2
    page.keyboard.press("Control+z")
    expect(page.locator(".label-label")).to_have_attribute(
        "title", re.compile(f"frames {start} to {stop}, label drawn")
    )
    saved(page)
    assert labels(explorer, "class = 'hop'")[0][2] == stop
    page.keyboard.press("Control+Shift+z")
    expect(page.locator(".label-label")).to_have_attribute("title", re.compile(f"to {later}"))
    page.keyboard.press("Control+z")
    page.keyboard.press("Control+z")
    expect(page.locator(".label-label")).to_have_count(0)
    saved(page)
    assert labels(explorer, "class = 'hop'") == []
    history = kinedex.open_store(explorer.store).labels.table("class = 'hop'", history=True)
    assert history.height >= 4
    page.keyboard.press("Home")
    page.keyboard.press("k")
    page.keyboard.press("y")
    expect(page.locator(".label-annotation.label-accepted")).to_have_count(1)
    saved(page)
    assert [row[3:] for row in labels(explorer, f"take = '{TAKE}'")] == [("positive", "accepted")]


def test_what_the_address_names_is_chosen_when_it_arrives(page: Page, explorer: Explorer) -> None:
    page.goto(explorer.url(f"/label?take={TAKE}&from=3&to=17"))
    expect(page.locator(".label-annotation").first).to_be_visible()
    expect(page.locator('[aria-pressed="true"]')).to_have_count(0)
    store = kinedex.open_store(explorer.store)
    store.labels.add([{"take": TAKE, "class": "late", "start": 3, "stop": 17}], annotator="somebody")
    expect(page.locator('[aria-pressed="true"]')).to_have_attribute("title", re.compile("frames 3 to 17, label drawn"))


def test_the_queue_is_answered_by_keys(page: Page, explorer: Explorer) -> None:
    page.goto(explorer.url("/label"))
    counts = page.get_by_test_id("queue-counts")
    expect(counts).to_contain_text("undecided of")
    before = int(counts.inner_text().split(" ")[0])
    page.keyboard.press("n")
    page.keyboard.press(" ")
    page.keyboard.press("y")
    expect(counts).to_contain_text(f"{before - 2} undecided of")
    saved(page)
    assert len(labels(explorer, "verdict = 'negative'")) == 1
    page.keyboard.press("Control+z")
    expect(counts).to_contain_text(f"{before - 1} undecided of")


def test_decisions_wait_for_a_server_that_was_killed(page: Page, explorer: Explorer) -> None:
    open_take(page, explorer)
    drag(page, "new", 0.6, 0.7)
    saved(page)
    explorer.kill()
    ((*_, verdict, origin),) = labels(explorer, "class = 'hop'")
    assert (verdict, origin) == ("positive", "drawn")
    drag(page, "new", 0.8, 0.9)
    expect(page.get_by_test_id("saved")).to_contain_text("Not saved: 1 decision is kept")
    expect(page.locator(".label-label").filter(has_text="hop")).to_have_count(2)
    explorer.start()
    page.context.new_page().goto(explorer.address)  # the new server has a new token
    saved(page)
    assert len(labels(explorer, "class = 'hop'")) == 2


def test_two_tabs_label_one_take_while_an_ingest_runs(page: Page, explorer: Explorer, tmp_path: Path) -> None:
    write_archive(tmp_path / "more", {"takes/x_cy_more_1.amc": 60}, first_seed=9)
    ingest = [sys.executable, "-m", "kinedex", "ingest", str(explorer.store), str(tmp_path / "more")]
    open_take(page, explorer)
    other = page.context.new_page()
    open_take(other, explorer)
    running = subprocess.Popen([*ingest, "--executor", "serial"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    page.bring_to_front()
    page.get_by_role("combobox", name="Class of new labels").fill("turn")
    drag(page, "new", 0.1, 0.2)
    saved(page)
    other.bring_to_front()
    turn = other.locator('[data-lane="labels/turn"] .label-label')
    expect(turn).to_have_count(1)
    turn.click()
    other.keyboard.press("n")
    expect(turn).to_have_class(re.compile("label-negative"))
    saved(other)
    page.bring_to_front()
    page.keyboard.press("Control+z")  # what it would undo is not any more what this tab has made
    expect(page.get_by_role("alert")).to_contain_text("changed again meanwhile")
    shown, _ = running.communicate(timeout=120)
    assert running.returncode == 0, shown
    expect(page.locator(".shell-header")).to_contain_text("9 takes")
    assert [row[3] for row in labels(explorer, "class = 'turn'")] == ["negative"]
    assert "x_cy_more_1" in kinedex.open_store(explorer.store).takes()["name"].to_list()
