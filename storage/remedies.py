"""Remedies of the errors and findings of a store: commands that can be run as they are."""

from __future__ import annotations

import shlex
from pathlib import Path

from kinedex.ops.errors import Remedy


def repair(store: str | Path) -> Remedy:
    """Return the remedy of damage: `kinedex repair`, which makes again what can be made again."""
    return _repair(store, "repairs it")


def build_index(store: str | Path) -> Remedy:
    """Return the remedy of an index that is missing, stale or damaged, which `kinedex repair` builds again."""
    return _repair(store, "builds it again")


def _repair(store: str | Path, effect: str) -> Remedy:
    command = ("kinedex", "repair", str(store))
    return Remedy(f"`{shlex.join(command)}` {effect}", command)


def upgrade(store: str | Path) -> Remedy:
    """Return the remedy of an older format: `kinedex upgrade`, which converts the store."""
    command = ("kinedex", "upgrade", str(store))
    return Remedy(f"`{shlex.join(command)}` converts it and keeps takes, results and index", command)


def upgrade_with_damage(store: str | Path) -> Remedy:
    """Return the remedy of damage in a store of an older format, which `kinedex repair` cannot write."""
    command = ("kinedex", "upgrade", str(store), "--keep-damaged")
    return Remedy(f"`{shlex.join(command)}` converts the store, and `kinedex repair` then repairs it", command)
