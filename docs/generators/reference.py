"""The page docs/reference.md, generated from the code (`python -m docs.generators.reference`)."""

from __future__ import annotations

import importlib
import re
import types
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, ForwardRef, Literal, Union, get_args, get_origin

import typer
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from typer.core import TyperArgument

from docs.generators.json_documents import DOCUMENTS
from docs.generators.markdown_tables import table
from kinedex.catalog.configs import KINDS, config_names, config_path, load_yaml
from kinedex.commands.app import COMMON_OPTIONS, PANELS
from kinedex.commands.cli import app
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.engine.stage import BUILT_IN, load_stage
from kinedex.pipelines.evaluation.comparison_parameters import Method, Split
from kinedex.pipelines.templates.ranking_evaluation import Fold
from kinedex.pipelines.templates.training import Combination

INTRODUCTION = """\
# Reference

Generated from the code by `python -m docs.generators.reference`; a test compares it with the code. Do not
edit it.

Views and macros of SQL are in [sql.md](sql.md), formats of motion files in [formats.md](formats.md), label files in
[labels.md](labels.md).
"""

SECTIONS = {
    "Commands": "and their options",
    "JSON output": "and its keys",
    "Stages": "and their parameters, the same in a pipeline file and by `--set STAGE.PARAMETER=VALUE`",
    "Pipelines": "that come along, and their settings, by `--set SETTING=VALUE`",
    "Configuration files": "and the keys of each kind",
}
"""The sections of the page, and the words that follow each in the contents."""

MODELS = (("Combination", Combination), ("Method", Method), ("Split", Split), ("Fold", Fold))
"""The models that parameters of stages hold."""

PARTS = {
    "skeletons": (
        ("", "kinedex.catalog.skeletons.mappings", "_SkeletonFile"),
        ("a `Mix`, which stands for a joint", "kinedex.catalog.skeletons.mappings", "_Mix"),
        ("`Aside`", "kinedex.catalog.skeletons.mappings", "_Aside"),
        ("`Root`", "kinedex.catalog.skeletons.mappings", "_Root"),
        ("a `LimbEntry`, which stands for a limb", "kinedex.catalog.skeletons.skeleton_fit", "LimbEntry"),
    ),
    "names": (
        ("names of nodes", "kinedex.catalog.skeletons.recognition.names", "_VocabularyFile"),
        ("labels of markers, of your own", "kinedex.catalog.skeletons.recognition.landmarks", "_OwnFile"),
        ("`skin` and `centres`", "kinedex.catalog.skeletons.recognition.landmarks", "_Part"),
    ),
    "features": (
        ("", "kinedex.catalog.feature_files", "FeatureFile"),
        ("a feature, by its number", "kinedex.catalog.feature_files", "_FeatureEntry"),
    ),
    "classes": (("a class", "kinedex.catalog.classes", "_ClassEntry"),),
    "queries": (
        ("a query", "kinedex.catalog.queries.query_reader", "QueryEntry"),
        ("a step of `sequence`", "kinedex.catalog.queries.query_reader", "StepEntry"),
        ("a query of another file", "kinedex.catalog.queries.query_reader", "ReferenceEntry"),
        ("a `Keyframe`", "kinedex.catalog.queries.keyframe_entries", "_KeyframeEntry"),
        ("a gap", "kinedex.catalog.queries.keyframe_entries", "GapEntry"),
    ),
    "kinematics": (
        ("", "kinedex.catalog.kinematics", "_ChainFile"),
        ("a node", "kinedex.catalog.kinematics", "_Node"),
        ("a joint", "kinedex.catalog.kinematics", "_Joint"),
    ),
    "keypoints": (
        ("", "kinedex.catalog.keypoint_sets", "_SetFile"),
        ("a point of `points`", "kinedex.catalog.keypoint_sets", "_Point"),
    ),
    "bodies": (
        ("", "kinedex.catalog.bodies", "_BodyFile"),
        ("`height`", "kinedex.catalog.bodies", "_Height"),
        ("a cone", "kinedex.catalog.bodies", "_Cone"),
    ),
    "bodies/filmed": (
        ("", "kinedex.catalog.filmed_bodies", "_FilmedFile"),
        ("a cone", "kinedex.catalog.filmed_bodies", "_Cone"),
        ("`clothes`", "kinedex.catalog.filmed_bodies", "_Clothes"),
        ("`errors`", "kinedex.catalog.filmed_bodies", "_Errors"),
    ),
    "sensors": (
        ("", "kinedex.catalog.sensorsets", "SensorEntries"),
        ("`units`", "kinedex.catalog.sensorsets", "Units"),
        ("`columns`", "kinedex.catalog.sensorsets", "Columns"),
    ),
    "printed": (
        ("", "kinedex.catalog.published_results", "PublishedResults"),
        ("an item of `figures`", "kinedex.catalog.published_results", "PublishedScore"),
        ("an item of `limbs`", "kinedex.catalog.published_results", "PublishedError"),
    ),
    "imu_grades": (
        ("", "kinedex.catalog.imu_grades", "GradeFile"),
        ("a `Channel`", "kinedex.catalog.imu_grades", "Channel"),
        ("`gaps`", "kinedex.catalog.imu_grades", "Gaps"),
        ("`clock`", "kinedex.catalog.imu_grades", "ClockErrors"),
        ("`magnets`", "kinedex.catalog.imu_grades", "Magnets"),
    ),
    "pipelines": (
        ("", "kinedex.pipelines.engine.config", "_PipelineFile"),
        ("a `Stage`", "kinedex.pipelines.engine.config", "_StageEntry"),
    ),
}
"""Kind of configuration file → its models: part of the file that each describes (empty: all of it), module, name."""

