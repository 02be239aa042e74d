"""Pipeline files: stages by name, their inputs and parameters, and settings that the user fills in."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.configs import Located, config_path, load_yaml, parse_yaml
from kinedex.ops.errors import ConfigError, KinedexError, did_you_mean
from kinedex.pipelines.engine.stage import STAGES, Stage, load_stage

_SETTING = re.compile(r"\$\{([A-Za-z_][A-Za-z0-9_]*)\}")


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
    stages: dict[str, _StageEntry | None] = Field(min_length=1)


@dataclass(frozen=True)
class PipelineStage:
    """One stage of a pipeline: its name there, its kind, the stages that play its roles, and its parameters."""

    name: str
    kind: Stage[BaseModel]
    inputs: dict[str, str]
    params: BaseModel

    @property
    def uses(self) -> str:
        """The name of the kind of stage."""
        return self.kind.name


@dataclass(frozen=True)
class Pipeline:
    """A pipeline file with its settings filled in; stages stand in an order in which they can run."""

    name: str
    path: Path
    description: str
    stages: tuple[PipelineStage, ...] = field(default_factory=tuple)

    def stage(self, name: str) -> PipelineStage:
        """A stage by its name; a KinedexError names the nearest."""
        for stage in self.stages:
            if stage.name == name:
                return stage
        raise KinedexError(f"{self.path}: no stage '{name}'{did_you_mean(name, [s.name for s in self.stages])}")


def load_pipeline(name_or_path: str | Path, assignments: Mapping[str, str] | None = None) -> Pipeline:
    """Read a pipeline file.

    Parameters
    ----------
    name_or_path: a shipped name or a path ending in .yaml.
    assignments: what the user sets: "name" for a setting of the file, "stage.key" for a parameter of a stage; the
        values are YAML text.

    Raises
    ------
    ConfigError: file, line and key of the first fault, and the nearest valid name.
    """
    located = load_yaml(config_path("pipelines", name_or_path))
    located.mapping()
    parsed = located.model(_PipelineFile)
    entries = {name: entry or _StageEntry() for name, entry in parsed.stages.items()}
    settings = dict(parsed.settings)
    overrides: dict[str, dict[str, Any]] = {}
    for name, text in (assignments or {}).items():
        _assign(located, entries, settings, overrides, name, text)
    stages = [_stage(located, entries, settings, overrides, name) for name in entries]
    return Pipeline(parsed.name, located.path, parsed.description, _ordered(stages))


def _assign(
    located: Located,
    entries: dict[str, _StageEntry],
    settings: dict[str, Any],
    overrides: dict[str, dict[str, Any]],
    name: str,
    text: str,
) -> None:
    stage, dot, key = name.partition(".")
    if not dot:
        if name not in settings:
            hint = _parameters_called(located, entries, name)
            hint = hint or (did_you_mean(name, settings) if settings else "; it has none")
            raise KinedexError(f"--set {name}: {located.path} has no setting of that name{hint}")
        literal = settings[name] is None or isinstance(settings[name], str)
        settings[name] = text if literal else _value(name, text)
        return
    if stage not in entries:
        raise KinedexError(f"--set {name}: {located.path} has no stage '{stage}'{did_you_mean(stage, entries)}")
    known = load_stage(_uses(located, entries, stage)).parameters.model_fields
    if key not in known:
        raise KinedexError(f"--set {name}: stage '{stage}' has no parameter '{key}'{did_you_mean(key, known)}")
    literal = known[key].annotation in (str, str | None)
    overrides.setdefault(stage, {})[key] = text if literal else _value(name, text)


def _parameters_called(located: Located, entries: dict[str, _StageEntry], name: str) -> str:
    """What to say where parameters of stages are called like a setting that is not there; empty where none is."""
    stages = [stage for stage in entries if name in load_stage(_uses(located, entries, stage)).parameters.model_fields]
    if not stages:
        return ""
    which = "a parameter of a stage" if len(stages) == 1 else "parameters of stages"
    return f"; did you mean {' or '.join(f'{stage}.{name}' for stage in stages)}, {which}?"


def _value(name: str, text: str) -> Any:
    """What the user sets, as YAML; a text where a text belongs is never parsed."""
    try:
        return parse_yaml(text, f"--set {name}").data
    except ConfigError as fault:
        raise KinedexError(f"--set {name}={text}: {fault.reason}; quote it") from None


def _uses(located: Located, entries: dict[str, _StageEntry], name: str) -> str:
    uses = entries[name].uses or name
    if uses not in STAGES:
        key = ("uses",) if entries[name].uses else ()
        raise located.error(f"there is no stage '{uses}'{did_you_mean(uses, STAGES)}", "stages", name, *key)
    return uses


def _stage(
    located: Located,
    entries: dict[str, _StageEntry],
    settings: dict[str, Any],
    overrides: dict[str, dict[str, Any]],
    name: str,
) -> PipelineStage:
    uses = _uses(located, entries, name)
    key = ("stages", name, "params")
    params = {option: _fill(located, settings, value, (*key, option)) for option, value in entries[name].params.items()}
    params.update(overrides.get(name, {}))
    kind = load_stage(uses)
    try:
        filled = located.model(kind.parameters, *key, data=params)
    except ConfigError as fault:
        _blame_the_user(fault, ".".join(key), name, overrides.get(name, {}))
        raise
    return PipelineStage(name, kind, _inputs(located, entries, name, kind), filled)


def _blame_the_user(fault: ConfigError, params: str, stage: str, given: Mapping[str, Any]) -> None:
    """Raise a KinedexError that names --set where the fault is in what stands there, not in the file."""
    option = re.split(r"[.\[]", (fault.key or "").removeprefix(f"{params}."))[0]
    if option in given:
        raise KinedexError(f"--set {stage}.{option}={given[option]}: {fault.reason}") from None


def _fill(located: Located, settings: dict[str, Any], value: Any, key: tuple[str | int, ...]) -> Any:
    """Replace ${setting} in texts; a text that is nothing else takes the setting's own type."""
    if isinstance(value, dict):
        return {name: _fill(located, settings, part, (*key, name)) for name, part in value.items()}
    if isinstance(value, list):
        return [_fill(located, settings, part, (*key, i)) for i, part in enumerate(value)]
    if not isinstance(value, str):
        return value
    for name in _SETTING.findall(value):
        if name not in settings:
            raise located.error(f"there is no setting '{name}'{did_you_mean(name, settings)}", *key)
        if settings[name] is None:
            raise located.error(f"the setting '{name}' must be given: --set {name}=…", "settings", name)
    whole = _SETTING.fullmatch(value)
    return settings[whole[1]] if whole else _SETTING.sub(lambda found: str(settings[found[1]]), value)


