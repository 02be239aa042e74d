"""Commands that change what a store shows and holds: use."""

from __future__ import annotations

from typing import Annotated

import typer

from kinedex.pipelines.commands.app import MAINTAIN, command
from kinedex.pipelines.commands.options import JsonOption, StorePath, WaitOption, wait_of
from kinedex.pipelines.commands.output import print_json, print_message, show_table


@command(MAINTAIN)
def use(
    store: StorePath,
    pipeline: Annotated[
        str | None, typer.Argument(help="Pipeline whose results the views show from now on; only listed unless given.")
    ] = None,
    latest: Annotated[
        bool, typer.Option("--latest", help="Show the pipeline that was run last, now and after every run.")
    ] = False,
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """Choose the pipeline whose results the views show, or list the pipelines.

    A view such as `annotations` shows the results of one pipeline: the chosen one, or the one that was run last. The
    rows of all pipelines are in `all_annotations`.
    """
    from kinedex.storage.snapshot.shown_results import current_pipeline, pipeline_runs
    from kinedex.storage.store.store import open_store
    from kinedex.storage.store.writer import StoreWriter

    if pipeline is not None and latest:
        raise typer.BadParameter("give a pipeline or --latest, not both")
    opened = open_store(store, at="newest")
    manifest = opened.manifest
    if pipeline is not None or latest:
        with StoreWriter.open(store, opened.feature_set, opened.rate_hz, wait_of(wait)) as writer:
            writer.choose_pipeline(pipeline)
            manifest = writer.commit()
    current = current_pipeline(manifest)
    chosen = bool(manifest.chosen_pipeline) and manifest.chosen_pipeline == current
    runs = pipeline_runs(manifest)
    if as_json:
        print_json({"store": store, "current": current, "chosen": chosen, "pipeline_runs": runs})
        return
    if pipeline is None and not latest:
        show_table(runs.select(["pipeline", "finished", "stages", "views", "current"]), "table", None)
    if current is None:
        print_message(f"{store}: no pipeline has made results")
        return
    why = f"which was chosen; `kinedex use {store} --latest` ends that" if chosen else "which was run last"
    print_message(f"the views of results show pipeline {current}, {why}")
