"""Choose the takes that are simulated, and write the folder of their recordings completely or not at all."""

from __future__ import annotations

import itertools
import os
import re
import shutil
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from kinedex.ops.arrays import F64
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.display import Progress
from kinedex.storage.durable_files import TEMPORARY
from kinedex.storage.formats.labels.formats import file_names
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store

RECORDINGS, TRUTH = "recordings.yaml", "truth"
"""The file that lists the recordings of a folder, and the folder of their true motion."""

_FORBIDDEN = re.compile(r"[^\w.+-]")
_MAX_LETTERS = 90


def chosen_takes(store: Store, takes: Sequence[str], where: str | None) -> list[str]:
    """Return the names of the takes that are named or selected, in the store's order.

    Parameters
    ----------
    store : Store
        The store.
    takes : sequence of str
        Names of takes.
    where : str or None
        SQL filter over the columns of takes, which selects further ones.

    Raises
    ------
    KinedexError
        There is no such take, or nothing is selected.
    """
    for name in takes:
        store.take_id(name)
    selected = set(store.takes_table(where)["name"].to_pylist()) if where is not None else set()
    if where is not None and not selected:
        raise KinedexError(f"the filter `{where}` selects no take of {store.path}")
    if not takes and where is None:
        raise KinedexError("no take is named; name takes, or select them with --where \"class = 'walk'\"")
    wanted = selected | set(takes)
    return [name for name in store.takes_table(None)["name"].to_pylist() if name in wanted]


def recording_names(takes: Sequence[str]) -> list[str]:
    """Return a name for the recording of each take, which is also the name of its folder.

    Characters other than letters, digits and . + - become underscores. Leading . + - are removed, long names are cut,
    and equal ones are numbered.
    """
    plain = [(_FORBIDDEN.sub("_", take)[:_MAX_LETTERS]).lstrip(".+-") or "take" for take in takes]
    twice = {name.casefold() for name in plain if sum(one.casefold() == name.casefold() for one in plain) > 1}
    numbered = [f"{name}-{i + 1}" if name.casefold() in twice else name for i, name in enumerate(plain)]
    return [name.replace("~", "-") for name in file_names(numbered)]


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


def write_recordings(
    folder: Path,
    takes: Sequence[str],
    head: str,
    progress: Progress,
    record: Callable[[Path, str, str], dict[str, Any]],
) -> dict[str, str]:
    """Write a recording of each take and the file that lists them into a new folder.

    Parameters
    ----------
    folder : Path
        The folder, which appears only when it is complete.
    takes : sequence of str
        The names of the takes.
    head : str
        The comment lines at the beginning of `recordings.yaml`.
    progress : callable
        Shows progress.
    record : callable
        Writes the files of a recording, given the unfinished folder, the name of the recording and the take; returns
        its entry in `recordings.yaml`.

    Returns
    -------
    dict of str to str
        Name of each recording → the take that it shows.

    Raises
    ------
    KinedexError
        The folder cannot be written, or `record` fails; nothing was written.
    """
    shown = dict(zip(recording_names(takes), takes, strict=True))
    entries: dict[str, dict[str, Any]] = {}
    with new_folder(folder) as unfinished, progress("recordings", len(shown)) as bar:
        (unfinished / TRUTH).mkdir()
        for name, take in shown.items():
            entries[name] = record(unfinished, name, take)
            bar.advance(1)
        text = yaml.safe_dump({"recordings": entries}, sort_keys=False, allow_unicode=True, width=200)
        (unfinished / RECORDINGS).write_bytes((head + text).encode())
    return shown


def filmed_joints(store: Store, take: str, joints: Sequence[str]) -> F64:
    """Return the positions (J, 3, T) of joints in a take; raise a KinedexError if the store lacks one of them."""
    table = store.frames(take).combine_chunks()
    unknown = [joint for joint in joints if joint not in table.column_names]
    if unknown:
        raise KinedexError(f"the store has no joint '{unknown[0]}', which a body before cameras needs")
    return np.ascontiguousarray(joint_positions(table, joints), np.float64)
