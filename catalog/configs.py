"""Find configuration files by kind and name, and parse them as YAML with line numbers."""

from __future__ import annotations

import copy
import math
import re
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args

import yaml
from pydantic import AfterValidator, BaseModel, Field, ValidationError

from kinedex.catalog.yaml_nodes import MAX_BYTES, MAX_DIGITS, composed, too_large
from kinedex.ops.errors import ConfigError, KinedexError, did_you_mean
from kinedex.ops.local_paths import refuse_addresses

KINDS = {
    "skeletons": "skeleton mapping",
    "names": "vocabulary of names",
    "features": "feature set",
    "classes": "class file",
    "queries": "query file",
    "kinematics": "kinematic chain",
    "keypoints": "keypoint set",
    "bodies": "body for depth images",
    "sensors": "file of sensors",
    "imu_grades": "grade of simulated sensors",
    "printed": "file of printed results",
    "bodies/filmed": "body before simulated depth cameras",
    "pipelines": "pipeline",
}
"""A dict from kind of configuration file, which is a folder of the shipped `configs/`, to the noun used in messages."""

_UNION_TYPE = re.compile(r"literal\[.*\]|(?:constrained-)?(?:float|int|str)|list\[.*\]|bool")
"""Matches the type that pydantic appends to the key of a union, such as `literal['auto']` in `tau.literal['auto']`."""

Key = tuple[str | int, ...]
Model = TypeVar("Model", bound=BaseModel)


def _of_this_machine(path: str) -> str:
    try:
        refuse_addresses(path)
    except KinedexError as fault:
        raise ValueError(str(fault)) from None  # `Located.model` adds file, line and key
    return path


LocalPath = Annotated[str, Field(min_length=1), AfterValidator(_of_this_machine)]
"""A path or a pattern of paths in a configuration file; addresses with a scheme such as s3:// are rejected."""


@lru_cache(maxsize=1)
def shipped_configs() -> Path:
    """Return the folder of the configuration files that come with kinedex, in a checkout and in a wheel alike."""
    return Path(__file__).resolve().parents[1] / "configs"


def config_names(kind: str) -> list[str]:
    """Return the names of the shipped files of one kind, sorted."""
    return sorted(path.stem for path in (shipped_configs() / kind).glob("*.yaml"))


def config_path(kind: str, name: str | Path) -> Path:
    """Return the path of a configuration file that is given by its path or by the name of a shipped file.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    name : path
        A path to a YAML file (any text with a separator or the suffix .yaml, .yml or .json), or a shipped name.

    Raises
    ------
    ConfigError
        If no such file exists; the message names the nearest shipped file.
    """
    refuse_addresses(name)
    text = str(name)
    if "/" in text or text.endswith((".yaml", ".yml", ".json")):
        path = Path(text).expanduser()
        if not path.is_file():
            raise ConfigError(path, f"no such file; expected a {KINDS[kind]}")
        return path
    path = shipped_configs() / kind / f"{text}.yaml"
    if not path.is_file():
        raise ConfigError(
            text,
            f"no {KINDS[kind]} is called that{did_you_mean(text, config_names(kind))}"
            " (a file of your own is given by its path, ending in .yaml)",
        )
    return path


@dataclass(frozen=True)
class Located:
    """Parsed YAML with the line of every key: `lines[("stages", "ingest", "source")]` is a line number from 1."""

    path: Path
    data: Any
    lines: dict[Key, int] = field(default_factory=dict)

    def line(self, *key: str | int) -> int | None:
        """Return the line of a key, or of the nearest enclosing key with a line; None if no line is known."""
        for end in range(len(key), -1, -1):
            if key[:end] in self.lines:
                return self.lines[key[:end]]
        return None

    def error(self, message: str, *key: str | int) -> ConfigError:
        """Return an error that names this file, the key and its line."""
        return ConfigError(self.path, message, line=self.line(*key), key=_dotted(key) or None)

    def mapping(self) -> dict[str, Any]:
        """Return the top level as a mapping; raise a ConfigError if it is something else."""
        if not isinstance(self.data, dict):
            raise self.error(f"expected a mapping of names, found {_kind_of(self.data)}")
        return self.data

    def model(self, model: type[Model], *key: str | int, data: Any = None) -> Model:
        """Validate the value at `key`, or `data` instead of it, as a pydantic model.

        Raises
        ------
        ConfigError
            If the value is invalid; the message has the line of the first fault, what was expected, and the nearest
            valid name.
        """
        part = data
        if part is None:
            part = self.data
            for step in key:
                part = part[step]
        try:
            return model.model_validate({} if part is None else part)
        except ValidationError as fault:
            raise self._translate(model, fault, key) from None

    def _translate(self, model: type[BaseModel], fault: ValidationError, key: Key) -> ConfigError:
        # A misspelt key also makes the right one missing, and the misspelling is the more useful message.
        errors = fault.errors(include_url=False)
        first = min(errors, key=lambda error: error["type"] != "extra_forbidden")
        choices = [one for one in errors if _is_choice(one["loc"]) and one["loc"][:-1] == first["loc"][:-1]]
        at = (*key, *first["loc"])
        if first in choices:
            found = dict.fromkeys(_reason(one).partition(", ")[0] for one in choices)
            return self.error(f"must be {' or '.join(found)}, got {first['input']!r}", *at[:-1])
        if first["type"] == "extra_forbidden":
            known = _fields_at(model, first["loc"][:-1])
            return self.error(f"no such key{did_you_mean(str(first['loc'][-1]), known)}", *at)
        if first["type"] == "missing":
            return self.error("this key is missing", *at)
        if first["type"] in ("too_short", "string_too_short"):
            least = first["ctx"]["min_length"]
            what = "character" if first["type"] == "string_too_short" else "entry"
            many = what if least == 1 else {"character": "characters", "entry": "entries"}[what]
            return self.error(f"must have at least {least} {many}, got {first['input']!r}", *at)
        reason = _reason(first)
        got = "" if first["type"] == "value_error" else f", got {first['input']!r}"
        must = "" if first["type"] == "value_error" else "must be "
        return self.error(f"{must}{reason}{got}", *at)


