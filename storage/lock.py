"""Lock a store so that it has one writer at a time, and name the holder of the lock."""

from __future__ import annotations

import json
import os
import socket
import sys
import time
import weakref
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType

from filelock import lock_descriptor, unlock_descriptor

from kinedex.ops.errors import Remedy, StoreError
from kinedex.storage.durable_files import write_errors

_POLL_SECONDS = 0.1

_NAMED_SECONDS = 0.5
"""The seconds within which a process writes its name after getting a lock, unless the disk is full."""

REPORT_SECONDS = 30.0
"""The seconds between two reports in which a waiting process names the holder of the lock."""


@dataclass(frozen=True)
class Wait:
    """The time that a writer waits while another one is active.

    Attributes
    ----------
    seconds : float
        The longest time to wait; 0 fails at once.
    report : callable, optional
        Shows a line of text that names the process waited for, at once and then every `REPORT_SECONDS`.
    option : str, optional
        The option or argument that makes the user's command wait longer, for the error message.
    """

    seconds: float = 0.0
    report: Callable[[str], object] | None = None
    option: str = ""


NO_WAIT = Wait()


class Lock:
    """An exclusive lock on a file, held until `release` or the end of the process, even if it is killed.

    The operating system releases the lock with the process, so the lock file of a killed process is no obstacle. The
    file holds a JSON object with process, host, time and command of the last holder.

    Parameters
    ----------
    path : Path
        The lock's file; it is created if it is missing, and never removed.
    purpose : str
        The work that must wait while another process holds the lock, for the message.
    wait : Wait, optional
        The time to wait for that process to finish.

    Raises
    ------
    StoreError
        Another process holds the lock (the message names it), or the file system has no locks.
    """

    def __init__(self, path: Path, purpose: str, wait: Wait = NO_WAIT) -> None:
        self.path = path
        with write_errors(path):
            self._file = open(path, "a+b", buffering=0)  # noqa: SIM115 (held beyond this function)
        try:
            if not self._try_lock():
                self._wait(purpose, wait)
        except BaseException:
            self._file.close()
            raise
        self._write_holder()
        _held.add(self)

    def _wait(self, purpose: str, wait: Wait) -> None:
        """Try again until the lock is free or the waiting time has passed."""
        began = time.monotonic()
        reports = 0
        while not self._try_lock():
            waited = time.monotonic() - began
            if waited >= wait.seconds:
                raise StoreError(
                    f"{self.path.parent} is being written by {self._holder()}; {purpose} must wait",
                    remedy=Remedy(f"`{wait.option}` waits for it") if wait.option else None,
                )
            if wait.report is not None and waited >= reports * REPORT_SECONDS:
                reports += 1
                wait.report(
                    f"waiting for {self._holder()}, which writes {self.path.parent}: {waited:.0f} s of at most "
                    f"{wait.seconds:.0f} s"
                )
            time.sleep(min(_POLL_SECONDS, wait.seconds))

    def _try_lock(self) -> bool:
        try:
            return lock_descriptor(self._file.fileno(), blocking=False)
        except OSError as fault:
            raise StoreError(f"{self.path}: this file system does not lock files ({fault.strerror})") from None

    def _write_holder(self) -> None:
        """Write the holder into the lock file; on a full disk write nothing, so that `kinedex gc` can free space."""
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
        """Describe the process that holds the lock; wait briefly if the process has not yet written its name."""
        deadline = time.monotonic() + _NAMED_SECONDS
        while (name := self._read_holder()) is None and time.monotonic() < deadline:
            time.sleep(_POLL_SECONDS / 10)
        return name or "another process"

    def _read_holder(self) -> str | None:
        """Return the process that the lock file names; None if the file names no process, or one that has ended."""
        try:
            # Windows does not let others read the locked byte: the first one, which is the brace of the JSON object
            self._file.seek(1)
            found = json.loads(b"{" + (self._file.read(4096) or b""))
            if found["host"] == socket.gethostname() and not _runs(int(found["pid"])):
                return None
            return f"process {found['pid']} on {found['host']} (since {found['started']}, command: {found['command']})"
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def release(self) -> None:
        """Release the lock; a second call does nothing."""
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


def _runs(pid: int) -> bool:
    """Return whether a process of this host runs; True if the system does not report it."""
    if os.name == "nt":
        return True  # Windows: a signal would end the process
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        pass
    return True


_held: weakref.WeakSet[Lock] = weakref.WeakSet()


def _close_in_child() -> None:
    """Close a forked child's copies of locked files, which would keep the locks of a killed parent."""
    for lock in list(_held):
        lock._file.close()


if hasattr(os, "register_at_fork"):  # systems without fork do not need this
    os.register_at_fork(after_in_child=_close_in_child)
