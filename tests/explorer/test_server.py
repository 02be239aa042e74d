"""A real server: a process of the command line, asked over a socket, while others write, until Ctrl-C."""

from __future__ import annotations

import http.client
import json
import os
import platform
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from kinedex.explorer import server
from kinedex.explorer.application import require_page
from kinedex.ops.errors import KinedexError
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, add

SECONDS = 60
"""Every wait ends after so long."""

COMMAND = """
import sys
from pathlib import Path
from kinedex.explorer import application, server
application.BUILT = Path(sys.argv[1])
application.require_page.__defaults__ = application.make_application.__defaults__ = (application.BUILT,)
sys.argv[1:] = sys.argv[2:]
from kinedex.commands.cli import main
main()
"""
"""The command line over a folder that stands for the built page: a checkout may have none."""


@dataclass
class Running:
    """A server that runs."""

    process: subprocess.Popen[str]
    host: str
    port: int
    token: str

    def ask(self, path: str, body: object = None) -> tuple[int, Any]:
        """Return status and JSON of an answer."""
        connection = http.client.HTTPConnection(self.host, self.port, timeout=SECONDS)
        try:
            text = None if body is None else json.dumps(body)
            connection.request("GET" if body is None else "POST", path, text, {"authorization": f"Bearer {self.token}"})
            answer = connection.getresponse()
            return answer.status, json.loads(answer.read())
        finally:
            connection.close()


def start(store: Path, built: Path, *words: str) -> Running:
    """Start `kinedex explore` on a free port and return once it has printed its address."""
    command = [sys.executable, "-c", COMMAND, str(built), "explore", str(store), "--no-browser", "--port", "0", *words]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    line = process.stdout.readline()
    found = re.search(r"http://([^:/]+):(\d+)/\?token=(\S+)", line)
    if found is None:
        raise AssertionError(f"{line}{process.communicate(timeout=SECONDS)}")
    return Running(process, found[1], int(found[2]), found[3])


