"""Record the provenance of a store's files: the command and the version of kinedex that made them."""

from __future__ import annotations

import shlex
import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

LONGEST = 1000
"""The largest number of characters of a recorded command."""


def running_command() -> str:
    """Return the command line of this process as it would be typed, such as "kinedex ingest STORE DIR".

    The option --log-file is left out: it does not affect results, and the explorer adds it to its commands.
    """
    program, *arguments = sys.argv or [""]
    if "--log-file" in arguments:
        place = arguments.index("--log-file")
        del arguments[place : place + 2]
    path = Path(program)
    name = path.parent.name if path.name == "__main__.py" else path.name
    # a program passed to Python as text has no name
    program_words = [name] if name and not name.startswith("-") else ["python", *filter(None, [name])]
    text = shlex.join([*program_words, *arguments])
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…"


@cache
def kinedex_version() -> str:
    """Return the version of the installed kinedex; "unknown" for a source tree that is not installed."""
    try:
        return version("kinedex")
    except PackageNotFoundError:
        return "unknown"
