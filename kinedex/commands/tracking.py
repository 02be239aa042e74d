"""Define the commands that make takes from recordings or improve takes: track, stabilise, reconstruct."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinedex.commands.app import TRACK, command
from kinedex.commands.options import (
    Follow,
    JsonOption,
    RunOptions,
    StorePath,
    WaitOption,
    WorkersOption,
    interval_of,
    wait_of,
)
from kinedex.commands.output import print_json, print_message, show_outcome, show_table

if TYPE_CHECKING:
    from kinedex.pipelines.tracking.tracking_runs import Explanation

OnlyOption = Annotated[
    list[str] | None, typer.Option("--only", metavar="NAME", help="Only this recording; may be repeated.")
]

_SHOWN = ("round", "kind", "side", "class", "hit", "start_seconds", "stop_seconds", "cost", "kept", "reason")


@command(TRACK)
def track(
    store: StorePath,
    recordings: Annotated[Path, typer.Argument(help="YAML file: name of a recording → calibration, keypoints, rate.")],
    only: OnlyOption = None,
    tracker: Annotated[str, typer.Option(help="take: all frames at once; frames: one after the other.")] = "take",
    *,
    options: Annotated[RunOptions, "assign force executor workers wait"],
    as_json: JsonOption = False,
) -> None:
    """Make takes of recordings by calibrated cameras.

    A recording becomes the take NAME_tracked. This is the pipeline `track`. Recordings that have not changed are not
    tracked again.
    """
    settings = {"recordings": str(recordings), "track.tracker": tracker}
    outcome = options.run("track", store, settings, {"observe.only": json.dumps(only)} if only else None)
    show_outcome(outcome, store, as_json)


@command(TRACK)
def stabilise(
    store: StorePath,
    takes: Annotated[list[str], typer.Argument(metavar="TAKE...", help="Tracked takes, or any take with gaps.")],
    priors: Annotated[
        str | None, typer.Option(metavar="KINDS", help="archive, pose, logical; several with a comma between.")
    ] = None,
    tau: Annotated[float, typer.Option(min=1e-6, max=1, help="Hits with distances below tau give priors.")] = 0.13,
    rounds: Annotated[int, typer.Option(min=1, max=20, help="Largest number of rounds.")] = 2,
    body: Annotated[
        str, typer.Option(metavar="TAKE", help="Of 3D tracks: a take of the actor whose bone lengths count.")
    ] = "estimate",
    classes: Annotated[str, typer.Option(metavar="FILE", help="Class file with locomotion and marks.")] = "own",
    explain: Annotated[bool, typer.Option("--explain", help="List hits and priors, withdrawn ones too.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Stabilise takes that are up to date, too.")] = False,
    workers: WorkersOption = None,
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """Stabilise tracked takes by what the archive knows.

    Each take becomes a take NAME_stabilised. A take that was tracked is stabilised from the observations of its
    recording, and any other take as a 3D track without cameras. The templates of the store are used; if there are none,
    templates are learned from the takes whose class is known.
    """
    from kinedex.console.terminal import Terminal, message_console
    from kinedex.pipelines.engine.executors import make_executor
    from kinedex.pipelines.tracking.parameters import TrackParameters, stabilise_parameters
    from kinedex.pipelines.tracking.tracking_runs import explanations, stabilise_stored
    from kinedex.storage.store.store import open_store

    given: dict[str, object] = {"tau": tau, "rounds": rounds, "body": body, "classes": classes}
    if priors is not None:
        given["priors"] = [kind.strip() for kind in priors.split(",")]
    params = stabilise_parameters(given)
    pool = make_executor("processes" if len(takes) > 1 and workers != 1 else "serial", workers)
    done = stabilise_stored(
        store,
        takes,
        params,
        TrackParameters.model_validate({}),
        pool,
        Terminal(message_console()),
        wait_of(wait),
        force,
    )
    pool.close()
    found = explanations(open_store(store, at="newest"), list(dict.fromkeys(takes)))
    if as_json:
        print_json(
            {"store": store, "takes": [_document(one) for one in found], "unchanged": done.unchanged,
             "remarks": done.remarks}
        )  # fmt: skip
        return
    for one in found:
        _show(one, one.stabilised in done.unchanged, explain)


def _document(one: Explanation) -> dict[str, object]:
    return {
        "take": one.take,
        "stabilised": one.stabilised,
        "recording": one.row["recording"],
        "rounds": one.row["rounds"],
        "hits": one.row["hits"],
        "withdrawn": one.row["withdrawn"],
        "moved_mm": round(one.moved_mm, 3),
        "priors": one.priors.to_pylist(),
    }


def _show(one: Explanation, unchanged: bool, explain: bool) -> None:
    """Print the priors of a stabilised take if `explain` is set, and a line about the take if it was up to date."""
    from kinedex.ops.wording import counted

    if explain:
        rows = one.priors.select(list(_SHOWN))
        if rows.num_rows:
            show_table(rows)
        else:
            print_message(f"{one.take}: no motion of the archive was found within tau")
    if unchanged:
        print_message(
            f"{one.take}: up to date as {one.stabilised}; priors from {counted(one.row['hits'], 'hit')}, joints "
            f"moved by {one.moved_mm:.1f} mm on average"
        )


RecordingsArgument = Annotated[
    Path | None, typer.Argument(help="YAML file: name of a recording → depth images, camera, rate.")
]
BodyOption = Annotated[
    str,
    typer.Option(
        metavar="TAKE",
        help="A take of the person whose bone lengths count; or estimate. Of --follow also the height in metres.",
    ),
]
ExplainOption = Annotated[bool, typer.Option("--explain", help="List what was tried in each frame, at what cost.")]
FramesOption = Annotated[
    str | None, typer.Option(metavar="A:B", help="Explain frames A to B of each recording, without B.")
]


@command(TRACK)
def reconstruct(
    store: StorePath,
    recordings: RecordingsArgument = None,
    *,
    live: Follow,
    only: OnlyOption = None,
    body: BodyOption = "estimate",
    form: Annotated[str, typer.Option(help="best; printed: as the thesis has it.")] = "best",
    explain: ExplainOption = False,
    frames: FramesOption = None,
    options: Annotated[RunOptions, "assign force executor workers wait"],
    as_json: JsonOption = False,
) -> None:
    """Make takes of recordings by a depth camera.

    A recording becomes the take NAME_reconstructed; the poses of the store's takes serve as the pose database. This is
    the pipeline `depth`. Recordings that have not changed are not reconstructed again. With --follow, frames are
    reconstructed as a camera writes them, until Ctrl-C, and are saved as the take FOLDER_live. A line with its latency
    is printed for each frame; with --json, the line has the joints.
    """
    if live.follow is not None:
        if live.camera is None or recordings is not None:
            raise typer.BadParameter("--follow takes frames of a folder, and needs --camera FILE instead of RECORDINGS")
        from kinedex.commands.live_depth import follow_and_save

        follow_and_save(store, live, body, form, options.wait, as_json)
        return
    if recordings is None:
        raise typer.BadParameter("name the recordings file, or follow a folder: --follow DIR --camera FILE")
    from kinedex.pipelines.reconstruction.reconstructed_takes import explained_votes
    from kinedex.storage.store.store import open_store

    if frames is not None and not explain:
        raise typer.BadParameter("--frames chooses what --explain lists; a recording is always reconstructed whole")
    interval = None if frames is None else interval_of(frames)
    settings = {"recordings": str(recordings), "reconstruct.body": body, "reconstruct.form": form}
    outcome = options.run("depth", store, settings, {"reconstruct.only": json.dumps(only)} if only else None)
    if not explain:
        show_outcome(outcome, store, as_json)
        return
    takes = outcome.summaries["reconstruct"]["takes"]
    assert isinstance(takes, list)
    votes = explained_votes(open_store(store, at="newest"), "depth/reconstruct", takes, interval)
    if as_json:
        print_json({"store": store, "takes": takes, "votes": votes.to_pylist()})
        return
    show_outcome(outcome, store)
    show_table(votes)
