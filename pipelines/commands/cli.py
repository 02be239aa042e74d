"""The command line: `kinedex COMMAND`."""

from __future__ import annotations

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
    """Run the console command `kinedex`."""
    app(prog_name="kinedex")  # whichever file started it


if __name__ == "__main__":
    main()
