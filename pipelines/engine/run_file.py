"""Write a pipeline file that repeats a recorded pipeline run with all its settings."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.engine.context import SHIPPED_FEATURES
from kinedex.storage.durable_files import whole_file, write_errors
from kinedex.storage.snapshot.manifest import kinedex_version
from kinedex.storage.snapshot.manifest_files import read_newest
from kinedex.storage.store.history import PipelineRun, kept_content

_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")
_REFERENCE = "${"


@dataclass(frozen=True)
class RunFile:
    """A pipeline file that was made from a recorded run.

    Attributes
    ----------
    text : str
        The content of the pipeline file.
    files : dict of Path to bytes
        The files that the pipeline file names: copies of the user's files, and skeleton mappings of the store.
    remarks : tuple of str
        Remarks on what the file alone does not reproduce, and on how to reproduce it.
    """

    text: str
    files: dict[Path, bytes]
    remarks: tuple[str, ...]


def export_run(store: Path, run: PipelineRun, output: Path) -> RunFile:
    """Write the pipeline file of a run, and the files that its parameters name into a folder beside it.

    Parameters
    ----------
    store : Path
        The directory of the store.
    run : PipelineRun
        The run.
    output : Path
        The file to write; the folder is named after it, such as `again-files` for `again.yaml`.

    Raises
    ------
    KinedexError
        The name of the file does not end in .yaml or .yml, a copy in the history is damaged, or nothing can be written.
    """
    if output.suffix not in (".yaml", ".yml"):
        raise KinedexError(f"{output}: a pipeline file ends in .yaml, for instance {output.name}.yaml")
    made = run_file(store, run, output)
    with write_errors(output):
        for path, content in made.files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            with whole_file(path) as temporary:
                temporary.write_bytes(content)
        with whole_file(output) as temporary:
            temporary.write_text(made.text, encoding="utf-8")
    return made


def run_file(store: Path, run: PipelineRun, output: Path) -> RunFile:
    """Return what `export_run` writes; parameters and errors are those of `export_run`."""
    if not run.stages:
        raise KinedexError(f"run {run.run}: the store does not know the stages of this run")
    folder = Path(os.path.abspath(output)).with_suffix("")
    work = _RunFile(store, run, folder.with_name(f"{folder.name}-files"))
    text = work.text()
    return RunFile(text, work.files, (*work.remarks, *_remarks(store, run)))


@dataclass
class _RunFile:
    """Builds a pipeline file from a recorded run."""

    store: Path
    run: PipelineRun
    folder: Path
    files: dict[Path, bytes] = field(default_factory=dict)
    settings: dict[str, str] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)

    def text(self) -> str:
        """Return the text of the file."""
        places = self._copies()
        mappings = self._mappings()
        stages: dict[str, Any] = {}
        for number, (root, settings) in enumerate(self.run.other_sources.items(), 1):
            given = {key: value for key, value in settings.items() if value not in (None, [])} | {"source": root}
            name = _free_name(f"ingest_before_{number}", [stage.stage for stage in self.run.stages])
            stages[name] = {
                "uses": "ingest",
                "params": self._params(given, places, f"source_before_{number}", mappings),
            }
        for stage in self.run.stages:
            entry: dict[str, Any] = {"uses": stage.uses} if stage.uses != stage.stage else {}
            if stage.inputs:
                entry["inputs"] = dict(stage.inputs)
            own = mappings if stage.uses == "ingest" else []
            if given := self._params(stage.given, places, "source", own):
                entry["params"] = given
            stages[stage.stage] = entry
        document: dict[str, Any] = {"name": self.run.pipeline}
        if self.run.description:
            document["description"] = self.run.description
        document |= {"settings": self.settings} if self.settings else {}
        document["stages"] = stages
        return self._heading() + yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=120)

    def _heading(self) -> str:
        run, name = self.run, f"{self.folder.name.removesuffix('-files')}.yaml"
        facts = [
            f"Pipeline run {run.run} of {run.begun or run.finished}, by kinedex {run.kinedex or '(unknown)'}.",
            *([f"The command was: {run.command}"] if run.command else []),
            *([f"The file of the pipeline was: {run.path}"] if run.path else []),
            "All settings are in this file. It runs into a new store with",
            f"    kinedex run {shlex.quote(name)} --store NEW_STORE",
        ]
        return "".join(f"# {_CONTROL.sub(' ', fact)}\n" for fact in facts) + "\n"

    def _copies(self) -> dict[str, str]:
        """Add copies of the user's files, and return the new path of each file and folder by its old path."""
        if not self.run.files:
            return {}
        strange = [kept.path for kept in self.run.files if not os.path.isabs(kept.path)]
        if strange:
            raise KinedexError(f"run {self.run.run}: {strange[0]!r} is no absolute path; the history is damaged")
        base = Path(os.path.commonpath([os.path.dirname(os.path.normpath(kept.path)) for kept in self.run.files]))
        places: dict[str, str] = {}
        for kept in self.run.files:
            old = Path(os.path.normpath(kept.path))
            new = self.folder / old.relative_to(base)
            self.files[new] = kept_content(self.store, kept)
            places[str(old)] = str(new)
            while old != base:
                old, new = old.parent, new.parent
                places[str(old)] = str(new)
        return places

    def _mappings(self) -> list[str]:
        """Add the skeleton mappings that the store held, and return their paths."""
        paths = []
        for number, (name, text) in enumerate(sorted(self.run.mappings.items()), 1):
            path = self.folder / "mappings" / f"{number:02d}-{re.sub(r'[^A-Za-z0-9_-]', '_', name)[:40]}.yaml"
            self.files[path] = text.encode()
            paths.append(str(path))
        return paths

    def _params(
        self, given: dict[str, Any], places: dict[str, str], source: str, mappings: list[str]
    ) -> dict[str, Any]:
        """Return parameters as written in the file: sources as settings, files by the paths of their copies."""
        params = {key: self._value(value, places) for key, value in given.items()}
        if mappings:
            params["skeletons"] = [*params.get("skeletons", []), *mappings]
        if isinstance(given.get("source"), str):
            params["source"] = self._setting(source, given["source"])
        return params

    def _value(self, value: Any, places: dict[str, str]) -> Any:
        match value:
            case dict():
                return {key: self._value(part, places) for key, part in value.items()}
            case list():
                return [self._value(part, places) for part in value]
            case str() if _REFERENCE in value:
                return self._setting("text", value)
        return places.get(value, value) if isinstance(value, str) else value

    def _setting(self, name: str, value: str) -> str:
        """Return the reference to a setting that holds a text; equal texts share a setting."""
        known = next((key for key, other in self.settings.items() if other == value), None)
        if known is None:
            known = _free_name(name, self.settings)
            self.settings[known] = value
        return f"${{{known}}}"


