"""Check arguments of the public functions against their type annotations, with one error for all wrong types."""

from __future__ import annotations

import ast
import functools
import inspect
import numbers
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from kinedex.ops.errors import ParameterError
from kinedex.ops.local_paths import refuse_addresses

T = TypeVar("T", bound=Callable[..., Any])
C = TypeVar("C")

Accepts = Callable[[object], bool]


def _is_number(value: object, kind: type) -> bool:
    return isinstance(value, kind) and not isinstance(value, bool | np.bool_)


_KINDS: dict[str, tuple[str, Accepts]] = {
    "None": ("None", lambda value: value is None),
    "str": ("a text", lambda value: isinstance(value, str)),
    "bool": ("True or False", lambda value: isinstance(value, bool | np.bool_)),
    "int": ("a whole number", lambda value: _is_number(value, numbers.Integral)),
    "float": ("a number", lambda value: _is_number(value, numbers.Real)),
    "Path": ("a path", lambda value: isinstance(value, os.PathLike)),
    "PathLike": ("a path", lambda value: isinstance(value, os.PathLike)),
    "Mapping": ("a mapping", lambda value: isinstance(value, Mapping)),
    "Sequence": ("a sequence", lambda value: isinstance(value, Sequence | np.ndarray) and not isinstance(value, str)),
    "Iterable": ("a sequence", lambda value: isinstance(value, Iterable) and not isinstance(value, str)),
}
"""A dict from type name in annotations to its description in errors and the check of a value."""

_CLASSES = {"Store", "Take", "Template", "Query", "DataFrame"}
"""Classes that are checked by name, so that the modules that define them need not be imported."""


def checked(function: T) -> T:
    """Return a public function that raises a ParameterError for an argument of a wrong type.

    Arguments that can be paths must be paths of this machine. An argument is checked if its annotation names plain
    types, classes of the public interface, or sequences of these. The function checks all others, such as arrays.
    """
    signature = inspect.signature(function)
    found = ((name, _check_of(one.annotation)) for name, one in signature.parameters.items())
    checks = {name: check for name, check in found if check is not None}
    paths = [name for name, one in signature.parameters.items() if "Path" in str(one.annotation)]

    @functools.wraps(function)
    def guarded(*arguments: Any, **named: Any) -> Any:
        given = signature.bind(*arguments, **named).arguments
        refuse_addresses([given[name] for name in paths if name in given])
        for name, value in given.items():
            if name in checks and not checks[name][1](value):
                raise ParameterError(name, checks[name][0], value)
        return function(*arguments, **named)

    return guarded  # type: ignore[return-value]


def checked_methods(made: type[C]) -> type[C]:
    """Check the arguments of all public methods of a class as `checked` does, including inherited methods."""
    members = {name: member for one in reversed(made.__mro__) for name, member in vars(one).items()}
    for name, member in members.items():
        if name.startswith("_"):
            continue
        if isinstance(member, classmethod):
            setattr(made, name, classmethod(checked(member.__func__)))
        elif inspect.isfunction(member):
            setattr(made, name, checked(member))
    return made


def _check_of(annotation: object) -> tuple[str, Accepts] | None:
    """Return the description and the check of an annotation; None if annotations of its kind cannot be checked."""
    if not isinstance(annotation, str):
        return None
    return _check_of_node(ast.parse(annotation, mode="eval").body)


def _check_of_node(node: ast.expr) -> tuple[str, Accepts] | None:
    match node:
        case ast.BinOp(left=left, op=ast.BitOr(), right=right):
            parts = [_check_of_node(left), _check_of_node(right)]
            known = [part for part in parts if part is not None]
            if len(known) < len(parts):
                return None
            words = " or ".join(dict.fromkeys(word for text, _ in known for word in text.split(" or ")))
            return words, lambda value: any(accepts(value) for _, accepts in known)
        case ast.Constant(value=None):
            return _KINDS["None"]
        case ast.Subscript(value=ast.Name(id="Literal"), slice=inner):
            values = ast.literal_eval(inner)
            options = values if isinstance(values, tuple) else (values,)
            return " or ".join(map(repr, options)), lambda value: isinstance(value, str) and value in options
        case ast.Subscript(value=ast.Name(id="Sequence" | "Iterable" as name), slice=inner):
            return _members(_KINDS[name], _check_of_node(inner))
        case ast.Subscript(value=ast.Name(id=name) | ast.Attribute(attr=name)) if name in ("Mapping", "PathLike"):
            return _KINDS[name]
        case ast.Name(id=name) | ast.Attribute(attr=name):
            if name in _CLASSES:
                return f"a {name}", lambda value: any(one.__name__ == name for one in type(value).__mro__)
            return _KINDS.get(name)
    return None


def _members(whole: tuple[str, Accepts], member: tuple[str, Accepts] | None) -> tuple[str, Accepts]:
    words, accepts = whole
    if member is None:
        return whole
    # items of an iterator are not checked, as that would consume it
    kinds = ", ".join(word.removeprefix("a ") for word in member[0].split(" or "))
    return (
        f"{words} of {kinds}",
        lambda value: accepts(value) and (not isinstance(value, list | tuple) or all(map(member[1], value))),
    )
