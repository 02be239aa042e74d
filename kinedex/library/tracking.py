"""Make takes from recordings: track camera recordings, reconstruct depth (also live), and stabilise takes by priors."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from kinedex.library.arguments import checked
from kinedex.library.pipeline import Executor, run_pipeline
from kinedex.ops.arrays import F64
from kinedex.pipelines.engine.runner import Outcome

if TYPE_CHECKING:
    import polars as pl

    from kinedex.ops.depth.tracker import FrameResult


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
    """Track recordings of calibrated cameras; each recording becomes a take ``NAME_tracked``.

    Parameters
    ----------
    store : str, os.PathLike or Store
        The store, which is created if it is missing. An open `Store` still shows the version with which it was opened.
    recordings : str or Path
        The recordings file, which gives each recording a calibration, keypoints or silhouettes, and a rate.
    only : iterable of str, optional
        The names of recordings; by default all recordings of the file.
    tracker : {"take", "frames"}
        "take" fits all frames at once; "frames" fits one frame after the other, as in the thesis.
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
        The outcome of the run; ``outcome.summaries["track"]["takes"]`` has the names of the takes.

    Raises
    ------
    KinedexError
        The recordings file, or a file that it names, is invalid; the message names file, line and key.

    Examples
    --------
    In this example, a take of the store serves as a recording, as a 3D track.

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
    """Stabilise takes with priors from the archive; each take becomes a take ``NAME_stabilised``.

    A take that was tracked is stabilised from the observations of its recording, and any other take as a 3D track.

    Parameters
    ----------
    store : str, os.PathLike or Store
        The store. An open `Store` still shows the version with which it was opened.
    takes : str or sequence of str
        The names of the takes.
    priors : sequence of {"archive", "pose", "logical"}, optional
        The kinds of priors; by default "archive", or "pose" and "logical" for recordings with only silhouettes.
    tau : float, optional
        The threshold of template hits; priors are applied to intervals with a distance below tau.
    rounds : int, optional
        The largest number of iterations of search and stabilisation.
    body : str, optional
        For 3D tracks, a take of the actor whose bone lengths are used, or "estimate".
    classes : str or Path, optional
        A class file with ``locomotion`` and ``marks``, or "own" for one class per template, without these keys.
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
        One row for each take: take, stabilised, rounds, hits, withdrawn, and moved_mm (mean displacement of joints).

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
    from kinedex.pipelines.tracking.tracking_runs import explanations, stabilise_stored
    from kinedex.storage.lock import Wait
    from kinedex.storage.store.store import open_store

    given = {"tau": tau, "rounds": rounds, "body": body, "classes": str(classes), "priors": priors and list(priors)}
    params, tracker = stabilise_parameters(given), TrackParameters.model_validate({})
    names = [takes] if isinstance(takes, str) else list(takes)
    terminal = Terminal() if verbose else collecting_terminal(io.StringIO())
    pool = make_executor(executor, workers)
    wait = Wait(wait_seconds, terminal.message, "wait_seconds=600")
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


@checked
def reconstruct(
    store: str | os.PathLike[str],
    recordings: str | Path,
    *,
    only: Iterable[str] = (),
    body: str = "estimate",
    form: Literal["best", "printed"] = "best",
    direction: Literal["both", "forward"] = "both",
    where: str = "class IS NOT NULL",
    executor: Executor = "serial",
    workers: int | None = None,
    wait_seconds: float = 0.0,
    verbose: bool = False,
) -> Outcome:
    """Reconstruct recordings of a depth camera; each recording becomes a take ``NAME_reconstructed``.

    Parameters
    ----------
    store : str, os.PathLike or Store
        The store, whose takes are the pose database. An open `Store` still shows the version with which it was opened.
    recordings : str or Path
        The recordings file, which gives each recording depth images, a camera, background, rate, body and ground truth.
    only : iterable of str, optional
        The names of recordings; by default all recordings of the file.
    body : str, optional
        A take of the person, whose bone lengths are used, or "estimate"; a body in the recordings file overrides it.
    form : {"best", "printed"}
        The form of the algorithm: "printed" follows the thesis, and "best" is an improvement by kinedex.
    direction : {"both", "forward"}
        "both" tracks forwards and backwards in time and uses the better pose of each frame; "forward" works as live
        tracking does.
    where : str, optional
        A SQL filter over the columns of takes, which selects the takes of the pose database.
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
        The outcome of the run; ``outcome.summaries["reconstruct"]["takes"]`` has the names of the takes, and
        ``outcome.summaries["evaluate_reconstruction"]["takes"]`` their mean errors in metres if the truth is known.

    Raises
    ------
    KinedexError
        The recordings file, or a file that it names, is invalid; the message names file, line and key.

    Examples
    --------
    The command `kinedex simulate depth` films half a second of a take of the store.

    >>> import shutil, subprocess, sys
    >>> copy = shutil.copytree(store_path, folder / "copy")
    >>> filmed = folder / "filmed"
    >>> options = ["--frames", "0:15", "--seed", "1", "--output", filmed, "--quiet"]
    >>> simulate = [sys.executable, "-m", "kinedex", "simulate", "depth", copy, take.name, *options]
    >>> _ = subprocess.run(simulate, check=True)
    >>> outcome = kinedex.reconstruct(copy, filmed / "recordings.yaml", direction="forward")
    >>> len(outcome.summaries["reconstruct"]["takes"])
    1
    """
    settings = {
        "recordings": str(recordings), "reconstruct.only": list(only), "reconstruct.body": body,
        "reconstruct.form": form, "reconstruct.direction": direction, "pose_database.where": where,
    }  # fmt: skip
    return run_pipeline(
        "depth", store, settings, executor=executor, workers=workers, wait_seconds=wait_seconds, verbose=verbose
    )


class Reconstructor:
    """Reconstructs the pose of a person from the frames of a depth camera, one after the other.

    Parameters
    ----------
    store : str, os.PathLike or Store
        The store, whose newest pose database is used; if there is none, the poses of all takes with a class are used.
    camera : str or Path
        The YAML file of the camera: width, height, fx, fy, cx, cy, depth_unit_m, and `up` or `pose` if the camera is
        tilted.
    body : str or float, optional
        A take of the person, whose bone lengths are used; the standing height in metres; or "estimate". The latter uses
        the mean body of the archive in the first second, and then measures the body in one step that takes some
        seconds. By default the mean body is used.
    background : str, Path or array (H, W), optional
        The empty room as a depth image, or as depths in metres. By default all measured pixels count as the person.
    rate_hz : float, optional
        Frames per second; by default the rate that the file of the camera states, or 30.
    form : {"best", "printed"}
        The form of the algorithm: "printed" follows the thesis, and "best" is an improvement by kinedex.
    stride : int, optional
        Every stride-th row and column of pixels is used; by default, the stride is chosen in the first frame that shows
        a person.

    Raises
    ------
    KinedexError
        The file of the camera is invalid, the store has no such take, or no takes for the pose database.

    Examples
    --------
    An image in which nothing was measured shows no person.

    >>> camera = "{width: 64, height: 48, fx: 60, fy: 60, cx: 31.5, cy: 23.5, depth_unit_m: 0.001}"
    >>> _ = (folder / "camera.yaml").write_text(camera)
    >>> person = kinedex.Reconstructor(store, folder / "camera.yaml", body=1.75)
    >>> pose = person.step(np.zeros((48, 64)))
    >>> pose.shape, bool(np.isnan(pose).all())
    ((24, 3), True)
    """

    @checked
    def __init__(
        self,
        store: str | os.PathLike[str],
        camera: str | Path,
        *,
        body: str | float | None = None,
        background: str | Path | npt.ArrayLike | None = None,
        rate_hz: float | None = None,
        form: Literal["best", "printed"] = "best",
        stride: int | None = None,
    ) -> None:
        from kinedex.pipelines.reconstruction.live_tracker import LiveTracker

        self._tracker = LiveTracker.open(Path(store), Path(camera), body, background, rate_hz, form, stride)
        self.last: FrameResult | None = None
        """The result of the last frame, with its explanation, in camera axes; None until a person is seen."""

    @property
    def joints(self) -> tuple[str, ...]:
        """The names of the 24 joints, in the order of a pose."""
        from kinedex.ops.body.joint_tree import JOINTS

        return JOINTS

    @property
    def height_m(self) -> float:
        """The standing height of the body in metres."""
        return self._tracker.bones.height_m

    def step(self, depth: npt.ArrayLike) -> F64:
        """Return the pose of the next frame.

        Parameters
        ----------
        depth : array (H, W)
            Depths as integers in units of the camera, or as floats in metres; 0 where nothing was measured.

        Returns
        -------
        float64 array (24, 3)
            The joints in metres, in world axes if the camera has a pose, otherwise with Y up and the camera above the
            origin; NaN if no person is seen.

        Raises
        ------
        KinedexError
            The image has another size than the images of the camera.

        Examples
        --------
        >>> camera = "{width: 64, height: 48, fx: 60, fy: 60, cx: 31.5, cy: 23.5, depth_unit_m: 0.001}"
        >>> _ = (folder / "camera.yaml").write_text(camera)
        >>> person = kinedex.Reconstructor(store, folder / "camera.yaml", body=1.75)
        >>> person.step(np.zeros((48, 64))).shape
        (24, 3)
        >>> person.last is None
        True
        """
        self.last, pose = self._tracker.step(np.asarray(depth))
        return pose

    def skip(self, frames: int = 1) -> None:
        """Skip frames that are missing; after more than 0.2 s without frames, the person is detected again.

        Parameters
        ----------
        frames : int, optional
            The number of frames that are missing.

        Examples
        --------
        >>> camera = "{width: 64, height: 48, fx: 60, fy: 60, cx: 31.5, cy: 23.5, depth_unit_m: 0.001}"
        >>> _ = (folder / "camera.yaml").write_text(camera)
        >>> person = kinedex.Reconstructor(store, folder / "camera.yaml", body=1.75)
        >>> person.skip(3)
        """
        self._tracker.skip(frames)
