"""Processes that are there to be killed: they start at once, from a process that has imported everything already."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from multiprocessing.context import ForkServerProcess
from typing import Any

_context = multiprocessing.get_context("forkserver")
_context.set_forkserver_preload(["tests.warmed"])


def start(function: Callable[..., object], *given: Any) -> ForkServerProcess:
    """Call a function of a module in a fresh process; `exitcode` after `join` is minus the signal that ended it."""
    process = _context.Process(target=function, args=given)
    process.start()
    return process


def channel() -> tuple[Any, Any]:
    """Two connected ends; one of them may be given to a process."""
    return _context.Pipe()
