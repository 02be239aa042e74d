"""Find the parameters of stages that name files: make paths absolute, and list the files for the history of runs."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ConfigDict
from pydantic.fields import FieldInfo

from kinedex.catalog.queries.query_reader import query_file_paths
from kinedex.ops.errors import KinedexError


class StageParameters(BaseModel):
    """The base class of parameters of stages; names that it does not know are errors."""

    model_config = ConfigDict(extra="forbid")


@dataclass(frozen=True)
class NamesFile:
    """Annotation of a parameter (a text or a list of texts) that names files or a folder.

    Attributes
    ----------
    kind : str
        "data" for a folder or file of data, which the history does not copy; "file" for a file of settings, or a
        folder of YAML files; "queries" or another kind of `catalog.configs.KINDS` if a shipped file may be named.
    """

    kind: str


def with_absolute_paths(params: type[BaseModel], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of parameters, with all paths in them made absolute.

    Parameters
    ----------
    params : type of BaseModel
        The parameters of a stage.
    values : mapping of str to object
        Values of some or all of them, as JSON values.
    """
    return {name: _changed(params.model_fields.get(name), value) for name, value in values.items()}


def _changed(field: FieldInfo | None, value: Any) -> Any:
    if field is None:
        return value
    kind = next((one.kind for one in field.metadata if isinstance(one, NamesFile)), None)
    if kind is not None:
        return _of_texts(value, partial(_absolute, kind=kind))
    inner = _model_in(field.annotation)
    if inner is None:
        return value
    if isinstance(value, list):
        return [with_absolute_paths(inner, one) if isinstance(one, dict) else one for one in value]
    is_model = field.annotation is inner
    return with_absolute_paths(inner, value) if is_model and isinstance(value, dict) else value


def _model_in(annotation: object) -> type[BaseModel] | None:
    """Return the pydantic model inside a type such as `list[Method]`; None if there is none."""
    if isinstance(annotation, type) and not get_args(annotation):
        return annotation if issubclass(annotation, BaseModel) else None
    return next((found for one in get_args(annotation) if (found := _model_in(one)) is not None), None)


def setting_files(params: BaseModel) -> Iterator[Path]:
    """Yield the readable files that parameters name, other than data and shipped files."""
    for name, field in type(params).model_fields.items():
        kind = next((one.kind for one in field.metadata if isinstance(one, NamesFile)), None)
        value = getattr(params, name)
        for inner in value if isinstance(value, list) else [value]:
            if isinstance(inner, str) and kind not in (None, "data"):
                yield from _files(inner, str(kind))
            elif isinstance(inner, BaseModel):
                yield from setting_files(inner)


def _of_texts(value: Any, change: Callable[[str], str]) -> Any:
    if isinstance(value, str):
        return change(value)
    return [change(one) if isinstance(one, str) else one for one in value] if isinstance(value, list) else value


def _absolute(text: str, kind: str) -> str:
    """Return a path as an absolute path; shipped names and reserved words are returned unchanged."""
    if kind == "data" or kind == "file" or "/" in text or text.endswith((".yaml", ".yml", ".json")):
        return os.path.abspath(Path(text).expanduser())
    return text


def _files(text: str, kind: str) -> Iterator[Path]:
    path = Path(_absolute(text, kind))
    if not path.is_absolute():
        return
    if path.is_dir():
        yield from sorted(one for one in path.rglob("*") if one.suffix in (".yaml", ".yml") and one.is_file())
    elif kind == "queries":
        try:
            yield from query_file_paths([path])
        except KinedexError:
            return
    elif path.is_file():
        yield path
