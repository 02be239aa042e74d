"""The application of the explorer: the routes of all subjects, the built page, and one answer to every fault."""

from __future__ import annotations

import html
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.responses import FileResponse, HTMLResponse, Response
from starlette.routing import Mount, Route

from kinedex.ops.errors import KinedexError, Remedy
from kinedex.pipelines.explorer.access import Access, Rules, TooLongError, too_long
from kinedex.pipelines.explorer.answers import fault_answer

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.types import ASGIApp

    from kinedex.pipelines.explorer.archive import Archive

BUILT = Path(__file__).parent / "built"
"""The folder of the built page (`make page`)."""

SUBJECTS = (
    "curves",
    "events",
    "lanes",
    "motion",
    "store",
    "takes",
)
"""The modules whose `routes` the application has."""


def make_application(archive: Archive, rules: Rules, built: Path = BUILT) -> ASGIApp:
    """Return the application that serves an archive.

    Parameters
    ----------
    archive : Archive
        The open store.
    rules : Rules
        Who may ask.
    built : Path, optional
        The folder of the built page.
    """
    routes: list[Route | Mount] = []
    for subject in SUBJECTS:
        routes += import_module(f"kinedex.pipelines.explorer.{subject}").routes
    routes += [
        Route("/api/{rest:path}", _no_address, methods=["GET", "POST"]),
        Route("/assets/{name}", _asset, methods=["GET"]),
        Route("/{rest:path}", _page, methods=["GET"]),
    ]
    known = (HTTPException, KinedexError, ValidationError, OSError, MemoryError, Exception)
    faults = {**dict.fromkeys(known, fault_answer), TooLongError: _too_long}
    app = Starlette(routes=routes, exception_handlers=faults)
    app.state.archive = archive
    app.state.built = built
    return Access(app, rules)


def require_page(built: Path = BUILT) -> None:
    """Raise a KinedexError if the page has not been built, as in a checkout."""
    if not (built / "index.html").is_file():
        raise KinedexError(
            f"{built}: the page of the explorer has not been built", remedy=Remedy("run `make page`", ("make", "page"))
        )


async def _no_address(request: Request) -> Response:
    raise HTTPException(404, f"no address of the server is {request.url.path}")


async def _too_long(_request: Request, _fault: Exception) -> Response:
    return too_long()


async def _asset(request: Request) -> Response:
    """Answer with a file of the built page; its name holds a hash of its content, so that browsers keep it."""
    built: Path = request.app.state.built
    name = request.path_params["name"]
    if name not in _assets(built):
        raise HTTPException(404, f"the page has no file {name}; reload it")
    return FileResponse(built / "assets" / name, headers={"cache-control": "private, max-age=31536000, immutable"})


@lru_cache
def _assets(built: Path) -> frozenset[str]:
    """Return the names of the files of the page: nothing else is served, whatever an address names."""
    return frozenset(path.name for path in (built / "assets").iterdir())


async def _page(request: Request) -> Response:
    """Answer with the page, whose script shows what the address names."""
    built: Path = request.app.state.built
    text = (built / "index.html").read_text(encoding="utf-8")
    nonce = html.escape(request.scope["state"]["nonce"])
    return HTMLResponse(text.replace("__NONCE__", nonce), headers={"cache-control": "no-store"})
