"""This module defines the errors of kinedex; each message states the place, what was expected, and a remedy."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

_LONG_WORD = re.compile(r"\S{600,}")
_LONGEST_MESSAGE = 1500
_LONGEST_NAME, _MAX_NAMES = 200, 10_000


@dataclass(frozen=True)
class Remedy:
    """The remedy of an error or of a finding.

    Attributes
    ----------
    text : str
        The clause that is appended to the error message.
    command : tuple of str
        The command that applies the remedy, word by word; empty if there is none.
    """

    text: str
    command: tuple[str, ...] = ()


class KinedexError(Exception):
    """The base class of all errors of kinedex, with a message that tells a user what to do.

    Parameters
    ----------
    message : str
        What was found and what was expected.
    remedy : Remedy, optional
        The way out, which ends the message; None where the message contains it.

    Attributes
    ----------
    way_out : (str, str) or None
        A parameter of the stage that raised the error, and a value of it with which the command can continue; None if
        there is no such parameter.
    """

    way_out: tuple[str, str] | None = None

    def __init__(self, message: str = "", *, remedy: Remedy | None = None) -> None:
        super().__init__(message if remedy is None else f"{message}; {remedy.text}")
        self.remedy = remedy


class ParameterError(KinedexError, ValueError):
    """A parameter of a function is out of its domain: "`name` must be …, got …"."""

    def __init__(self, name: str, must_be: str, got: object) -> None:
        super().__init__(f"{name} must be {must_be}, got {got!r}")
        self.name = name
        self._arguments = (name, must_be, got)

    def __reduce__(self) -> tuple[object, ...]:
        return (ParameterError, self._arguments)


class SourceError(KinedexError):
    """A source file cannot be read in the format that its name or content indicates.

    Parameters
    ----------
    path : str or Path
        The file.
    message : str
        What was found and expected.
    line : int, optional
        The line, from 1; None if the fault has no line, as in an empty or missing file.
    """

    def __init__(self, path: str | Path, message: str, *, line: int | None = None) -> None:
        message = _readable(message)
        self.path = str(path)
        self.line = line
        self.reason = message
        where = self.path if line is None else f"{self.path}:{line}"
        super().__init__(f"{where}: {message}")

    def __reduce__(self) -> tuple[object, ...]:
        return (_source_error, (self.path, self.reason, self.line))


def _source_error(path: str, reason: str, line: int | None) -> SourceError:
    return SourceError(path, reason, line=line)


class ConfigError(KinedexError):
    """A configuration file is invalid; the message has file, line, key, the expected value and the nearest name."""

    def __init__(self, path: str | Path, message: str, *, line: int | None = None, key: str | None = None) -> None:
        message = _readable(message)
        key = None if key is None else _readable(key)
        self.path = str(path)
        self.line = line
        self.key = key
        self.reason = message
        where = self.path if line is None else f"{self.path}:{line}"
        super().__init__(f"{where}: {key}: {message}" if key else f"{where}: {message}")

    def __reduce__(self) -> tuple[object, ...]:
        return (_config_error, (self.path, self.reason, self.line, self.key))


def _config_error(path: str, reason: str, line: int | None, key: str | None) -> ConfigError:
    return ConfigError(path, reason, line=line, key=key)


class StoreError(KinedexError):
    """A store is missing, locked, damaged, of another format version, or lacks the requested data.

    Parameters
    ----------
    message : str
        What was found and what was expected.
    remedy : Remedy, optional
        The way out, which ends the message; None where the message contains it.
    """


class NewStoreError(StoreError):
    """A store is undamaged but unsuitable for the request, which needs a different store."""


class ConflictError(KinedexError):
    """A change conflicts with a concurrent change by another user or process; nothing was changed."""


class AcceptError(KinedexError):
    """A change would lose data, which the user has to accept first (`--accept`); nothing was changed."""


def _readable(message: str) -> str:
    """Return a message without very long words, such as quoted file contents, and cut to a readable length."""
    message = _LONG_WORD.sub(lambda found: f"{found[0][:60]}… ({len(found[0])} characters)", message)
    if len(message) > _LONGEST_MESSAGE:
        more = len(message) - 2 * (_LONGEST_MESSAGE // 3)
        message = f"{message[: _LONGEST_MESSAGE // 3]} … ({more} characters) … {message[-_LONGEST_MESSAGE // 3 :]}"
    return message.encode("utf-8", "backslashreplace").decode()


def did_you_mean(name: str, known: Iterable[str], alike: float = 0.6) -> str:
    """Return "; did you mean 'x'?" for the most similar known name, or a list of the known names if they are few.

    Parameters
    ----------
    name : str
        The name that the user wrote.
    known : iterable of str
        The valid names.
    alike : float
        The similarity from 0 to 1 that the nearest name must have to be suggested (difflib's ratio).

    Returns
    -------
    str
        A clause to append to an error message; empty where no name is known.
    """
    names = sorted(set(known))
    # the search takes time proportional to the lengths of both names and to the number of names
    short = [known for known in names[:_MAX_NAMES] if len(known) <= _LONGEST_NAME]
    near = difflib.get_close_matches(name, short, n=1, cutoff=alike) if len(name) <= _LONGEST_NAME else []
    if near:
        return f"; did you mean '{near[0]}'?"
    if not names:
        return ""
    shown = ", ".join(one[:_LONGEST_NAME] for one in names[:12])
    return f"; known: {shown}" + (f" and {len(names) - 12} more" if len(names) > 12 else "")
