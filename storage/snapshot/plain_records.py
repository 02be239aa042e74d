"""Make records from JSON values by the types of their fields, without pydantic, which is slow to import.

A value of another type raises an error without details; pydantic, which makes the same records, then names the value.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from types import MappingProxyType
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

Record = TypeVar("Record")

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


@cache
def _reader(kind: Any) -> Reader:
    """Return the function that converts a JSON value to a type, or raises a ValueError."""
    if is_dataclass(kind) and isinstance(kind, type):
        return _dataclass_reader(kind)
    origin, of = get_origin(kind), get_args(kind)
    if origin is Annotated:
        reader: Reader = next(note.read for note in of[1:] if hasattr(note, "read"))
        return reader
    if origin is tuple:
        return _list_reader(of[0]) if of[1:] == (...,) else _tuple_reader(of)
    if origin is dict and of[0] is str:
        return _dict_reader(of[1])
    if origin is Literal:
        return _literal_reader(of)
    return _READERS[kind]


def _text(value: Any) -> str:
    if type(value) is not str:
        raise ValueError
    return value


def _integer(value: Any) -> int:
    if type(value) is not int:
        raise ValueError
    return value


def _number(value: Any) -> float:
    if type(value) is not float and type(value) is not int:
        raise ValueError
    return float(value)


def _truth(value: Any) -> bool:
    if type(value) is not bool:
        raise ValueError
    return value


_READERS = MappingProxyType({str: _text, int: _integer, float: _number, bool: _truth, Any: lambda value: value})


def _literal_reader(words: tuple[Any, ...]) -> Reader:
    def read(value: Any) -> Any:
        if type(value) is not str or value not in words:
            raise ValueError
        return value

    return read


def _list_reader(kind: Any) -> Reader:
    each = _reader(kind)

    def read(value: Any) -> tuple[Any, ...]:
        if type(value) is not list:
            raise ValueError
        return tuple(map(each, value))

    return read


def _tuple_reader(kinds: tuple[Any, ...]) -> Reader:
    readers = tuple(map(_reader, kinds))

    def read(value: Any) -> tuple[Any, ...]:
        if type(value) is not list or len(value) != len(readers):
            raise ValueError
        return tuple(one(item) for one, item in zip(readers, value, strict=True))

    return read


def _dict_reader(kind: Any) -> Reader:
    each = _reader(kind)

    def read(value: Any) -> dict[str, Any]:
        if type(value) is not dict:
            raise ValueError
        return {_text(key): each(item) for key, item in value.items()}

    return read


def _dataclass_reader(kind: type) -> Reader:
    hints = get_type_hints(kind, include_extras=True)
    readers = {one.name: _reader(hints[one.name]) for one in fields(kind)}
    needed = {one.name for one in fields(kind) if one.default is MISSING and one.default_factory is MISSING}

    def read(value: Any) -> Any:
        if type(value) is not dict or not needed <= value.keys():
            raise ValueError
        return kind(**{name: each(value[name]) for name, each in readers.items() if name in value})

    return read