WHERE = {
    "skeletons": "`ingest.skeletons`, `ingest.skeleton`, `kinedex mapping`. "
    "[How to read files with a skeleton of your own](howto/own-skeleton.md).",
    "names": "`ingest.skeletons`, `kinedex mapping add`. [Names that recognition does not know]"
    "(howto/own-skeleton.md#names-that-recognition-does-not-know).",
    "features": "`ingest.features`. [Features of your own](howto/own-features.md).",
    "classes": "`annotate.classes`. [Classes of your own](howto/own-classes.md).",
    "queries": "`kinedex search`, `annotate.queries`, `rank.queries`. Every key is explained in "
    "[`example.yaml`](../configs/queries/example.yaml).",
    "kinematics": "The body of BVH files that `kinedex export` writes from named joints; no command takes another one.",
    "keypoints": "The names of the keypoints of pose estimators, and where they lie on the body; `keypoint_set` of a "
    "recording names a shipped set, or a file of your own.",
    "bodies": "The body that is fitted to depth images: round cones between the 24 named joints, and pivots.",
    "bodies/filmed": "`kinedex simulate depth --body`: flesh, clothes and errors of a body before a simulated depth "
    "camera. Every key is explained in [`first.yaml`](../configs/bodies/filmed/first.yaml).",
    "sensors": "`read_imu.sensors`, `kinedex inspect --sensors`: which limb wears which sensor, and what the files of "
    "sensors do not state. [Files of sensors](inertial.md#files).",
    "imu_grades": "`kinedex simulate imu --grade`, `simulate_imu.grade`: the errors of simulated sensors. Those named "
    "after devices have their source in the file.",
    "printed": "`evaluate_limb_errors.printed`: figures of a publication, in columns beside ours.",
    "pipelines": "`kinedex run`. Every shipped pipeline is listed above.",
}


def reference() -> str:
    """Return the whole page as Markdown."""
    parts = ["## Commands\n", _common(), *_commands()]
    parts += ["## JSON output\n", *_documents()]
    parts += ["## Stages\n", "The bounds of a value follow its type.\n"]
    parts += [_stage(name) for name in BUILT_IN]
    parts += [f"### Inside of parameters: {name}\n\n{_summary(model)}\n\n{_fields(model)}" for name, model in MODELS]
    parts += ["## Pipelines\n", *(_pipeline(name) for name in config_names("pipelines"))]
    parts += ["## Configuration files\n", *(_kind(kind) for kind in KINDS)]
    body = "\n".join(parts)
    return "\n".join([INTRODUCTION, _contents(body), body])


