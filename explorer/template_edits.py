"""Edits of a template: weights of features, columns cut at both ends, and τ; and the edited template as a file.

`POST /api/templates/file` {stage, kind, template, weights?: {feature: factor}, first?, stop?, tau?} → {name, text}: the
edited template as YAML for `kinedex rank` and for the parameter `template_files` of `learn_templates`. `first` and
`stop` are the columns that are kept.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field
from starlette.requests import Request

from kinedex.catalog.configs import config_path
from kinedex.catalog.template_files import write_yaml
from kinedex.explorer.answers import command_line, python_lines
from kinedex.explorer.endpoints import RequestBody, post
from kinedex.explorer.open_archive import Archive
from kinedex.explorer.templates import TemplateUse, template_named, template_use
from kinedex.ops.errors import ConfigError
from kinedex.ops.templates.derived_templates import adjusted
from kinedex.ops.templates.templates import Kind, NamedTemplate
from kinedex.pipelines.templates.template_learning import SubclassTemplate
from kinedex.pipelines.templates.training import feature_weights
from kinedex.storage.store.store import Store

Factor = Annotated[float, Field(ge=0, le=1000)]


class EditRequest(RequestBody):
    """A request with a learned template, and the edits of it."""

    stage: str
    kind: Kind
    template: str
    weights: Annotated[dict[str, Factor], Field(max_length=64, default_factory=dict)]
    first: Annotated[int, Field(ge=0)] = 0
    stop: Annotated[int | None, Field(ge=1)] = None
    tau: Annotated[float | None, Field(gt=0, le=1)] = None
    truth: Literal["evaluation", "labels"] | None = None
    compete: bool = False
    everything: bool = False


@dataclass(frozen=True)
class Edit:
    """A template after an edit.

    Attributes
    ----------
    one : SubclassTemplate
        The template.
    template : bool
        True where it differs from the learned one.
    tau : float
        The threshold of the request; by default, the threshold of the pipeline.
    """

    one: SubclassTemplate
    template: bool
    tau: float


def edited_template(store: Store, one: SubclassTemplate, asked: EditRequest) -> SubclassTemplate:
    """Return a template with an edit applied; it has no clips, like a template read from a file."""
    template = one.learned.template
    factors = feature_weights(asked.weights, store.feature_set)
    factors = np.ones(template.values.shape[1]) if factors is None else factors
    stop = len(template) if asked.stop is None else asked.stop
    made = adjusted(template, factors, asked.first, stop)
    return replace(one, learned=replace(one.learned, template=made), clips=())


def is_edited(one: SubclassTemplate, asked: EditRequest) -> bool:
    """Return whether a request changes columns or weights of the template."""
    columns = len(one.learned.template)
    whole = (asked.first, columns if asked.stop is None else asked.stop) == (0, columns)
    return not whole or any(weight != 1 for weight in asked.weights.values())


def equivalent_edit(archive: Archive, use: TemplateUse, one: SubclassTemplate, edit: Edit) -> dict[str, str]:
    """Return the commands that search by the template, and that annotate with it in its pipeline."""
    name, delta = one.subclass, f"{use.params.delta:g}"
    file = file_name(name)
    own: list[str] = [file] if edit.template else [name, "--kind", use.kind, "--stage", use.stage]
    made = f"kinedex.Template.load({file!r})"
    if not edit.template:
        made = f"store.template({name!r}, {use.kind!r}, stage={use.stage!r})"
    return {
        "command": command_line("kinedex", "rank", archive.path, *own, "--tau", f"{edit.tau:.6g}", "--delta", delta),
        "python": python_lines(archive.path, f"store.rank({made}, tau={edit.tau:.6g}, delta={delta})"),
        "pipeline": _pipeline_command(archive, use, use.class_of(name), file if edit.template else None, edit.tau),
    }


def _pipeline_command(archive: Archive, use: TemplateUse, label: str, file: str | None, tau: float) -> str:
    """Return the command that runs the pipeline of a template again, with the edited template and threshold."""
    manifest = archive.store().manifest
    pipeline, _, stage = use.stage.partition("/")
    record = manifest.pipelines.get(pipeline)
    settings: dict[str, object] = {} if record is None else dict(record.settings)
    if file is not None:
        given = manifest.stages[use.stage].summary.get("params") or {}
        others = [one for one in given.get("template_files") or [] if Path(one).name != file]
        settings[f"{stage}.template_files"] = [*others, file]
    if use.annotate is not None and use.params.annotation_method.needs.thresholds:
        name = use.annotate.partition("/")[2]
        settings[f"{name}.tau_by_class"] = {**use.params.tau_by_class, label: round(tau, 6)}
    words = ["kinedex", "run", pipeline if record is None else _shipped_name(record.path), "--store", str(archive.path)]
    words += [word for name, value in settings.items() for word in ("--set", f"{name}={_value(value)}")]
    return command_line(*words)


def _shipped_name(path: str) -> str:
    """Return the name of a pipeline if kinedex ships it; otherwise return its path."""
    name = Path(path).stem
    try:
        return name if config_path("pipelines", name) == Path(path) else path
    except ConfigError:
        return path


def _value(value: object) -> str:
    """Return the value of a setting as `--set` reads it."""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def file_name(template: str) -> str:
    """Return a name for the file of an edited template that browsers and commands accept."""
    name = re.sub(r"[^\w.-]", "_", template).lstrip(".-")
    return f"{name or 'template'}.yaml"


def write_file(archive: Archive, asked: EditRequest, _request: Request) -> dict[str, Any]:
    """Return the edited template as the text of a file."""
    store = archive.store()
    one = template_named(template_use(store, asked.stage, asked.kind), asked.template)
    made = edited_template(store, one, asked).learned.template
    parts = [f"{asked.kind} template of {asked.stage}"]
    if len(made) < len(one.learned.template):
        kept = f"columns {asked.first + 1} to {asked.first + len(made)}"
        parts.append(f"{kept} of {len(one.learned.template)}")
    changed = [f"{name} × {weight:g}" for name, weight in asked.weights.items() if weight != 1]
    if changed:
        parts.append(f"weights {', '.join(changed)}")
    if asked.tau is not None:
        parts.append(f"τ = {asked.tau:g}")
    text = write_yaml([NamedTemplate(one.subclass, made, "; ".join(parts))], store.feature_set)
    return {"name": file_name(one.subclass), "text": text}


routes = [post("/api/templates/file", write_file, EditRequest)]
