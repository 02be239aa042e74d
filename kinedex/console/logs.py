"""Write log records of kinedex to standard error and to files of JSON lines.

The library only emits records, below the logger `kinedex`; the command line decides where they are written.
"""

from __future__ import annotations

import json
import logging
import sys
from datetime import UTC, datetime
from pathlib import Path

from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import json_escaped, visible_lines

_STANDARD = frozenset((*vars(logging.makeLogRecord({})), "message", "asctime"))
"""The attributes that every record has; all others are fields that were added with `extra=`."""


def _is_not_an_event(record: logging.LogRecord) -> bool:
    """Return whether a record is not an event; events of a run, such as failures, are already on the terminal."""
    return not hasattr(record, "event")


class _Lines(logging.Formatter):
    """Formatter that escapes line breaks in names, so that a name cannot forge further lines."""

    def format(self, record: logging.LogRecord) -> str:
        """Format a record as text, with control characters escaped."""
        return visible_lines(super().format(record))


class JsonLines(logging.Formatter):
    """Formatter of records as JSON lines with time, level, logger, message, and the fields added with `extra=`."""

    def format(self, record: logging.LogRecord) -> str:
        """Format a record as one line of JSON."""
        line: dict[str, object] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        line |= {name: value for name, value in vars(record).items() if name not in _STANDARD}
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return json_escaped(json.dumps(line, ensure_ascii=False, default=str))


def configure_logging(*, quiet: bool = False, verbose: bool = False, log_file: Path | None = None) -> None:
    """Configure the handlers of kinedex's log records, and remove those of an earlier call.

    Parameters
    ----------
    quiet : bool
        True prints only errors to standard error; False prints warnings as well.
    verbose : bool
        Print all records to standard error.
    log_file : Path or None
        File to which all records are appended, one JSON object per line.

    Raises
    ------
    KinedexError
        If the file cannot be written.
    """
    logger = logging.getLogger("kinedex")
    for handler in [one for one in logger.handlers if one.name == "kinedex-command"]:
        logger.removeHandler(handler)
        handler.close()
    shown = logging.StreamHandler(sys.stderr)
    shown.setLevel(logging.DEBUG if verbose else logging.ERROR if quiet else logging.WARNING)
    if not verbose:
        shown.addFilter(_is_not_an_event)
    shown.setFormatter(_Lines("%(asctime)s %(name)s: %(message)s" if verbose else "kinedex: %(message)s"))
    handlers: list[logging.Handler] = [shown]
    if log_file is not None:
        try:
            handlers.append(logging.FileHandler(log_file, encoding="utf-8"))
        except OSError as fault:
            raise KinedexError(f"--log-file {log_file}: cannot be written: {fault.strerror}") from None
        handlers[-1].setFormatter(JsonLines())
    for handler in handlers:
        handler.name = "kinedex-command"
        logger.addHandler(handler)
    logger.setLevel(logging.DEBUG if verbose or log_file is not None else logging.WARNING)
