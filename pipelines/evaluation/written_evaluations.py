"""Read evaluations from stores, from folders of reports, or from JSON files."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.evaluation.metrics import Counts
from kinedex.storage.snapshot.manifest_files import read_newest, versions
from kinedex.storage.snapshot.visible_results import pipelines_by_use
from kinedex.storage.store.history import refuse_damaged_report

MARK = "::"
"""The separator between a path and the name of a pipeline or method."""

FORMAT = "kinedex evaluation 1"


@dataclass(frozen=True)
class MethodEvaluation:
    """The evaluation of one method.

    Attributes
    ----------
    evaluation : str
        The name of the split, or of the evaluation.
    method : str
        The name of the method; empty if the file has only one.
    pooled : Counts
        The counts over all takes and classes.
    classes, takes : dict of str to Counts
        The counts of each class and take.
    settings : dict
        The parameters of the annotation that the file contains.
    """

    evaluation: str
    method: str
    pooled: Counts
    classes: dict[str, Counts]
    takes: dict[str, Counts]
    settings: dict[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The name of the evaluation, followed by that of the method if there is one."""
        return f"{self.evaluation}: {self.method}" if self.method else self.evaluation


@dataclass(frozen=True)
class ReadEvaluations:
    """The evaluations of one method, or of all methods if `method` is None, at the path `text` that the user wrote.

    `remark` names the pipeline that was used if a store has evaluations of several and none was chosen.
    """

    text: str
    method: str | None
    found: tuple[MethodEvaluation, ...]
    remark: str | None = None


def read_evaluations(text: str) -> ReadEvaluations:
    """Read the evaluations at a path.

    Parameters
    ----------
    text : str
        A store, a folder of reports (`…/results/reports/<pipeline>`), or a JSON file (methods.json, metrics.json, or
        leave_one_out.json of earlier versions). After a store, `::PIPELINE` selects a pipeline, by default the current
        one. `::METHOD` selects a method, and can follow `::PIPELINE`.

    Raises
    ------
    KinedexError
        There is no evaluation, a file is no evaluation, or there is no such pipeline or method.
    """
    where, *names = text.split(MARK)
    path = Path(where).expanduser()
    files = _files_by_pipeline(path)
    pipeline, *others = files
    given = [one.method for file in files[pipeline] for one in _read(file)]
    chosen = bool(names) and names[0] in files and not (len(names) == 1 and names[0] in given)
    if chosen:
        pipeline = names.pop(0)
    found = [one for file in files[pipeline] for one in _read(file)]
    if names:
        method = MARK.join(names)
        known = {one.method for one in found if one.method}
        if method not in known:
            both = known | set(others) if others and not chosen else known
            what = "method" if chosen or "" in files else "method or pipeline"
            raise KinedexError(f"{where} has no {what} '{method}'{did_you_mean(method, both)}")
        found = [one for one in found if one.method == method]
    remark = None
    if others and not chosen:
        names_another = f"`{where}{MARK}PIPELINE` names another: {', '.join(others)}"
        remark = f"{where}: the evaluation of pipeline {pipeline}; {names_another}"
    return ReadEvaluations(text, MARK.join(names) or None, tuple(found), remark)


def _files_by_pipeline(path: Path) -> dict[str, list[Path]]:
    """Return the JSON files at a path by pipeline, the current pipeline of a store first."""
    if path.is_file():
        return {"": [path]}
    if not path.is_dir():
        raise KinedexError(f"{path}: there is no such store, folder or file")
    reports = path / "results" / "reports"
    folders = sorted(folder for folder in reports.iterdir() if folder.is_dir()) if reports.is_dir() else [path]
    found = {folder.name: files for folder in folders if (files := _files_in(folder))}
    if not found:
        raise KinedexError(
            f"{path} holds no evaluation: no {', '.join(_NAMES)}; run a pipeline with the stage compare_methods or "
            "evaluate"
        )
    order = pipelines_by_use(read_newest(path)) if len(found) > 1 and versions(path) else ()
    return {name: found[name] for name in dict.fromkeys((*order, *found)) if name in found}


_NAMES = ("methods.json", "metrics.json", "leave_one_out.json")


def _files_in(folder: Path) -> list[Path]:
    """Return the evaluation files of a folder, sorted by kind; a prefix in the name of a file names its stage."""
    files = sorted(folder.glob("*.json"))
    return [file for name in _NAMES for file in files if file.name == name or file.name.endswith(f".{name}")]


def _read(file: Path) -> list[MethodEvaluation]:
    refuse_damaged_report(file)
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except OSError as fault:
        raise KinedexError(f"{file}: cannot be read: {fault.strerror}") from None
    except ValueError:
        raise KinedexError(f"{file}: is no JSON file") from None
    try:
        if content.get("format") == FORMAT:
            settings = {one["name"]: one for one in content.get("methods", [])}
            return [
                _scored(split["name"], name, one, settings.get(name, {}))
                for split in content["splits"]
                for name, one in split["methods"].items()
            ]
        if "pooled" in content:
            return [_scored(content["evaluation"], "", content, content.get("annotate", {}))]
    except (KeyError, TypeError, AttributeError):
        pass
    raise KinedexError(f"{file}: is no evaluation; expected {' or '.join(_NAMES)} as kinedex writes them")


def _scored(evaluation: str, method: str, content: dict[str, Any], settings: dict[str, Any]) -> MethodEvaluation:
    return MethodEvaluation(
        evaluation,
        method,
        _counts(content["pooled"]),
        {name: _counts(one) for name, one in content.get("classes", {}).items()},
        {name: _counts(one) for name, one in content.get("takes", {}).items()},
        settings,
    )


def _counts(content: dict[str, Any]) -> Counts:
    return Counts(**{one.name: int(content[one.name]) for one in fields(Counts)})


def paired_evaluations(
    a: ReadEvaluations, b: ReadEvaluations, split: str | None = None
) -> list[tuple[MethodEvaluation, MethodEvaluation]]:
    """Pair the evaluations of A and B: the same evaluation of the same method, or of the chosen methods.

    A file with only one method is paired with any method of the other side.

    Raises
    ------
    KinedexError
        Nothing can be compared; the message lists the evaluations of both.
    """
    ours, theirs = _in_split(a, split), _in_split(b, split)
    if len(ours) == len(theirs) == 1:
        return [(ours[0], theirs[0])]
    any_method = a.method is not None or b.method is not None
    found = [
        (one, other)
        for one in ours
        for other in theirs
        if one.evaluation == other.evaluation
        and (any_method or one.method == other.method or not (one.method and other.method))
    ]
    if not found:
        raise KinedexError(
            f"nothing to compare: {a.text} has {_listed(ours)}; {b.text} has {_listed(theirs)}. Choose by "
            f"`--split NAME` and by `PATH{MARK}METHOD`"
        )
    return found


def _in_split(read: ReadEvaluations, split: str | None) -> list[MethodEvaluation]:
    if split is None:
        return list(read.found)
    found = [one for one in read.found if one.evaluation == split]
    if not found:
        known = {one.evaluation for one in read.found}
        raise KinedexError(f"{read.text} has no evaluation '{split}'{did_you_mean(split, known)}")
    return found


def _listed(scored: list[MethodEvaluation]) -> str:
    return ", ".join(f"'{one.name}'" for one in scored)
