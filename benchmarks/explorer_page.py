"""`make bench-explorer`: time the page of the explorer in a real browser, beside the same work by SQL and Python.

Three archives: 100 hours in 2,400 takes (`benchmarks.explorer_archive`); some 3,000 short takes: the motion files of a
folder under five names where one is given (`make bench-explorer DATA=dir`), or as many clips made like the 100 hours;
and 100,000 takes of half a second, for the table of takes in groups.
Each figure stands beside what is asked for. Work on the main thread is its own time in every frame, read from a trace
(`benchmarks.explorer_browser` lists what counts); the time on the clock and the frames per second are printed only, as
there is no GPU and other programs run. Times of the page are those of `performance.now()`; seconds of the server begin
with the start of its process.
"""

from __future__ import annotations

import argparse
import gzip
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np
from playwright.sync_api import Browser, Page

from benchmarks.archive import BUILD
from benchmarks.explorer_archive import hundred_hours, many_takes
from benchmarks.explorer_browser import (
    SETTLED_MS,
    Explorer,
    Frames,
    anonymous_mib,
    asked,
    calibrate_page,
    chromium,
    explorer,
    find_chromium,
    first_rows,
    go,
    group_rows,
    loaded_files,
    new_page,
    open_rows,
    open_take,
    recorded,
    scroll,
    scrub,
    show_take,
)
from benchmarks.harness import LEFT_OUT, Figure, calibrate, seconds, show, silent, sized, write
from benchmarks.rivals import sql
from kinedex.catalog.queries.query_reader import read_queries
from kinedex.catalog.queries.query_writer import write_queries
from kinedex.console.terminal import make_console
from kinedex.explorer.application import BUILT
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.templates.store_ranking import RankingQuestion, rank_store
from kinedex.pipelines.templates.stored_templates import template_from_clip
from kinedex.storage.store.store import Store, open_store

READY_S, PAINT_S, OPEN_S, EXAMPLE_S, KEYFRAMES_S, GROUPED_S = 1.0, 2.0, 0.2, 0.5, 0.15, 0.5
FRAME_MS, SERVER_MIB, PAGE_MB = 8.0, 500.0, 2.0
"""The limits that are asked for."""

SHORT_TAKES = sized(3290, 60)
STARTS, OPENED = sized((5, 20), (1, 3))
NAMES = ("alpha", "bravo", "charlie", "delta", "echo")
"""The names under which the files of a folder are in the archive of short takes."""

ROWS = """SELECT r.word, t.name, t.class, t.actor, r.start AS first, r.stop AS after, r.stop - r.start AS n, t.seconds
FROM word_runs AS r JOIN takes AS t USING (take_id) LIMIT 100000"""
"""A result of 100,000 rows whose columns do not make them hits."""

EXAMPLE_FRAMES, EXAMPLE_TAKES = sized(((30, 60, 120), 4), ((30, 60), 2))

GROUPED = sized(("class", "actor", "folder"), ("class",))


def short_takes(data: Path | None) -> Store:
    """Return the archive of short takes; make it where it is missing."""
    if data is None:
        return hundred_hours(hours=sized(3, 0.05), takes=SHORT_TAKES, clips=SHORT_TAKES)
    path = BUILD / "explorer-five"
    if not (path / "manifest").is_dir():
        source = BUILD / "explorer-five-files"
        for name in NAMES:
            shutil.copytree(data, source / name, dirs_exist_ok=True, copy_function=shutil.copyfile)
        run_pipeline("ingest", path, assignments={"source": str(source)}, terminal=silent())
        shutil.rmtree(source)
    return open_store(path)


