"""Define the commands about the pipeline runs of a store: history list, show, export."""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from kinedex.commands.app import MAINTAIN, command, group
from kinedex.commands.options import JsonOption, Output, StorePath
from kinedex.commands.output import print_json, print_message, print_path
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.wording import visible

history = group("history", "List, show and repeat what pipelines did to a store.", MAINTAIN)

RunArgument = Annotated[
    str, typer.Argument(metavar="RUN", help="Id of a pipeline run, its beginning, or a pipeline for its last run.")
]


@command(of=history, name="list")
def list_(
    store: StorePath,
    pipeline: Annotated[str | None, typer.Option(metavar="NAME", help="Only runs of this pipeline.")] = None,
    last: Annotated[int | None, typer.Option(min=1, metavar="N", help="Only the last N runs.")] = None,
    *,
    output: Output,
    as_json: JsonOption = False,
) -> None:
    """List the pipeline runs of a store and what each changed."""
    from kinedex.console.run_overview import runs_table
    from kinedex.storage.store.history import history_problems, list_runs

    every = list_runs(store)
    known = sorted({run.pipeline for run in every})
    if pipeline is not None and pipeline not in known:
        raise KinedexError(f"--pipeline {pipeline}: no run is of this pipeline{did_you_mean(pipeline, known)}")
    fitting = [run for run in every if pipeline in (None, run.pipeline)]
    shown = fitting[-last:] if last is not None else fitting
    table = runs_table(store, every, shown)
    if as_json:
        print_json({"store": store, "runs": table})
        return
    output.show(table)
    for file, problem in history_problems(store):
        typer.echo(visible(f"{file}: {problem}; `kinedex verify` reports the way out"), err=True)
    if len(shown) < len(fitting):
        print_message(f"{len(shown)} of {len(fitting)} runs; without --last all are shown")


@command(of=history)
def show(store: StorePath, run: RunArgument, as_json: JsonOption = False) -> None:
    """Show everything that is known about a pipeline run."""
    from kinedex.console.run_overview import (
        find_run,
        previous_runs,
        results_of,
        run_changes,
        run_lines,
        versions_with_results,
    )
    from kinedex.storage.snapshot.manifest_files import versions
    from kinedex.storage.store.history import list_runs

    every = list_runs(store)
    found = find_run(every, run, store)
    before = previous_runs(every)[found.run]
    results = results_of(found, versions_with_results(store), versions(store)[-1])
    if as_json:
        more = {"results": results, "changes": run_changes(found, before)}
        print_json({"store": store, "run": asdict(found) | more})
        return
    for line in run_lines(found, before, results):
        print(visible(line))


@command(of=history)
def export(
    store: StorePath,
    run: RunArgument,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="File to write, ending in .yaml; files that the run used go into a folder beside it. The file is "
            "PIPELINE-RUN.yaml in this folder unless given.",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write a pipeline file that repeats a pipeline run.

    All settings are in the file.
    """
    from kinedex.console.run_overview import find_run
    from kinedex.pipelines.engine.run_file import changed_defaults, export_run
    from kinedex.storage.store.history import list_runs

    found = find_run(list_runs(store), run, store)
    path = output or Path(re.sub(r"[^A-Za-z0-9_-]", "_", f"{found.pipeline}-{found.run}") + ".yaml")
    made = export_run(store, found, path)
    remarks = [*made.remarks, *changed_defaults(found, path.absolute())]
    if as_json:
        files = sorted(map(str, made.files))
        print_json({"store": store, "run": found.run, "file": path, "files": files, "remarks": remarks})
        return
    print_path(path)
    for one in sorted(made.files):
        print_path(one)
    for remark in remarks:
        typer.echo(visible(f"note: {remark}"), err=True)
