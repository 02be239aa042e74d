"""Load the functions that draw the pages of stages by name, and write these pages, each whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from kinedex.ops.errors import KinedexError
from kinedex.storage.durable_files import replace_file


def write_page(page: str, path: Path) -> int:
    """Write a page under a temporary name and rename it.

    Parameters
    ----------
    page : str
        Content of the file.
    path : Path
        The file; its folder must exist.

    Returns
    -------
    int
        Size in bytes.

    Raises
    ------
    KinedexError
        If the folder does not exist.
    """
    if not path.parent.is_dir():
        raise KinedexError(
            f"{path}: the folder {path.parent} does not exist; create it (mkdir -p {path.parent}) or name another"
        )
    content = page.encode("utf-8")
    replace_file(path, lambda unfinished: unfinished.write_bytes(content))
    return len(content)


def drawn_by(place: str) -> Callable[..., Any]:
    """Return the function that a text "module:name" names.

    The code digest of a stage follows such texts, and thus covers functions that the stage does not import.
    """
    found: Callable[..., Any] = resolve_name(place)
    return found
