"""Time whole depth recordings: the stage around the tracker, the parts of its time, and two at once on two cores.

The recordings are of two takes of the synthetic archive before the simulated time-of-flight camera, tracked forwards
with the poses of all takes, in a copy of the store.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import yaml

from benchmarks.archive import BUILD
from benchmarks.depth_frame import FRAME_PASSES, RUNS, mean_of_best, plain_pass, recording
from benchmarks.harness import Figure, silent, sized
from kinedex.ops.depth.points import Preparation
from kinedex.ops.depth.tracker import Reconstructor
from kinedex.pipelines.engine.executors import make_executor
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.reconstruction import reconstruction_runs
from kinedex.pipelines.reconstruction.parameters import ReconstructParameters
from kinedex.pipelines.reconstruction.reconstructed_takes import ReconstructionResult
from kinedex.pipelines.reconstruction.reconstruction_runs import ReconstructTask, reconstruct_recording
from kinedex.pipelines.simulation.simulated_depth import RECORDINGS, DepthRequest, simulate_depth
from kinedex.pipelines.tracking import recording_runs
from kinedex.storage.formats.depth.frames import DepthFrames
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter

FRAMES, RECORDED, RUNS_WHOLE = sized((120, 2, 3), (12, 2, 1))
MAX_AROUND = 10.0
"""Preparing points and writing are to take so many percent of the time at most."""

PARTS: dict[str, tuple[str, tuple[tuple[Any, str], ...]]] = {
    "read": ("reading images", ((DepthFrames, "__getitem__"),)),
    "prepare": ("preparing points", ((Preparation, "prepare"),)),
    "track": ("tracking, points included", ((Reconstructor, "step"),)),
    "write": (
        "writing",
        (
            (ReconstructionResult, "table"),
            (recording_runs, "put_takes"),
            (recording_runs, "put_for_takes"),
            (StoreWriter, "commit"),
        ),
    ),
}
"""Parts of the stage's time: what they are, and the functions that take them."""


def figures(store: Store) -> list[Figure]:
    """Time recordings as the stage makes takes of them."""
    folder = BUILD / "depth"
    path = _copy_with_recordings(store, folder)
    made = recording(store)
    plain = mean_of_best(made, lambda k: plain_pass(made, k, 1), RUNS)
    parts = min((_timed_run(path, folder) for _ in range(RUNS_WHOLE)), key=lambda one: one["whole"])
    frames, whole = RECORDED * FRAMES, parts["whole"]
    share = 100 * (parts["prepare"] + parts["write"]) / whole
    alone, together = _on_two_cores(path, folder)
    return [
        Figure(
            "depth: whole frame, with all that the stage does around it", frames, "frames", whole,
            f"{FRAME_PASSES} plain passes", frames * FRAME_PASSES * plain,
        ),
        Figure(
            "depth: preparing points and writing, of the stage's time", share, "%", None, f"at most {MAX_AROUND:g} %",
            other_amount=MAX_AROUND,
        ),
        *(
            Figure(f"depth: {name}, of the stage's time", 100 * parts[key] / whole, "%", None)
            for key, (name, _) in PARTS.items()
        ),
        Figure("depth: two recordings on two cores", frames, "frames", together, "one after the other", alone),
    ]  # fmt: skip


def _copy_with_recordings(store: Store, folder: Path) -> Path:
    """Return a copy of a store that has reconstructed its two longest takes from recordings of them."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    path = folder / "store"
    shutil.copytree(store.path, path)
    takes = store.takes().sort("frames", "name", descending=[True, False])["name"].to_list()[:RECORDED]
    request = DepthRequest(tuple(takes), None, 1, "tof", interval=(0, FRAMES))
    simulate_depth(open_store(path), request, folder / "recordings", silent().progress)
    file = folder / "recordings" / RECORDINGS
    content = yaml.safe_load(file.read_text())
    for name, entry in content["recordings"].items():
        entry["body"] = name
        del entry["truth"]
    file.write_text(yaml.safe_dump(content))
    _run(path, folder)
    return path


def _run(path: Path, folder: Path) -> None:
    settings = {
        "recordings": str(folder / "recordings" / RECORDINGS), "reconstruct.direction": "forward",
        "pose_database.where": "true",
    }  # fmt: skip
    run_pipeline(
        "depth", path, assignments=settings, executor="serial", force=frozenset({"reconstruct"}), terminal=silent()
    )


def _timed_run(path: Path, folder: Path) -> dict[str, float]:
    """Return the seconds that a run of the stage takes for its recordings, and for each of `PARTS`."""
    spent = {"whole": 0.0, **dict.fromkeys(PARTS, 0.0)}
    with ExitStack() as timers:
        timers.enter_context(_timed(reconstruction_runs, "run_tasks", spent, "whole"))
        for key, (_, functions) in PARTS.items():
            for owner, name in functions:
                timers.enter_context(_timed(owner, name, spent, key))
        _run(path, folder)
    return spent


@contextmanager
def _timed(owner: Any, name: str, spent: dict[str, float], key: str) -> Iterator[None]:
    """Add the time of each call of a function to a sum, while a `with` statement runs."""
    plain: Callable[..., Any] = getattr(owner, name)

    def timed(*given: Any, **named: Any) -> Any:
        begin = time.perf_counter()
        try:
            return plain(*given, **named)
        finally:
            spent[key] += time.perf_counter() - begin

    setattr(owner, name, timed)
    try:
        yield
    finally:
        setattr(owner, name, plain)


def _on_two_cores(path: Path, folder: Path) -> tuple[float, float]:
    """Return the seconds of the recordings one after the other, and side by side in two processes."""
    with open_store(path, at="newest") as store:
        params = ReconstructParameters.model_validate(
            {"recordings": str(folder / "recordings" / RECORDINGS), "direction": "forward"}
        )
        rows = store.result("reconstructions").to_pylist()
        tasks = [
            ReconstructTask(
                store, "depth/pose_database", row["recording"], row["take"], row["take_id"], params, "", "bench"
            )
            for row in rows
        ]
        found = []
        for workers in (1, RECORDED):
            pool = make_executor("processes", workers)
            times = []
            for _ in range(1 + RUNS_WHOLE):  # the first run starts processes and loads kernels
                begin = time.perf_counter()
                list(pool.map(reconstruct_recording, tasks))
                times.append(time.perf_counter() - begin)
            pool.close()
            found.append(min(times[1:]))
    return found[0], found[1]
