"""Run the demos: a pipeline on a synthetic archive, which is made if it is missing, or on an archive of the user."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from kinedex.console.terminal import Terminal
from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import counted, few
from kinedex.pipelines.engine.executors import cores
from kinedex.pipelines.engine.kernel_compilation import KernelCompilation
from kinedex.pipelines.engine.runner import Outcome, run_pipeline
from kinedex.pipelines.synth.archive import Summary, write_archive
from kinedex.storage.snapshot.manifest_files import versions
from kinedex.storage.store.store import open_store

ACTORS, SEED = 5, 2026

FILMED, LEAST_FRAMES = "al", 45
"""The actor who is filmed in the demos of tracking and depth, and the least number of frames of a filmed clip."""

DEPTH_TAKES = 6
"""Number of clips that are filmed in the demo of depth."""


def run_demo(
    store: Path,
    data: Path | None,
    minutes: float,
    executor: str,
    workers: int | None,
    console: Console,
    method: str = "thesis",
) -> Outcome:
    """Run the pipeline `annotate`; without data, on a synthetic archive beside the store.

    Parameters
    ----------
    store : Path
        Directory of the store.
    data : Path or None
        Archive of the user; None makes a synthetic one.
    minutes : float
        Minutes of motion in the synthetic archive.
    executor : str
        Executor, as for `run_pipeline`.
    workers : int or None
        Number of workers, as for `run_pipeline`.
    console : Console
        Where messages are printed.
    method : str
        Method of the stage `annotate`: thesis or best.

    Returns
    -------
    Outcome
        What the pipeline did.

    Raises
    ------
    KinedexError
        If `data` is no folder, or a stage fails.
    """
    settings = {"method": method}
    if data is not None and not data.is_dir():
        raise KinedexError(f"--data {data}: no such folder")
    refuse_other_takes(store, data or archive_folder(store, minutes))
    if data is None:
        data = archive_folder(store, minutes)
        kernels = None if data.exists() or executor == "serial" else KernelCompilation(workers)
        make_archive(data, minutes, ACTORS, SEED, workers, console)
        if kernels is not None and not kernels.is_done:
            with Terminal(console).progress("compiling kernels"):
                kernels.wait()
        settings["classes"] = "synthetic"
    settings["source"] = str(data)
    console.print(f"store: {store}", markup=False)
    return run_pipeline(
        "annotate", store, assignments=settings, executor=executor, workers=workers, terminal=Terminal(console)
    )


def run_tracking_demo(store: Path, minutes: float, executor: str, workers: int | None, console: Console) -> Outcome:
    """Film takes of one actor of a synthetic archive, and run the pipeline `stabilise` with the archive of the others.

    Parameters
    ----------
    store : Path
        Directory of the store.
    minutes : float
        Minutes of motion in the synthetic archive.
    executor : str
        Executor, as for `run_pipeline`.
    workers : int or None
        Number of workers, as for `run_pipeline`.
    console : Console
        Where messages are printed.

    Raises
    ------
    KinedexError
        A stage fails.
    """
    from kinedex.pipelines.simulation.camera_recordings import Request, simulate_cameras

    terminal = Terminal(console)
    common: dict[str, Any] = {"executor": executor, "workers": workers, "terminal": terminal}
    data = ingest_archive(store, minutes, console, common)
    recordings = recordings_folder(store, minutes)
    if not (recordings / "recordings.yaml").is_file():
        console.print(f"recordings of the actor '{FILMED}' in {recordings}", style="bold", markup=False)
        where = f"actor = '{FILMED}' AND class IS NOT NULL AND frames >= {LEAST_FRAMES}"
        with open_store(store) as opened:
            made = simulate_cameras(opened, Request(where=where, seed=SEED), recordings, terminal.progress)
        filmed = f"{counted(len(made.recordings), 'recording')}, {counted(made.failures, 'failure')}"
        console.print(f"    {filmed} in {made.frames:,} frames", markup=False)
    console.print(f"store: {store}", markup=False)
    settings = {
        "source": str(data),
        "recordings": str(recordings / "recordings.yaml"),
        "train": f"class IS NOT NULL AND actor <> '{FILMED}'",
    }
    return run_settled("stabilise", store, settings, common)


def run_depth_demo(store: Path, minutes: float, executor: str, workers: int | None, console: Console) -> Outcome:
    """Film takes of one actor of a synthetic archive by a depth camera, and reconstruct them with the others' poses.

    Parameters
    ----------
    store : Path
        Directory of the store.
    minutes : float
        Minutes of motion in the synthetic archive.
    executor : str
        Executor, as for `run_pipeline`.
    workers : int or None
        Number of workers, as for `run_pipeline`.
    console : Console
        Where messages are printed.

    Raises
    ------
    KinedexError
        A stage fails.
    """
    from kinedex.pipelines.simulation.depth_recordings import RECORDINGS, Request, simulate_depth

    terminal = Terminal(console)
    common: dict[str, Any] = {"executor": executor, "workers": workers, "terminal": terminal}
    data = ingest_archive(store, minutes, console, common)
    recordings = recordings_folder(store, minutes)
    if not (recordings / RECORDINGS).is_file():
        console.print(f"depth recordings of the actor '{FILMED}' in {recordings}", style="bold", markup=False)
        where = f"actor = '{FILMED}' AND class IS NOT NULL AND frames >= {LEAST_FRAMES}"
        with open_store(store) as opened:
            names = [str(name) for name in opened.takes(where).sort("name")["name"].to_list()][:DEPTH_TAKES]
            made = simulate_depth(opened, Request(tuple(names), seed=SEED), recordings, terminal.progress)
        console.print(f"    {counted(len(made.recordings), 'recording')}, {made.frames:,} frames", markup=False)
    console.print(f"store: {store}", markup=False)
    settings = {
        "source": str(data),
        "recordings": str(recordings / RECORDINGS),
        "pose_database.where": f"class IS NOT NULL AND actor <> '{FILMED}'",
    }
    return run_settled("reconstruct", store, settings, common)


def run_settled(pipeline: str, store: Path, settings: Mapping[str, str], run: Mapping[str, Any]) -> Outcome:
    """Run a pipeline that makes takes from recordings, and run it again, so that the index has these takes.

    Parameters
    ----------
    pipeline : str
        Name of the pipeline.
    store : Path
        Directory of the store.
    settings : mapping of str to str
        Its settings, as `--set` gives them.
    run : mapping of str to any
        Executor, workers and terminal, as for `run_pipeline`.

    Returns
    -------
    Outcome
        That of the first run; a later one with the same settings has nothing to do.
    """
    outcome = run_pipeline(pipeline, store, assignments=settings, **run)
    if outcome.ran:
        run["terminal"].heading("the same again, with the takes of the recordings in the index")
        run_pipeline(pipeline, store, assignments=settings, **run)
    return outcome


def ingest_archive(store: Path, minutes: float, console: Console, run: Mapping[str, Any]) -> Path:
    """Make the synthetic archive of a demo beside its store, ingest it, and return its folder.

    Parameters
    ----------
    store : Path
        Directory of the store.
    minutes : float
        Minutes of motion.
    console : Console
        Where messages are printed.
    run : mapping of str to any
        Executor, workers and terminal, as for `run_pipeline`.
    """
    from kinedex.catalog.configs import config_path, load_yaml

    data = archive_folder(store, minutes)
    refuse_other_takes(store, data)
    make_archive(data, minutes, ACTORS, SEED, run["workers"], console)
    patterns = load_yaml(config_path("pipelines", "reconstruct")).mapping()["settings"]["patterns"]
    run_pipeline("ingest", store, settings={"source": str(data), "ingest.patterns": patterns}, **run)
    return data


def archive_folder(store: Path, minutes: float) -> Path:
    """Return the folder of a demo's synthetic archive, beside its store."""
    return store.parent / f"{store.name}-archive-{minutes:g}min"


