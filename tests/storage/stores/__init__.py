"""A small store of each format that a release, or a version before the first one, has written."""

from __future__ import annotations

import tarfile
from pathlib import Path


def unpacked(number: int, folder: Path) -> Path:
    """Unpack the store of a format into a folder, and return its path."""
    with tarfile.open(Path(__file__).with_name(f"format-{number}.tar.xz")) as packed:
        packed.extractall(folder, filter="data")
    return folder / "store"
