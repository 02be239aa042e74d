"""The ASGI application of the explorer: the routes of its modules, the built page, and the handler of errors."""

from __future__ import annotations

import asyncio
import html
import shlex
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from threading import Lock, Thread

from anyio import to_thread
from pydantic import ValidationError
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, HTMLResponse, Response
from starlette.routing import BaseRoute, Match, Route, Router
from starlette.types import ASGIApp, Receive, Scope, Send

from kinedex.explorer.access import Access, Rules, TooLongError, too_long_response
from kinedex.explorer.answers import error_response
from kinedex.explorer.open_archive import Archive
from kinedex.explorer.warm_up import prepare
from kinedex.ops.errors import KinedexError, Remedy

BUILT = Path(__file__).parent / "built"
"""The folder of the built page (`make page`)."""

SUBJECTS = (
    "curves",
    "doubts",
    "review_queue",
    "events",
    "examples",
    "explanations",
    "exports",
    "edit_effect",
    "hits",
    "keyframes",
    "jobs",
    "label_files",
    "labels",
    "take_lanes",
    "learning",
    "maps",
    "motion",
    "named_files",
    "quality",
    "runs",
    "sql",
    "store",
    "suspect_labels",
    "takes",
    "template_edits",
    "templates",
)
"""The modules whose `routes` the application has."""

FIRST = frozenset({"events", "quality", "store", "takes"})
"""The modules that the first page needs. The others are imported after it is shown: some import numba or polars."""


PAUSE_SECONDS = 1.5
"""Seconds from sending the page to importing the modules that it needs later."""


def make_application(archive: Archive, rules: Rules, built: Path = BUILT) -> ASGIApp:
    """Return the application that serves an archive.

    Parameters
    ----------
    archive : Archive
        The open store.
    rules : Rules
        The rules by which requests are admitted.
    built : Path, optional
        The folder of the built page.
    """
    routes: list[BaseRoute] = [route for subject in SUBJECTS if subject in FIRST for route in routes_of(subject)]
    later = LaterRoutes([subject for subject in SUBJECTS if subject not in FIRST])
    routes += [
        later,
        Route("/assets/{name}", _asset, methods=["GET"]),
        Route("/{rest:path}", _page, methods=["GET"]),
    ]
    known = (HTTPException, KinedexError, ValidationError, OSError, MemoryError, Exception)
    faults = {**dict.fromkeys(known, error_response), TooLongError: _too_long}
    app = Starlette(routes=routes, exception_handlers=faults)
    app.state.archive = archive
    app.state.built = built
    app.state.later = later
    return Access(app, rules)


def routes_of(subject: str) -> list[Route]:
    """Import a module of `kinedex.explorer`, and return its `routes`."""
    found: list[Route] = import_module(f"kinedex.explorer.{subject}").routes
    return found


class LaterRoutes(BaseRoute):
    """The routes below /api/ of modules that are all imported when one of these routes is first requested.

    Parameters
    ----------
    subjects : sequence of str
        The names of the modules.
    """

    def __init__(self, subjects: Sequence[str]) -> None:
        self._subjects = subjects
        self._lock = Lock()
        self._router: Router | None = None
        self._soon = False

    def load(self) -> Router:
        """Import the modules, and return the router of their routes; any thread may call it."""
        with self._lock:
            if self._router is None:
                self._router = Router([route for subject in self._subjects for route in routes_of(subject)])
            return self._router

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """Match every address below /api/ that no earlier route has matched; the scope is unchanged."""
        is_ours = scope["type"] == "http" and scope["path"].startswith("/api/")
        return (Match.FULL if is_ours else Match.NONE), {}

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Import the modules in a thread if they are not imported yet, and pass the request to their router."""
        router: Router = await to_thread.run_sync(self.load)
        await router(scope, receive, send)

    def load_soon(self, archive: Archive) -> None:
        """Import the modules in a thread after `PAUSE_SECONDS`, and prepare the answers to probable first requests."""
        if not self._soon:
            self._soon = True
            loop = asyncio.get_running_loop()
            loop.call_later(PAUSE_SECONDS, lambda: Thread(target=self._prepare, args=[archive], daemon=True).start())

    def _prepare(self, archive: Archive) -> None:
        self.load()
        prepare(archive)


def require_page(built: Path = BUILT) -> None:
    """Raise a KinedexError if the page has not been built, as in a checkout."""
    if (built / "index.html").is_file():
        return
    checkout = built.resolve().parents[1]
    missing = f"{built}: the page of the explorer has not been built"
    if not (checkout / "Makefile").is_file():
        raise KinedexError(f"{missing}, and this is no checkout that could build it; install kinedex again")
    command = ("make", "-C", str(checkout), "page")
    raise KinedexError(missing, remedy=Remedy(f"`{shlex.join(command)}` builds it, in a minute or two", command))


async def _too_long(_request: Request, _fault: Exception) -> Response:
    return too_long_response()


async def _asset(request: Request) -> Response:
    """Answer with a file of the built page; its name holds a hash of its content, so that browsers keep it."""
    built: Path = request.app.state.built
    name = request.path_params["name"]
    if name not in _assets(built):
        raise HTTPException(404, f"the page has no file {name}; reload it")
    return FileResponse(built / "assets" / name, headers={"cache-control": "private, max-age=31536000, immutable"})


def _assets(built: Path) -> frozenset[str]:
    """Return the names of the files of the page; no other file is served."""
    return frozenset(path.name for path in (built / "assets").iterdir())


async def _page(request: Request) -> Response:
    """Answer with the page, whose script shows the view that the address names."""
    built: Path = request.app.state.built
    text = (built / "index.html").read_text(encoding="utf-8")
    request.app.state.later.load_soon(request.app.state.archive)
    nonce = html.escape(request.scope["state"]["nonce"])
    return HTMLResponse(text.replace("__NONCE__", nonce), headers={"cache-control": "no-store"})
