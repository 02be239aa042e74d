"""A question whose page has gone is computed no further; a decision that was sent is kept."""

from __future__ import annotations

import asyncio
import json
from itertools import count, islice
from pathlib import Path
from typing import Any

import pytest

from kinedex.explorer.access import Rules
from kinedex.explorer.application import make_application
from kinedex.explorer.open_archive import Archive
from kinedex.ops.cancellation import CancelledWorkError, cancelled_when, check_cancelled
from kinedex.pipelines.engine.executors import in_threads
from tests.explorer.conftest import PORT, TOKEN, run
from tests.pipelines.labelled import long_take, write_store

WAIT_SECONDS = 60.0

ENDLESS = "SELECT count(*) FROM range(1000000000) a, range(1000000000) b WHERE a.range * b.range % 7 = 9"


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_store(tmp_path_factory.mktemp("withdrawal") / "store", [long_take("one", "al", "walk", "kick")])


def status_of(path: Path, built: Path, address: str, body: object) -> int:
    """Return the status of the answer to a page that sends a question and closes the connection at once."""
    app = make_application(Archive(path), Rules(TOKEN, PORT), built)
    text = json.dumps(body).encode()
    headers = {"host": f"127.0.0.1:{PORT}", "authorization": f"Bearer {TOKEN}", "content-length": str(len(text))}
    scope = {
        "type": "http", "http_version": "1.1", "method": "POST", "path": address, "raw_path": address.encode(),
        "query_string": b"", "scheme": "http", "client": ("127.0.0.1", 9), "server": ("127.0.0.1", PORT),
        "headers": [(name.encode(), value.encode()) for name, value in headers.items()],
    }  # fmt: skip
    messages = iter([{"type": "http.request", "body": text, "more_body": False}])
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        return next(messages, {"type": "http.disconnect"})

    async def send(message: Any) -> None:
        sent.append(message)

    run(asyncio.wait_for(app(scope, receive, send), WAIT_SECONDS))
    return int(sent[0]["status"])


def test_a_statement_that_nobody_waits_for_is_stopped(path: Path, built: Path) -> None:
    # its own limit would end it with 408
    assert status_of(path, built, "/api/ask/sql", {"text": ENDLESS}) == 499


def test_a_decision_is_kept_though_the_page_has_gone(path: Path, built: Path) -> None:
    label = {"take": "one", "start": 0, "stop": 9}
    assert status_of(path, built, "/api/ask/labels", {"class": "walk", "positives": [label]}) == 200
    assert Archive(path).store().labels().column("class").to_pylist() == ["walk"]


def test_threads_draw_no_more_work_once_it_is_withdrawn() -> None:
    drawn: list[int] = []
    found: list[int] = []

    def items() -> Any:
        for number in count():
            drawn.append(number)
            yield number

    def work(item: int) -> int:
        return item

    source = in_threads(work, items(), 2)
    with cancelled_when(lambda: len(found) >= 3):
        found += islice(source, 3)
        with pytest.raises(CancelledWorkError):
            next(source)
    assert found == [0, 1, 2]
    assert len(drawn) <= 3 + 4
    check_cancelled()  # outside of the context nothing is
