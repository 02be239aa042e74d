"""Frames of a depth camera that another program writes into a folder, reconstructed as they appear."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.errors import KinedexError, SourceError
from kinedex.pipelines.reconstruction.live import LiveTracker
from kinedex.storage.formats.depth.frame_files import IMAGES, RAW
from kinedex.storage.formats.depth.frames import read_frame
from kinedex.storage.formats.depth.png import frame_number

F64 = npt.NDArray[np.float64]

POLL_S = 0.004
"""The folder is looked into so often."""

PATIENCE_S = 0.5
"""A file that cannot be read yet may be so long in writing; then it counts as damaged."""


@dataclass(frozen=True, eq=False)
class FollowedFrame:
    """A frame that was reconstructed as it appeared.

    Attributes
    ----------
    number : int
        The last number in the name of its file.
    file : Path
        The file.
    pose : float64 array (24, 3)
        The joints in the world in metres; NaN without a person.
    hypothesis : str or None
        local or database; None without a person.
    cost : float
        Its cost in the vote; NaN without a person.
    work_ms : float
        Time for reading the file and finding the pose, in milliseconds.
    latency_ms : float or None
        Time from the last change of the file to its pose; None for files that were there before.
    skipped : int
        The frames before it that are missing.
    fault : str
        What is wrong with a damaged file; empty otherwise.
    """

    number: int
    file: Path
    pose: F64
    hypothesis: str | None
    cost: float
    work_ms: float
    latency_ms: float | None
    skipped: int
    fault: str = ""

    def document(self) -> dict[str, Any]:
        """Return it as JSON values."""
        is_seen = self.hypothesis is not None
        return {
            "frame": self.number,
            "file": str(self.file),
            "hypothesis": self.hypothesis,
            "cost": self.cost if is_seen else None,
            "work_ms": round(self.work_ms, 3),
            "latency_ms": None if self.latency_ms is None else round(self.latency_ms, 3),
            "skipped": self.skipped,
            "fault": self.fault or None,
            "joints": dict(zip(JOINTS, np.round(self.pose, 5).tolist(), strict=True)) if is_seen else None,
        }


def follow_folder(tracker: LiveTracker, folder: Path, idle_s: float | None = None) -> Iterator[FollowedFrame]:
    """Yield the frames of a folder, those that are there and then new ones, by ascending numbers.

    A file whose number is below that of one that was taken already is passed over.

    Parameters
    ----------
    tracker : LiveTracker
        The tracker.
    folder : Path
        The folder that files appear in.
    idle_s : float, optional
        End where no new file has appeared for so long, in seconds; never unless given.

    Raises
    ------
    KinedexError
        The folder is not there, or the name of a file has no number.
    """
    if not folder.is_dir():
        raise KinedexError(f"{folder}: no such folder; --follow needs the one that frames are written into")
    begin = time.time()
    last, seen, since = -1, set[str](), time.monotonic()
    while True:
        new = _new_files(folder, seen)
        seen.update(path.name for _, path in new)
        for number, path in new:
            if number <= last:
                continue
            yield _reconstructed(tracker, path, number, last, begin)
            last, since = number, time.monotonic()
        if idle_s is not None and time.monotonic() - since > idle_s:
            return
        if not new:
            time.sleep(POLL_S)


def _new_files(folder: Path, seen: set[str]) -> list[tuple[int, Path]]:
    """Return number and path of the files that were not seen yet, by number."""
    with os.scandir(folder) as entries:
        names = [one.name for one in entries if one.name not in seen]
    paths = [folder / name for name in names if not name.startswith(".") and Path(name).suffix.lower() in IMAGES + RAW]
    return sorted((frame_number(path), path) for path in paths)


def _reconstructed(tracker: LiveTracker, path: Path, number: int, last: int, begin: float) -> FollowedFrame:
    skipped = number - last - 1 if last >= 0 else 0
    if skipped:
        tracker.skip(skipped)
    start = time.perf_counter()
    image, fault = None, ""
    while image is None:
        try:
            image = read_frame(path, tracker.camera)
        except SourceError as found:
            if time.perf_counter() - start > PATIENCE_S:
                fault = str(found)
                break
            time.sleep(POLL_S)
    pose, hypothesis, cost = np.full((len(JOINTS), 3), np.nan), None, float("nan")
    if image is None:
        tracker.skip(1)
    else:
        result, pose = tracker.follow(image)
        if result is not None:
            hypothesis, cost = result.hypothesis, result.cost
    work_ms = 1000.0 * (time.perf_counter() - start)
    try:
        written = path.stat().st_mtime
    except OSError:
        written = begin - 1.0  # it is gone already
    latency_ms = 1000.0 * (time.time() - written) if written >= begin else None
    return FollowedFrame(number, path, pose, hypothesis, cost, work_ms, latency_ms, skipped, fault)
