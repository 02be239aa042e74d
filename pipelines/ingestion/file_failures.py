"""Represent failures of ingestion: files that could not be read, and the reasons, as rows of `ingest_log`."""

from __future__ import annotations

import os
import traceback
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import pyarrow as pa

from kinedex.ops.errors import KinedexError, SourceError
from kinedex.storage.formats.motion.scanned_files import SourceFile, UnreadableFile, readable
from kinedex.storage.snapshot.schemas import result_table

MAX_MESSAGES = 10


@dataclass(frozen=True)
class Failure:
    """A file that could not be read, and the reason; all texts are valid Unicode that can be printed.

    Attributes
    ----------
    source : str
        The path of the file below the source folder.
    error : str
        The kind of error.
    message : str
        The message.
    file : str
        The absolute path of the file.
    line : int, optional
        The line of the error.
    person : str
        The person that could not be read, in a file with several persons; empty if the whole file failed.
    """

    source: str
    error: str
    message: str
    file: str
    line: int | None
    person: str = ""

    @property
    def subject(self) -> tuple[str, str]:
        """The path of the file, and the person."""
        return self.source, self.person


def file_failure(motion: SourceFile, fault: Exception, person: str | None = None) -> Failure:
    """Return the failure of a motion file.

    An error that is neither one of kinedex nor of the operating system is a defect of kinedex: other files are still
    read, and the message asks the user to report it.

    Parameters
    ----------
    motion : SourceFile
        The motion file.
    fault : Exception
        The error.
    person : str, optional
        The person, in a file with several persons.
    """
    if person:
        return _of_person(file_failure(motion, fault), person)
    file = readable(str(motion.absolute))
    if isinstance(fault, SourceError):
        return Failure(motion.path, "SourceError", readable(str(fault)), readable(fault.path), fault.line)
    error = type(fault).__name__
    if isinstance(fault, KinedexError):
        message = f"{file}: {fault}"
    elif isinstance(fault, MemoryError):
        error = "MemoryError"
        message = (
            f"{file}: there is not enough memory for this file of {motion.size / 1e6:.1f} MB; run with fewer workers "
            "(--workers 1), on a machine with more memory, or cut the file into shorter takes"
        )
    elif isinstance(fault, OSError):
        message = f"{file}: cannot be read: {os.strerror(fault.errno) if fault.errno else fault}"
    else:
        where = traceback.extract_tb(fault.__traceback__)[-1:]
        at = "".join(f" in {os.path.basename(frame.filename)}:{frame.lineno}" for frame in where)
        message = (
            f"{file}: this is a defect of kinedex, not of the file alone: {error}{at}: {fault}; please report it with "
            "the file. The other files are not concerned"
        )
    return Failure(motion.path, error, readable(message), file, None)


def _of_person(found: Failure, person: str) -> Failure:
    """Return the failure of a person, whose name the message states after the path of the file."""
    place = found.file if found.line is None else f"{found.file}:{found.line}"
    reason = found.message.removeprefix(f"{place}: ")
    return replace(found, message=f"{place}: person '{readable(person)}': {reason}", person=person)


def fatal_failure(motion: SourceFile, fault: Exception, person: str | None = None) -> Failure:
    """Return the failure of a file, or of a person in it, that kills every process that reads it."""
    if person:
        return _of_person(fatal_failure(motion, fault), person)
    file = readable(str(motion.absolute))
    message = (
        f"{file}: {fault}; most likely this file of {motion.size / 1e6:.1f} MB needs more memory than there is: run "
        "with fewer workers (--workers 1), on a machine with more memory, or leave the file out"
    )
    return Failure(motion.path, type(fault).__name__, readable(message), file, None)


def scan_failure(refused: UnreadableFile) -> Failure:
    """Return the failure of a file that the scan of the source has refused."""
    return Failure(refused.path, "SourceError", str(refused.fault), refused.fault.path, None)


def failure_messages(failures: Sequence[Failure]) -> list[str]:
    """Return messages for the terminal: at most ten, and a line that counts the others."""
    lines = [f"excluded: {one.message}" for one in failures[:MAX_MESSAGES]]
    more = len(failures) - MAX_MESSAGES
    return lines + ([f"… and {more} more: SELECT * FROM ingest_log lists them all"] if more > 0 else [])


def log_table(failures: Sequence[Failure], run: str, stage: str = "ingest") -> pa.Table:
    """Return failures of a kind of stage as rows of `ingest_log`."""
    rows = [
        {
            "source": failure.source,
            "stage": stage,
            "error": failure.error,
            "message": failure.message,
            "file": failure.file,
            "line": failure.line,
            "logged_at": datetime.now(UTC),
        }
        for failure in failures
    ]
    return result_table("ingest_log", rows, run)
