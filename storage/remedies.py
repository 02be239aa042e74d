"""Remedies of the errors and findings of a store: commands that can be run as they are."""

from __future__ import annotations

import shlex
from pathlib import Path

from kinedex.ops.errors import Remedy


def repair(store: str | Path) -> Remedy:
    """Return the remedy of damage: `kinedex repair`, which makes again what can be made again."""
    command = ("kinedex", "repair", str(store))
    return Remedy(f"`{shlex.join(command)}` repairs it", command)
