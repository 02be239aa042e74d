"""Drive the page of the explorer in Chromium, and time it there.

Work on the main thread is read from a trace of the DevTools protocol. All `RunTask` events of the renderer's main
thread count: event handlers, scripts, timers, answers that arrive, garbage collection, style, layout, pre-paint, the
recording of paint commands, and the commit to the compositor. What ran since the frame before is added to the frame in
which it ends (`AnimationFrame`). The thread's own time of a task is its work; its duration holds the time in which
other processes had the core, too. Not counted is what other threads do: the compositor, the rasterisation (by software
where there is no GPU, in other threads), and the server.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from http.client import HTTPConnection
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np
import numpy.typing as npt

from benchmarks.harness import sized
from kinedex.ops.errors import KinedexError

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

WAIT_MS = 60_000
"""Every wait for the page ends after so long."""

SETTLED_MS = 1500
"""A page that is to be moved through has been there for so long: a person looks before moving."""

JUMPS, PIXELS, MOVES = sized((60, 9000, 120), (5, 900, 12))
"""The jumps and the way of a table that is scrolled, and the moves of motion that is scrubbed, unless given."""

SIZE = (1400, 900)
"""The size of the window in CSS pixels."""

CATEGORIES = ("devtools.timeline", "disabled-by-default-devtools.timeline")
"""The categories of the trace: the fewest that have tasks and frames, as each event costs time itself."""

PROBES = """
// the moment at which the main thread has finished the frame that is being made
const afterFrame = (done) => {
  const channel = new MessageChannel();
  channel.port1.onmessage = () => done(performance.now());
  requestAnimationFrame(() => channel.port2.postMessage(0));
};
const probes = window.probes = { answers: [], rows: null, click: null, motion: null, open: 0, afterFrame };
const rowsAreThere = () => (document.querySelector('.grid-body .grid-cell')?.textContent ?? '…') !== '…';
const watch = new MutationObserver(() => {
  if (!rowsAreThere()) return;
  watch.disconnect();
  afterFrame((now) => { probes.rows = now; });
});
watch.observe(document, { childList: true, subtree: true, characterData: true });
document.addEventListener('click', (event) => { probes.click = event.timeStamp; probes.motion = null; }, true);
// figures of the player are the only instances that are drawn
const drawInstances = WebGL2RenderingContext.prototype.drawElementsInstanced;
WebGL2RenderingContext.prototype.drawElementsInstanced = function (...values) {
  if (probes.motion === null && probes.click !== null) {
    probes.motion = -1;
    const channel = new MessageChannel();
    channel.port1.onmessage = () => { probes.motion = performance.now(); };
    channel.port2.postMessage(0);
  }
  return drawInstances.apply(this, values);
};
const fetchPlain = window.fetch;
window.fetch = async (address, options) => {
  const answer = { path: String(address), start: performance.now(), parsed: null, shown: null };
  probes.open++;
  const response = await fetchPlain(address, options).finally(() => { probes.open--; });
  const json = response.json.bind(response);
  response.json = async () => {
    const value = await json();
    answer.parsed = performance.now();
    probes.answers.push(answer);
    const look = () => {
      if (document.querySelector('.hits[aria-busy="false"] .hit') === null) requestAnimationFrame(look);
      else afterFrame((now) => { answer.shown = now; });
    };
    if (answer.path.startsWith('/api/ask/')) requestAnimationFrame(look);
    return value;
  };
  return response;
};
"""
"""The script that notes moments of the page; performance.now() counts from the beginning of the navigation."""


@dataclass(frozen=True)
class Frames:
    """The frames of some work in the page.

    Attributes
    ----------
    work_ms : float64 array (n,)
        The main thread's own time of each frame.
    wall_ms : float64 array (n,)
        The same with the time in which other processes had the core.
    seconds : float
        The time from the first frame to the last.
    """

    work_ms: npt.NDArray[np.float64]
    wall_ms: npt.NDArray[np.float64]
    seconds: float

    @cached_property
    def rate_hz(self) -> float:
        """Return the frames per second."""
        return len(self.work_ms) / self.seconds if self.seconds else 0.0


@dataclass(frozen=True)
class Explorer:
    """A server that runs.

    Attributes
    ----------
    address : str
        With the token.
    process : int
        Its number.
    ready_seconds : float
        The time from its start to its first answer.
    """

    address: str
    process: int
    ready_seconds: float

    @property
    def base(self) -> str:
        """Return the address without the token."""
        return self.address.split("/?")[0]


def find_chromium() -> str | None:
    """Return the path of a Chromium of this machine; None where there is none."""
    names = ("chromium", "chromium-browser", "google-chrome")
    return next((found for name in names if (found := shutil.which(name))), None)


@contextmanager
def chromium(path: str) -> Iterator[Browser]:
    """Run Chromium without a window and without a GPU."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        arguments = ["--no-sandbox", "--enable-unsafe-swiftshader"]
        browser = driver.chromium.launch(executable_path=path, args=arguments, timeout=WAIT_MS)
        yield browser
        browser.close()


