"""Processes that have loaded everything and have no threads, so that they can be forked within milliseconds."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import pickle
import pkgutil
import select
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import Any

from numba.core.dispatcher import Dispatcher

import kinedex

ANSWER_SECONDS = 400.0
"""A forked child that takes longer than this is ended."""

Kernel = tuple[str, str]
"""The name of a module, and that of a compiled function in it."""


class Workers:
    """Warm processes that answer cases, as many at a time as there are jobs, until the end of a `with` block."""

    def __init__(self, jobs: int) -> None:
        self._processes: dict[Connection, Any] = {}
        for _ in range(jobs):
            ours, theirs = multiprocessing.get_context("spawn").Pipe()
            self._processes[ours] = multiprocessing.get_context("spawn").Process(target=_serve, args=(theirs,))
            self._processes[ours].start()
            theirs.close()

    def each(
        self, function: Callable[..., Any], cases: Sequence[tuple[Any, str, *tuple[Any, ...]]]
    ) -> Iterator[tuple[str, Any]]:
        """Yield the second value of each case, which names it, and what the function returns of the case."""
        left, busy = list(reversed(cases)), dict[Connection, Any]()
        for pipe in self._processes:
            if left:
                busy[pipe] = left.pop()
                pipe.send((function, busy[pipe]))
        while busy:
            ready = wait(list(busy), timeout=3 * ANSWER_SECONDS)
            if not ready:
                raise TimeoutError(f"no answer about {[case[1] for case in busy.values()]}")
            for pipe in ready:
                assert isinstance(pipe, Connection)
                case = busy.pop(pipe)
                yield case[1], pipe.recv()
                if left:
                    busy[pipe] = left.pop()
                    pipe.send((function, busy[pipe]))

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        for pipe, process in self._processes.items():
            pipe.close()
            process.kill()
            process.join()


def _serve(pipe: Connection) -> None:
    _load_everything()
    with suppress(EOFError):
        while True:
            function, case = pipe.recv()
            pipe.send(function(*case))


def _load_everything() -> None:
    """Import all modules, and read the code of all stages, whose digests are remembered."""
    for module in pkgutil.walk_packages(kinedex.__path__, "kinedex."):
        importlib.import_module(module.name)
    import tests.warmed
    from kinedex.pipelines.engine.code_digest import code_digest
    from kinedex.pipelines.engine.stage import STAGES, load_stage
    from kinedex.pipelines.keyframes.query_learning import _code

    assert tests.warmed
    for name in STAGES:
        code_digest(type(load_stage(name)))
    _code()


def asked(function: Callable[[], Any]) -> Any:
    """Return what a function returns in a forked child; the traceback, as a string, where it fails."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        _answer(function, writer)
    os.close(writer)
    received, deadline = b"", time.monotonic() + ANSWER_SECONDS
    while select.select([reader], [], [], max(0.0, deadline - time.monotonic()))[0]:
        piece = os.read(reader, 1 << 16)
        if not piece:
            break
        received += piece
    os.close(reader)
    with suppress(ProcessLookupError):
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    try:
        return pickle.loads(received)
    except (EOFError, pickle.UnpicklingError):
        return f"no answer within {ANSWER_SECONDS:g} s (ended with {os.waitstatus_to_exitcode(status)})"


def _answer(function: Callable[[], Any], writer: int) -> None:
    try:
        nowhere = os.open(os.devnull, os.O_RDWR)
        for descriptor in (0, 1, 2):
            os.dup2(nowhere, descriptor)
        answer: object = function()
    except BaseException:
        answer = traceback.format_exc()
    with open(writer, "wb", closefd=False) as pipe:
        pickle.dump(answer, pipe)
    os._exit(0)


def compiled() -> list[tuple[Kernel, list[Any]]]:
    """Return the kernels that this process has compiled or loaded, with their signatures."""
    return [(key, list(kernel.signatures)) for key, kernel in _kernels().items() if kernel.signatures]


def load_kernels(kernels: list[tuple[Kernel, list[Any]]]) -> None:
    """Load kernels from numba's cache, so that children need not."""
    known = _kernels()
    for key, signatures in kernels:
        for signature in signatures:
            known[key].compile(signature)


def _kernels() -> dict[Kernel, Dispatcher]:
    modules = [module for name, module in list(sys.modules.items()) if name.startswith("kinedex.")]
    return {
        (module.__name__, name): value
        for module in modules
        for name, value in vars(module).items()
        if isinstance(value, Dispatcher)
    }
