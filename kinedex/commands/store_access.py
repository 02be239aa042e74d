"""Open the version of a store that a command reads."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Literal

import typer

from kinedex.ops.errors import KinedexError

if TYPE_CHECKING:
    from kinedex.storage.store.store import Store


def open_for_reading(store: Path, at: str | None, files: Iterable[Path] = ()) -> Store:
    """Open the version of a store that `--at` names, or else the newest that has its index.

    If this is not the newest version, a line on standard error reports it.

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
    from kinedex.console.terminal import is_quiet
    from kinedex.storage.store.store import open_store

    _leave_pandas_out()
    opened = open_store(store, files, _version_of(at))
    shown, newest = opened.manifest.version, opened.newest_version
    if at is None and shown != newest and not is_quiet():
        typer.echo(
            f"version {shown} of {store} is shown, the newest with its index; version {newest} is the newest: --at "
            "newest shows it",
            err=True,
        )
    return opened


def _leave_pandas_out() -> None:
    """Prevent PyArrow from importing pandas, which it does on the first conversion of a list, if it is installed.

    That import takes as long as all others of a command. `to_pandas` of a table still imports it later.
    """
    if "pandas" in sys.modules:
        return
    import pyarrow as pa

    absent = _NoPandas()
    sys.meta_path.insert(0, absent)
    try:
        pa.array([])
    finally:
        sys.meta_path.remove(absent)


class _NoPandas:
    def find_spec(self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None) -> None:
        """Raise ModuleNotFoundError for pandas."""
        if fullname == "pandas":
            raise ModuleNotFoundError(name=fullname)


def _version_of(text: str | None) -> int | Literal["newest"] | None:
    if text is None or text.isdecimal():
        return None if text is None else int(text)
    if text != "newest":
        raise KinedexError(f"--at {text}: expected the number of a version, or newest")
    return "newest"
