"""Make records from JSON values by the types of their fields, without pydantic, which is slow to import.

A value of another type raises an error without details. The caller can then validate the same JSON with pydantic, whose
error names the value.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import cache, partial
from types import MappingProxyType
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

Record = TypeVar("Record")
Value = TypeVar("Value")

Reader = Callable[[Any], Any]


def record_of(kind: type[Record], value: object) -> Record:
    """Return the record that a JSON object describes; unknown keys are ignored.

    Parameters
    ----------
    kind : type
        A dataclass whose fields are JSON values, or dataclasses, tuples or dictionaries of them.
    value : object
        The JSON object.

    Raises
    ------
    ValueError
        The object does not describe such a record.
    """
    of: Any = kind
    record: Record = _reader(of)(value)
    return record


def _exactly(kind: type[Value], value: Any) -> Value:
    """Return a value; raise a ValueError unless it is of exactly the given type, not a subtype."""
    if type(value) is not kind:
        raise ValueError
    return value


def _number(value: Any) -> float:
    return float(value) if type(value) is int else _exactly(float, value)


def _one_of(words: tuple[Any, ...], value: Any) -> Any:
    if _exactly(str, value) not in words:
        raise ValueError
    return value


_PLAIN: dict[Any, Reader] = {kind: partial(_exactly, kind) for kind in (str, int, bool)}
_READERS = MappingProxyType({**_PLAIN, float: _number, Any: lambda value: value})


@cache
def _reader(kind: Any) -> Reader:
    """Return the function that converts a JSON value to a type, or raises a ValueError."""
    if is_dataclass(kind) and isinstance(kind, type):
        return _dataclass_reader(kind)
    origin, of = get_origin(kind), get_args(kind)
    if origin is Annotated:
        reader: Reader = next(note.read for note in of[1:] if hasattr(note, "read"))
        return reader
    if origin is Literal:
        return partial(_one_of, of)
    if origin is tuple and of[1:] != (...,):
        readers = tuple(map(_reader, of))
        return lambda value: tuple(one(item) for one, item in zip(readers, _exactly(list, value), strict=True))
    if origin is tuple:
        each = _reader(of[0])
        return lambda value: tuple(map(each, _exactly(list, value)))
    if origin is dict and of[0] is str:
        each = _reader(of[1])
        return lambda value: {_exactly(str, key): each(item) for key, item in _exactly(dict, value).items()}
    return _READERS[kind]


def _dataclass_reader(kind: type) -> Reader:
    hints = get_type_hints(kind, include_extras=True)
    readers = {one.name: _reader(hints[one.name]) for one in fields(kind)}
    needed = {one.name for one in fields(kind) if one.default is MISSING and one.default_factory is MISSING}

    def read(value: Any) -> Any:
        if not needed <= _exactly(dict, value).keys():
            raise ValueError
        return kind(**{name: each(value[name]) for name, each in readers.items() if name in value})

    return read
