"""The command line: `kinedex COMMAND`."""

from __future__ import annotations

import sys
from io import TextIOWrapper

# Importing a module registers its commands, in the order of the help. They import what they need when they run.
from kinedex.pipelines.commands import (  # noqa: F401
    keyframes,
    labels,
    maintenance,
    pipelines,
    queries,
    ranking,
    reports,
    tables,
    templates,
)
from kinedex.pipelines.commands.app import app

__all__ = ["app", "main"]


def main() -> None:
    """Run the console command `kinedex`; its output is UTF-8, on Windows too."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper) and stream.encoding.lower() not in ("utf-8", "utf8"):
            stream.reconfigure(encoding="utf-8")
    app(prog_name="kinedex")  # whichever file started it


if __name__ == "__main__":
    main()