def _free_name(name: str, taken: Iterable[str]) -> str:
    number, free, others = 1, name, set(taken)
    while free in others:
        number += 1
        free = f"{name}_{number}"
    return free


def _remarks(store: Path, run: PipelineRun) -> list[str]:
    """Return remarks on results that the file alone does not reproduce, with instructions to reproduce them."""
    remarks = []
    if run.state != "finished":
        remarks.append(f"this run did not finish (it is {run.state}); the file runs all of its stages")
    if run.kinedex not in ("", kinedex_version()):
        remarks.append(f"it was made by kinedex {run.kinedex}; this is {kinedex_version()}, whose results may differ")
    for number, root in enumerate(run.sources, 1):
        if not Path(root).is_dir():
            name = "source" if number == 1 else f"source_{number}"
            remarks.append(f"the source {root} is not there: give its place with --set {name}=FOLDER")
    if run.other_sources:
        count = counted(len(run.other_sources), "other source")
        remarks.append(f"the store held takes of {count}; the stages ingest_before_… bring them in first")
    if run.labels and any("labels" in stage.params.get("examples", ()) for stage in run.stages):
        remarks.append(
            f"it learned from labels that the store holds: bring them into the new store with `kinedex labels export "
            f"{shlex.quote(str(store))} --labels -o labels.csv` and `kinedex labels import NEW_STORE labels.csv` once "
            "the takes are in, then run the file again"
        )
    features = read_newest(store).feature_set.name
    given = [stage.given for stage in run.stages] + list(run.other_sources.values())
    if features != SHIPPED_FEATURES and not any(one.get("features") for one in given):
        remarks.append(f"the store has the features '{features}': give their file with --set ingest.features=FILE")
    return remarks


def changed_defaults(run: PipelineRun, file: Path) -> list[str]:
    """Return remarks on unset parameters whose defaults have changed since the run.

    For a file that this version of kinedex cannot run, the only remark gives the reason.
    """
    try:
        loaded = load_pipeline(file)
    except KinedexError as fault:
        return [f"this kinedex cannot run the file: {fault}"]
    now = {stage.name: stage.params.model_dump(mode="json") for stage in loaded.stages}
    return [
        f"{stage.stage}.{key} was {value!r} by default, and is {now[stage.stage][key]!r} now: "
        f"--set {stage.stage}.{key}=… gives it the old value"
        for stage in run.stages
        for key, value in stage.params.items()
        if key not in stage.given and stage.stage in now and key in now[stage.stage] and now[stage.stage][key] != value
    ]
