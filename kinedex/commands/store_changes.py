"""Define the commands that change the content of a store or its views: use, merge, takes remove, readmit and accept."""

from __future__ import annotations

import shlex
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from kinedex.commands.app import MAINTAIN, command
from kinedex.commands.options import JsonOption, StorePath, WaitOption, WhereOption, wait_of, writer_of
from kinedex.commands.output import print_json, print_message, show_table
from kinedex.commands.tables import takes_group
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.wording import counted, name_list


@command(MAINTAIN)
def use(
    store: StorePath,
    pipeline: Annotated[
        str | None, typer.Argument(help="Pipeline whose results the views show from now on; only listed unless given.")
    ] = None,
    latest: Annotated[
        bool, typer.Option("--latest", help="Show the pipeline that was run last, now and after every run.")
    ] = False,
    at: Annotated[
        int | None,
        typer.Option(
            "--at",
            metavar="VERSION",
            help="Bring back the results that the pipeline had in this version, in place of its later ones; which "
            "pipeline the views show stays.",
        ),
    ] = None,
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """Choose the pipeline whose results the views show, or list them.

    A view such as `annotations` shows the results of one pipeline: the chosen one, or the one that was run last. The
    rows of all pipelines are in `all_annotations`. With --at, results of an earlier version become current again.
    """
    from kinedex.storage.snapshot.visible_results import current_pipeline, pipeline_runs, result_pipelines
    from kinedex.storage.store.store import open_store

    if pipeline is not None and latest:
        raise typer.BadParameter("give a pipeline or --latest, not both")
    if at is not None and pipeline is None:
        raise typer.BadParameter("--at needs the pipeline whose results are brought back")
    opened = open_store(store, at="newest")
    manifest = opened.manifest
    if pipeline is not None or latest:
        with writer_of(opened, wait) as writer:
            if pipeline is not None and at is not None:
                writer.restore_pipeline(pipeline, open_store(store, at=at).manifest)
            else:
                writer.choose_pipeline(pipeline)
            manifest = writer.commit()
    current = current_pipeline(manifest)
    chosen = bool(manifest.chosen_pipeline) and manifest.chosen_pipeline == current
    if as_json:
        runs = pipeline_runs(manifest)
        print_json({"store": store, "current": current, "chosen": chosen, "pipeline_runs": runs})
        return
    if pipeline is None and not latest:
        show_table(result_pipelines(manifest))
    if current is None:
        print_message(f"{store}: no pipeline has made results")
        return
    ends = f"which was chosen; `kinedex use {shlex.quote(str(store))} --latest` ends that"
    why = ends if chosen else "which was run last"
    print_message(f"the views of results show pipeline {current}, {why}")


AcceptOption = Annotated[bool, typer.Option("--accept", help="Do it; unless given, what would be done is listed.")]


@command(of=takes_group)
def remove(
    store: StorePath,
    takes: Annotated[list[str] | None, typer.Argument(metavar="TAKE...", help="Names of takes.")] = None,
    where: WhereOption = None,
    accept: AcceptOption = False,
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """Remove takes; their motion files and their labels stay.

    Later ingests skip the files of these takes, until `kinedex takes readmit`.
    """
    from kinedex.storage.index.builder import build_index
    from kinedex.storage.store.store import open_store
    from kinedex.storage.store.take_removal import planned_removal, remove_takes

    opened = open_store(store, at="newest")
    planned = planned_removal(opened, takes or (), where)
    if accept:
        with writer_of(opened, wait) as writer:
            planned = planned_removal(writer.store, takes or (), where)
            remove_takes(writer, planned)
        build_index(open_store(store, at="newest"), wait=wait_of(wait))
    names = planned.takes.column("name").to_pylist()
    if as_json:
        files = [{"source_root": root, "source": path} for root, path in planned.files]
        document = {"store": store, "removed": accept, "takes": names, "files": files}
        print_json({**document, "returning": planned.returning, "tracks": planned.tracks, "labels": planned.labels})
        return
    if not accept:
        show_table(planned.takes.select(["name", "actor", "class", "seconds", "source"]), paged=True)
    count = counted(len(names), "take")
    labels = f"; the store keeps {counted(planned.labels, 'label')}" if planned.labels else ""
    print_message(f"{count} {'removed' if accept else 'would be removed'}{labels}")
    if planned.files:
        print_message(
            f"ingests pass {counted(len(planned.files), 'file')} over from then on, "
            f"`kinedex takes readmit {shlex.quote(str(store))}` ends that; no file is changed"
        )
    if planned.returning:
        print_message(
            f"the next ingest brings back {name_list(planned.returning)}: other takes of the same file stay in the "
            "store"
        )
    if planned.tracks:
        print_message(
            f"{name_list(planned.tracks)}: no motion file holds {'it' if len(planned.tracks) == 1 else 'them'}; the "
            "pipeline "
            "that reads its recording makes its take again, unless the recording is taken out of the recordings file"
        )
    if not accept:
        print_message("nothing was changed: --accept removes them")


@command(of=takes_group)
def accept(
    store: StorePath,
    takes: Annotated[list[str] | None, typer.Argument(metavar="TAKE...", help="Names of takes.")] = None,
    where: Annotated[
        str | None,
        typer.Option(help="SQL filter over the columns of the view doubts, for instance \"cause LIKE '%estimated%'\"."),
    ] = None,
    revoke: Annotated[bool, typer.Option("--revoke", help="Take the acceptance back.")] = False,
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """Accept warnings and guesses about takes.

    They stay in the column `warnings`, and are accepted in the view `doubts`, as long as a later ingest has the same to
    say about the take.
    """
    from kinedex.storage.store.accepted_doubts import accept_doubts, chosen_doubts
    from kinedex.storage.store.store import open_store

    opened = open_store(store)
    doubts = chosen_doubts(opened, takes or (), where)
    with writer_of(opened, wait) as writer:
        changed = accept_doubts(writer, doubts, revoke=revoke)
        writer.commit()
    if as_json:
        rows = [{"take": one.take, "message": one.message} for one in doubts]
        print_json({"store": store, "accepted": not revoke, "doubts": rows, "changed": changed})
        return
    same = f" ({len(doubts) - changed:,} were so before)" if changed < len(doubts) else ""
    print_message(f"{counted(len(doubts), 'doubt')} {'no longer accepted' if revoke else 'accepted'}{same}")


@command(of=takes_group)
def readmit(
    store: StorePath,
    files: Annotated[
        list[str] | None, typer.Argument(metavar="FILE...", help="Paths of files as the list without them shows.")
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="All of them.")] = False,
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the files of removed takes, or let ingests read them again."""
    import pyarrow as pa

    from kinedex.storage.store.store import open_store

    opened = open_store(store, at="newest")
    removed = [(root, path) for root, paths in opened.manifest.removed_files.items() for path in paths]
    chosen = removed if every else [one for one in removed if one[1] in (files or ()) or "/".join(one) in (files or ())]
    for name in files or ():
        if not any(name in (path, f"{root}/{path}") for root, path in removed):
            near = did_you_mean(name, [path for _, path in removed])
            raise KinedexError(f"no takes were removed of a file '{name}'{near}")
    if chosen:
        with writer_of(opened, wait) as writer:
            writer.readmit_files(chosen)
            writer.commit()
    shown = chosen if files or every else removed
    rows = [{"source_root": root, "source": path} for root, path in shown]
    if as_json:
        print_json({"store": store, "readmitted": bool(files) or every, "files": rows})
        return
    schema = pa.schema([("source_root", pa.string()), ("source", pa.string())])
    show_table(pa.Table.from_pylist(rows, schema=schema), paged=True)
    done = "are read by the next ingest of their folder" if files or every else "are passed over by ingests"
    done = done.replace("are ", "is ", 1) if len(shown) == 1 else done
    print_message(f"{counted(len(shown), 'file')} {done}")


@command(MAINTAIN)
def merge(
    store: StorePath,
    other: Annotated[Path, typer.Argument(metavar="OTHER", help="Store whose takes come in; it stays as it is.")],
    prefix: Annotated[
        str, typer.Option(metavar="TEXT", help="Text in front of the names of the takes that come in.")
    ] = "",
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """Add the takes and labels of another store to a store.

    Frames are copied; no motion file is read. Labels come with their history, results do not: run pipelines again.
    """
    from kinedex.console.terminal import Terminal, message_console
    from kinedex.storage.index.builder import build_index
    from kinedex.storage.store.merge import merge_store
    from kinedex.storage.store.store import open_store

    mine = open_store(store, at="newest")
    with open_store(other, at="newest") as theirs:
        with writer_of(mine, wait) as writer:
            with Terminal(message_console()).progress("copy", len(theirs.manifest.live_takes)) as bar:
                merged = merge_store(writer, theirs, prefix, bar.advance)
            takes = len(writer.manifest.live_takes)
        build_index(open_store(store, at="newest"), wait=wait_of(wait))
        left = sorted(kind for kind, parts in theirs.manifest.results.items() if parts)
    if as_json:
        print_json({"store": store, "other": other, **asdict(merged), "all_takes": takes, "results_left": left})
        return
    labels = f" and {counted(merged.labels, 'row')} of labels" if merged.labels else ""
    print_message(f"{counted(merged.takes, 'take')}{labels} from {other}; {store} has {counted(takes, 'take')} now")
    if left:
        print_message("results do not come along: run pipelines over the store again")
    if merged.kept_mappings:
        print_message(f"mappings of which {store} has others, which it keeps: {name_list(merged.kept_mappings)}")
