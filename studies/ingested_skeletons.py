"""Skeletons of AMC files that change after a store has taken them in, for `studies.mutations`."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import kinedex
from kinedex.ops.arrays import F64
from kinedex.ops.errors import KinedexError
from studies.acclaim_mutations import AcclaimText, write

_THIGH = re.compile(r"(name\s+lfemur\s+direction[^\n]*\n\s*length\s+)(\S+)")


@dataclass(frozen=True)
class Change:
    """A change of the files of a folder: what it is, the function that makes it, and whether the files show it."""

    what: str
    make: Callable[[Path], None]
    knowable: bool = True


@dataclass(frozen=True)
class Stored:
    """A take of a store: the joints (T, J, 3), and the sentences that its reading gave."""

    positions: F64
    said: tuple[str, ...]


def changes(made: AcclaimText, others: list[AcclaimText]) -> Iterator[Change]:
    """Yield changes of the skeleton that belongs to a motion."""
    longer = _THIGH.sub(lambda one: f"{one[1]}{1.2 * float(one[2]):.6g}", made.skeleton)
    alike = _THIGH.sub(lambda one: f"{one[1]}{'9' + one[2][1:]}", made.skeleton)
    assert longer != made.skeleton
    assert alike != made.skeleton
    assert len(alike) == len(made.skeleton)

    def write_text(text: str, seconds: float | None = None) -> Callable[[Path], None]:
        def make(folder: Path) -> None:
            path = folder / made.skeleton_name
            before = path.stat()
            path.write_text(text, encoding="latin-1")
            if seconds is not None:
                nanoseconds = before.st_mtime_ns + round(1e9 * seconds)
                os.utime(path, ns=(nanoseconds, nanoseconds))

        return make

    yield Change("thigh longer", write_text(longer))
    yield Change("thigh longer, with an older time", write_text(longer, -86_400.0))
    yield Change("another length of as many digits", write_text(alike))
    yield Change("another length of as many digits, with the same time", write_text(alike, 0.0), knowable=False)
    yield Change("skeleton gone", lambda folder: (folder / made.skeleton_name).unlink())
    own = Path(made.name).with_suffix(".asf").name
    yield Change("another skeleton that fits better", lambda folder: _place(folder / own, longer))
    for other in others:
        if other.skeleton_name != made.skeleton_name:
            yield Change(f"that of {other.skeleton_name}", write_text(other.skeleton))


def _place(path: Path, text: str) -> None:
    path.write_text(text, encoding="latin-1")


def stored_trials(made: AcclaimText, others: list[AcclaimText]) -> Iterator[tuple[Change, str, str]]:
    """Yield for each change its outcome, and a sentence on it.

    The take is right if it is the one of a new store of the changed folder.
    """
    for change in changes(made, others):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name) / "archive"
            folder.mkdir()
            write(folder, made)
            before = _taken_in(Path(name) / "store", folder)
            assert isinstance(before, Stored)
            change.make(folder)
            other = shutil.copytree(folder, Path(name) / "copy")  # parsed skeletons are remembered by their paths
            after, right = _taken_in(Path(name) / "store", folder), _taken_in(Path(name) / "new", other)
            yield change, *_judged(change, before, after, right)


def _judged(change: Change, before: Stored, after: Stored | str, right: Stored | str) -> tuple[str, str]:
    if isinstance(after, str):
        return "refused", after
    if isinstance(right, Stored):
        off = float(np.nanmax(np.linalg.norm(after.positions - right.positions, axis=2)))
        if off < 1e-6:
            return "right", ""
        detail = f"{off:.3g} m off"
    else:
        detail = "read by a skeleton that is gone"
    new = [one for one in after.said if one not in before.said]
    return ("warned", f"{detail}: {new[0]}") if new else ("silent" if change.knowable else "not knowable", detail)


def _taken_in(store: Path, folder: Path) -> Stored | str:
    """Return the take of a folder after an ingest, or the reason why its file is refused."""
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            kinedex.ingest(store, folder)
    except KinedexError as fault:
        return str(fault)
    with kinedex.open_store(store) as opened:
        logged = opened.results("ingest_log")
        if len(logged):
            return str(logged["message"][0])
        take = next(iter(opened))
        return Stored(np.asarray(take.positions, np.float64), take.warnings)


def with_frames(made: AcclaimText, frames: int) -> AcclaimText:
    """Return a motion of the first frames of another."""
    parts = re.split(r"(?m)^(?=\d+\s*$)", made.motion)
    return replace(made, motion="".join(parts[: frames + 1]))
