"""State remedies for errors and findings of a store, as commands that can be run unchanged."""

from __future__ import annotations

import shlex
from pathlib import Path

from kinedex.ops.errors import Remedy


def repair(store: str | Path) -> Remedy:
    """Return the remedy for damage: `kinedex repair`, which restores what can be restored."""
    return _repair(store, "repairs it")


def build_index(store: str | Path) -> Remedy:
    """Return the remedy for a missing, outdated or damaged index, which `kinedex repair` rebuilds."""
    return _repair(store, "builds it again")


def _repair(store: str | Path, effect: str) -> Remedy:
    command = ("kinedex", "repair", str(store))
    return Remedy(f"`{shlex.join(command)}` {effect}", command)


def upgrade(store: str | Path) -> Remedy:
    """Return the remedy for a store of an older format: `kinedex upgrade`, which converts it."""
    command = ("kinedex", "upgrade", str(store))
    return Remedy(f"`{shlex.join(command)}` converts it and keeps takes, results and index", command)


def upgrade_with_damage(store: str | Path) -> Remedy:
    """Return the remedy for damage in a store of an older format, which `kinedex repair` cannot write."""
    command = ("kinedex", "upgrade", str(store), "--keep-damaged")
    return Remedy(f"`{shlex.join(command)}` converts the store, and `kinedex repair` then repairs it", command)