def _contents(body: str) -> str:
    """Return a list of the sections, each with links to its parts."""
    seen: Counter[str] = Counter()
    lines: list[str] = []
    for level, title in re.findall(r"^(##+) (.*)$", body, re.MULTILINE):
        anchor = re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
        link = f"#{anchor}-{seen[anchor]}" if seen[anchor] else f"#{anchor}"
        seen[anchor] += 1
        if level == "##":
            lines.append(f"- [{title}]({link}) {SECTIONS[title]}:")
        else:
            # of a command its name without arguments
            name = re.sub(r" [^a-z].*", "", title.split(": ")[-1].removeprefix("kinedex "))
            lines[-1] += f"{'' if lines[-1].endswith(':') else ','} [`{name}`]({link})"
    return "".join(f"{line}\n" for line in lines)


def _common() -> str:
    """Return what holds for all commands: exit codes and common options."""
    first = next(_leaves(typer.main.get_command(app)))
    options = {one.name: one for one in first.params}
    rows = [(_option(options[name]), options[name].help) for name in COMMON_OPTIONS]
    return f"{app.info.epilog}\n\nEvery command has these options:\n\n{table(('option', 'what it does'), rows)}"


def _leaves(one: Any) -> Iterator[Any]:
    """Yield the commands of a group and of the groups in it; groups have no options of their own."""
    if not hasattr(one, "commands"):
        yield one
        return
    for inner in one.commands.values():
        yield from _leaves(inner)


def _documents() -> list[str]:
    introduction = (
        "With `--json` these commands print one JSON object to standard output, and nothing else; messages go to "
        "standard error. A command that fails prints `error` with its `type`, `message`, `exit_code` and `remedy`, and "
        "exits with that code. A remedy has a `text` and a `command`, the list of its words, which is empty where no "
        "command helps; the remedy is null where the message itself is the way out.\n"
    )
    return [introduction] + [
        f"### kinedex {command} --json\n\n"
        + table(("key", "value"), [(f"`{key}`", meaning) for key, meaning in keys.items()])
        for command, keys in DOCUMENTS.items()
    ]


def _commands() -> list[str]:
    root: Any = typer.main.get_command(app)
    found = []
    for panel in PANELS:
        of_panel = [(name, one) for name, one in root.commands.items() if one.rich_help_panel == panel]
        found += [text for name, one in of_panel for text in _command(one, f"kinedex {name}")]
    return found


def _command(one: Any, name: str) -> list[str]:
    """Return the sections of a command, or of every command of a group."""
    if hasattr(one, "commands"):
        return [text for inner, each in one.commands.items() for text in _command(each, f"{name} {inner}")]
    arguments = [each for each in one.params if isinstance(each, TyperArgument)]
    options = [each for each in one.params if not isinstance(each, TyperArgument)]
    options = [each for each in options if each.name not in ("help", *COMMON_OPTIONS)]
    usage = " ".join([name, *(_usage(each) for each in arguments)])
    rows = [(f"`{_usage(each).strip('[]')}`", _shown(each), each.help or "") for each in arguments]
    rows += [(_option(each), _shown(each), each.help or "") for each in options]
    text = " ".join((one.help or "").split())
    return [f"### {usage}\n\n{text}\n\n{table(('argument or option', 'default', 'what it is'), rows)}"]


def _usage(argument: Any) -> str:
    name = argument.metavar or argument.name.upper()
    name = f"{name.rstrip('.')}…" if argument.nargs == -1 else name
    return name if argument.required or name.startswith("[") else f"[{name}]"


def _option(option: Any) -> str:
    names = ", ".join(f"`{name}`" for name in sorted(option.opts, key=len, reverse=True))
    return f"{names} {option.metavar}" if option.metavar else names


def _shown(option: Any) -> str:
    if option.required:
        return "required"
    if getattr(option, "is_flag", False):
        return f"`{option.opts[0]}`" if option.default else ""
    return "" if option.default in (None, "") else f"`{option.default}`"


def _stage(name: str) -> str:
    stage = load_stage(name)
    roles = [
        f"`{role}` (a stage `{needed.stage}`{', can be missing' if needed.optional else ''})"
        for role, needed in stage.inputs.items()
    ]
    inputs = f"Inputs: {', '.join(roles)}.\n\n" if roles else ""
    return f"### {name}\n\n{_summary(type(stage))}\n\n{inputs}{_fields(stage.parameters)}"


