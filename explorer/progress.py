"""Answer slow requests by lines of JSON: the progress, then the answer; stop the work if the client disconnects.

Whoever asks with `Accept: application/x-ndjson` gets {done, total} whenever it has changed (both 0 until the work is
known), and at last {answer} or {error, status}; everybody else gets the answer alone.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Mapping
from threading import Event
from typing import Any, TypeVar

from anyio import to_thread
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

from kinedex.explorer.addresses import Question, post
from kinedex.explorer.answers import Json, fault_answer
from kinedex.explorer.archive import Archive
from kinedex.ops.withdrawal import withdrawn_when

LINES = "application/x-ndjson"

LOOK_SECONDS = 0.1


class Progress:
    """The number of steps of some work, done and in all; one thread counts them while another one reads the numbers."""

    def __init__(self) -> None:
        self.step = (0, 0)

    def start(self, total: int) -> None:
        """Set the number of steps of the work."""
        self.step = (0, total)

    def advance(self) -> None:
        """Count a step."""
        self.step = (self.step[0] + 1, self.step[1])


Asked = TypeVar("Asked", bound=Question)

Function = Callable[[Archive, Asked, Request, Progress], Mapping[str, Any]]


def post_with_progress(path: str, function: Function[Asked], asked: type[Asked]) -> Route:
    """Return the route of a question with a body, whose answer may take a while.

    Parameters
    ----------
    path : str
        Path of the address.
    function : callable
        Called with the archive, the body, the request and the progress, which it advances; returns the answer. It must
        not write.
    asked : type of Question
        Model of the body.
    """

    def alone(archive: Archive, body: Asked, request: Request) -> Mapping[str, Any]:
        return function(archive, body, request, Progress())

    plain = post(path, alone, asked)

    async def endpoint(request: Request) -> Response:
        if LINES not in request.headers.get("accept", ""):
            answer: Response = await plain.endpoint(request)
            return answer
        body = asked.model_validate_json(await request.body())
        return StreamingResponse(_lines(request, function, body), media_type=LINES)

    return Route(path, endpoint, methods=["POST"])


async def fault_line(request: Request, fault: Exception) -> bytes:
    """Return the line {error, status} for an error that was raised after the status of the response was sent."""
    answer = await fault_answer(request, fault)
    error = json.loads(bytes(answer.body) or b'{"error": {"type": "WithdrawnError", "message": ""}}')
    return json.dumps({**error, "status": answer.status_code}).encode() + b"\n"


async def _lines(request: Request, function: Function[Asked], body: Asked) -> AsyncIterator[bytes]:
    progress, gone = Progress(), Event()
    with withdrawn_when(gone.is_set):
        work = asyncio.create_task(to_thread.run_sync(function, request.app.state.archive, body, request, progress))
    seen = None
    try:
        while not work.done():
            if progress.step != seen:
                seen = progress.step
                yield json.dumps({"done": seen[0], "total": seen[1]}).encode() + b"\n"
            await asyncio.wait({work}, timeout=LOOK_SECONDS)
        try:
            yield bytes(Json({"answer": work.result()}).body) + b"\n"
        except Exception as fault:  # the status of the response is sent already
            yield await fault_line(request, fault)
    finally:
        gone.set()
