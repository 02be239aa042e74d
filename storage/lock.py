"""The lock that keeps two writers of one store apart, and says who holds it."""

from __future__ import annotations

import fcntl
import json
import os
import socket
import sys
import time
import weakref
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from kinedex.ops.errors import StoreError
from kinedex.storage.disk import write_errors
from kinedex.storage.snapshot.manifest import now

_POLL_SECONDS = 0.1


class Lock:
    """An exclusive lock on a file, held until `release` or the end of the process, however it ends.

    The operating system drops it with the process, so a lock left behind by a killed one is no obstacle.

    Parameters
    ----------
    path: the lock's file. purpose: what must wait where another process holds it, for the message.
    wait_seconds: how long to wait for that process to finish before the StoreError that names it.
    """

    def __init__(self, path: Path, purpose: str, wait_seconds: float = 0.0) -> None:
        self.path = path
        with write_errors(path):
            self._file = open(path, "a+", encoding="utf-8")  # noqa: SIM115 (held beyond this function)
        deadline = time.monotonic() + wait_seconds
        while not self._taken():
            if time.monotonic() >= deadline:
                self._file.seek(0)
                holder = self._file.read(4096)
                self._file.close()
                raise StoreError(f"{path.parent} is being written by {_who(holder)}; {purpose} must wait")
            time.sleep(_POLL_SECONDS)
        me = {
            "pid": os.getpid(),
            "host": socket.gethostname(),
            "started": now(),
            "command": " ".join(sys.argv)[:500],
        }
        # on a full disk the lock holds all the same, without a name: `kinedex gc` must be able to make room
        with suppress(OSError):
            self._file.seek(0)
            self._file.truncate()
            self._file.write(json.dumps(me))
            self._file.flush()
        _held.add(self)

    def _taken(self) -> bool:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError as fault:
            self._file.close()
            raise StoreError(f"{self.path}: this file system does not lock files ({fault.strerror})") from None
        return True

    def release(self) -> None:
        """Let the next writer in; more than once does no harm."""
        if not self._file.closed:
            _held.discard(self)
            fcntl.flock(self._file, fcntl.LOCK_UN)
            with suppress(OSError):
                self._file.close()

    def __enter__(self) -> Lock:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()


_held: weakref.WeakSet[Lock] = weakref.WeakSet()


def _who(holder: str) -> str:
    try:
        found = json.loads(holder)
        return f"process {found['pid']} on {found['host']} (since {found['started']}, command: {found['command']})"
    except (ValueError, KeyError, TypeError):
        return "another process"


def _let_go_in_child() -> None:
    """A forked child must not keep the lock of a killed parent alive; closing its copy leaves the parent's locked."""
    for lock in list(_held):
        lock._file.close()


os.register_at_fork(after_in_child=_let_go_in_child)
