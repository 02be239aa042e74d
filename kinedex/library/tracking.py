"""Track recordings of cameras from Python, and stabilise takes by priors of the archive."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from kinedex.library.arguments import checked
from kinedex.library.pipeline import Executor, run_pipeline
from kinedex.pipelines.engine.runner import Outcome

if TYPE_CHECKING:
    import polars as pl

Priors = Literal["archive", "pose", "logical"]


@checked
def track(
    store: str | os.PathLike[str],
    recordings: str | Path,
    *,
    only: Iterable[str] = (),
    tracker: Literal["take", "frames"] = "take",
    executor: Executor = "serial",
    workers: int | None = None,
    wait_seconds: float = 0.0,
    verbose: bool = False,
) -> Outcome:
    """Track recordings of calibrated cameras: each becomes a take ``NAME_tracked``.

    Parameters
    ----------
    store : str, os.PathLike or Store
        The store; it is made where there is none. An open `Store` keeps showing the version that it was opened with.
    recordings : str or Path
        The recordings file: name of a recording → calibration, keypoints or silhouettes, rate.
    only : iterable of str, optional
        The names of recordings; by default all of the file.
    tracker : {"take", "frames"}
        "take" fits all frames at once; "frames" fits one after the other, as in the thesis.
    executor : {"serial", "processes", "dask"}
        The way recordings are distributed over workers, as for `run_pipeline`.
    workers : int, optional
        The number of worker processes; by default the number of cores.
    wait_seconds : float, optional
        The time to wait while another process writes to the store; 0 fails at once.
    verbose : bool, optional
        True prints the messages of the stages.

    Returns
    -------
    Outcome
        What ran; ``outcome.summaries["track"]["takes"]`` has the names of the takes.

    Raises
    ------
    KinedexError
        The recordings file, or a file that it names, is invalid; the message names file, line and key.

    Examples
    --------
    A take of the store stands for a recording here, as a 3D track.

    >>> import shutil
    >>> copy = shutil.copytree(store_path, folder / "copy")
    >>> _ = (folder / "recordings.yaml").write_text(f"recordings: {{again: {{track: {take.name}}}}}")
    >>> outcome = kinedex.track(copy, folder / "recordings.yaml")
    >>> outcome.summaries["track"]["takes"]
    ['again_tracked']
    """
    settings = {"recordings": str(recordings), "observe.only": list(only), "track.tracker": tracker}
    return run_pipeline(
        "track", store, settings, executor=executor, workers=workers, wait_seconds=wait_seconds, verbose=verbose
    )


@checked
def stabilise(
    store: str | os.PathLike[str],
    takes: str | Sequence[str],
    *,
    priors: Sequence[Priors] | None = None,
    tau: float = 0.13,
    rounds: int = 2,
    body: str = "estimate",
    classes: str | Path = "own",
    executor: Executor = "serial",
    workers: int | None = None,
    wait_seconds: float = 0.0,
    verbose: bool = False,
) -> pl.DataFrame:
    """Stabilise takes by priors of the archive: each becomes a take ``NAME_stabilised``.

    A take that was tracked is stabilised from the observations of its recording, any other one as a 3D track.

    Parameters
    ----------
    store : str, os.PathLike or Store
        The store. An open `Store` keeps showing the version that it was opened with.
    takes : str or sequence of str
        The takes.
    priors : sequence of {"archive", "pose", "logical"}, optional
        The kinds of priors; archive by default, but pose and logical for recordings with silhouettes alone.
    tau : float, optional
        The threshold of template hits: intervals with a distance below tau get priors.
    rounds : int, optional
        The largest number of rounds of search and stabilisation.
    body : str, optional
        For 3D tracks: a take of the actor, whose bone lengths are used, or "estimate".
    classes : str or Path, optional
        A class file with ``locomotion`` and ``marks``; "own" for one class per template, without these.
    executor : {"serial", "processes", "dask"}
        The way takes are distributed over workers, as for `run_pipeline`.
    workers : int, optional
        The number of worker processes; by default the number of cores.
    wait_seconds : float, optional
        The time to wait while another process writes to the store; 0 fails at once.
    verbose : bool, optional
        True prints the messages of the stages.

    Returns
    -------
    polars.DataFrame
        One row for each take: take, stabilised, rounds, hits, withdrawn, and moved_mm, the mean displacement of joints.

    Raises
    ------
    KinedexError
        A take is not in the store or lacks hips or shoulders, or the store has neither templates nor takes with a
        class.

    Examples
    --------
    >>> import shutil
    >>> copy = shutil.copytree(store_path, folder / "copy")
    >>> done = kinedex.stabilise(copy, take.name, rounds=1)
    >>> done["stabilised"].to_list() == [f"{take.name}_stabilised"]
    True
    """
    import polars as pl

    from kinedex.console.terminal import Terminal, collecting_terminal
    from kinedex.pipelines.engine.executors import make_executor
    from kinedex.pipelines.tracking.parameters import TrackParameters, stabilise_parameters
    from kinedex.pipelines.tracking.runs import explanations, stabilise_stored
    from kinedex.storage.lock import Wait
    from kinedex.storage.store.store import open_store

    given = {"tau": tau, "rounds": rounds, "body": body, "classes": str(classes), "priors": priors and list(priors)}
    params, tracker = stabilise_parameters(given), TrackParameters.model_validate({})
    names = [takes] if isinstance(takes, str) else list(takes)
    terminal = Terminal() if verbose else collecting_terminal(io.StringIO())
    pool = make_executor(executor, workers)
    wait = Wait(wait_seconds, terminal.say, "wait_seconds=600")
    try:
        stabilise_stored(Path(store), names, params, tracker, pool, terminal, wait)
    finally:
        pool.close()
    with open_store(Path(store), at="newest") as opened:
        found = explanations(opened, list(dict.fromkeys(names)))
    rows = [
        {
            "take": one.take,
            "stabilised": one.stabilised,
            **{key: one.row[key] for key in ("rounds", "hits", "withdrawn")},
            "moved_mm": one.moved_mm,
        }
        for one in found
    ]
    return pl.DataFrame(rows)
