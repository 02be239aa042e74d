"""The command `explore`, which shows a store in a browser."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from kinedex.commands.app import ASK, command
from kinedex.commands.options import StorePath


@command(ASK)
def explore(
    store: StorePath,
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Port to listen on; 8734 or a free one unless given.")
    ] = None,
    host: Annotated[
        str, typer.Option(metavar="NAME", help="Listen on this address instead of this machine alone.")
    ] = "127.0.0.1",
    read_only: Annotated[bool, typer.Option("--read-only", help="Refuse everything that writes.")] = False,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Print the address only.")] = False,
) -> None:
    """Open the archive in a browser: takes, search by example, labels.

    A server on this machine shows the store until Ctrl-C. The address that it prints holds a token; nobody else can
    open it.
    """
    from kinedex.explorer.server import serve

    serve(store, host, port, read_only=read_only, browser=not no_browser, say=_say, warn=_warn)


def _say(text: str) -> None:
    print(text, flush=True)


def _warn(text: str) -> None:
    print(f"warning: {text}", file=sys.stderr, flush=True)
