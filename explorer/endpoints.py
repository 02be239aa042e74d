"""Make the routes of the server from functions that answer requests; request bodies are parsed and checked first.

A function gets the archive and runs in a thread, so that it may wait for SQL, files and kernels. It returns a mapping,
which is sent as JSON, or a `Response`. If the page closes the connection or sends another request instead, a
function that only reads is cancelled (`ops.cancellation`).

    routes = [get("/api/store", describe), post("/api/takes", find_takes, TakesQuestion)]

A slow request with `Accept: application/x-ndjson` is answered by lines of JSON: {done, total} whenever the progress has
changed (both 0 until the amount of work is known), and at last {answer} or {error, status}. Without this header the
response is the answer alone. The work stops if the client disconnects.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Mapping
from threading import Event
from typing import Any, TypeVar

from anyio import to_thread
from pydantic import BaseModel, ConfigDict
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

from kinedex.explorer.answers import Json, NotFoundError, error_response
from kinedex.explorer.open_archive import Archive, ReadOnlyError
from kinedex.ops.cancellation import cancelled_when

Result = Mapping[str, Any] | Response | bytes

LINES = "application/x-ndjson"

LOOK_SECONDS = 0.1


class RequestBody(BaseModel):
    """The base class of request bodies; an unknown field is an error."""

    model_config = ConfigDict(extra="forbid", strict=True)


Asked = TypeVar("Asked", bound=RequestBody)


def get(path: str, function: Callable[[Archive, Request], Result]) -> Route:
    """Return the route of a GET address, whose path and query hold all parameters.

    Parameters
    ----------
    path : str
        Path of the address, with parameters in braces.
    function : callable
        Called with the archive and the request, whose `path_params` and `query_params` it reads; returns the answer.
    """

    async def endpoint(request: Request) -> Response:
        return _response(await _unless_gone(request, function, request.app.state.archive, request))

    return Route(path, endpoint, methods=["GET"])


def post(
    path: str, function: Callable[[Archive, Asked, Request], Result], asked: type[Asked], *, writes: bool = False
) -> Route:
    """Return the route of a POST address, whose requests have a JSON body.

    Parameters
    ----------
    path : str
        Path of the address, with parameters in braces.
    function : callable
        Called with the archive, the parsed body and the request; returns the answer.
    asked : type of RequestBody
        Model of the body.
    writes : bool, optional
        True if the function writes anything; `--read-only` refuses it then.
    """

    async def endpoint(request: Request) -> Response:
        archive: Archive = request.app.state.archive
        if writes and archive.read_only:
            raise ReadOnlyError(
                "this explorer was started with --read-only and writes nothing; start `kinedex explore` without it"
            )
        body = asked.model_validate_json(await request.body())
        if writes:  # a request that writes runs to its end even if the page was closed
            return _response(await to_thread.run_sync(function, archive, body, request))
        return _response(await _unless_gone(request, function, archive, body, request))

    route = Route(path, endpoint, methods=["POST"])
    route.writes = writes  # type: ignore[attr-defined]
    return route


async def _unless_gone(request: Request, function: Callable[..., Result], *values: object) -> Result:
    """Call a function in a thread, and cancel its work once the connection of the request is closed."""
    gone = Event()
    watch = asyncio.create_task(_watch(request, gone))
    try:
        with cancelled_when(gone.is_set):
            return await to_thread.run_sync(function, *values)
    finally:
        watch.cancel()


async def _watch(request: Request, gone: Event) -> None:
    """Wait until a connection is closed, and set an event then; the body of the request was read before."""
    while (await request.receive())["type"] != "http.disconnect":
        pass
    gone.set()


def _response(result: Result) -> Response:
    if isinstance(result, bytes):
        return Response(result, media_type="application/octet-stream")
    return result if isinstance(result, Response) else Json(result)


def take_of(archive: Archive, request: Request) -> tuple[Any, int]:
    """Return the open store and the id of the take that the address names as `take`.

    Raises
    ------
    NotFoundError
        The store has no such take.
    """
    store = archive.store()
    take = request.path_params["take"]
    if take not in store.take_frames:
        raise NotFoundError(f"no take has the id {take}; it may have been removed from the store")
    return store, take


def get_of_take(path: str, function: Callable[[Any, int], Result]) -> Route:
    """Return the route of a GET address below that of a take, for a function of the open store and the take's id."""
    return get(f"/api/takes/{{take:int}}{path}", lambda archive, request: function(*take_of(archive, request)))


class Progress:
    """The steps of some work, done and in all, which one thread counts while another thread reads them."""

    def __init__(self) -> None:
        self.step = (0, 0)

    def start(self, total: int) -> None:
        """Set the number of steps of the work."""
        self.step = (0, total)

    def advance(self) -> None:
        """Count a step."""
        self.step = (self.step[0] + 1, self.step[1])


Function = Callable[[Archive, Asked, Request, Progress], Mapping[str, Any]]


def post_with_progress(path: str, function: Function[Asked], asked: type[Asked]) -> Route:
    """Return the route of a POST address whose answers may take a while.

    Parameters
    ----------
    path : str
        Path of the address.
    function : callable
        Called with the archive, the body, the request and the progress, which it advances; returns the answer. It must
        not write.
    asked : type of RequestBody
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


async def error_line(request: Request, fault: Exception) -> bytes:
    """Return the line {error, status} for an error that was raised after the status of the response was sent."""
    answer = await error_response(request, fault)
    error = json.loads(bytes(answer.body) or b'{"error": {"type": "CancelledWorkError", "message": ""}}')
    return json.dumps({**error, "status": answer.status_code}).encode() + b"\n"


async def _lines(request: Request, function: Function[Asked], body: Asked) -> AsyncIterator[bytes]:
    progress, gone = Progress(), Event()
    with cancelled_when(gone.is_set):
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
            yield await error_line(request, fault)
    finally:
        gone.set()
