"""The explorer as a person has it: a process of the command line over a small store, opened in a real browser."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, expect

from kinedex.explorer.application import BUILT

WAIT_MS = 30_000
"""Every wait for the page ends after so long: first questions load what answers them, beside other tests."""

expect.set_options(timeout=WAIT_MS)

Open = Callable[..., Page]


@pytest.fixture(scope="session")
def serve() -> Iterator[Callable[[Path], str]]:
    """Return a function that starts an explorer over a store and returns its address with the token."""
    if not (BUILT / "index.html").is_file():
        missing = "the page of the explorer has not been built (make page)"
        if os.environ.get("KINEDEX_BROWSER") == "required":
            pytest.fail(missing)
        pytest.skip(missing)
    running: list[subprocess.Popen[str]] = []

    def start(store: Path, *options: str) -> str:
        command = [sys.executable, "-m", "kinedex", "explore", str(store), "--no-browser", "--port", "0", *options]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        running.append(process)
        assert process.stdout is not None
        seen = ""
        for line in process.stdout:
            seen += line
            if found := re.search(r"http://\S+\?token=\S+", line):
                return found.group(0)
        pytest.fail(f"the explorer did not start:\n{seen}")

    yield start
    for process in running:
        process.terminate()
    for process in running:
        process.wait(2 * WAIT_MS / 1000)


@pytest.fixture(scope="session")
def explorer(serve: Callable[[Path], str], store: Path) -> str:
    """Return the address, with its token, of an explorer over the store of dances."""
    return serve(store)


def is_fault(message: ConsoleMessage) -> bool:
    """Return whether a message of the browser is a fault of the page, and not a request that the server refuses."""
    return message.type == "error" and "responded with a status of 4" not in message.text


@pytest.fixture
def open_page(open_page_of: Open, explorer: str) -> Open:
    """Return a function that opens a page of the explorer; a fault of the page fails the test."""
    return partial(open_page_of, explorer)


@pytest.fixture
def open_page_of(browser: Browser) -> Iterator[Open]:
    """Return a function that opens a page of the explorer of an address; a fault of the page fails the test."""
    contexts = []
    faults: list[str] = []

    def open_at(explorer: str, path: str = "/", width: int = 1400, height: int = 900, scheme: str = "light") -> Page:
        context = browser.new_context(
            viewport={"width": width, "height": height},
            color_scheme="dark" if scheme == "dark" else "light",
        )
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(WAIT_MS)
        page.on("pageerror", lambda fault: faults.append(str(fault)))
        page.on("console", lambda message: faults.append(message.text) if is_fault(message) else None)
        context.request.get(explorer)  # the cookie of the explorer, without a page that is loaded and left again
        page.goto(explorer.split("/?")[0] + path)
        return page

    yield open_at
    for context in contexts:
        context.close()
    assert not faults
