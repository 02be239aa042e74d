"""Convert plain arguments of the command line (texts, paths, numbers, absent values) without pydantic.

Typer builds a pydantic validator for every parameter of a command, given or not, and importing pydantic takes longer
than the rest of parsing a command line. Most parameters are absent, and most of the others have plain values. Other
values and invalid ones are converted by Typer itself, so that its error messages stay the same.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any, get_args, get_origin

_NUMBERS = {int: re.compile(r"\d{1,9}", re.ASCII), float: re.compile(r"\d{1,9}(\.\d{1,9})?", re.ASCII)}
"""Patterns of number texts that all parsers convert to the same value."""

_PATH_CHECKS = ("exists", "resolve_path", "writable", "path_type")


def convert_plain_values(parameters: Iterable[Any]) -> None:
    """Make the parameters of a command convert plain values without Typer, if this version of Typer allows it.

    Parameters
    ----------
    parameters : iterable of typer.core.TyperArgument or typer.core.TyperOption
        The parameters, which are changed; parameters that were changed before are left unchanged.
    """
    for one in parameters:
        has_parts = hasattr(one, "get_runtime_param") and hasattr(one, "type_descriptor")
        if has_parts and "get_runtime_param" not in vars(one):
            one.get_runtime_param = partial(_Values, one.get_runtime_param, one.type_descriptor)


class _Values:
    """The converter of a parameter, which passes values that are not plain to Typer's converter, created on demand."""

    def __init__(self, as_always: Any, descriptor: Any) -> None:
        self._as_always = as_always
        self._descriptor = descriptor

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """Return the converted value of a parameter; if it is absent, None, or an empty tuple if it can be repeated."""
        several = param.multiple or param.nargs == -1
        if value is None:
            return () if several else None
        kind, about = self._descriptor.annotation, self._descriptor.parameter_info
        if several and get_origin(kind) is list and isinstance(value, tuple | list):
            (each,) = get_args(kind)
            if all(is_plain(word, each, about) for word in value):
                return [each(word) for word in value]
        elif not several and is_plain(value, kind, about):
            return kind(value)
        return self._as_always().coerce(value, param=param, ctx=ctx)


def is_plain(value: Any, kind: Any, about: Any) -> bool:
    """Return whether `kind(value)` is the value that Typer makes of a word or of a default.

    Parameters
    ----------
    value : object
        A word of the command line, or a default.
    kind : type
        Type of the parameter.
    about : typer.models.ParameterInfo
        The declaration of the parameter.
    """
    if about.parser is not None:
        return False
    if kind is str:
        return type(value) is str
    if kind is Path:
        word = os.fspath(value) if isinstance(value, str | Path) else "\0"
        checked = any(getattr(about, name) for name in _PATH_CHECKS) or not (about.file_okay and about.dir_okay)
        return not checked and "\0" not in word and (not os.path.exists(word) or os.access(word, os.R_OK))
    if kind not in _NUMBERS or about.clamp:
        return False
    is_number = _NUMBERS[kind].fullmatch(value) if isinstance(value, str) else type(value) in (int, kind)
    low, high = about.min, about.max
    return bool(is_number) and (low is None or kind(value) >= low) and (high is None or kind(value) <= high)
