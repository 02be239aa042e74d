"""The stream of events: where it begins, what it brings, and that it ends."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from typing import Any

import pytest

from kinedex.explorer import events as module
from kinedex.explorer.events import Events
from kinedex.ops.errors import StoreError
from tests.explorer.conftest import run

STATE = {"version": 3, "labels": "a"}


async def message(stream: AsyncIterator[bytes]) -> tuple[str, Any]:
    """Return kind and content of the next message, empty for one that only keeps the connection."""
    async with asyncio.timeout(30):
        text = (await anext(stream)).decode()
    if not text.startswith("event: "):
        return "", text
    kind, data = text.strip().split("\n")
    return kind.removeprefix("event: "), json.loads(data.removeprefix("data: "))


def test_a_listener_gets_the_state_the_jobs_that_run_and_then_the_news() -> None:
    async def listen() -> None:
        events = Events()
        events.publish("job", {"id": "1", "title": "learn", "state": "running"})
        events.publish("job", {"id": "2", "title": "annotate", "state": "running"})
        events.publish("job", {"id": "1", "title": "learn", "state": "done"})
        stream = events.listen(lambda: STATE)
        assert (await message(stream))[1] == "retry: 1000\n\n"
        assert await message(stream) == ("state", STATE)
        assert (await message(stream))[1]["id"] == "2"
        await asyncio.to_thread(events.publish, "version", {"version": 4})
        assert await message(stream) == ("version", {"version": 4})
        events.close()
        assert [one async for one in stream] == []

    run(listen())


@pytest.mark.parametrize("good", [0, 1])
def test_a_store_that_cannot_be_read_for_a_while_ends_no_stream(good: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "WAIT_SECONDS", 0.01)
    looks = 0

    def look() -> dict[str, object]:
        nonlocal looks
        looks += 1
        if good < looks < good + 4:
            raise StoreError("damaged")
        return STATE

    events = Events()
    job = {"id": "1", "title": "learn", "state": "running"}
    events.publish("job", job)

    async def listen() -> None:
        stream = events.listen(look)
        begun = [("state", STATE), ("job", job)] * good
        expected = [*begun, ("trouble", {"message": "damaged"}), ("job", job), ("state", STATE), ("job", job)]
        assert (await message(stream))[0] == ""
        assert [await message(stream) for _ in expected] == expected
        await stream.aclose()

    run(listen())
    assert looks >= good + 4
