"""The Runs page in a browser: the plan with its reasons, the history, metrics, and a report in a sandbox."""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from pathlib import Path

import pytest
from playwright.sync_api import expect

from kinedex.storage.store.store import open_store
from kinedex.storage.store.writer import StoreWriter
from tests.browser.explorer.conftest import WAIT_MS, Open


@pytest.mark.parametrize("width", [1400, 390])
def test_a_report_opens_without_the_origin_of_the_explorer(open_page: Open, width: int) -> None:
    page = open_page("/runs", width=width)
    expect(page.get_by_role("region", name="Runs of pipelines")).to_contain_text("dances")
    page.get_by_text("6 ran").click()
    expect(page.get_by_text("has not run yet").first).to_be_visible()
    faults: list[str] = []
    page.context.on("weberror", lambda fault: faults.append(str(fault.error)))
    with page.context.expect_page() as opened:
        page.get_by_role("link", name="report.html").click()
    report = opened.value
    expect(report.locator("h1").first).to_be_visible()
    assert report.evaluate("window.origin") == "null"
    assert report.evaluate("fetch('/api/store').then(() => 'answered', () => 'refused')") == "refused"
    assert not faults


def test_a_plan_has_reasons_and_a_wrong_setting_its_error_in_place(open_page: Open, store: Path) -> None:
    page = open_page("/runs?view=start")
    page.get_by_role("button", name="dances").click()
    source = page.get_by_label("source", exact=True)
    for text, error in (("", "the setting 'source' must be given"), ("/nowhere", "is not a folder")):
        source.fill(text)
        source.press("Enter")
        expect(page.get_by_text(error)).to_have_count(1)
        expect(source).to_have_attribute("aria-invalid", "true")
    source.fill(str(store.parent / "archive"))
    source.press("Enter")
    expect(page.get_by_test_id("plan")).to_contain_text("Every stage is up to date")
    page.get_by_label("Parameters of stages").fill("annotate.tau=0.1")
    page.get_by_role("button", name="Show the plan").click()
    expect(page.get_by_role("region", name="Stages of the plan")).to_contain_text("its parameters changed")
    page.get_by_label("Parameters of stages").fill("")
    page.get_by_role("button", name="Run", exact=True).click()
    job = page.get_by_test_id("run-job").filter(has_text="Run dances")  # other tests share the server
    expect(job).to_contain_text("Run dances: done", timeout=60_000)
    job.get_by_role("button", name="Show the log").click()
    expect(job.get_by_label("Log")).to_contain_text("kinedex run")
    page.get_by_role("tab", name="Methods compared").click()
    expect(page.get_by_role("region", name="Methods compared")).to_contain_text("F (segments)")


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="processes are found in /proc")
def test_a_run_is_stopped_and_one_that_does_not_hear_is_ended_by_force(open_page: Open, store: Path) -> None:
    page = open_page("/runs?view=start")
    page.get_by_role("button", name="dances").click()
    page.get_by_label("source", exact=True).fill(str(store.parent / "archive"))
    page.get_by_label("Parameters of stages").fill("annotate.tau=0.11")
    with StoreWriter.open(store, open_store(store).feature_set):  # the run waits for this writer
        for force in (False, True):
            page.get_by_role("button", name="Run", exact=True).click()
            job = page.get_by_test_id("run-job").first
            expect(job).to_contain_text("Run dances: running")
            if force:
                os.kill(process_of(store), signal.SIGSTOP)
            job.get_by_role("button", name="Stop", exact=True).click()
            if force:
                job.get_by_role("button", name="Stop by force").click()
            expect(job).to_contain_text("Run dances: stopped")
            expect(job.get_by_role("button", name="Stop")).to_have_count(0)


def process_of(store: Path) -> int:
    """Return the id of the process of a job on a store, as soon as it is there."""
    for _ in range(WAIT_MS // 50):
        for place in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                words = (place / "cmdline").read_bytes().decode().split("\0")
                if {"run", "--log-file", str(store)} <= {*words}:
                    return int(place.name)
        time.sleep(0.05)
    raise AssertionError("no job runs")
