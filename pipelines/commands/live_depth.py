"""Frames of a live depth camera on the terminal: `kinedex reconstruct --follow`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

import typer

from kinedex.pipelines.commands.output import print_message
from kinedex.pipelines.reconstruction.followed_folder import FollowedFrame, follow_folder
from kinedex.pipelines.reconstruction.live import LiveTracker


def print_followed(
    store: Path, folder: Path, camera: Path, background: Path | None, body: str, form: str, idle: float | None,
    as_json: bool,
) -> None:  # fmt: skip
    """Reconstruct the frames that are written into a folder, and print each."""
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
