"""Messages of the server to the pages that are open: `GET /api/events`, a stream of server-sent events.

The kinds are `version` (a newer version of the store can be read), `labels` (labels have changed), `job` (the
progress of a job, `{id, title, state, done?, total?, message?}`) and `trouble` ({message}: the store cannot be read);
each carries one JSON object. A stream begins with `state` ({version, labels}), by which a page that has not listened
for a while knows whether it missed anything, and with the jobs that run. After `trouble`, another `state` reports that
the store can be read again.
"""

from __future__ import annotations

import asyncio
import json
import threading
import time
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import suppress

from anyio import to_thread
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

from kinedex.ops.errors import KinedexError

WAIT_SECONDS = 1.0
"""Seconds from one check of the store for changes to the next, while a page listens."""

QUIET_SECONDS = 15.0
"""Seconds without a message after which an empty one is sent, so that closed connections are noticed."""


class Events:
    """The listeners of one server; any thread may publish."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._listeners: dict[asyncio.Queue[bytes | None], asyncio.AbstractEventLoop] = {}
        self._running: dict[str, bytes] = {}
        self._closed = False

    def publish(self, kind: str, message: Mapping[str, object]) -> None:
        """Send a message to all pages that listen.

        Parameters
        ----------
        kind : str
            Name of the event: version, labels or job.
        message : mapping
            The content of the message, which is sent as a JSON object.
        """
        chunk = _encoded(kind, message)
        if kind == "job":
            with self._lock:
                if message["state"] == "running":
                    self._running[str(message["id"])] = chunk
                else:
                    self._running.pop(str(message["id"]), None)
        self._send(chunk)

    def close(self) -> None:
        """End all streams, because the server stops."""
        self._closed = True
        self._send(None)

    def _send(self, chunk: bytes | None) -> None:
        with self._lock:
            for queue, loop in self._listeners.items():
                loop.call_soon_threadsafe(queue.put_nowait, chunk)

    async def listen(self, look: Callable[[], Mapping[str, object]]) -> AsyncIterator[bytes]:
        """Yield messages when they arrive, and check the store regularly for changes.

        Parameters
        ----------
        look : callable
            Publishes what has changed in the store, and returns its state; called in a thread, once in `WAIT_SECONDS`.
        """
        queue: asyncio.Queue[bytes | None] = asyncio.Queue()
        with self._lock:
            self._listeners[queue] = asyncio.get_running_loop()
        try:
            yield b"retry: 1000\n\n"
            known = _Known(look)
            for chunk in await self._news(known):
                yield chunk
            async for chunk in self._messages(queue, known):
                yield chunk
        finally:
            with self._lock:
                del self._listeners[queue]

    async def _messages(self, queue: asyncio.Queue[bytes | None], known: _Known) -> AsyncIterator[bytes]:
        """Yield the messages of a listener until the server stops."""
        looked = spoken = time.monotonic()
        while not self._closed:
            chunk: bytes | None = b""
            with suppress(TimeoutError):
                chunk = await asyncio.wait_for(queue.get(), WAIT_SECONDS)
            if chunk is None:
                return
            now = time.monotonic()
            if now - looked >= WAIT_SECONDS:
                for news in await self._news(known):
                    yield news
                looked = now
            if chunk or now - spoken >= QUIET_SECONDS:
                spoken = now
                yield chunk or b": quiet\n\n"

    async def _news(self, known: _Known) -> list[bytes]:
        """Return new messages if the store became readable or unreadable: its state or the error, and running jobs."""
        news = await known.news()
        with self._lock:
            return [news, *self._running.values()] if news else []


class _Known:
    """The state of the store that was last sent to a listener: readable, or the error; at first nothing was sent."""

    def __init__(self, look: Callable[[], Mapping[str, object]]) -> None:
        self._look = look
        self._trouble: str | None = None

    async def news(self) -> bytes:
        """Check the store; return a message if it has become unreadable or readable again, else an empty one."""
        state: Mapping[str, object] = {}
        try:
            state = await to_thread.run_sync(self._look)
            trouble = ""
        except (KinedexError, OSError) as fault:
            trouble = str(fault)
        if trouble == self._trouble:
            return b""
        self._trouble = trouble
        return _encoded("trouble", {"message": trouble}) if trouble else _encoded("state", state)


def _encoded(kind: str, message: Mapping[str, object]) -> bytes:
    return f"event: {kind}\ndata: {json.dumps(message, allow_nan=False)}\n\n".encode()


async def stream(request: Request) -> Response:
    """Answer with the messages for as long as the page listens."""
    archive = request.app.state.archive
    return StreamingResponse(archive.events.listen(archive.state), media_type="text/event-stream")


routes = [Route("/api/events", stream)]
