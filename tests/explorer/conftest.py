"""A small store, and clients of an explorer over it, for tests of the server."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

from kinedex.explorer.access import Rules
from kinedex.explorer.application import make_application
from kinedex.explorer.open_archive import Archive
from kinedex.storage.index.builder import build_index
from kinedex.storage.store.store import open_store
from tests.ops.numeric.motions import motion
from tests.pipelines.labelled import clip, long_take, write_store

TOKEN = "the-token"
PORT = 8734
HOST = f"http://127.0.0.1:{PORT}"


def run(work: Coroutine[Any, Any, object]) -> None:
    """Run a coroutine in a thread of its own: once a test has opened a browser, an event loop runs in this one."""
    with ThreadPoolExecutor(1) as thread:
        thread.submit(asyncio.run, work).result()


@pytest.fixture(scope="package")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a store of eight clips of two actors and three long takes, one with a warning; nothing writes to it."""
    takes = [clip(name, actor, number) for name in ("kick", "walk") for actor in ("al", "bo") for number in (1, 2)]
    takes += [long_take("al_long", "al", "walk", "kick"), long_take("bo_long", "bo", "kick", "walk", "rest")]
    takes += [{**long_take("odd", "bo", "rest"), "warnings": ["the source has <gaps>"], "invalid_frames": 2}]
    return write_store(tmp_path_factory.mktemp("explorer") / "an archive", takes)


@pytest.fixture(scope="package")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder that stands for the built page."""
    folder = tmp_path_factory.mktemp("page") / "built"
    (folder / "assets").mkdir(parents=True)
    (folder / "index.html").write_text('<meta name="style-nonce" content="__NONCE__"><script src="/assets/a.js">')
    (folder / "assets" / "a.js").write_text("1")
    (folder / "secret.txt").write_text("nobody asks for it")
    return folder


Connect = Callable[..., TestClient]


@pytest.fixture(scope="package")
def connect(store: Path, built: Path) -> Connect:
    """Return a function that opens an explorer over the store (or another) and returns a client with the token."""

    def open_client(
        path: Path = store, *, read_only: bool = False, token: str | None = TOKEN, rules: Rules | None = None
    ) -> TestClient:
        archive = Archive(path, read_only=read_only)
        app = make_application(archive, rules or Rules(TOKEN, PORT), built)
        headers = {} if token is None else {"authorization": f"Bearer {token}"}
        return TestClient(app, base_url=HOST, headers=headers, raise_server_exceptions=False, follow_redirects=False)

    return open_client


MOTIONS = ("raise left", "bow", "raise right")


@pytest.fixture
def moving(tmp_path: Path) -> Path:
    """Return a store of eighteen takes, each of which shows its class by its body; the words show nothing."""
    takes = []
    for k in range(18):
        body = motion(MOTIONS[k % 3], 36 + k, k)
        row = {"name": f"take_{k:02d}", "actor": "al", "class": MOTIONS[k % 3], "words": np.zeros(len(body), np.uint64)}
        takes.append(row | {"positions": body.transpose(1, 2, 0)})
    path = write_store(tmp_path / "archive", takes)
    build_index(open_store(path, at="newest"))
    return path
