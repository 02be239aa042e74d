"""The server of the explorer: its socket, uvicorn, and a clean end on Ctrl-C."""

from __future__ import annotations

import ctypes
import errno
import os
import signal
import socket
import sys
import webbrowser
from collections.abc import Callable
from pathlib import Path
from threading import Thread
from types import FrameType

import uvicorn

from kinedex.explorer.access import Rules, address, is_loopback, new_token
from kinedex.explorer.application import make_application, require_page
from kinedex.explorer.jobs import end_jobs
from kinedex.explorer.open_archive import Archive
from kinedex.ops.errors import KinedexError

PORT = 8734
"""The default port; if it is in use, a free one is taken."""

HEAD_BYTES = 64 * 1024
"""The largest size of an address with its headers, in bytes; addresses that list chosen takes are long."""

HEAPS, M_ARENA_MAX = 2, -8
"""The number of malloc heaps that all threads share, and the number of that setting in glibc's malloc.h."""

GRACE_SECONDS = 2
"""Seconds that requests may take to end when the server stops."""


def open_socket(host: str, port: int | None) -> socket.socket:
    """Return a socket that listens on a host.

    Parameters
    ----------
    host : str
        Name or address.
    port : int or None
        The port; for None, `PORT`, or a free port if that one is in use.

    Raises
    ------
    KinedexError
        The port is in use or not allowed, or the host is no address of this machine.
    """
    ports = [PORT, 0] if port is None else [port]
    for number in ports:
        try:
            return _bound(host, number)
        except OSError as fault:
            if number == ports[-1] or fault.errno != errno.EADDRINUSE:
                raise _refused(host, number, fault) from None
    raise AssertionError("one port is always tried last")


def _bound(host: str, port: int) -> socket.socket:
    family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    opened = socket.socket(family, kind, protocol)
    try:
        if os.name == "posix":  # elsewhere it would share the port with a server that runs
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.bind(address)
        opened.listen(128)
    except BaseException:
        opened.close()
        raise
    return opened


def _refused(host: str, port: int, fault: OSError) -> KinedexError:
    """Return the error for a socket that cannot be opened, with a way out."""
    if fault.errno == errno.EADDRINUSE:
        return KinedexError(
            f"--port {port}: the port is in use, perhaps by another `kinedex explore`; leave --port out to get a free "
            "one"
        )
    if fault.errno == errno.EACCES:
        return KinedexError(f"--port {port}: this user may not listen on it; choose one from 1024 to 65535")
    return KinedexError(
        f"--host {host}: cannot listen there: {fault.strerror or fault}; leave --host out to listen on this machine "
        "alone"
    )


class Server(uvicorn.Server):
    """A uvicorn server that, when stopped, first ends the streams of events, which would keep it waiting."""

    def __init__(self, config: uvicorn.Config, archive: Archive) -> None:
        super().__init__(config)
        self._archive = archive

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """End the streams of events, and stop once the current requests have been answered."""
        self._archive.events.close()
        super().handle_exit(sig, frame)


def serve(
    store: Path,
    host: str,
    port: int | None,
    *,
    read_only: bool,
    browser: bool,
    message: Callable[[str], None],
    warn: Callable[[str], None],
) -> None:
    """Serve a store until Ctrl-C.

    Parameters
    ----------
    store : Path
        The directory of the store.
    host : str
        Name or address to listen on.
    port : int or None
        The port; for None, `PORT`, or a free port if that one is in use.
    read_only : bool
        Refuse everything that writes.
    browser : bool
        Open the page in a browser.
    message, warn : callable
        Print a line, and a warning.

    Raises
    ------
    KinedexError
        There is no store or no built page, or the port is in use.
    KeyboardInterrupt
        The user has pressed Ctrl-C.
    """
    require_page()
    share_heaps()
    archive = Archive(store, read_only=read_only)
    signal.signal(signal.SIGTERM, _exit)
    with open_socket(host, port) as listening:
        rules = Rules.for_host(new_token(), host, listening.getsockname()[1])
        shown = address(rules, host)
        if not is_loopback(host):
            warn(remote_access_warning(host))
        message(f"{store}: open {shown}")
        if not read_only and not os.access(store, os.W_OK):
            warn(read_only_warning(store))
        message("Ctrl-C stops the server")
        config = uvicorn.Config(
            make_application(archive, rules),
            loop="asyncio",
            http="h11",
            ws="none",
            lifespan="off",
            log_config=None,
            access_log=False,
            server_header=False,
            proxy_headers=False,
            h11_max_incomplete_event_size=HEAD_BYTES,
            timeout_graceful_shutdown=GRACE_SECONDS,
        )
        if browser:
            _open(shown)
        try:
            Server(config, archive).run([listening])
        finally:
            end_jobs(archive)


def _exit(number: int, _frame: FrameType | None) -> None:
    """Raise SystemExit on a signal, which uvicorn sends again after its shutdown, so that running jobs are ended."""
    raise SystemExit(128 + number)


def share_heaps() -> None:
    """Let the threads of this process share two heaps, where the C library is glibc.

    By default glibc gives each thread its own heap, which keeps freed memory in fragments: with an archive of
    100 hours, the memory of a server grew by some 8 MiB with each search.
    """
    if sys.platform == "linux":
        setting = getattr(ctypes.CDLL(None), "mallopt", None)
        if setting is not None:
            setting(M_ARENA_MAX, HEAPS)


def _open(shown: str) -> None:
    """Open an address in a graphical browser; without a display, none is opened, as a text browser would take over."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return
    Thread(target=webbrowser.open, args=[shown], daemon=True).start()


def read_only_warning(store: Path) -> str:
    """Return the warning that the store cannot be written."""
    return (
        f"{store} cannot be written by this user or on this file system: labels, learning, pipelines and "
        "exports will be refused, and decisions wait in the browser; change that, or start with --read-only"
    )


def remote_access_warning(host: str) -> str:
    """Return the warning that other machines can connect."""
    return (
        f"the server listens on {host}: everybody who can reach this machine and knows the address with its "
        "token can read the store and label it, and the connection is not encrypted; leave --host out to listen on "
        "this machine alone, and use an SSH tunnel to come from elsewhere"
    )
