"""Read pipeline files: stages by name, their inputs and parameters, and settings that the user gives."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.configs import Located, config_path, load_yaml, parse_yaml, read_text, shipped_configs
from kinedex.ops.errors import ConfigError, KinedexError, did_you_mean
from kinedex.ops.local_paths import refuse_addresses
from kinedex.pipelines.engine.stage import STAGES, Input, Stage, load_stage

_SETTING = re.compile(r"\$\{([A-Za-z_][A-Za-z0-9_]*)\}")


KnownFailures = Literal["report", "remember"]
"""With "report", every run reports all failures; with "remember", the store keeps them, and a run reports new ones."""


class _StageEntry(BaseModel):
    model_config = ConfigDict(extra="forbid")
    uses: str | None = None
    inputs: dict[str, str] = {}
    params: dict[str, Any] = {}


class _PipelineFile(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$")
    description: str = ""
    settings: dict[str, Any] = {}
    known_failures: KnownFailures = "report"
    stages: dict[str, _StageEntry | None] = Field(min_length=1)


@dataclass(frozen=True)
class PipelineStage:
    """One stage of a pipeline.

    Attributes
    ----------
    name : str
        The name of the stage in the pipeline.
    kind : Stage
        The kind of stage.
    inputs : dict of str to str
        Input role → the name of the stage that fills it.
    params : BaseModel
        The validated parameters.
    unset : frozenset of str
        The parameters that neither the user nor the user's file sets. Each has its default, or the default of a
        setting of a shipped pipeline.
    """

    name: str
    kind: Stage[BaseModel]
    inputs: dict[str, str]
    params: BaseModel
    unset: frozenset[str] = frozenset()

    @property
    def uses(self) -> str:
        """The name of the kind of stage."""
        return self.kind.name


@dataclass(frozen=True)
class Pipeline:
    """A pipeline file with its settings filled in; its stages are in an order in which they can run."""

    name: str
    path: Path
    description: str
    stages: tuple[PipelineStage, ...] = field(default_factory=tuple)
    text: str = ""
    known_failures: KnownFailures = "report"

    def stage(self, name: str) -> PipelineStage:
        """Return a stage by its name; raise a KinedexError, which suggests the nearest name, if there is none."""
        for stage in self.stages:
            if stage.name == name:
                return stage
        raise KinedexError(f"{self.path}: no stage '{name}'{did_you_mean(name, [s.name for s in self.stages])}")


@dataclass(frozen=True)
class _Given:
    """A value that the user gives for a setting or a parameter: a text of `--set`, or a Python value."""

    name: str
    value: Any
    is_text: bool

    @property
    def place(self) -> str:
        """The way in which the user gave the value, for messages."""
        return f"--set {self.name}" if self.is_text else f"settings['{self.name}']"

    @property
    def shown(self) -> str:
        """The way in which the user gave the value, and the value, for messages."""
        return f"{self.place}={self.value}" if self.is_text else f"{self.place} = {self.value!r}"

    def parsed(self, is_text_expected: bool) -> Any:
        """Return the value; a text of `--set` is parsed as YAML, unless a text is expected."""
        if not self.is_text:
            return _plain(self.value)
        if is_text_expected:
            return self.value
        try:
            return parse_yaml(self.value, self.place).data
        except ConfigError as fault:
            raise KinedexError(f"{self.shown}: {fault.reason}; {self._quotes()}") from None

    def _quotes(self) -> str:
        """Return advice on how to quote a text of `--set` that is not valid YAML."""
        if '"' not in self.value or "\\" not in self.value:
            return "quote it"
        single = self.value.replace("'", "''").replace('"', "'")
        text = f"{self.name}={single}"
        shown = shlex.quote(text) if set('$`"!') & set(text) else f'"{text}"'
        return f"in double quotes YAML reads a backslash as the begin of a code; use single ones: --set {shown}"


def _plain(value: Any) -> Any:
    """Return a value with paths converted to texts and numpy numbers to Python numbers, also inside containers."""
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, dict):
        return {_plain(key): _plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(part) for part in value]
    return value.item() if hasattr(value, "item") and getattr(value, "ndim", None) == 0 else value


def load_pipeline(
    name_or_path: str | Path,
    assignments: Mapping[str, str] | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Pipeline:
    """Read a pipeline file.

    Parameters
    ----------
    name_or_path : str or Path
        A shipped name, or a path ending in .yaml.
    assignments : mapping of str to str, optional
        The texts of `--set` on the command line: "name" for a setting of the file, "stage.key" for a parameter of a
        stage. Values are YAML.
    settings : mapping of str to object, optional
        Python values for the same names. For a parameter that only one stage has, the name may omit the stage.

    Raises
    ------
    ConfigError
        The pipeline file is invalid; the message names file, line and key, and the nearest valid name.
    KinedexError
        A given value is invalid, or there is no setting or parameter of its name.
    """
    given = [_Given(name, text, True) for name, text in (assignments or {}).items()]
    given += [_Given(name, value, False) for name, value in (settings or {}).items()]
    return _PipelineReader(load_yaml(config_path("pipelines", name_or_path)), assignments is not None).read(given)


class _PipelineReader:
    """Builds a pipeline from a file and from the values that the user gives.

    Parameters
    ----------
    located : Located
        The file.
    from_command_line : bool
        True where messages refer to `--set`; else they refer to the argument `settings`.
    """

    def __init__(self, located: Located, from_command_line: bool) -> None:
        self._located = located
        self._from_command_line = from_command_line
        located.mapping()
        self._file = located.model(_PipelineFile)
        self._entries = {name: entry or _StageEntry() for name, entry in self._file.stages.items()}
        self._settings = dict(self._file.settings)
        self._defaults = set(self._settings) if located.path.is_relative_to(shipped_configs()) else set()
        self._overrides: dict[str, dict[str, _Given]] = {}

    def read(self, given: Sequence[_Given]) -> Pipeline:
        """Fill in the given values, and check all settings, stages and parameters."""
        for one in given:
            self._assign(one)
        for name in self._settings.keys() - {one.name for one in given}:
            self._refuse_addresses(self._settings[name], "settings", name)
        stages = [self._stage(name) for name in self._entries]
        text = read_text(self._located.path)
        file = self._file
        return Pipeline(file.name, self._located.path, file.description, _ordered(stages), text, file.known_failures)

    def _assign(self, one: _Given) -> None:
        stage, dot, key = one.name.partition(".")
        if not dot:
            if one.name in self._settings:
                before = self._settings[one.name]
                self._defaults.discard(one.name)
                self._settings[one.name] = one.parsed(before is None or isinstance(before, str))
                return
            stage, key = self._only_stage_with(one), one.name
        path = self._located.path
        if stage not in self._entries:
            raise KinedexError(f"{one.place}: {path} has no stage '{stage}'{did_you_mean(stage, self._entries)}")
        known = self._kind(stage).parameters.model_fields
        if key not in known:
            raise KinedexError(f"{one.place}: stage '{stage}' has no parameter '{key}'{did_you_mean(key, known)}")
        self._overrides.setdefault(stage, {})[key] = one

    def _only_stage_with(self, one: _Given) -> str:
        """Return the only stage that has the given parameter; raise a KinedexError if none or several have it."""
        stages = [stage for stage in self._entries if one.name in self._kind(stage).parameters.model_fields]
        if len(stages) == 1:
            return stages[0]
        if stages:
            names = " or ".join(f"{stage}.{one.name}" for stage in stages)
            raise KinedexError(f"{one.place}: several stages have this parameter; name one: {names}")
        hint = did_you_mean(one.name, self._settings) if self._settings else "; it has none"
        raise KinedexError(f"{one.place}: {self._located.path} has no setting of that name{hint}")

    def _kind(self, name: str) -> Stage[BaseModel]:
        """Return the kind of a stage that the file names."""
        uses = self._entries[name].uses or name
        if uses not in STAGES:
            key = ("uses",) if self._entries[name].uses else ()
            raise self._located.error(f"there is no stage '{uses}'{did_you_mean(uses, STAGES)}", "stages", name, *key)
        return load_stage(uses)

    def _stage(self, name: str) -> PipelineStage:
        kind = self._kind(name)
        key = ("stages", name, "params")
        entry = self._entries[name].params
        for option, value in entry.items():
            self._refuse_addresses(value, *key, option)
        params = {option: self._fill(value, (*key, option)) for option, value in entry.items()}
        given = self._overrides.get(name, {})
        fields = kind.parameters.model_fields
        params |= {option: one.parsed(fields[option].annotation in (str, str | None)) for option, one in given.items()}
        refuse_addresses(params)
        try:
            filled = self._located.model(kind.parameters, *key, data=params)
        except ConfigError as fault:
            option = re.split(r"[.\[]", (fault.key or "").removeprefix(f"{'.'.join(key)}."))[0]
            if option in given:
                raise KinedexError(f"{given[option].shown}: {fault.reason}") from None
            raise
        unset = {option for option in fields if option not in params}
        unset |= {option for option, value in entry.items() if option not in given and self._is_default(value)}
        return PipelineStage(name, kind, self._inputs(name, kind), filled, frozenset(unset))

    def _refuse_addresses(self, value: Any, *key: str) -> None:
        """Raise an error, with the line of the file, if a value is the address of remote data."""
        try:
            refuse_addresses(value)
        except KinedexError as fault:
            raise self._located.error(str(fault), *key) from None

    def _is_default(self, value: Any) -> bool:
        """Return whether a value of the file refers to a setting that has its default in a shipped pipeline."""
        whole = _SETTING.fullmatch(value) if isinstance(value, str) else None
        return whole is not None and whole[1] in self._defaults

    def _fill(self, value: Any, key: tuple[str | int, ...]) -> Any:
        """Replace `${setting}` in texts; a text that consists of one setting alone takes the setting's type."""
        if isinstance(value, dict):
            return {name: self._fill(part, (*key, name)) for name, part in value.items()}
        if isinstance(value, list):
            return [self._fill(part, (*key, i)) for i, part in enumerate(value)]
        if not isinstance(value, str):
            return value
        settings = self._settings
        for name in _SETTING.findall(value):
            if name not in settings:
                raise self._located.error(f"there is no setting '{name}'{did_you_mean(name, settings)}", *key)
            if settings[name] is None:
                way = f"--set {name}=…" if self._from_command_line else f"settings={{'{name}': …}}"
                raise self._located.error(f"the setting '{name}' must be given: {way}", "settings", name)
        whole = _SETTING.fullmatch(value)
        return settings[whole[1]] if whole else _SETTING.sub(lambda found: str(settings[found[1]]), value)

    def _inputs(self, name: str, kind: Stage[BaseModel]) -> dict[str, str]:
        """Return the stage for each input role: the one that the file names, else the only one of the right kind.

        Optional roles for which there is no stage are left out.
        """
        given = self._entries[name].inputs
        for role in given:
            if role not in kind.inputs:
                hint = did_you_mean(role, kind.inputs)
                raise self._located.error(f"'{kind.name}' has no input '{role}'{hint}", "stages", name, "inputs", role)
        found = {}
        for role, needed in kind.inputs.items():
            stage = self._named(name, role, needed) if role in given else self._only(name, kind, role, needed)
            if stage is not None:
                found[role] = stage
        return found

    def _named(self, name: str, role: str, needed: Input) -> str:
        """Return the stage that the file names for an input role; raise a ConfigError if it has the wrong kind."""
        stage = self._entries[name].inputs[role]
        key = ("stages", name, "inputs", role)
        if stage not in self._entries:
            raise self._located.error(f"there is no stage '{stage}'{did_you_mean(stage, self._entries)}", *key)
        kind = self._entries[stage].uses or stage
        if kind != needed.stage:
            raise self._located.error(f"must be a stage '{needed.stage}', but '{stage}' is a stage '{kind}'", *key)
        return stage

    def _only(self, name: str, kind: Stage[BaseModel], role: str, needed: Input) -> str | None:
        candidates = [other for other, entry in self._entries.items() if (entry.uses or other) == needed.stage]
        if len(candidates) > 1:
            raise self._located.error(
                f"input '{role}' could be any of {', '.join(candidates)}; name one under `inputs`", "stages", name
            )
        if not candidates and not needed.optional:
            raise self._located.error(
                f"'{kind.name}' needs a stage '{needed.stage}' for its input '{role}'", "stages", name
            )
        return candidates[0] if candidates else None


def _ordered(stages: list[PipelineStage]) -> tuple[PipelineStage, ...]:
    """Return the stages ordered such that each comes after its inputs, and otherwise as in the file."""
    result: list[PipelineStage] = []
    waiting = list(stages)
    while waiting:
        done = {stage.name for stage in result}
        ready = next((stage for stage in waiting if done.issuperset(stage.inputs.values())), None)
        if ready is None:
            raise KinedexError(f"the stages {', '.join(stage.name for stage in waiting)} need each other")
        result.append(ready)
        waiting.remove(ready)
    return tuple(result)
