"""Runs a program with a bound of seconds, beyond which it is ended with every process that it has started."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

LAST_LINES = 12
"""Lines of the output that are shown of a program that failed."""


class Ended(NamedTuple):
    """The end of a program: its exit code, None where it took too long, and what it printed."""

    code: int | None
    output: str

    def problem(self, first: str) -> str:
        """Return a problem in words, above the end of the output."""
        return "\n".join([first, *self.output.splitlines()[-LAST_LINES:]])


def run_bounded(words: Sequence[str], folder: Path, environment: Mapping[str, str], seconds: float) -> Ended:
    """Run a program to its end, or to the bound.

    Parameters
    ----------
    words : sequence of str
        The program and its arguments.
    folder : Path
        The folder that it runs in.
    environment : mapping of str to str
        Its environment variables.
    seconds : float
        The bound.

    Returns
    -------
    Ended
        The exit code and all that was printed.
    """
    process = subprocess.Popen(
        words, cwd=folder, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True, errors="replace", start_new_session=True,
    )  # fmt: skip
    try:
        output = process.communicate(timeout=seconds)[0]
        return Ended(process.returncode, output)
    except subprocess.TimeoutExpired:
        return Ended(None, "")
    finally:
        _end_session(process)


def _end_session(process: subprocess.Popen[str]) -> None:
    """End what is left of a program and of the processes that it has started, such as those below make or bash."""
    if os.name == "posix":
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    else:
        process.kill()
    process.wait(timeout=60)
    assert process.stdout is not None
    process.stdout.close()
