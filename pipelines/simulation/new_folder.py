"""Write folders of recordings such that they appear only when all of their files are written."""

from __future__ import annotations

import itertools
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from kinedex.ops.errors import KinedexError
from kinedex.storage.disk import TEMPORARY


@contextmanager
def new_folder(folder: Path) -> Iterator[Path]:
    """Write a folder completely or not at all.

    Parameters
    ----------
    folder : Path
        A folder that does not exist, or is empty.

    Yields
    ------
    Path
        A temporary folder to write to, which is renamed when the block ends, and removed if the block fails.

    Raises
    ------
    KinedexError
        The folder cannot be written.
    """
    unfinished = folder.absolute().parent / f"{TEMPORARY}{uuid.uuid4().hex}"
    try:
        unfinished.mkdir(parents=True)
        yield unfinished
        if folder.is_dir():
            folder.rmdir()
        os.replace(unfinished, folder)
    except OSError as fault:
        raise KinedexError(f"{folder}: cannot be written: {fault.strerror}; nothing was written") from None
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def require_new(folder: Path) -> None:
    """Raise an error if a folder contains files.

    Raises
    ------
    KinedexError
        The path is a folder with files, or not a folder.
    """
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise KinedexError(f"{folder}: is no folder; give a new one with -o")
    if folder.is_dir() and any(folder.iterdir()):
        raise KinedexError(
            f"{folder}: is not empty, and recordings are never overwritten; give a new folder, such as "
            f"-o {_free_name(folder)}"
        )


def _free_name(folder: Path) -> Path:
    """Return the first of `NAME-2`, `NAME-3`, … that does not exist beside a folder."""
    absolute = folder.absolute()
    numbers = (number for number in itertools.count(2) if not absolute.with_name(f"{absolute.name}-{number}").exists())
    return folder.parent / f"{absolute.name}-{next(numbers)}"