def figures(_: Store | None = None, data: Path | None = None) -> list[Figure]:
    """Time the page over both archives.

    Parameters
    ----------
    data : Path, optional
        A folder of motion files, for the archive of short takes.
    """
    browser_path = find_chromium()
    if browser_path is None or not (BUILT / "index.html").is_file():
        reason = "no Chromium on this machine" if browser_path is None else "the page has not been built (make page)"
        return [Figure("the page of the explorer", 0.0, "", None, LEFT_OUT + reason)]
    whole, short, many = hundred_hours(), short_takes(data), many_takes()
    long = hundred_hours(hours=sized(1.5, 0.1), takes=3, clips=0)
    found: list[Figure] = []
    with chromium(browser_path) as browser:
        with new_page(browser) as page:
            found.append(_calibrated(page))
        for store in (whole, short):
            found += _starts(browser, store)
        with explorer(short.path) as server, new_page(browser) as page:
            found += _table(page, server, f"a table of {short.take_rows.num_rows:,} takes")
            found += _takes_opened(browser, page, server, short, "short takes", "")
        with explorer(many.path) as server, new_page(browser) as page:
            found += _grouped(page, server, many)
        with explorer(long.path) as server, new_page(browser) as page:
            found += _scrubbed(page, server, long)
        with explorer(whole.path) as server, new_page(browser) as page:
            first_rows(page, server.address)
            found += _rows(page, server, whole)
            found += _takes_opened(browser, page, server, whole, "takes of minutes", "?sort=seconds-")
            found += _examples(page, server, whole)
            found += _keyframes(page, server, whole)
            found += _sizes(browser, server)
        with new_page(browser) as page:
            found.append(_calibrated(page))
    return found


def _calibrated(page: Page) -> Figure:
    return Figure("calibration: sort in the browser", 1.0, "M numbers", calibrate_page(page))


def _limit(name: str, value: float, limit: float, unit: str) -> Figure:
    """Return a value in seconds as a figure in ms or s, beside what is asked for."""
    scale = 1000 if unit == "ms" else 1
    return Figure(name, scale * value, unit, None, f"asked for: {scale * limit:g} {unit}", other_amount=scale * limit)


def _starts(browser: Browser, store: Store) -> Iterator[Figure]:
    """Time starts of the server, and each time the first page of a browser that has never seen it."""
    servers, paints = [], []
    for _ in range(STARTS):
        with explorer(store.path) as server, new_page(browser) as page:
            servers.append(server.ready_seconds)
            paints.append(first_rows(page, server.address))
    command = [sys.executable, "-m", "kinedex", "sql", str(store.path), "SELECT * FROM takes ORDER BY name LIMIT 100"]
    times = []
    for _ in range(3):
        begin = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True, timeout=300)
        times.append(time.perf_counter() - begin)
    about = f"{store.take_rows.num_rows:,} takes, {sum(store.take_frames.values()) / store.rate_hz / 3600:.0f} h"
    yield _limit(f"server ready, {about}: median of {STARTS}", median(servers), READY_S, "s")
    yield _limit("the slowest of them", max(servers), READY_S, "s")
    yield _limit(f"first rows in sight after that, {about}: median", median(paints), PAINT_S, "s")
    yield _limit("the slowest of them", max(paints), PAINT_S, "s")
    both = median(one + other for one, other in zip(servers, paints, strict=True))
    name = "from the start to the first rows: median"
    yield Figure(name, 1.0, "starts", both, "kinedex sql, the same rows", min(times))


def _frames(what: str, frames: Frames) -> Iterator[Figure]:
    work, wall = frames.work_ms, frames.wall_ms
    share = f"{len(work):,} frames, {frames.rate_hz:.0f} a second"
    most = float(np.percentile(work, 99))
    yield _limit(f"a frame's work while {what}: 99th percentile", most / 1000, FRAME_MS / 1000, "ms")
    yield Figure("the same: median", float(np.median(work)), "ms", None, share)
    yield Figure("the same: worst", float(work.max()), "ms", None)
    yield Figure("the same on the clock: 99th percentile", float(np.percentile(wall, 99)), "ms", None, "printed only")


def _table(page: Page, server: Explorer, what: str) -> Iterator[Figure]:
    first_rows(page, server.address)
    page.wait_for_timeout(SETTLED_MS)
    scroll(page, jumps=10, pixels=1000)
    yield from _frames(f"{what} scrolls", recorded(page, lambda: scroll(page)))