def _reason(error: Any) -> str:
    """Return the part of a pydantic error message that states what was expected."""
    return str(error["msg"]).removeprefix("Value error, ").removeprefix("Input should be ")


def _is_choice(loc: tuple[int | str, ...]) -> bool:
    """Return whether the location of a pydantic error ends with one of the types of a union."""
    return bool(loc) and isinstance(loc[-1], str) and _UNION_TYPE.fullmatch(loc[-1]) is not None


def _fields_at(model: type[BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    """Return the keys of the nested model that contains the location of a pydantic error."""
    current: Any = model
    for step in loc:
        fields = getattr(current, "model_fields", {})
        if step in fields:  # other steps are keys or indices of containers of models
            current = _model_in(fields[step].annotation)
    return [field.alias or name for name, field in getattr(current, "model_fields", {}).items()]


def _model_in(annotation: Any) -> Any:
    """Return the first model inside an annotation such as `dict[str, Model | None]`, or the annotation itself."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for part in get_args(annotation) if (found := _model_in(part)) is not None), None)


def _dotted(key: Key) -> str:
    text = ""
    for step in key:
        text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else str(step)
    return text


def _kind_of(data: object) -> str:
    if data is None:
        return "nothing (the file is empty)"
    for kind, name in ((list, "a list"), (str, "a text"), (dict, "a mapping")):
        if isinstance(data, kind):
            return name
    return repr(data)


def load_yaml(path: str | Path) -> Located:
    """Read one YAML (or JSON) file with the line of every key.

    Raises
    ------
    ConfigError
        If the file cannot be read, is not UTF-8 or not YAML, repeats a key, or exceeds the bounds of
        `kinedex.catalog.yaml_nodes`; the message names the line.
    """
    return parse_yaml(read_text(Path(path)), path)


def read_text(path: Path, encoding: Literal["utf-8", "utf-8-sig"] = "utf-8") -> str:
    """Return the text of a configuration file.

    Raises
    ------
    ConfigError
        If the file cannot be read, is not UTF-8, or has more than `MAX_BYTES`.
    """
    try:
        with path.open(encoding=encoding) as file:
            text = file.read(MAX_BYTES + 1)
    except OSError as fault:
        raise ConfigError(path, f"cannot be read: {fault.strerror}") from fault
    except UnicodeDecodeError as fault:
        raise ConfigError(path, f"is not UTF-8 text (byte {fault.start})") from fault
    if len(text) > MAX_BYTES:
        raise too_large(path, "is larger than may be")
    return text


def parse_yaml(text: str, path: str | Path) -> Located:
    """Parse YAML text like `load_yaml`; errors name `path`."""
    known = _parsed(text, Path(path))
    return Located(known.path, copy.deepcopy(known.data), dict(known.lines))


@lru_cache(maxsize=32)  # A run reads the same dozen files repeatedly, and YAML is slow to parse.
def _parsed(text: str, path: Path) -> Located:
    located = Located(path, None, {})
    try:
        node = composed(text, path)
        data = None if node is None else _construct(node, (), located, yaml.SafeLoader(""))
    except yaml.MarkedYAMLError as fault:
        line = fault.problem_mark.line + 1 if fault.problem_mark else None
        raise ConfigError(path, f"is not valid YAML: {fault.problem}", line=line) from None
    except (yaml.YAMLError, ValueError, TypeError, LookupError, AttributeError, ArithmeticError) as fault:
        # Invalid dates, unhashable keys, and faults inside PyYAML itself.
        raise ConfigError(path, f"is not valid YAML: {fault}") from None
    except RecursionError:
        raise ConfigError(path, "is nested too deeply, or an alias contains itself") from None
    return Located(located.path, data, located.lines)


def _construct(node: yaml.Node, key: Key, located: Located, constructor: yaml.SafeLoader) -> Any:
    located.lines.setdefault(key, node.start_mark.line + 1)
    if isinstance(node, yaml.MappingNode):
        constructor.flatten_mapping(node)
        result: dict[Any, Any] = {}
        for key_node, value_node in node.value:
            name = constructor.construct_object(key_node, deep=True)
            inner = (*key, name)
            line = key_node.start_mark.line + 1
            if name in result:
                first = located.lines.get(inner)
                raise ConfigError(
                    located.path,
                    f"this key stands twice (first in line {first})",
                    line=line,
                    key=_dotted(inner),
                )
            located.lines[inner] = line
            result[name] = _construct(value_node, inner, located, constructor)
        return result
    if isinstance(node, yaml.SequenceNode):
        return [_construct(item, (*key, i), located, constructor) for i, item in enumerate(node.value)]
    return constructor.construct_object(node, deep=True)


def scalar(text: str) -> str:
    """Return a text as a YAML scalar, with quotes only if YAML would read the plain text as another value."""
    short = len(text) <= MAX_DIGITS and text.isascii() and text.replace("_", "").isalnum()
    plain = short and yaml.safe_load(text) == text
    return text if plain else yaml.safe_dump(text, default_style='"', width=math.inf, allow_unicode=True).strip()
