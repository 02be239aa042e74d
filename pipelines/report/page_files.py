"""Puts a report where it belongs: whole, or not at all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from kinedex.ops.errors import KinedexError


def write_page(page: str, path: Path) -> int:
    """Write a page under a temporary name, then rename it into place.

    Returns
    -------
    Its size in bytes.

    Raises
    ------
    KinedexError: the folder is not there.
    """
    if not path.parent.is_dir():
        raise KinedexError(
            f"{path}: there is no folder {path.parent}; make it (mkdir -p {path.parent}) or name another"
        )
    content = page.encode("utf-8")
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    return len(content)