def _inputs(located: Located, entries: dict[str, _StageEntry], name: str, kind: Stage[BaseModel]) -> dict[str, str]:
    """Which stage plays which role: as the file says, else the only stage that can."""
    given = entries[name].inputs
    for role in given:
        if role not in kind.inputs:
            hint = did_you_mean(role, kind.inputs)
            raise located.error(f"'{kind.name}' has no input '{role}'{hint}", "stages", name, "inputs", role)
    result = {}
    for role, needed in kind.inputs.items():
        usual = needed.stage
        if role in given:
            if given[role] not in entries:
                hint = did_you_mean(given[role], entries)
                raise located.error(f"there is no stage '{given[role]}'{hint}", "stages", name, "inputs", role)
            other = entries[given[role]].uses or given[role]
            if other != usual:
                raise located.error(
                    f"must be a stage '{usual}', but '{given[role]}' is a stage '{other}'",
                    "stages",
                    name,
                    "inputs",
                    role,
                )
            result[role] = given[role]
            continue
        candidates = [other for other, entry in entries.items() if (entry.uses or other) == usual]
        if len(candidates) == 1:
            result[role] = candidates[0]
        elif candidates:
            raise located.error(
                f"input '{role}' could be any of {', '.join(candidates)}; say which under `inputs`", "stages", name
            )
        elif not needed.optional:
            raise located.error(f"'{kind.name}' needs a stage '{usual}' for its input '{role}'", "stages", name)
    return result


def _ordered(stages: list[PipelineStage]) -> tuple[PipelineStage, ...]:
    """Stages in an order in which every input comes first; the file's own order where it does not matter.

    There always is one: inputs are of given kinds, and no kind of stage needs itself, however indirectly.
    """
    result: list[PipelineStage] = []
    waiting = list(stages)
    while waiting:
        done = {stage.name for stage in result}
        ready = next(stage for stage in waiting if done.issuperset(stage.inputs.values()))
        result.append(ready)
        waiting.remove(ready)
    return tuple(result)
