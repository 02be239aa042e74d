"""Commands of reconstruction from depth: reconstruct."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from kinedex.commands.app import TRACK, command
from kinedex.commands.options import (
    ExecutorOption,
    ForceOption,
    JsonOption,
    SetOption,
    StorePath,
    WaitOption,
    WorkersOption,
    assignments_of,
    interval_of,
)
from kinedex.commands.output import print_json, show_outcome, show_table

_STAGE = "depth/reconstruct"

RecordingsArgument = Annotated[
    Path | None, typer.Argument(help="YAML file: name of a recording → depth images, camera, rate.")
]
FollowOption = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Reconstruct the frames that are written into this folder.")
]
CameraOption = Annotated[Path | None, typer.Option(metavar="FILE", help="Of --follow: the camera.")]
BackgroundOption = Annotated[Path | None, typer.Option(metavar="FILE", help="Of --follow: the empty room.")]
IdleOption = Annotated[
    float | None, typer.Option(min=0.1, metavar="SECONDS", help="Of --follow: end so long after the last frame.")
]
OnlyOption = Annotated[
    list[str] | None, typer.Option("--only", metavar="NAME", help="Only this recording; may be repeated.")
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
    follow: FollowOption = None,
    camera: CameraOption = None,
    background: BackgroundOption = None,
    idle: IdleOption = None,
    only: OnlyOption = None,
    body: BodyOption = "estimate",
    form: Annotated[str, typer.Option(help="best; printed: as the thesis has it.")] = "best",
    explain: ExplainOption = False,
    frames: FramesOption = None,
    assign: SetOption = None,
    force: ForceOption = None,
    executor: ExecutorOption = "processes",
    workers: WorkersOption = None,
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make takes of recordings by a depth camera.

    A recording becomes the take NAME_reconstructed, with poses of the store as memory. This is the pipeline `depth`.
    Recordings that are unchanged stay as they are. With --follow the frames that a camera writes are reconstructed as
    they appear, with the latency of each, until Ctrl-C, and are saved as the take FOLDER_live; --json prints a line
    with the joints for each.
    """
    if follow is not None:
        if camera is None or recordings is not None:
            raise typer.BadParameter("--follow takes frames of a folder, and needs --camera FILE instead of RECORDINGS")
        from kinedex.commands.live_depth import follow_and_save

        follow_and_save(store, follow, camera, background, body, form, idle, wait, as_json)
        return
    if recordings is None:
        raise typer.BadParameter("name the recordings file, or follow a folder: --follow DIR --camera FILE")
    import json

    from kinedex.console.terminal import Terminal
    from kinedex.pipelines.engine.runner import run_pipeline
    from kinedex.pipelines.reconstruction.reconstructed_takes import explained_votes
    from kinedex.storage.store.store import open_store

    if frames is not None and not explain:
        raise typer.BadParameter("--frames chooses what --explain lists; a recording is always reconstructed whole")
    interval = None if frames is None else interval_of(frames)
    assignments = {
        "recordings": str(recordings), "reconstruct.body": body, "reconstruct.form": form, **assignments_of(assign)
    }  # fmt: skip
    if only:
        assignments["reconstruct.only"] = json.dumps(only)
    outcome = run_pipeline(
        "depth", store, assignments=assignments, executor=executor, workers=workers, force=frozenset(force or ()),
        terminal=Terminal(), wait_seconds=wait or 0.0,
    )  # fmt: skip
    if not explain:
        show_outcome(outcome, store, as_json)
        return
    takes = outcome.summaries["reconstruct"]["takes"]
    assert isinstance(takes, list)
    votes = explained_votes(open_store(store, at="newest"), _STAGE, takes, interval)
    if as_json:
        print_json({"store": store, "takes": takes, "votes": votes.to_pylist()})
        return
    show_outcome(outcome, store)
    show_table(votes, "table", None)
