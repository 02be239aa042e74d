"""Track frames of a live depth camera, print them, and save the take: `kinedex reconstruct --follow`."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Literal

import numpy as np
import typer

from kinedex.commands.options import Follow, wait_of
from kinedex.commands.output import print_message
from kinedex.ops.depth.lookup import near_maps
from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import counted
from kinedex.pipelines.reconstruction.followed_folder import FollowedFrame, follow_folder
from kinedex.pipelines.reconstruction.live_tracker import LiveRecording, LiveTracker, put_live_take, write_live_motion
from kinedex.pipelines.tracking.recording_runs import COMPILING, is_compiled, rebuild_index
from kinedex.storage.store.store import open_store

PATIENCE_S = 600.0
"""The longest time in seconds to wait for another writer before a take is saved, unless --wait is given."""


def follow_and_save(store: Path, follow: Follow, body: str, form: str, wait: float | None, as_json: bool) -> None:
    """Reconstruct and print each frame that is written into a folder, and save all frames as a take at the end."""
    folder, camera = follow.follow, follow.camera
    assert folder is not None
    assert camera is not None
    if not is_compiled(near_maps):
        print_message(COMPILING)
    tracker = LiveTracker.open(store, camera, _live_body(body), follow.background, None, _form(form), keep=True)
    live = LiveRecording(tracker, folder, camera)
    size = "of a size that is estimated in the first second" if tracker.is_measuring else _height(tracker)
    print_message(f"following {folder}: a person {size}; Ctrl-C ends and saves")
    try:
        with _ended_by_signals():
            _follow(live, follow.idle, as_json)
    except KeyboardInterrupt:
        pass
    finally:
        _save(store, live, PATIENCE_S if wait is None else wait, as_json)


def _follow(live: LiveRecording, idle: float | None, as_json: bool) -> None:
    """Print each reconstructed frame, and the latencies at the end."""
    tracker, frames, unseen = live.tracker, 0, 0
    latencies: list[float] = []
    try:
        for one in follow_folder(tracker, live.folder, idle, print_message):
            if not frames:
                live.first_frame = one.number
            frames, unseen, live.bytes = frames + 1, unseen + (one.hypothesis is None), live.bytes + one.bytes
            if one.latency_ms is not None:
                latencies.append(one.latency_ms)
            typer.echo(json.dumps(one.document()) if as_json else _followed_line(one))
            if one.estimated_m is not None:
                print_message(f"a person {_height(tracker)}, estimated; latencies count from here")
                latencies.clear()
    finally:
        print_message(f"{counted(frames, 'frame')}, {unseen:,} without a person{_latencies(latencies)}")


def _latencies(latencies: list[float]) -> str:
    """Return a clause with the median, the 95th percentile and the maximum of latencies."""
    if not latencies:
        return ""
    median, most = np.percentile(latencies, [50, 95])
    return f"; latency {median:.1f} ms in the median, 95 % within {most:.1f} ms, at worst {max(latencies):.1f} ms"


def _save(store: Path, live: LiveRecording, wait: float, as_json: bool) -> None:
    """Save the frames as a take, or as a motion file in the working directory if the store cannot be written."""
    with suppress(KeyboardInterrupt):  # if this is interrupted, the take has the mean bone lengths
        live.tracker.measure()
    if not live.is_seen:
        print_message(
            f"nothing to save: nobody was seen; are {live.camera}, its `depth_unit_m` and --background right?"
        )
        return
    try:
        take, remarks = put_live_take(store, live, wait_of(wait))
    except (KinedexError, OSError, KeyboardInterrupt) as fault:
        path = write_live_motion(live, Path.cwd())
        raise KinedexError(
            f"{str(fault) or 'stopped'}\nthe store has no take of this session; its joints are in {path}, which an "
            "ingest of its folder reads"
        ) from None
    rebuild_index(store, wait_of(wait))
    with open_store(store, at="newest") as opened:
        row = next(row for row in opened.take_rows.to_pylist() if row["name"] == take)
    if as_json:
        typer.echo(json.dumps({"take": take, "frames": row["source_frames"], "remarks": list(remarks)}))
        return
    for remark in remarks:
        print_message(remark)
    print_message(
        f"saved as {take}: {counted(row['source_frames'], 'frame')} at {row['source_rate_hz']:g} per second, "
        f"{row['invalid_frames']:,} of {row['frames']:,} analysis frames without a pose"
    )


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Turn signals that end a process, such as when a terminal is closed, into KeyboardInterrupt in the block."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    chosen = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)]
    before = {one: signal.signal(one, _stop) for one in chosen}
    try:
        yield
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


def _stop(number: int, frame: object) -> None:
    raise KeyboardInterrupt


def _height(tracker: LiveTracker) -> str:
    return f"{tracker.bones.height_m:.2f} m tall"


def _followed_line(one: FollowedFrame) -> str:
    if one.fault:
        return f"{one.number}: damaged: {one.fault}"
    latency = "" if one.latency_ms is None else f", latency {one.latency_ms:.1f} ms"
    missing = f", {one.skipped} missing before" if one.skipped else ""
    pose = "nobody" if one.hypothesis is None else f"{one.hypothesis}, cost {100 * one.cost:.1f} cm"
    return f"{one.number}: {pose}, {one.work_ms:.1f} ms{latency}{missing}"


def _live_body(body: str) -> str | float:
    try:
        return float(body)
    except ValueError:
        return body


def _form(text: str) -> Literal["best", "printed"]:
    if text not in ("best", "printed"):
        raise typer.BadParameter(f"--form {text}: expected best or printed")
    return "printed" if text == "printed" else "best"