def refuse_other_takes(store: Path, data: Path) -> None:
    """Raise an error if a store has takes, none of which are from this archive; nothing is written.

    Parameters
    ----------
    store : Path
        Directory of the store, which need not exist.
    data : Path
        Folder of the motion files of the demo, compared by name, since store and folder may have been moved.

    Raises
    ------
    KinedexError
        The store holds takes, but none of this archive.
    """
    if not versions(store):
        return
    rows = open_store(store, at="newest").take_rows.select(["source_root"]).to_pylist()
    roots = {Path(row["source_root"]) for row in rows if row["source_root"]}
    if not roots or any(root.name == data.resolve().name for root in roots):
        return
    raise KinedexError(
        f"{store} holds {counted(len(rows), 'take')} of {few(sorted(map(str, roots)))}, and none of {data}: the demo "
        "would mix others with them; name a folder for its store that does not exist yet, such as "
        f"{store.with_name(store.name + '-demo')}"
    )


def recordings_folder(store: Path, minutes: float) -> Path:
    """Return the folder of a demo's recordings, which depends on the length of the archive, as the takes do."""
    return store.parent / f"{store.name}-recordings-{minutes:g}min"


def make_archive(
    directory: Path, minutes: float, actors: int, seed: int, workers: int | None, console: Console
) -> Summary:
    """Make a synthetic archive, or finish one that was interrupted, and print what it holds.

    Raises
    ------
    KinedexError
        If the folder holds something else.
    """
    begin = time.perf_counter()
    console.print(f"synthetic archive of {minutes:g} minutes in {directory}", style="bold", markup=False)
    summary = write_archive(
        directory, minutes=minutes, actors=actors, seed=seed, progress=Terminal(console).progress,
        jobs=workers or cores(),
    )  # fmt: skip
    console.print(f"    {summary}", markup=False)
    took = f"made in {time.perf_counter() - begin:.0f} s" if summary.made else "made before"
    console.print(f"    {took}", markup=False)
    return summary
