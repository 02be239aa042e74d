"""Make the routes of the server from functions that answer requests; request bodies are parsed and checked first.

A function gets the archive and runs in a thread, so that it may wait for SQL, files and kernels. It returns a mapping,
which is sent as JSON, or a response of its own. If the page closes the connection or sends another request instead, a
function that only reads is cancelled (`ops.withdrawal`).

    routes = [get("/api/store", describe), post("/api/takes", find_takes, TakesQuestion)]
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from threading import Event
from typing import Any, TypeVar

from anyio import to_thread
from pydantic import BaseModel, ConfigDict
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from kinedex.explorer.answers import Json, NotFoundError
from kinedex.explorer.archive import Archive, ReadOnlyError
from kinedex.ops.withdrawal import withdrawn_when


class Question(BaseModel):
    """The base class of request bodies; an unknown field is an error."""

    model_config = ConfigDict(extra="forbid", strict=True)


Asked = TypeVar("Asked", bound=Question)

Result = Mapping[str, Any] | Response


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
    asked : type of Question
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
        if writes:  # it runs to its end even if the page has gone
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
        with withdrawn_when(gone.is_set):
            return await to_thread.run_sync(function, *values)
    finally:
        watch.cancel()


async def _watch(request: Request, gone: Event) -> None:
    """Wait until a connection is closed, and set an event then; the body of the request was read before."""
    while (await request.receive())["type"] != "http.disconnect":
        pass
    gone.set()


def _response(result: Result) -> Response:
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
