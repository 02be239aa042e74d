"""Find the files with the frames of a depth recording, and the number of each frame from a name, list or time."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import KinedexError, SourceError
from kinedex.ops.local_paths import refuse_addresses
from kinedex.storage.formats.cameras.file_patterns import MAX_FILES, find_files
from kinedex.storage.formats.depth.png import frame_number
from kinedex.storage.formats.source_files import read_bytes

F64 = npt.NDArray[np.float64]

IMAGES = (".png", ".pcd", ".ply")
"""File endings of images and clouds, which hold one frame each."""

RAW = (".raw", ".bin")
"""File endings of raw 16-bit numbers."""

CONVERTERS = {
    ".mkv": "Open3D's `python azure_kinect_mkv_reader.py --input FILE.mkv --output DIR` writes DIR/depth/*.png and "
    "DIR/intrinsic.json",
    ".bag": "`rs-convert -i FILE.bag -d -r DIR/depth` of RealSense writes raw 16-bit files (its PNG is a coloured "
    "picture); bags of ROS: `rosrun image_view image_saver image:=/camera/depth/image_rect_raw _encoding:=16UC1 "
    "_filename_format:=depth_%06d.png`",
    ".db3": "`ros2 run image_view image_saver --ros-args -r image:=/camera/depth/image_rect_raw -p encoding:=16UC1 -p "
    "filename_format:=depth_%06d.png` writes 16-bit PNG while `ros2 bag play` runs",
}
"""A dict from the extension of unsupported recordings to the command that converts them to supported files."""

CONVERTERS[".mcap"] = CONVERTERS[".db3"]

_TIME = re.compile(r"(?:.*[^0-9.])?([0-9]{9,14}\.[0-9]+)")
_SECONDS_DIGITS = 11  # digits before the point; a longer number is a time in milliseconds
_MAX_STEP, _MAX_TIMED_STEP = 5, 1.5  # largest median step between files, in frames
_MAX_SPAN, _MIN_SPAN = 10, 1000  # largest number of frames per file over a recording, and a span that is always allowed
_MAX_RATE_ERROR = 0.02


@dataclass(frozen=True, eq=False)
class FrameFiles:
    """The files that hold the frames of a recording.

    Attributes
    ----------
    kind : str
        "images", "npz" or "raw".
    files : tuple of Path
        The files in natural order; a single file for NPZ.
    times : float64 array (T,), optional
        Time of each file in seconds, ascending, if names or a list state times.
    """

    kind: str
    files: tuple[Path, ...]
    times: F64 | None = None

    def rate_hz(self) -> float | None:
        """Return the frame rate from the median step between times; None without times."""
        if self.times is None or len(self.times) < 2:
            return None
        step = float(np.median(np.diff(self.times)))
        return 1 / step if step > 1e-4 else None

    def numbers(self, rate_hz: float | None) -> dict[int, Path]:
        """Return a dict from frame number to file, by the last number in a name or the time since the first file.

        Parameters
        ----------
        rate_hz : float, optional
            Frames per second, for files with times.

        Raises
        ------
        SourceError
            A name has no number, two names have the same number, the numbers do not count frames, or the rate
            contradicts the times.
        """
        timed = self.times is not None and rate_hz is not None
        found = self._timed(self.times, rate_hz) if timed else self._numbered()  # type: ignore[arg-type]
        first, last = min(found), max(found)
        count = len(found)
        if last - first >= _MAX_SPAN * count + _MIN_SPAN:
            raise SourceError(
                found[last], f"most of the frames {first} to {last} are missing: {count} files have numbers or times "
                "so far apart; name the files of one recording",
            )  # fmt: skip
        return found

    def _numbered(self) -> dict[int, Path]:
        """Return a dict from frame number to file, by the last numbers in the names."""
        found: dict[int, Path] = {}
        for path in self.files:
            number = frame_number(path)
            if number in found:
                raise SourceError(path, f"has the frame number {number}, as {found[number].name} has")
            found[number] = path
        steps = np.diff(sorted(found))
        if len(steps) and np.median(steps) > _MAX_STEP:
            raise SourceError(
                self.files[0], f"the last numbers in the names go up by {np.median(steps):g} in the median, and must "
                "count frames; rename the files (depth_000000.png, depth_000001.png, …)",
            )  # fmt: skip
        return found

    def _timed(self, times: F64, rate_hz: float) -> dict[int, Path]:
        """Return a dict from frame number to file, by times rounded to frames; no two files get the same number."""
        found: dict[int, Path] = {}
        last = -1
        for path, time in zip(self.files, (times - times[0]).tolist(), strict=True):
            last = max(last + 1, round(time * rate_hz))
            found[last] = path
        due = float(times[-1] - times[0]) * rate_hz
        step = rate_hz / (self.rate_hz() or rate_hz)
        if abs(last - due) > max(2.0, _MAX_RATE_ERROR * due) or step > _MAX_TIMED_STEP:
            raise SourceError(
                self.files[0], f"{len(times)} frames in {times[-1] - times[0]:.2f} s are not {rate_hz:g} frames per "
                f"second; `rate_hz: {self.rate_hz() or 0:.4g}` fits the times in the names or the list",
            )  # fmt: skip
        return found


def find_frames(folder: Path, pattern: str, excluded: Path | None = None) -> FrameFiles:
    """Return the files with the frames of a recording.

    Parameters
    ----------
    folder : Path
        The folder that a relative pattern starts from, and stays below.
    pattern : str
        A pattern of files, a folder, an NPZ or raw file, or a list of TUM RGB-D (.txt).
    excluded : Path, optional
        A file that is not returned, although the pattern may match it.

    Raises
    ------
    SourceError
        No file matches, or files of this kind cannot be read; the message states the command that converts them.
    """
    ending = Path(pattern).suffix.lower()
    if ending in CONVERTERS:
        raise SourceError(folder / pattern, f"recordings ending in {ending} are not read: {CONVERTERS[ending]}")
    found = find_files(folder, pattern, excluded=excluded) if not os.path.isdir(folder / pattern) else None
    if found is None:
        files = _in_folder(folder, pattern)
    else:
        files = tuple(path for paths in found.files.values() for path in paths)
    if found is not None and found.each_camera:
        raise SourceError(folder, f"'{pattern}' is of several cameras; a depth recording has one")
    endings = {path.suffix.lower() for path in files}
    if len(endings) > 1:
        listed = ", ".join(sorted(one or "none" for one in endings))
        raise SourceError(folder, f"'{pattern}' matches files ending in {listed}; name one kind, as depth/*.png")
    (ending,) = endings
    if ending == ".txt" and len(files) == 1:
        return _listed(files[0])
    if ending == ".npz" and len(files) == 1:
        return FrameFiles("npz", files)
    if ending in RAW and len(files) == 1:
        return FrameFiles("raw", files)
    if ending in (*IMAGES, *RAW):
        return _with_times(files)
    known = "*.png, *.pcd, *.ply, *.raw, one .npz, or depth.txt of TUM RGB-D"
    raise SourceError(files[0], f"is no depth image that is read; expected {known}")


def _in_folder(folder: Path, pattern: str) -> tuple[Path, ...]:
    """Return the frame files in a folder, with the first known extension that any file has."""
    fault: SourceError | None = None
    for ending in (*IMAGES, *RAW):
        try:
            return find_files(folder, pattern, (ending,)).files[""]
        except SourceError as found:
            fault = fault or found
    raise fault or SourceError(folder, "has no depth images")


def _with_times(files: Sequence[Path]) -> FrameFiles:
    """Return files in natural order, and their times if every name ends with a time (seconds or milliseconds)."""
    found = [_TIME.fullmatch(path.stem) for path in files]
    if len(files) < 2 or not all(found):
        return FrameFiles("images", tuple(files))
    whole = [one[1] for one in found if one is not None]
    milliseconds = len(whole[0].partition(".")[0]) > _SECONDS_DIGITS
    times = np.array([float(text) for text in whole]) * (1e-3 if milliseconds else 1.0)
    return _in_order(files, times)


def _in_order(files: Sequence[Path], times: F64) -> FrameFiles:
    order = np.argsort(times, kind="stable")
    repeated = np.flatnonzero(np.diff(times[order]) <= 0)
    if len(repeated):
        raise SourceError(files[int(order[repeated[0] + 1])], "has the same time as another frame")
    return FrameFiles("images", tuple(files[int(i)] for i in order), times[order])


def _listed(path: Path) -> FrameFiles:
    """Read a file list of TUM RGB-D, whose lines hold a time in seconds and a path relative to the list's folder."""
    data = read_bytes(path, "lists of frames", "write shorter recordings")
    files, times = [], []
    for number, line in enumerate(data.decode("utf-8", "replace").splitlines(), 1):
        words = line.split("#")[0].split()
        if not words:
            continue
        try:
            time = float(words[0])
        except ValueError:
            time = np.nan
        if len(words) != 2 or not 0 <= time <= 1e12:
            raise SourceError(path, f"expected a time in seconds and a file, got {line[:80]!r}", line=number)
        try:
            refuse_addresses(words[1])
        except KinedexError as fault:
            raise SourceError(path, str(fault), line=number) from None
        place = Path(words[1])
        if place.is_absolute() or ".." in place.parts or "\0" in words[1]:
            raise SourceError(path, f"{words[1][:80]!r} must be a path below the folder of this list", line=number)
        if place.suffix.lower() != ".png":
            raise SourceError(path, f"expected a PNG file, got {words[1][:80]!r}", line=number)
        files.append(path.parent / place)
        times.append(time)
    if not 1 <= len(files) <= MAX_FILES:
        raise SourceError(path, f"lists {len(files)} frames; expected lines with a time in seconds and a PNG file")
    return _in_order(files, np.array(times))
