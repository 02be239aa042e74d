"""Pages open in a browser and are asked for errors of scripts, text beyond the window and targets for fingers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page, expect

WAIT_MS = 30_000
"""The longest wait for anything in a page."""

expect.set_options(timeout=WAIT_MS)

SIZES = {"desk": (1400, 900), "phone": (390, 844)}

BEYOND = """() => {
  const { clientWidth, scrollWidth } = document.documentElement, found = [];
  if (scrollWidth > clientWidth) {
    found.push(`the page is ${scrollWidth} wide`);
    for (const one of document.querySelectorAll("body *")) {
      const box = one.getBoundingClientRect();
      if (box.right > clientWidth + 1 && !one.closest("svg *")) found.push(`${one.tagName} ends at ${box.right}`);
    }
  }
  for (const one of document.querySelectorAll("body *")) {
    const style = getComputedStyle(one), box = one.getBoundingClientRect();
    if (!box.width || style.visibility === "hidden" || one.closest("svg svg, svg *")) continue;
    const hides = ["hidden", "clip"].includes(style.overflowX);
    const cut = hides && one.clientWidth > 1 && one.scrollWidth > one.clientWidth + 1;
    if (cut && one.textContent.trim()) found.push(`${one.tagName}.${one.className}: its text is cut off`);
  }
  return found;
}"""
"""Elements whose text is cut off, and the width of a page that is wider than the window."""

SCROLLED = """() => [...document.querySelectorAll("table")]
  .filter(table => table.offsetParent)
  .map(table => [table, table.parentElement])
  .filter(([table, box]) => table.getBoundingClientRect().right > box.getBoundingClientRect().right + 1)
  .map(([table]) => table.innerText.slice(0, 60))"""
"""Tables of which a column is beyond the box that they are in."""

SMALL = """() => [...document.querySelectorAll("button, select, summary, input, [role=button]:not(rect)")]
  .map(one => [one, (one.closest("label") ?? one).getBoundingClientRect(), one.getBoundingClientRect()])
  .filter(([one, box]) => box.width && getComputedStyle(one).visibility !== "hidden")
  .filter(([one, box, own]) => Math.max(box.height, own.height) < 39.5 || Math.max(box.width, own.width) < 39.5)
  .map(([one, box]) => `${one.tagName} ${one.textContent.trim().slice(0, 20)}: ${box.width} x ${box.height}`)"""
"""Buttons and the like that are smaller than 40 pixels."""


@contextmanager
def opened(browser: Browser, file: Path, size: str = "desk", scheme: Any = "light", **more: Any) -> Iterator[Page]:
    """Open a file in a window; an error of its scripts fails the test when the window closes."""
    width, height = SIZES[size]
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme, **more)
    context.set_default_timeout(WAIT_MS)
    page = context.new_page()
    errors: list[str] = []
    page.on("pageerror", lambda fault: errors.append(str(fault)))
    page.on("console", lambda message: errors.append(message.text) if message.type in ("error", "warning") else None)
    page.on(
        "request",
        lambda request: errors.append(request.url) if not request.url.startswith(("file:", "data:", "blob:")) else None,
    )
    page.goto(file.resolve().as_uri(), timeout=WAIT_MS)
    yield page
    context.close()
    assert errors == []


def picture(page: Page, selector: str) -> str:
    """Return what a canvas shows, as a data URL."""
    return str(page.locator(selector).first.evaluate("one => one.toDataURL()"))


def is_drawn(page: Page, selector: str) -> bool:
    """Return whether a canvas shows anything."""
    script = "one => one.getContext('2d').getImageData(0, 0, one.width, one.height).data.some(value => value)"
    return bool(page.locator(selector).first.evaluate(script))