def _grouped(page: Page, server: Explorer, store: Store) -> Iterator[Figure]:
    """Group the table of takes by a column, and scroll it, beside the same order and groups by SQL."""
    first_rows(page, server.address)
    for column in GROUPED:
        what = f"{store.take_rows.num_rows:,} takes in groups by {column}"
        opened = group_rows(page, server.base, column)
        page.wait_for_timeout(SETTLED_MS)
        scroll(page, jumps=10, pixels=1000)
        yield from _frames(f"a table of {what} scrolls", recorded(page, lambda: scroll(page)))
        yield _limit(f"{what}: from the click to rows below headings", opened, GROUPED_S, "ms")
        key = "parse_dirpath(source, 'forward_slash')" if column == "folder" else f'"{column}"'
        by_sql = seconds(partial(_group_by_sql, store, key), 2)
        yield Figure("the same", 1.0, "tables", opened, "order and groups by DuckDB", by_sql)


def _group_by_sql(store: Store, key: str) -> None:
    with store.connect() as connection:
        connection.sql(f"SELECT {key}, count(*), sum(seconds) FROM takes GROUP BY 1 ORDER BY 1").to_arrow_table()
        connection.sql(f"SELECT take_id FROM takes ORDER BY {key}, name").to_arrow_table()


def _rows(page: Page, server: Explorer, store: Store) -> Iterator[Figure]:
    """Scroll the rows of a statement, and time how soon they are there, beside the statement by itself."""
    begin = time.perf_counter()
    open_rows(page, server.base, ROWS)
    opened = time.perf_counter() - begin
    with store.connect() as connection:
        by_sql = seconds(lambda: connection.sql(ROWS).to_arrow_table(), 2)
    page.wait_for_timeout(SETTLED_MS)
    scroll(page, jumps=10, pixels=1000)
    yield from _frames("a table of 100,000 rows scrolls", recorded(page, lambda: scroll(page)))
    yield Figure("the address of these rows to rows in sight", 1.0, "tables", opened, "the statement by DuckDB", by_sql)


def _scrubbed(page: Page, server: Explorer, store: Store) -> Iterator[Figure]:
    first_rows(page, server.address)
    take = max(store.take_ids, key=lambda name: store.take_frames[store.take_ids[name]])
    minutes = store.take_frames[store.take_ids[take]] / store.rate_hz / 60
    show_take(page, server.base, take)
    scrub(page, 10)
    yield from _frames(f"{minutes:.0f} minutes of motion are scrubbed", recorded(page, lambda: scrub(page)))


def _takes_opened(
    browser: Browser, page: Page, server: Explorer, store: Store, what: str, question: str
) -> Iterator[Figure]:
    """Open takes from the table: in a page that has shown one, and as the first of a session."""
    with explorer(store.path) as other, new_page(browser) as fresh:
        first_rows(fresh, other.address)
        fresh.wait_for_timeout(4 * SETTLED_MS)
        first = open_take(fresh, 0)
    page.goto(f"{server.base}/{question}")
    open_take(page, 0)
    times = [open_take(page, 1 + number) for number in range(OPENED)]
    names = page.locator(".grid-body a").all_text_contents()[1 : 1 + OPENED]
    by_python = median(seconds(partial(store.frames, name), 1) for name in names)
    yield _limit(f"a take opens, {what}: median of {OPENED}", median(times), OPEN_S, "ms")
    yield _limit("the slowest of them", max(times), OPEN_S, "ms")
    yield Figure("the median", 1.0, "takes", median(times), "its frames by Store.frames", by_python)
    yield _limit("the first of a session, six seconds after the page", first, OPEN_S, "ms")


