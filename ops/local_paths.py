"""This module refuses addresses with a scheme, such as s3://bucket/takes, where a local path is required."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping

from kinedex.ops.errors import KinedexError

_TEXT = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://(.*)", re.DOTALL)

_PATH = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):[/\\]+(.*)", re.DOTALL)
"""The same pattern for path objects, which merge two slashes; a single letter is a Windows drive."""


def refuse_addresses(value: object) -> None:
    """Raise an error if a text or path is an address with a scheme, also within lists, mappings and tuples.

    Parameters
    ----------
    value : object
        A text or path, or a collection of them; values of other types are accepted.

    Raises
    ------
    KinedexError
        The value is an address with a scheme, or contains one.
    """
    if isinstance(value, str | os.PathLike):
        text = os.fspath(value)
        pattern = _TEXT if isinstance(value, str) else _PATH
        if isinstance(text, str) and (found := pattern.match(text)) is not None:
            raise KinedexError(_refusal(found[1], found[2]))
    elif isinstance(value, Mapping):
        refuse_addresses(list(value.values()))
    elif isinstance(value, list | tuple | set | frozenset):
        for one in value:
            refuse_addresses(one)


def _refusal(scheme: str, rest: str) -> str:
    if scheme.lower() == "file":
        path = rest.removeprefix("localhost") or "/"
        return f"{scheme}://{rest}: paths are written without a scheme; give {path if path[0] == '/' else '/' + path}"
    return (
        f"{scheme}://{rest}: kinedex reads and writes files of this machine alone; copy the data to a folder, or mount "
        "it as one, and give the path of that"
    )
