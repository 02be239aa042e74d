"""Compute maps in separate processes, at low priority, and stop each process when no client waits for its map."""

from __future__ import annotations

import asyncio
import importlib.util
import multiprocessing
import os
import threading
from collections.abc import AsyncIterator
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from weakref import WeakKeyDictionary

from kinedex.explorer.open_archive import Archive
from kinedex.ops.cache import Cache
from kinedex.ops.errors import KinedexError
from kinedex.ops.maps.layout import PURPOSE
from kinedex.ops.packages import MissingPackageError, extra_package
from kinedex.pipelines.inspection.archive_map import ArchiveMap, Unit, archive_map
from kinedex.storage.store.store import Store, open_store

KEPT = 4
"""Maximum number of maps that are cached, with some 30 bytes a point."""

LOOK_SECONDS = 0.2

NICE = 5
"""The niceness of a process, so that other requests of the user run first."""

Key = tuple[str, Unit]
Step = tuple[int, int]


class MapRun:
    """The computation of a map in a separate process.

    Attributes
    ----------
    step : (int, int)
        Steps done, and steps in all; both 0 until the first is reported.
    result : ArchiveMap or None
        The map, once it is computed.
    fault : KinedexError or None
        The reason why there is no map.
    waiting : int
        The number of requests that wait for the map.
    reader : threading.Thread
        The thread that receives the reports. It alone waits for the process: of two threads that wait for one process,
        the system tells only one how it ended, and the other may believe for a moment that it still runs.
    """

    def __init__(self, store: Store, unit: Unit) -> None:
        self.step: Step = (0, 0)
        self.result: ArchiveMap | None = None
        self.fault: KinedexError | None = None
        self.waiting = 0
        self.stopped = False
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe(duplex=False)
        arguments = (theirs, store.path, store.manifest.version, unit)
        self._process = context.Process(target=_compute, args=arguments, name="kinedex-map", daemon=True)
        self._process.start()
        theirs.close()
        self.reader = threading.Thread(target=self._read, name="map", daemon=True)
        self.reader.start()

    @property
    def done(self) -> bool:
        """True once there is a result or a fault."""
        return self.result is not None or self.fault is not None

    def stop(self) -> None:
        """End the process, when no client waits for the map any longer."""
        self.stopped = True
        self._process.terminate()

    def _read(self) -> None:
        """Receive the reports of the process until it ends."""
        with suppress(EOFError, OSError):
            while not self.done:
                found = self._pipe.recv()
                if isinstance(found, ArchiveMap):
                    self.result = found
                elif isinstance(found, KinedexError):
                    self.fault = found
                else:
                    self.step = found
        self._process.join()
        if not self.done:
            self.fault = KinedexError(
                f"the process that computes the map ended without a result (exit code {self._process.exitcode}); "
                "the log of `kinedex explore` may show why, and memory may have run out"
            )
        self._pipe.close()


def _compute(pipe: Connection, path: Path, version: int, unit: Unit) -> None:
    """Compute a map, and send its progress and the map, or the error that has prevented it."""
    if hasattr(os, "nice"):
        os.nice(NICE)
    try:
        # one thread, to leave the other cores free and to add in a fixed order
        with extra_package("threadpoolctl", "scikit-learn", PURPOSE, "map").threadpool_limits(1):
            pipe.send(archive_map(open_store(path, at=version), unit, lambda done, total: pipe.send((done, total))))
    except KinedexError as fault:
        pipe.send(KinedexError(str(fault)))  # some subclasses cannot be unpickled
    except BrokenPipeError:  # the server is gone
        pass


class Maps:
    """The cached maps of an explorer, and the maps that are being computed; used on one event loop."""

    def __init__(self) -> None:
        self._kept: Cache[Key, ArchiveMap] = Cache(KEPT)
        self._running: dict[Key, MapRun] = {}

    async def find(self, store: Store, unit: Unit) -> AsyncIterator[Step | ArchiveMap]:
        """Yield the steps of a computation when they are done, and finally the map.

        A map is cached by the content of the takes, so that versions that differ in results alone share it. A
        computation is stopped when all iterators have been closed.

        Parameters
        ----------
        store : Store
            The store.
        unit : {"takes", "windows"}
            The unit that a point represents.

        Raises
        ------
        KinedexError
            There is no map; the message has the reason.
        """
        key = (store.manifest.content or str(store.manifest.version), unit)
        kept = self._kept.get(key)
        if kept is not None:
            yield kept
            return
        run = self._running.get(key)
        if run is None or run.stopped:
            run = self._running[key] = MapRun(store, unit)
        run.waiting += 1
        try:
            seen: Step | None = None
            while not run.done:
                if run.step != seen:
                    seen = run.step
                    yield seen
                await asyncio.sleep(LOOK_SECONDS)
        finally:
            run.waiting -= 1
            if run.waiting == 0:
                if not run.done:
                    run.stop()
                if self._running.get(key) is run:
                    del self._running[key]
        if run.fault is not None:
            raise run.fault
        assert run.result is not None
        yield self._kept.put(key, run.result)


def require_extra() -> None:
    """Raise a MissingPackageError if scikit-learn is not installed, without importing it."""
    if importlib.util.find_spec("sklearn") is None:
        extra_package("sklearn", "scikit-learn", PURPOSE, "map")
        raise MissingPackageError  # not reached: the import has failed


_MAPS: WeakKeyDictionary[Archive, Maps] = WeakKeyDictionary()


def maps_of(archive: Archive) -> Maps:
    """Return the `Maps` of the server of an archive; they are created on the first call."""
    return _MAPS.setdefault(archive, Maps())
