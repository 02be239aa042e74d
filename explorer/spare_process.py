"""Start and use a spare process, which has imported the modules for learning and waits for a command."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

PROGRAM = "kinedex.explorer.waiting_command"
"""The module that the process runs."""


class SpareProcess:
    """The server's handle of a process that waits for a command.

    Parameters
    ----------
    options : mapping, optional
        Further arguments of `subprocess.Popen`.
    """

    def __init__(self, **options: Any) -> None:
        words = [sys.executable, "-m", PROGRAM]
        null = subprocess.DEVNULL
        self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=null, stderr=null, **options)

    @property
    def waits(self) -> bool:
        """True if it can be given a command."""
        return self._process.poll() is None

    def run(self, words: Sequence[str], log: Path) -> subprocess.Popen[bytes] | None:
        """Run a command of `kinedex`, whose output is appended to a file; None if the process has ended meanwhile."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps({"words": list(words), "log": str(log.absolute())}).encode() + b"\n")
            self._process.stdin.close()
        except OSError:
            return None
        return self._process

    def end(self) -> None:
        """Close the input of the process, which then ends."""
        assert self._process.stdin is not None
        with suppress(OSError):
            self._process.stdin.close()
        try:
            self._process.wait(1.0)
        except subprocess.TimeoutExpired:  # it is still importing
            self._process.kill()
            self._process.wait()
