"""Run pipelines from Python: ingest motion files into a store, and run any other pipeline."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from kinedex.console.terminal import Terminal, collecting_terminal
from kinedex.library.arguments import checked
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.runner import Outcome
from kinedex.pipelines.engine.runner import run_pipeline as run_stages

Executor = Literal["serial", "processes", "dask"]


@checked
def run_pipeline(
    pipeline: str | Path,
    store: str | os.PathLike[str],
    settings: Mapping[str, Any] | None = None,
    *,
    executor: Executor = "serial",
    workers: int | None = None,
    scheduler: str | None = None,
    force: Iterable[str] = (),
    wait_seconds: float = 0.0,
    accept: bool = False,
    verbose: bool = False,
) -> Outcome:
    """Run the stages of a pipeline that are not up to date.

    Parameters
    ----------
    pipeline : str or Path
        A shipped pipeline such as "annotate", or the path of a YAML file.
    store : str, os.PathLike or Store
        The store, which is created if it is missing. An open `Store` still shows the version with which it was opened.
    settings : mapping of str to object, optional
        Settings of the pipeline by name, and parameters of stages by name, or by ``"stage.name"`` if several stages
        have a parameter of this name.
    executor : {"serial", "processes", "dask"}
        The way in which stages distribute their work. A script that uses processes must guard its start with
        ``if __name__ == "__main__":``.
    workers : int, optional
        The number of worker processes; by default the number of cores.
    scheduler : str, optional
        The address of a Dask scheduler.
    force : iterable of str, optional
        Stages that run even if they are up to date.
    wait_seconds : float, optional
        The time to wait while another process writes to the store; 0 fails at once.
    accept : bool, optional
        True lets the run take values, such as classes, away from takes; by default it refuses, and nothing changes.
    verbose : bool, optional
        True prints the messages of the stages.

    Returns
    -------
    Outcome
        The stages that ran, the metrics, and the path of the report.

    Raises
    ------
    KinedexError
        The pipeline, a setting or the store is invalid, in which case nothing was changed; or a stage failed, in which
        case the results of earlier stages are kept.

    Examples
    --------
    >>> outcome = kinedex.run_pipeline("ingest", folder / "store", settings={"source": archive / "takes"})
    >>> outcome.ran
    ('ingest', 'index')
    """
    unseen = io.StringIO()
    terminal = Terminal() if verbose else collecting_terminal(unseen)
    try:
        return run_stages(
            pipeline,
            Path(store),
            settings=settings,
            executor=executor,
            workers=workers,
            scheduler=scheduler,
            force=force,
            wait_seconds=wait_seconds,
            accept=accept,
            terminal=terminal,
        )
    except KinedexError as fault:
        if unseen.getvalue():
            fault.add_note(f"The stages reported:\n{unseen.getvalue().rstrip()}")
        raise


@checked
def ingest(
    store: str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    mapping: str | Path | None = None,
    rate: float | None = None,
    patterns: Sequence[str] | None = None,
    metadata: str | Path | Sequence[str | Path] | None = None,
    prune: bool = False,
    strict: bool = False,
    settings: Mapping[str, Any] | None = None,
    executor: Executor = "serial",
    workers: int | None = None,
    wait_seconds: float = 0.0,
    accept: bool = False,
    verbose: bool = False,
) -> Outcome:
    r"""Ingest the motion files of a folder into a store, and index them.

    Parameters
    ----------
    store : str, os.PathLike or Store
        The store, which is created if it is missing.
    folder : str or os.PathLike
        The folder with the motion files, at any depth.
    mapping : str or Path, optional
        The skeleton mapping for all files of its format: a shipped name, or the path of a YAML file. By default
        skeletons are recognised by the names of their joints.
    rate : float, optional
        Frames per second of every file, which override those that the files state.
    patterns : sequence of str, optional
        Regular expressions with named groups (actor, class, clip, or any other), tried in order on the path relative to
        the folder, such as ``r"(?P<actor>\w+)/(?P<class>\w+)_\d+\."``. By default, those of the last ingest of the
        folder are used.
    metadata : str, Path or sequence of them, optional
        Tables (CSV or YAML) whose rows name takes or files, and whose other columns become columns of takes.
    prune : bool, optional
        True drops takes whose file is no longer in the folder.
    strict : bool, optional
        True stops at the first file that cannot be read.
    settings : mapping of str to object, optional
        Further parameters of the stage `ingest`, such as ``{"fill_gap_frames": 24}``.
    executor : {"serial", "processes", "dask"}
        The way the work is distributed, as for `run_pipeline`.
    workers : int, optional
        The number of worker processes; by default the number of cores.
    wait_seconds : float, optional
        The time to wait while another process writes to the store; 0 fails at once.
    accept : bool, optional
        True lets the run take values, such as classes, away from takes; by default it refuses, and nothing changes.
    verbose : bool, optional
        True prints the messages of the stages.

    Returns
    -------
    Outcome
        ``outcome.left_out`` is the number of files that could not be read; the reasons are in
        ``store.results("ingest_log")``.

    Raises
    ------
    KinedexError
        There is no motion file, none can be read, a setting is invalid, or another process writes to the store.

    Examples
    --------
    >>> kinedex.ingest(folder / "store", archive / "takes", patterns=[r"SYN_(?P<actor>[a-z]+)_"]).left_out
    0
    >>> kinedex.open_store(folder / "store").takes()["actor"].unique().sort().to_list()
    ['al', 'bo']
    """
    given: dict[str, Any] = {"source": Path(folder), **(settings or {})}
    optional = {"skeleton": mapping, "patterns": patterns, "metadata": metadata, "override_rate_hz": rate}
    given |= {name: value for name, value in optional.items() if value is not None}
    given |= {name: True for name, wanted in (("prune", prune), ("strict", strict)) if wanted}
    return run_pipeline(
        "ingest", store, given, executor=executor, workers=workers, wait_seconds=wait_seconds, accept=accept,
        verbose=verbose,
    )  # fmt: skip
