"""Limit the memory for reading motion files: the memory that a file needs is estimated before it is read."""

from __future__ import annotations

import re
from dataclasses import dataclass

from kinedex.catalog.features import FeatureSet
from kinedex.ops.body.features import words_bytes
from kinedex.ops.body.resample import feature_rate
from kinedex.ops.errors import KinedexError, ParameterError, SourceError
from kinedex.storage.formats.motion.reader import SLOWEST_HZ, MotionFile, ReadSettings, body_bytes
from kinedex.storage.formats.motion.reader_table import reader_of
from kinedex.storage.snapshot.parts import ROW_GROUP

PROCESS_BYTES = 300_000_000
"""The memory of a process without that of a file: Python, libraries, kernels, and frames that wait to be written."""

_UNITS = {"": 1, "k": 1e3, "m": 1e6, "g": 1e9, "ki": 2**10, "mi": 2**20, "gi": 2**30}
_SIZE = re.compile(r"([0-9]+(?:\.[0-9]+)?)\s*([kmg]i?|)b?", re.IGNORECASE | re.ASCII)


def parse_size(text: str) -> int:
    """Parse a memory size such as "1.5GB" (powers of 1000) or "2GiB" (powers of 1024), and return bytes.

    Raises
    ------
    ParameterError
        The text is not a size.
    """
    found = _SIZE.fullmatch(text.strip())
    if found is None:
        raise ParameterError("max_memory", "a size such as 1.5GB or 800MB", text)
    return int(float(found[1]) * _UNITS[found[2].lower()])


def needed_bytes(file: MotionFile, feature_set: FeatureSet, rate_hz: float, settings: ReadSettings) -> int:
    """Estimate the peak memory, in bytes, of a process that reads one file and writes its frames.

    Parameters
    ----------
    file : MotionFile
        The file.
    feature_set : FeatureSet
        The features of its words.
    rate_hz : float
        The analysis rate.
    settings : ReadSettings
        Settings of the user for reading files.

    Raises
    ------
    SourceError
        The file is damaged.
    """
    joints = len(feature_set.joints)
    extent = reader_of(file.path).extent(file, joints, settings)
    # upsampling increases the memory that a take needs
    source_hz = extent.rate_hz or (rate_hz if extent.frames else SLOWEST_HZ)
    sampled = 0
    rate = feature_rate(source_hz, rate_hz)
    frames = int(extent.frames * rate / source_hz) + 1
    if rate != source_hz:
        sampled = body_bytes(frames, joints) + 400 * frames
    written = int(frames * rate_hz / rate) + 1
    body = body_bytes(extent.frames, joints)
    waiting = min(written, 4 * ROW_GROUP)  # the others are already written to the part
    later = body + sampled + max(words_bytes(feature_set.rules) * frames, 3 * waiting * (12 * joints + 28))
    return PROCESS_BYTES + max(extent.bytes, later)


@dataclass(frozen=True)
class MemoryShare:
    """The part of a memory limit that each worker may use.

    Attributes
    ----------
    bytes : int
        The memory of one worker.
    workers : int
        The number of workers.
    """

    bytes: int
    workers: int

    @classmethod
    def of(cls, limit: str, workers: int) -> MemoryShare:
        """Divide a limit such as "1.5GB" among workers; with several workers, the main process is counted as well."""
        whole = parse_size(limit)
        return cls(whole if workers == 1 else max(0, whole - PROCESS_BYTES) // workers, workers)

    def refuse_large(self, file: MotionFile, feature_set: FeatureSet, rate_hz: float, settings: ReadSettings) -> None:
        """Raise a SourceError if a file needs more memory than a worker has; parameters as for `needed_bytes`."""
        try:
            need = needed_bytes(file, feature_set, rate_hz, settings)
        except KinedexError:
            return  # the reader reports the error
        if need > self.bytes:
            had = f"{self.bytes / 1e6:,.0f} MB"
            limit = had if self.workers == 1 else f"{had} that each of {self.workers} workers has of it"
            fewer = "" if self.workers == 1 else "give --workers 1, or "
            raise SourceError(
                file.path,
                f"takes {need / 1e6:,.0f} MB of memory, more than --max-memory allows ({limit}); {fewer}a larger "
                "limit, or cut the file into shorter takes",
            )