@pytest.fixture(scope="module")
def copy(store: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a copy of the store that tests write to."""
    path = tmp_path_factory.mktemp("served") / "store"
    shutil.copytree(store, path)
    return path


@pytest.fixture(scope="module")
def running(copy: Path, built: Path) -> Iterator[Running]:
    one = start(copy, built)
    yield one
    one.process.kill()
    one.process.communicate(timeout=SECONDS)


def test_a_server_answers_several_at_once(running: Running) -> None:
    found: list[int] = []
    asking = [
        threading.Thread(target=lambda: found.append(running.ask("/api/takes", {"limit": 5})[1]["total"]))
        for _ in range(8)
    ]
    for one in asking:
        one.start()
    for one in asking:
        one.join(SECONDS)
    assert found == [11] * 8


def test_the_token_is_asked_for_over_a_socket_too(running: Running) -> None:
    assert running.ask("/api/store")[0] == 200
    assert Running(running.process, running.host, running.port, "wrong").ask("/api/store")[0] == 401


def test_a_long_address_may_come_in_pieces(running: Running) -> None:
    head = f"GET /?chosen={'A' * 56_000} HTTP/1.1\r\nHost: {running.host}:{running.port}\r\n"
    head += f"Authorization: Bearer {running.token}\r\nConnection: close\r\n\r\n"
    with socket.create_connection((running.host, running.port), SECONDS) as opened:
        for first in range(0, len(head), 4000):
            opened.sendall(head[first : first + 4000].encode())
            time.sleep(0.005)  # so that the server sees the head grow
        assert opened.recv(100).startswith(b"HTTP/1.1 200")


def events_of(running: Running) -> tuple[http.client.HTTPConnection, http.client.HTTPResponse]:
    connection = http.client.HTTPConnection(running.host, running.port, timeout=SECONDS)
    connection.request("GET", "/api/events", headers={"authorization": f"Bearer {running.token}"})
    return connection, connection.getresponse()


def test_two_tabs_see_the_version_that_somebody_else_writes(running: Running, copy: Path) -> None:
    tabs = [events_of(running), events_of(running)]
    assert tabs[0][1].headers["content-type"].startswith("text/event-stream")
    before = running.ask("/api/store")[1]
    with StoreWriter.open(copy, BODY) as writer:
        add(writer, {"zz_new": 40})
        writer.commit()
    for connection, stream in tabs:
        seen = ""
        while "event: version" not in seen:
            seen = stream.readline().decode()
            assert seen, "the stream ended"
        assert json.loads(stream.readline().decode().removeprefix("data: "))["version"] > before["version"]
        connection.close()
    after = running.ask("/api/store")[1]
    assert (after["takes"], after["version"]) == (before["takes"] + 1, before["version"] + 1)


@pytest.mark.skipif(os.name == "nt", reason="Windows sends no such signal")
def test_ctrl_c_ends_a_server_quietly_though_a_page_listens(copy: Path, built: Path) -> None:
    one = start(copy, built, "--read-only")
    connection, stream = events_of(one)
    assert stream.readline()
    one.process.send_signal(signal.SIGINT)
    _, faults = one.process.communicate(timeout=SECONDS)
    connection.close()
    assert one.process.returncode == 130
    assert faults.startswith("kinedex: stopped")
    assert faults.count("\n") == 1, faults


@pytest.mark.skipif(os.name == "nt", reason="Windows sends no such signal")
def test_a_server_that_is_ended_from_outside_leaves_as_after_ctrl_c(copy: Path, built: Path) -> None:
    one = start(copy, built, "--read-only")
    one.process.send_signal(signal.SIGTERM)
    _, faults = one.process.communicate(timeout=SECONDS)
    assert (one.process.returncode, faults) == (128 + signal.SIGTERM, "")  # by an exception, so that jobs are ended


def test_a_port_in_use_is_named_with_a_way_out() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(KinedexError, match=f"--port {port}: the port is in use.*leave --port out"):
            server.open_socket("127.0.0.1", port)


def test_without_a_port_a_free_one_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        monkeypatch.setattr(server, "PORT", other.getsockname()[1])
        with server.open_socket("127.0.0.1", None) as opened:
            assert opened.getsockname()[1] not in (0, server.PORT)


@pytest.mark.parametrize("host", ["no.such.host.invalid", "203.0.113.7"])
def test_a_host_that_is_not_here_is_named(host: str) -> None:
    with pytest.raises(KinedexError, match=f"--host {host}: cannot listen there.*leave --host out"):
        server.open_socket(host, 0)


def test_other_machines_are_let_in_with_a_warning_alone() -> None:
    assert re.search(r"0\.0\.0\.0.*SSH tunnel", server.remote_access_warning("0.0.0.0"))


def test_a_checkout_without_the_page_names_the_command_that_builds_it(tmp_path: Path) -> None:
    built = tmp_path / "explorer" / "built"
    with pytest.raises(KinedexError, match="no checkout that could build it; install kinedex again"):
        require_page(built)
    (tmp_path / "Makefile").write_text("page:\n")
    with pytest.raises(KinedexError, match=f"`make -C {tmp_path} page` builds it"):
        require_page(built)


HEAPS = """
import ctypes, re, sys, threading
from kinedex.explorer import server
server.share_heaps()
begun, held = threading.Barrier(9), []
def allocate():
    held.append([bytearray(1000) for _ in range(100)])
    begun.wait(60)
threads = [threading.Thread(target=allocate) for _ in range(8)]
for one in threads: one.start()
begun.wait(60)
for one in threads: one.join()
libc = ctypes.CDLL(None)
libc.fopen.restype = ctypes.c_void_p
file = ctypes.c_void_p(libc.fopen(sys.argv[1].encode(), b"w"))
libc.malloc_info(0, file)
libc.fclose(file)
"""
"""Eight threads at once after `share_heaps`; the state of malloc goes to a file."""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="heaps of threads are those of glibc")
def test_threads_share_heaps(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-c", HEAPS, str(tmp_path / "heaps.xml")], check=True, timeout=SECONDS)
    assert (tmp_path / "heaps.xml").read_text().count("<heap nr=") <= server.HEAPS


def test_a_store_that_cannot_be_written_is_announced() -> None:
    assert server.read_only_warning(Path("an archive")).startswith("an archive cannot be written")
