"""Responses of the server: JSON without NaN, one format for all errors, and commands that do the same as a request."""

from __future__ import annotations

import json
import logging
import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response

from kinedex.explorer.open_archive import Archive, ReadOnlyError
from kinedex.ops.cancellation import CancelledWorkError
from kinedex.ops.errors import ConflictError, KinedexError, ParameterError, Remedy
from kinedex.storage.durable_files import WriteError
from kinedex.storage.formats.json_text import json_value
from kinedex.storage.interruption import TimeLimitError

_LOG = logging.getLogger("kinedex.explorer")

EXACT = 2**53
"""Larger integers are sent as text, because JavaScript cannot represent them exactly."""


class NotFoundError(KinedexError):
    """The address, or the take, class or run that it names, does not exist."""


class Json(Response):
    """A value as JSON (UTF-8): ∞ and NaN are null, integers beyond 2⁵³ are text."""

    media_type = "application/json"

    def render(self, content: Any) -> bytes:
        """Return a value as JSON, in UTF-8."""
        value = _exact(json_value(content))
        return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode(
            "utf-8", "backslashreplace"
        )


def _exact(value: Any) -> Any:
    """Return a JSON value in which integers that JavaScript cannot represent exactly are text."""
    if isinstance(value, dict):
        return {name: _exact(part) for name, part in value.items()}
    if isinstance(value, list):
        return [_exact(part) for part in value]
    return str(value) if isinstance(value, int) and not -EXACT <= value <= EXACT else value


def error_json(status: int, kind: str, message: str, remedy: Remedy | None = None) -> Json:
    """Return the JSON response for an error, in the format that all pages read.

    Parameters
    ----------
    status : int
        The HTTP status code.
    kind : str
        Class of the error.
    message : str
        The error: what was found, what was expected, and what to do.
    remedy : Remedy, optional
        What to do, as a command or an action.
    """
    error = {"type": kind, "message": message, "remedy": remedy and asdict(remedy)}
    return Json({"error": error}, status)


_STATUS: dict[type[KinedexError], int] = {
    NotFoundError: 404,
    ReadOnlyError: 403,
    ConflictError: 409,
    WriteError: 507,  # pages keep decisions after a status of 500 or more, and send them again
    TimeLimitError: 408,
    ParameterError: 422,
    KinedexError: 400,
}
"""A dict from class of an error to its status; a class without entry has the status of its parent."""


async def error_response(_request: Request, fault: Exception) -> Response:
    """Return the response for a request that failed; a traceback goes to the log only."""
    if isinstance(fault, ClientDisconnect | CancelledWorkError):
        return Response(status_code=499)  # the client has disconnected
    if isinstance(fault, KinedexError):
        status = next(_STATUS[kind] for kind in type(fault).__mro__ if kind in _STATUS)
        return error_json(status, type(fault).__name__, str(fault), fault.remedy)
    if isinstance(fault, ValidationError):
        return error_json(422, "ParameterError", _wrong_fields(fault))
    if isinstance(fault, HTTPException):
        return error_json(fault.status_code, "HTTPError", fault.detail)
    if isinstance(fault, MemoryError):
        return error_json(500, "MemoryError", "the server has no memory left; ask for less, or close other programs")
    if isinstance(fault, OSError):
        place = f"{fault.filename}: " if fault.filename else ""
        return error_json(500, type(fault).__name__, f"{place}{fault.strerror or fault}")
    _LOG.error("a request failed", exc_info=fault)
    return error_json(
        500, type(fault).__name__, "the server met an error of its own; the log of `kinedex explore` shows it"
    )


def _wrong_fields(fault: ValidationError) -> str:
    """Return the fields of a request that do not fit, with what is expected of each."""
    parts = (
        f"{'.'.join(map(str, one['loc'])) or 'the request'}: {one['msg'].removeprefix('Value error, ')}"
        for one in fault.errors(include_url=False, include_context=False, include_input=False)[:10]
    )
    return "; ".join(parts)


def command_line(*words: str | Path) -> str:
    """Return a shell command, with quotes around the words that need them.

    Examples
    --------
    >>> command_line("kinedex", "sql", Path("my store"), "SELECT 1")
    "kinedex sql 'my store' 'SELECT 1'"
    """
    return shlex.join(str(word) for word in words)


def python_lines(store: Path, *lines: str) -> str:
    """Return a Python program that opens the store as `store` and then runs some lines.

    Examples
    --------
    >>> print(python_lines(Path("my store"), "store.takes()"))
    import kinedex
    store = kinedex.open_store('my store')
    store.takes()
    """
    return "\n".join(["import kinedex", f"store = kinedex.open_store({str(store)!r})", *lines])


def equivalent_query(archive: Archive, text: str) -> dict[str, str]:
    """Return the command and the Python lines that run a SQL query on the store."""
    return {
        "command": command_line("kinedex", "sql", archive.path, text),
        "python": python_lines(archive.path, f"store.sql({text!r})"),
    }
