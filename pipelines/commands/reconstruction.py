"""Commands of reconstruction from depth: reconstruct."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from kinedex.pipelines.commands.app import TRACK, command
from kinedex.pipelines.commands.options import (
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
from kinedex.pipelines.commands.output import print_json, print_message, show_outcome, show_table

if TYPE_CHECKING:
    from kinedex.pipelines.reconstruction.followed_folder import FollowedFrame

_STAGE = "depth/reconstruct"


@command(TRACK)
def reconstruct(
    store: StorePath,
    recordings: Annotated[
        Path | None, typer.Argument(help="YAML file: name of a recording → depth images, camera, rate.")
    ] = None,
    follow: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Reconstruct the frames that are written into this folder.")
    ] = None,
    camera: Annotated[Path | None, typer.Option(metavar="FILE", help="Of --follow: the camera.")] = None,
    background: Annotated[Path | None, typer.Option(metavar="FILE", help="Of --follow: the empty room.")] = None,
    idle: Annotated[
        float | None, typer.Option(min=0.1, metavar="SECONDS", help="Of --follow: end so long after the last frame.")
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option("--only", metavar="NAME", help="Only this recording; may be repeated."),
    ] = None,
    body: Annotated[
        str,
        typer.Option(
            metavar="TAKE",
            help="A take of the person whose bone lengths count; or estimate. Of --follow also the height in metres.",
        ),
    ] = "estimate",
    form: Annotated[str, typer.Option(help="best; printed: as the thesis has it.")] = "best",
    explain: Annotated[
        bool, typer.Option("--explain", help="List what was tried in each frame, at what cost.")
    ] = False,
    frames: Annotated[
        str | None, typer.Option(metavar="A:B", help="Explain frames A to B of each recording, without B.")
    ] = None,
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
    they appear, with the latency of each, until Ctrl-C; --json prints a line with the joints for each.
    """
    if follow is not None:
        if camera is None or recordings is not None:
            raise typer.BadParameter("--follow takes frames of a folder, and needs --camera FILE instead of RECORDINGS")
        _follow(store, follow, camera, background, body, form, idle, as_json)
        return
    if recordings is None:
        raise typer.BadParameter("name the recordings file, or follow a folder: --follow DIR --camera FILE")
    import json

    from kinedex.pipelines.engine.runner import run_pipeline
    from kinedex.pipelines.reconstruction.explanations import explained_votes
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
        wait_seconds=wait or 0.0,
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


def _follow(
    store: Path, folder: Path, camera: Path, background: Path | None, body: str, form: str, idle: float | None,
    as_json: bool,
) -> None:  # fmt: skip
    """Reconstruct the frames that are written into a folder, and print each."""
    import json

    from kinedex.pipelines.reconstruction.followed_folder import follow_folder
    from kinedex.pipelines.reconstruction.live import LiveTracker

    tracker = LiveTracker.open(store, camera, _live_body(body), background, None, _form(form))
    print_message(f"following {folder}: a person {tracker.bones.height_m:.2f} m tall; Ctrl-C ends")
    latencies, frames, unseen = [], 0, 0
    try:
        for one in follow_folder(tracker, folder, idle):
            frames, unseen = frames + 1, unseen + (one.hypothesis is None)
            latencies += [] if one.latency_ms is None else [one.latency_ms]
            if as_json:
                typer.echo(json.dumps(one.document()))
            else:
                typer.echo(_followed_line(one))
    except KeyboardInterrupt:
        pass
    latencies.sort()
    shown = ""
    if latencies:
        median, most = latencies[len(latencies) // 2], latencies[9 * len(latencies) // 10]
        shown = f"; latency {median:.1f} ms in the median, at most {most:.1f} ms for nine of ten"
    print_message(f"{frames:,} frames, {unseen:,} without a person{shown}")


def _followed_line(one: FollowedFrame) -> str:
    if one.fault:
        return f"{one.number}: damaged: {one.fault}"
    latency = "" if one.latency_ms is None else f", latency {one.latency_ms:.1f} ms"
    missing = f", {one.skipped} missing before" if one.skipped else ""
    pose = "nobody" if one.hypothesis is None else f"{one.hypothesis}, cost {100 * one.cost:.1f} cm"
    return f"{one.number}: {pose}, {one.work_ms:.1f} ms{latency}{missing}"


def _live_body(body: str) -> str | float | None:
    if body == "estimate":
        return None
    try:
        return float(body)
    except ValueError:
        return body


def _form(text: str) -> Literal["best", "printed"]:
    if text not in ("best", "printed"):
        raise typer.BadParameter(f"--form {text}: expected best or printed")
    return "printed" if text == "printed" else "best"