@contextmanager
def explorer(store: Path) -> Iterator[Explorer]:
    """Run a server over a store in a process of its own, and time its start.

    Raises
    ------
    KinedexError
        It does not start.
    """
    command = [sys.executable, "-m", "kinedex", "explore", str(store), "--no-browser", "--port", "0"]
    begin = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        yield _ready(process, begin)
    finally:
        process.terminate()
        process.communicate(timeout=30)


def _ready(process: subprocess.Popen[str], begin: float) -> Explorer:
    seen = ""
    for line in process.stdout or ():
        seen += line
        if found := re.search(r"http://\S+\?token=\S+", line):
            host, rest = found[0].removeprefix("http://").split("/", 1)
            asked = HTTPConnection(host, timeout=WAIT_MS / 1000)
            asked.request("GET", f"/{rest}")
            asked.getresponse().read()
            asked.close()
            return Explorer(found[0], process.pid, time.perf_counter() - begin)
    raise KinedexError(f"the explorer did not start:\n{seen}")


def anonymous_mib(process: int | str = "self") -> float:
    """Return the memory that belongs to a process alone; pages of mapped files are not among it."""
    status = Path(f"/proc/{process}/status").read_text(encoding="ascii")
    return next(float(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("RssAnon"))


@contextmanager
def new_page(browser: Browser) -> Iterator[Page]:
    """Open a page with an empty cache, which notes its moments by `PROBES`."""
    context = browser.new_context(viewport={"width": SIZE[0], "height": SIZE[1]})
    context.add_init_script(PROBES)
    page = context.new_page()
    page.set_default_timeout(WAIT_MS)
    yield page
    context.close()


def first_rows(page: Page, address: str) -> float:
    """Open the Archive page, and return the seconds from there until its first rows are drawn."""
    page.goto(address)
    return float(_noted(page, "probes.rows")) / 1000


def _noted(page: Page, expression: str) -> float:
    """Return a moment once the page has noted it, in ms."""
    noted = page.wait_for_function(f"() => {expression} > 0 && {expression}", polling=20)
    return float(noted.json_value())


def _wait_for_answers(page: Page) -> None:
    """Wait until no request is open, such as for the figures of hits: a person looks before asking again."""
    page.wait_for_function("() => probes.open === 0", polling=50)
    page.wait_for_timeout(100)
    page.wait_for_function("() => probes.open === 0", polling=50)


def calibrate_page(page: Page) -> float:
    """Return the seconds in which this browser sorts a million numbers: the best of five."""
    return float(
        page.evaluate(
            """() => {
              let best = Infinity;
              for (let run = 0; run < 5; run++) {
                let state = 1;
                const numbers = Float64Array.from({ length: 1e6 }, () => (state = (state * 48271) % 2147483647));
                const begin = performance.now();
                numbers.sort();
                best = Math.min(best, performance.now() - begin);
              }
              return best / 1000;
            }"""
        )
    )


def recorded(page: Page, work: Callable[[], object]) -> Frames:
    """Return the frames of some work in the page, by a trace."""
    browser = page.context.browser
    assert browser is not None
    browser.start_tracing(page=page, categories=list(CATEGORIES))
    try:
        work()
    finally:
        trace = browser.stop_tracing()
    return read_frames(json.loads(trace)["traceEvents"])


def read_frames(events: list[dict[str, Any]]) -> Frames:
    """Return the frames of the renderer's main thread; see the module for what counts.

    Parameters
    ----------
    events : list of dict
        Those of a trace in the format of Chromium, times in microseconds.
    """
    drawn = [one for one in events if one["name"] == "AnimationFrame" and one["ph"] == "b"]
    named = {
        (one["pid"], one["tid"])
        for one in events
        if one["name"] == "thread_name" and one["args"]["name"] == "CrRendererMain"
    }
    threads = [(one["pid"], one["tid"]) for one in drawn if (one["pid"], one["tid"]) in named]
    if not threads:
        return Frames(np.zeros(0), np.zeros(0), 0.0)
    main = max(set(threads), key=threads.count)
    begun = sorted(one["ts"] for one in drawn if (one["pid"], one["tid"]) == main)
    tasks = sorted(
        (one["ts"], one["dur"], one.get("tdur", one["dur"]))
        for one in events
        if one["name"] == "RunTask" and one["ph"] == "X" and (one["pid"], one["tid"]) == main
    )
    # A task belongs to the first frame that begins before the task ends.
    ends = np.array([start + lasts for start, lasts, _ in tasks], np.float64)
    frame = np.searchsorted(np.searchsorted(ends, begun, side="left"), np.arange(len(tasks)), side="left")
    whole = frame < len(begun)
    sums = [
        np.bincount(frame[whole], np.array([one[which] for one in tasks], np.float64)[whole], len(begun)) / 1000
        for which in (2, 1)
    ]
    filled = sums[1] > 0
    return Frames(sums[0][filled], sums[1][filled], (begun[-1] - begun[0]) / 1e6)


def open_rows(page: Page, base: str, statement: str) -> None:
    """Show the rows of a statement as a table on the page Ask."""
    page.goto(f"{base}/ask?way=sql&sql={quote(statement)}")
    page.locator(".answer .grid-body").nth(10).wait_for()


def group_rows(page: Page, base: str, column: str) -> float:
    """Open the table of takes, group it by a column, and return the seconds from the click to rows below headings."""
    page.goto(f"{base}/")
    page.locator(".grid-body a").first.wait_for()
    page.wait_for_timeout(SETTLED_MS)
    page.get_by_role("combobox", name="Grouped by").click()
    option = page.get_by_role("option", name=column, exact=True)
    option.wait_for()
    page.evaluate(
        """() => {
          probes.grouped = 0;
          const look = () => {
            const there = ['.grid-heading', '.grid-body:not(.grid-heading):not(.loading)'];
            if (there.some((one) => document.querySelector(one) === null)) requestAnimationFrame(look);
            else probes.afterFrame((now) => { probes.grouped = now; });
          };
          requestAnimationFrame(look);
        }"""
    )
    option.click()
    return (_noted(page, "probes.grouped") - float(page.evaluate("probes.click"))) / 1000


def scroll(page: Page, jumps: int = JUMPS, pixels: int = PIXELS) -> None:
    """Scroll the table in sight by the wheel, slowly and quickly, there and back, and by its bar to anywhere.

    Parameters
    ----------
    page : Page
        A page that shows a table.
    jumps : int, optional
        The number of places that the bar goes to, one a frame.
    pixels : int, optional
        The way of the wheel in each direction, at 2,000 and at 8,000 pixels a second.
    """
    box = page.locator(".grid").bounding_box()
    assert box is not None
    protocol = page.context.new_cdp_session(page)
    for speed in (2000, 8000):
        for way in (-pixels, pixels):
            protocol.send(
                "Input.synthesizeScrollGesture",
                {
                    "x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2, "yDistance": way,
                    "speed": speed, "preventFling": True, "gestureSourceType": "mouse",
                },
            )  # fmt: skip
    protocol.detach()
    page.evaluate(
        """async (jumps) => {
          const grid = document.querySelector('.grid');
          let state = 1;
          for (let jump = 0; jump < jumps; jump++) {
            state = (state * 48271) % 2147483647;
            grid.scrollTop = (state / 2147483647) * (grid.scrollHeight - grid.clientHeight);
            await new Promise(requestAnimationFrame);
          }
          grid.scrollTop = 0;
        }""",
        jumps,
    )


def open_take(page: Page, row: int) -> float:
    """Click on a take in the table, and return the seconds until its first pose is drawn; go back to the table."""
    link = page.locator(".grid-body a").nth(row)
    link.wait_for()
    _wait_for_answers(page)
    link.click()
    taken = (_noted(page, "probes.motion") - float(page.evaluate("probes.click"))) / 1000
    page.locator(".lanes-area").wait_for()
    page.go_back()
    page.locator(".grid-body a").nth(row).wait_for()
    return taken


def show_take(page: Page, base: str, take: str) -> None:
    """Open the page of a take, and wait for its motion and its words."""
    page.goto(f"{base}/take/{quote(take, safe='')}")
    page.locator(".pose-features li:visible").or_(page.get_by_text("No feature holds.")).first.wait_for()
    page.wait_for_timeout(SETTLED_MS)


def scrub(page: Page, moves: int = MOVES) -> None:
    """Move through a take: on the axis, under the pointer, and by the slider while the lanes are zoomed in and follow.

    Parameters
    ----------
    page : Page
        A page that shows a take.
    moves : int, optional
        Moves of the pointer each time, from one end to the other.
    """
    for place, drag in ((".lanes-top canvas:nth-child(2)", True), (".lanes-area", False)):
        _sweep(page, place, moves, drag=drag)
    page.keyboard.press("0")
    for _ in range(12):
        page.keyboard.press("+")
    _sweep(page, ".player-controls input[type=range]", moves, drag=True)
    page.keyboard.press("0")


def _sweep(page: Page, place: str, moves: int, *, drag: bool) -> None:
    box = page.locator(place).bounding_box()
    assert box is not None
    across = np.linspace(box["x"] + 4, box["x"] + box["width"] - 4, moves)
    y = box["y"] + min(box["height"] / 2, 60)
    page.mouse.move(float(across[0]), y)
    if drag:
        page.mouse.down()
    for x in across:
        page.mouse.move(float(x), y)
    if drag:
        page.mouse.up()


@dataclass(frozen=True)
class RoundTrip:
    """A question of the page: seconds from the request to its answer as objects, and to the drawn list of hits."""

    parsed: float
    shown: float


def asked(page: Page, path: str, ask: Callable[[], object]) -> RoundTrip:
    """Return the last round trip to a path of the server that an action causes."""
    _wait_for_answers(page)
    page.evaluate("() => { probes.answers.length = 0; }")
    ask()
    answer = f"probes.answers.findLast((one) => one.path === '{path}')"
    _noted(page, f"({answer}?.shown ?? 0)")
    found = page.evaluate(f"() => {answer}")
    return RoundTrip((found["parsed"] - found["start"]) / 1000, (found["shown"] - found["start"]) / 1000)


def go(page: Page, path: str) -> None:
    """Go to an address within the page, as a link does."""
    page.evaluate("(path) => window.history.pushState(null, '', path)", path)


def loaded_files(page: Page) -> dict[str, int]:
    """Return the files of the built page that this page has loaded, with the bytes that were transferred for each."""
    found: dict[str, int] = page.evaluate(
        """() => Object.fromEntries(performance.getEntriesByType('resource')
          .filter((one) => one.name.includes('/assets/'))
          .map((one) => [one.name.split('/').at(-1), one.transferSize]))"""
    )
    return found
