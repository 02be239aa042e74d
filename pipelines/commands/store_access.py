"""Opening of the version of a store that a command reads."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from kinedex.ops.errors import KinedexError

if TYPE_CHECKING:
    from kinedex.storage.store.store import Store


def open_for_reading(store: Path, at: str | None, files: Iterable[Path] = ()) -> Store:
    """Open the version of a store that `--at` names, or else the newest that has its index.

    A line on standard error reports where this is not the newest version.

    Parameters
    ----------
    store : Path
        Directory of the store.
    at : str or None
        Number of a version, or "newest".
    files : iterable of Path, optional
        Folders outside the store whose files SQL may read.

    Raises
    ------
    KinedexError
        There is no store or no such version, or the option holds no version.
    """
    from kinedex.pipelines.console.terminal import is_quiet
    from kinedex.storage.store.store import open_store

    opened = open_store(store, files, _version_of(at))
    shown, newest = opened.manifest.version, opened.newest_version
    if at is None and shown != newest and not is_quiet():
        typer.echo(
            f"version {shown} of {store} is shown, the newest with its index; version {newest} is the newest: --at "
            "newest shows it",
            err=True,
        )
    return opened


def _version_of(text: str | None) -> int | Literal["newest"] | None:
    if text is None or text.isdecimal():
        return None if text is None else int(text)
    if text != "newest":
        raise KinedexError(f"--at {text}: expected the number of a version, or newest")
    return "newest"