def _summary(model: type) -> str:
    return (model.__doc__ or "").strip().splitlines()[0]


def _fields(model: type[BaseModel]) -> str:
    described = any(field.description for field in model.model_fields.values())
    rows = [
        (f"`{field.alias or name}`", _type(field.annotation, field.metadata), _default(field), field.description or "")
        for name, field in model.model_fields.items()
    ]
    header = ("key", "type", "default", "what it is")
    if not rows:
        return "It has no parameters.\n"
    return table(header, rows) if described else table(header[:3], [row[:3] for row in rows])


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    return "" if value is None or value == "" else f"`{_yaml(value)}`"


def _yaml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return f"[{', '.join(_yaml(one) for one in value)}]"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key}: {_yaml(one)}' for key, one in value.items())}}}"
    return f"{value:g}" if isinstance(value, float) else str(value)


_NAMES = {str: "text", int: "integer", float: "number", bool: "true or false", Any: "any"}
_BOUNDS = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<"}


def _type(annotation: Any, metadata: Iterable[object] = ()) -> str:
    """Return a type in words, with its bounds."""
    bounds = [
        f"{sign} {_yaml(getattr(one, key))}" for one in metadata for key, sign in _BOUNDS.items() if hasattr(one, key)
    ]
    return ", ".join([_bare(annotation), *bounds])


def _bare(annotation: Any) -> str:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        meta = [part for one in arguments[1:] for part in (one.metadata if isinstance(one, FieldInfo) else [one])]
        return _type(arguments[0], meta)
    if origin in (Union, types.UnionType):
        return " or ".join(_type(one) for one in arguments if one is not type(None))
    if origin is Literal:
        return " or ".join(f"`{one}`" for one in arguments)
    if origin is list:
        return f"list of {_bare(arguments[0])}"
    if origin is tuple:
        return f"[{', '.join(_bare(one) for one in arguments)}]"
    if origin is dict:
        return (
            f"{_bare(arguments[0])} → ({inner})"
            if " " in (inner := _type(arguments[1]))
            else f"{_bare(arguments[0])} → {inner}"
        )
    if annotation in _NAMES:
        return _NAMES[annotation]
    name = annotation.__forward_arg__ if isinstance(annotation, ForwardRef) else annotation.__name__
    return f"`{name.strip('_').removesuffix('Entry')}`"


def _pipeline(name: str) -> str:
    path = config_path("pipelines", name)
    located = load_yaml(path)
    body = located.mapping()
    settings = body.get("settings") or {}
    lines = path.read_text(encoding="utf-8").splitlines()
    stages = ", ".join(
        f"`{stage.name}`" if stage.name == stage.uses else f"`{stage.name}` (a stage `{stage.uses}`)"
        for stage in load_pipeline(name, {key: "x" for key, value in settings.items() if value is None}).stages
    )
    rows = [
        (
            f"`{key}`",
            "required" if value is None else f"`{_yaml(value)}`",
            _comment(lines, located.line("settings", key)),
        )
        for key, value in settings.items()
    ]
    settings_table = table(("setting", "default", "what it is"), rows) if rows else "It has no settings.\n"
    file = f"[`{name}.yaml`](../configs/pipelines/{name}.yaml)"
    return f"### {name}\n\n{body['description']} ({file})\n\nStages: {stages}.\n\n{settings_table}"


def _comment(lines: Sequence[str], number: int | None) -> str:
    """Return the comment at the end of a line, counted from 1."""
    found = re.search(r"\s# ?(.*)$", lines[number - 1]) if number else None
    return found[1].strip() if found else ""


def _kind(kind: str) -> str:
    names = ", ".join(f"[`{name}`](../configs/{kind}/{name}.yaml)" for name in config_names(kind))
    parts = []
    for what, module, name in PARTS[kind]:
        model = getattr(importlib.import_module(module), name)
        title = f"Keys of {what}:" if what else "Keys:"
        parts.append(f"{title}\n\n{_fields(model)}")
    body = "\n".join(parts)
    return f"### configs/{kind}\n\n{WHERE[kind]} Shipped: {names}.\n\n{body}"


if __name__ == "__main__":
    page = Path(__file__).resolve().parents[2] / "docs" / "reference.md"
    page.write_text(reference(), encoding="utf-8")
