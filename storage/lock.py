"""The lock that keeps two writers of one store apart and names its holder."""

from __future__ import annotations

import json
import os
import socket
import sys
import time
import weakref
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType

from filelock import lock_descriptor, unlock_descriptor

from kinedex.ops.errors import StoreError
from kinedex.storage.disk import write_errors

_POLL_SECONDS = 0.1


class Lock:
    """An exclusive lock on a file, held until `release` or the end of the process, however it ends.

    The operating system drops the lock with the process, so the lock file of a killed one is no obstacle. The file
    holds a JSON object with process, host, time and command of the last holder.

    Parameters
    ----------
    path : Path
        The lock's file; it is made where it is missing, and never removed.
    purpose : str
        The work that must wait while another process holds the lock, for the message.
    wait_seconds : float, optional
        Time to wait for that process to finish.

    Raises
    ------
    StoreError
        Another process holds the lock (the message names it), or the file system has no locks.
    """

    def __init__(self, path: Path, purpose: str, wait_seconds: float = 0.0) -> None:
        self.path = path
        with write_errors(path):
            self._file = open(path, "a+b", buffering=0)  # noqa: SIM115 (held beyond this function)
        deadline = time.monotonic() + wait_seconds
        while not self._try_lock():
            if time.monotonic() >= deadline:
                holder = self._holder()
                self._file.close()
                raise StoreError(f"{path.parent} is being written by {holder}; {purpose} must wait")
            time.sleep(_POLL_SECONDS)
        self._write_holder()
        _held.add(self)

    def _try_lock(self) -> bool:
        try:
            return lock_descriptor(self._file.fileno(), blocking=False)
        except OSError as fault:
            self._file.close()
            raise StoreError(f"{self.path}: this file system does not lock files ({fault.strerror})") from None

    def _write_holder(self) -> None:
        """Write who holds the lock; on a full disk it holds without a name, so that `kinedex gc` can make room."""
        holder = {
            "pid": os.getpid(),
            "host": socket.gethostname(),
            "started": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
            "command": " ".join(sys.argv)[:500],
        }
        with suppress(OSError):
            self._file.truncate(0)
            self._file.write(json.dumps(holder).encode())

    def _holder(self) -> str:
        """Describe the process that holds the lock."""
        try:
            # Windows lets nobody else read the locked byte, which is the first one: the brace of the JSON object
            self._file.seek(1)
            found = json.loads(b"{" + (self._file.read(4096) or b""))
            return f"process {found['pid']} on {found['host']} (since {found['started']}, command: {found['command']})"
        except (OSError, ValueError, KeyError, TypeError):
            return "another process"

    def release(self) -> None:
        """Let the next writer in; a second call does nothing."""
        if not self._file.closed:
            _held.discard(self)
            unlock_descriptor(self._file.fileno())
            with suppress(OSError):
                self._file.close()

    def __enter__(self) -> Lock:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()


_held: weakref.WeakSet[Lock] = weakref.WeakSet()


def _close_in_child() -> None:
    """Close the copies of a forked child, which would keep the lock of a killed parent; the parent's stays locked."""
    for lock in list(_held):
        lock._file.close()


if hasattr(os, "register_at_fork"):  # systems without fork need nothing of this
    os.register_at_fork(after_in_child=_close_in_child)