def _examples(page: Page, server: Explorer, store: Store) -> Iterator[Figure]:
    """Ask by examples of several lengths; the address changes as it does when an interval is selected."""
    takes = store.takes("class IS NULL").sort("take_id")["name"][:EXAMPLE_TAKES]
    page.goto(f"{server.base}/ask")
    trips = []
    for take in takes:
        for length in EXAMPLE_FRAMES:
            path = f"/ask?take={take}&from=300&to={300 + length}"
            trips.append(asked(page, "/api/ask/examples", partial(go, page, path)))
    example = template_from_clip(store, takes[1], 300, 300 + EXAMPLE_FRAMES[1])
    by_python = seconds(lambda: rank_store(store, [example], RankingQuestion(top=60, mirror=True, workers=2)), 3)
    own = trips[1 + len(EXAMPLE_FRAMES)].parsed
    hours = sum(store.take_frames.values()) / store.rate_hz / 3600
    yield _limit(f"hits by example over {hours:.0f} h, request to answer: median of {len(trips)}",
                 median(one.parsed for one in trips), EXAMPLE_S, "ms")  # fmt: skip
    yield _limit("the slowest of them", max(one.parsed for one in trips), EXAMPLE_S, "ms")
    yield _limit("request to the list of hits in sight: median", median(one.shown for one in trips), EXAMPLE_S, "ms")
    yield _limit("the slowest of them", max(one.shown for one in trips), EXAMPLE_S, "ms")
    yield _limit("the first of them, which is the server's first question", trips[0].shown, EXAMPLE_S, "ms")
    yield Figure("one of them, request to answer", 1.0, "questions", own, "rank_store in Python", by_python)


def _keyframes(page: Page, server: Explorer, store: Store) -> Iterator[Figure]:
    """Ask by the shipped example queries, each written into the field of YAML."""
    page.goto(f"{server.base}/ask?way=keyframes")
    field = page.get_by_label("The same as YAML")
    queries = [query for query in read_queries("example", store.feature_set) if len(query.chains) == 1]
    texts = [write_queries([query], store.feature_set) for query in queries[: sized(len(queries), 2)]]
    trips = [asked(page, "/api/ask/keyframes", partial(field.fill, text)) for text in texts]
    with store.connect(threads=2) as connection:
        by_sql = seconds(lambda: connection.sql(sql(queries[0].chains[0])).to_arrow_table(), 1)
    hours = sum(store.take_frames.values()) / store.rate_hz / 3600
    yield _limit(f"hits by keyframes over {hours:.0f} h, request to answer: median of {len(trips)}",
                 median(one.parsed for one in trips), KEYFRAMES_S, "ms")  # fmt: skip
    yield _limit("the slowest of them", max(one.parsed for one in trips), KEYFRAMES_S, "ms")
    yield _limit("request to the list of hits in sight: median", median(one.shown for one in trips), KEYFRAMES_S, "ms")
    yield _limit("the slowest of them", max(one.shown for one in trips), KEYFRAMES_S, "ms")
    yield Figure("one of them, request to answer", 1.0, "questions", trips[0].parsed, "one SQL statement", by_sql)


def _sizes(browser: Browser, server: Explorer) -> Iterator[Figure]:
    """Measure the memory of a server that has answered all that, and the bytes of the page."""
    memory = anonymous_mib(server.process)
    yield Figure("memory of the server after all that, without mapped files", memory, "MiB", None,
                 f"asked for: at most {SERVER_MIB:g} MiB", other_amount=SERVER_MIB)  # fmt: skip
    packed = {path.name: len(gzip.compress(path.read_bytes(), 9)) for path in (BUILT / "assets").iterdir()}
    with new_page(browser) as page:
        first_rows(page, server.address)
        first = loaded_files(page)
    yield Figure("all files of the page, compressed", sum(packed.values()) / 1e6, "MB", None,
                 f"asked for: at most {PAGE_MB:g} MB", other_amount=PAGE_MB)  # fmt: skip
    yield Figure("those of the first page, compressed", sum(packed[name] for name in first) / 1e6, "MB", None,
                 "transferred", other_amount=sum(first.values()) / 1e6)  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the part, print the table, and write JSON."""
    about = "Time the page of the explorer in a real browser."
    parser = argparse.ArgumentParser(prog="python -m benchmarks.explorer_page", description=about)
    parser.add_argument("--data", type=Path, help="folder of motion files, for the archive of short takes")
    found = [calibrate(), *figures(data=parser.parse_args(arguments).data), calibrate()]
    console = make_console()
    console.print(show(found))
    console.print(f"written to {write(found, BUILD)}", markup=False)


if __name__ == "__main__":
    main()
