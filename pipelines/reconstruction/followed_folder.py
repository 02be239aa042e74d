"""Reconstruct poses live from depth frames that another program writes into a folder."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinedex.catalog.depth_cameras import DepthCamera
from kinedex.ops.arrays import F32, F64
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.errors import KinedexError, SourceError
from kinedex.pipelines.reconstruction.live_tracker import LiveTracker
from kinedex.storage.formats.depth.frame_files import IMAGES, RAW
from kinedex.storage.formats.depth.frames import read_frame
from kinedex.storage.formats.depth.png import frame_number

POLL_S = 0.004
"""Seconds between two checks of the folder for new files."""

PATIENCE_S = 0.5
"""Seconds for which an unreadable file must stay unchanged to count as damaged; until then it may be incomplete."""

MAX_STEP, STEPS, MAX_JUMP = 5, 3, 100_000
"""Limits of the steps between frame numbers in file names.

The numbers do not count frames if the last `STEPS` steps all exceed `MAX_STEP`, or the last one exceeds `MAX_JUMP`.
"""


@dataclass(frozen=True, eq=False)
class FollowedFrame:
    """A frame that was reconstructed when its file appeared.

    Attributes
    ----------
    number : int
        The last number in the name of its file.
    file : Path
        The file.
    pose : float64 array (24, 3)
        The joint positions in the world in metres; NaN without a person.
    hypothesis : str or None
        The hypothesis that won, local or database; None without a person.
    cost : float
        Its cost in the comparison of hypotheses; NaN without a person.
    work_ms : float
        Time for reading the file and finding the pose, in milliseconds.
    latency_ms : float or None
        Time from the last change of the file to its pose; None for files that existed before the first frame, or
        before the size of the person was estimated.
    skipped : int
        The number of missing frames before it.
    fault : str
        The error of a damaged file; empty otherwise.
    bytes : int
        The size of the file.
    estimated_m : float or None
        The estimated height of the person, in the frame that completes the estimation; None in others.
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
    bytes: int = 0
    estimated_m: float | None = None

    def document(self) -> dict[str, Any]:
        """Return the frame as a JSON object."""
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


def follow_folder(
    tracker: LiveTracker, folder: Path, idle_s: float | None = None, message: Callable[[str], object] = print
) -> Iterator[FollowedFrame]:
    """Yield the frames of a folder by ascending numbers, first the existing ones and then new ones as they appear.

    A file is skipped if its name has no number, or a number that is not above the number before. The first file of
    each of these two kinds is reported.

    Parameters
    ----------
    tracker : LiveTracker
        The tracker.
    folder : Path
        The folder that files appear in.
    idle_s : float, optional
        Seconds without a new file after which the iteration ends; by default it never ends.
    message : callable, optional
        Shows a line about files that are skipped.

    Raises
    ------
    KinedexError
        The folder does not exist, or the numbers in the names do not count frames.
    """
    if not folder.is_dir():
        raise KinedexError(f"{folder}: no such folder; --follow needs the one that frames are written into")
    begin = time.time()
    last, seen, since = -1, set[str](), time.monotonic()
    steps: deque[int] = deque(maxlen=STEPS)
    reported: set[bool] = set()
    while True:
        new = _new_files(folder, seen)
        seen.update(path.name for _, path in new)
        for number, path in new:
            if number is None or number <= last:
                if (number is None) not in reported:
                    reported.add(number is None)
                    message(f"{path.name} {_reason(number, last)}")
                continue
            if last >= 0:
                steps.append(number - last)
                _check_steps(path, steps)
            one = _reconstructed(tracker, path, number, last, begin)
            begin = begin if one.estimated_m is None else time.time()  # earlier files had to wait for the estimation
            yield one
            last, since = number, time.monotonic()
        if idle_s is not None and time.monotonic() - since > idle_s:
            return
        if not new:
            time.sleep(POLL_S)


def _reason(number: int | None, last: int) -> str:
    if number is None:
        return "is passed over, as are all files without a number in their names"
    return f"is passed over, as are all files that come after one with a higher number or the same, here {last}"


def _check_steps(path: Path, steps: Sequence[int]) -> None:
    """Raise a SourceError if the numbers in the names of the last files do not count frames."""
    if steps[-1] > MAX_JUMP or (len(steps) == STEPS and min(steps) > MAX_STEP):
        raise SourceError(
            path, f"the last numbers in the names go up by {steps[-1]}, and must count frames; let the camera "
            "write depth_000000.png, depth_000001.png, …",
        )  # fmt: skip


def _new_files(folder: Path, seen: set[str]) -> list[tuple[int | None, Path]]:
    """Return number and path of the new files, sorted by number; files without a number come first."""
    with os.scandir(folder) as entries:
        names = [one.name for one in entries if one.name not in seen]
    paths = [folder / name for name in names if not name.startswith(".") and Path(name).suffix.lower() in IMAGES + RAW]
    return sorted(((_number(path), path) for path in paths), key=lambda one: (-1 if one[0] is None else one[0], one[1]))


def _number(path: Path) -> int | None:
    try:
        return frame_number(path)
    except SourceError:
        return None


def _reconstructed(tracker: LiveTracker, path: Path, number: int, last: int, begin: float) -> FollowedFrame:
    skipped = number - last - 1 if last >= 0 else 0
    if skipped:
        tracker.skip(skipped)
    start = time.perf_counter()
    image, fault = _read(path, tracker.camera)
    measuring = tracker.is_measuring
    pose, hypothesis, cost = np.full((len(JOINTS), 3), np.nan), None, float("nan")
    if image is None:
        tracker.skip(1)
    else:
        result, pose = tracker.follow(image)
        if result is not None:
            hypothesis, cost = result.hypothesis, result.cost
    work_ms = 1000.0 * (time.perf_counter() - start)
    written, size = _written(path) or (begin - 1.0, 0)  # the file may have been deleted
    latency_ms = 1000.0 * (time.time() - written) if written >= begin else None
    estimated_m = tracker.bones.height_m if measuring and not tracker.is_measuring else None
    return FollowedFrame(number, path, pose, hypothesis, cost, work_ms, latency_ms, skipped, fault, size, estimated_m)


def _read(path: Path, camera: DepthCamera) -> tuple[F32 | None, str]:
    """Return the depths in a file and "", or None and its error; wait for a file that is still being written."""
    state, since = _written(path), time.monotonic()
    while True:
        try:
            return read_frame(path, camera), ""
        except SourceError as found:
            now = _written(path)
            if now != state:
                state, since = now, time.monotonic()
            elif time.monotonic() - since > PATIENCE_S:
                return None, str(found)
        time.sleep(POLL_S)


def _written(path: Path) -> tuple[float, int] | None:
    """Return the modification time of a file, and its size; None if it does not exist."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime, found.st_size
