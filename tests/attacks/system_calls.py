"""A child process whose writing system calls are watched, so that it can be killed before any of them.

The child installs a seccomp filter that reports every call that changes files, from all of its threads, and waits
until this process lets the call through; Arrow's and DuckDB's writes are seen as well as Python's. Linux on x86-64.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import platform
import select
import signal
import socket
import struct
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

_ON_PATH = {
    "open": 2, "creat": 85, "truncate": 76, "rename": 82, "mkdir": 83, "rmdir": 84, "link": 86, "unlink": 87,
    "openat": 257, "mkdirat": 258, "unlinkat": 263, "renameat": 264, "linkat": 265, "renameat2": 316,
}  # fmt: skip
_ON_DESCRIPTOR = {
    "write": 1, "pwrite64": 18, "writev": 20, "pwritev": 296, "fsync": 74, "fdatasync": 75, "ftruncate": 77,
    "fallocate": 285, "sendfile": 40, "copy_file_range": 326,
}  # fmt: skip
_NAMES = {number: name for name, number in (_ON_PATH | _ON_DESCRIPTOR).items()}
_FLAGS = {"open": 1, "openat": 2}
"""The argument of these calls that tells whether they write."""
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
_LAST_PATH = {"rename": (None, 1), "link": (None, 1), "renameat": (2, 3), "renameat2": (2, 3), "linkat": (2, 3)}
"""The arguments of these calls that name the new place: folder and path."""

_X86_64 = 0xC000003E
_ALLOW, _NOTIFY = 0x7FFF0000, 0x7FC00000
_RECEIVE, _SEND = 0xC0502100, 0xC0182101
_CONTINUE = 1
_NOTICE, _ANSWER = struct.Struct("=QIIiIQ6Q"), struct.Struct("=QqiI")


LONGEST_SECONDS = 120
"""A child that changes no file for this long is killed."""


@dataclass(frozen=True)
class Call:
    """A system call that changes a file: its name, and the file; of a rename, the new place."""

    name: str
    path: str


def available() -> bool:
    """Return whether calls can be watched here."""
    return sys.platform == "linux" and platform.machine() == "x86_64"


def watched(function: Callable[[], object], root: str, allow: Callable[[Call], bool]) -> int:
    """Run a function in a forked child, and ask before each of its calls that changes a file below a folder.

    Parameters
    ----------
    function : callable
        The child's work; its output is dropped.
    root : str
        The folder, an absolute path without links.
    allow : callable
        Is given each call before it happens; where it returns False, the child is killed at once instead.

    Returns
    -------
    int
        The exit code of the child: 0, 1 after an exception, or minus the signal that ended it.
    """
    ours, theirs = socket.socketpair()
    child = os.fork()
    if child == 0:
        ours.close()
        _be_watched(function, theirs)
    theirs.close()
    try:
        _, descriptors, _, _ = socket.recv_fds(ours, 1, 1)
        if descriptors:
            _answer(child, descriptors[0], root, allow)
    finally:
        ours.close()
        with suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)  # does nothing to one that has ended
        _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status)


def _be_watched(function: Callable[[], object], channel: socket.socket) -> None:
    """Install the filter, hand its listener over, and do the work; never return."""
    code = 1
    try:
        listener = _install()
        socket.send_fds(channel, [b"x"], [listener])
        os.close(listener)
        channel.close()
        nowhere = os.open(os.devnull, os.O_RDWR)
        for descriptor in (0, 1, 2):
            os.dup2(nowhere, descriptor)
        function()
        code = 0
    finally:
        os._exit(code)


def _install() -> int:
    """Install the filter in this process; return the descriptor that its notices come from."""

    def load(offset: int) -> bytes:
        return struct.pack("HBBI", 0x20, 0, 0, offset)

    def give(action: int) -> bytes:
        return struct.pack("HBBI", 0x06, 0, 0, action)

    def unless(number: int, skip: int) -> bytes:
        return struct.pack("HBBI", 0x15, 0, skip, number)

    program = [load(4), unless(_X86_64, 1), struct.pack("HBBI", 0x05, 0, 0, 1), give(_ALLOW), load(0)]
    for name, number in (_ON_PATH | _ON_DESCRIPTOR).items():
        if name in _FLAGS:
            writes = struct.pack("HBBI", 0x45, 0, 1, _WRITES)
            program += [unless(number, 4), load(16 + 8 * _FLAGS[name]), writes, give(_NOTIFY), give(_ALLOW)]
        else:
            program += [unless(number, 1), give(_NOTIFY)]
    program += [give(_ALLOW)]
    code = b"".join(program)
    buffer = ctypes.create_string_buffer(code, len(code))

    class Program(ctypes.Structure):
        _fields_ = [("length", ctypes.c_ushort), ("filter", ctypes.c_void_p)]

    libc = ctypes.CDLL(None, use_errno=True)
    filters = Program(len(code) // 8, ctypes.cast(buffer, ctypes.c_void_p))
    if libc.prctl(38, 1, 0, 0, 0):  # PR_SET_NO_NEW_PRIVS
        raise OSError(ctypes.get_errno(), "prctl")
    listener: int = libc.syscall(317, 1, 8, ctypes.byref(filters))  # SECCOMP_SET_MODE_FILTER, with a new listener
    if listener < 0:
        raise OSError(ctypes.get_errno(), "seccomp")
    return listener


def _answer(child: int, listener: int, root: str, allow: Callable[[Call], bool]) -> None:
    """Let the calls of the child through, one by one, until it ends or is killed."""
    poll = select.poll()
    poll.register(listener, select.POLLIN)
    try:
        while True:
            events = poll.poll(1000 * LONGEST_SECONDS)
            if not events or not events[0][1] & select.POLLIN:
                return  # it has ended, or does nothing any more, and is killed
            notice = bytearray(_NOTICE.size)
            try:
                fcntl.ioctl(listener, _RECEIVE, notice)
            except OSError:
                continue  # the child, or its thread, has ended meanwhile
            number, thread, _, called, _, _, *given = _NOTICE.unpack(notice)
            call = _call(thread, _NAMES[called], given)
            if call is not None and (call.path + "/").startswith(root + "/") and not allow(call):
                os.kill(child, signal.SIGKILL)
                return
            with suppress(OSError):
                fcntl.ioctl(listener, _SEND, _ANSWER.pack(number, 0, 0, _CONTINUE))
    finally:
        os.close(listener)


def _call(thread: int, name: str, given: list[int]) -> Call | None:
    try:
        if name in _ON_DESCRIPTOR:
            descriptor = given[2 if name == "copy_file_range" else 0]
            return Call(name, os.readlink(f"/proc/{thread}/fd/{descriptor}").removesuffix(" (deleted)"))
        if name in _LAST_PATH:
            folder, at = _LAST_PATH[name]
        elif name.endswith("at"):
            folder, at = 0, 1
        else:
            folder, at = None, 0
        path = os.fsdecode(_text(thread, given[at]))
        if not path.startswith("/"):
            descriptor = None if folder is None else struct.unpack("i", struct.pack("I", given[folder] & 0xFFFFFFFF))[0]
            place = "cwd" if descriptor in (None, -100) else f"fd/{descriptor}"
            path = os.path.join(os.readlink(f"/proc/{thread}/{place}"), path)
        return Call(name, os.path.normpath(path))
    except OSError:
        return None


def _text(process: int, address: int) -> bytes:
    """Read a string of another process."""
    with open(f"/proc/{process}/mem", "rb", buffering=0) as memory:
        found = b""
        while b"\0" not in found:
            memory.seek(address + len(found))
            found += memory.read(256 - (address + len(found)) % 256)
    return found.partition(b"\0")[0]
