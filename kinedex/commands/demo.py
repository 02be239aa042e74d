"""Run the demos, which are pipelines on a synthetic archive (created if it is missing) or on the user's archive."""

from __future__ import annotations

import csv
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from kinedex.catalog.configs import config_path, load_yaml
from kinedex.catalog.limbs import WORN
from kinedex.console.terminal import Terminal
from kinedex.ops.arrays import F64
from kinedex.ops.errors import KinedexError
from kinedex.ops.inertial.rotations import distance_deg
from kinedex.ops.intervals import in_seconds
from kinedex.ops.packages import imu_package
from kinedex.ops.wording import counted, name_list
from kinedex.pipelines.engine.executors import cores
from kinedex.pipelines.engine.kernel_compilation import KernelCompilation
from kinedex.pipelines.engine.runner import Outcome, run_pipeline
from kinedex.pipelines.simulation.synthetic_archive import ArchiveSummary, write_archive
from kinedex.pipelines.tracking.recording_runs import earlier_rows
from kinedex.storage.snapshot.manifest_files import versions
from kinedex.storage.store.store import Store, open_store

ACTORS, SEED = 5, 2026

FILMED = "al"
"""The actor who is filmed in the demos of tracking and depth; the archive has the motions of the other actors."""

CLIPS, OTHERS = (
    f"actor = '{FILMED}' AND class IS NOT NULL AND frames >= 45",
    f"class IS NOT NULL AND actor <> '{FILMED}'",
)
"""SQL filters for the clips that are filmed, and for the clips from which templates and poses are taken."""

DEPTH_TAKES = 6
"""Number of clips that are filmed in the demo of depth."""

INERTIAL = "chapter7"
"""The pipeline that injects errors into takes and detects the errors by sensors."""

WORN_TAKES, MIN_DURATION_S = 4, 15.0
"""Number of takes with simulated sensors, and their least duration in seconds."""

TRUTH = Path("truth") / "sensors.csv"


@dataclass(frozen=True)
class Demo:
    """A demo: its store, the minutes of motion in its synthetic archive, and the options of its pipeline runs."""

    store: Path
    minutes: float
    executor: str
    workers: int | None
    console: Console

    @property
    def archive(self) -> Path:
        """The folder of the synthetic archive, beside the store."""
        return self.store.parent / f"{self.store.name}-archive-{self.minutes:g}min"

    @property
    def recordings(self) -> Path:
        """The folder of the recordings, which depends on the length of the archive, as the takes do."""
        return self.store.parent / f"{self.store.name}-recordings-{self.minutes:g}min"

    def message(self, text: str, style: str | None = None) -> None:
        """Print a line."""
        self.console.print(text, style=style, markup=False)

    def ingest(self) -> None:
        """Create the synthetic archive if it is missing, and ingest it."""
        refuse_other_takes(self.store, self.archive)
        make_archive(self.archive, self.minutes, ACTORS, SEED, self.workers, self.console)
        patterns = load_yaml(config_path("pipelines", "reconstruct")).mapping()["settings"]["patterns"]
        self.run("ingest", settings={"source": str(self.archive), "ingest.patterns": patterns})

    def run(
        self, pipeline: str, assignments: Mapping[str, str] | None = None, settings: Mapping[str, Any] | None = None
    ) -> Outcome:
        """Run a pipeline with settings given as texts (as by `--set`) or as values."""
        return run_pipeline(
            pipeline, self.store, assignments=assignments, settings=settings, executor=self.executor,
            workers=self.workers, terminal=Terminal(self.console),
        )  # fmt: skip

    def run_settled(self, pipeline: str, settings: Mapping[str, str]) -> Outcome:
        """Run a pipeline that makes takes of recordings, and run it again with these takes in the index.

        The outcome of the first run is returned; if it ran no stage, there is no second run. After the second run, a
        run with the same settings has nothing to do.
        """
        self.message(f"store: {self.store}")
        assignments = {"source": str(self.archive), **settings}
        outcome = self.run(pipeline, assignments)
        if outcome.ran:
            Terminal(self.console).heading("the same again, with the takes of the recordings in the index")
            self.run(pipeline, assignments)
        return outcome


def run_demo(demo: Demo, data: Path | None, method: str = "thesis") -> Outcome:
    """Run the pipeline `annotate` on the user's archive or on a synthetic archive beside the store.

    Parameters
    ----------
    demo : Demo
        The demo.
    data : Path or None
        Archive of the user; None for a synthetic archive.
    method : str
        Method of the stage `annotate`: thesis, best or numeric.

    Raises
    ------
    KinedexError
        `data` is not a folder, the store has only takes of another archive, or a stage fails.
    """
    settings = {"method": method}
    if data is not None and not data.is_dir():
        raise KinedexError(f"--data {data}: no such folder")
    refuse_other_takes(demo.store, data or demo.archive)
    if data is None:
        data = demo.archive
        kernels = None if data.exists() or demo.executor == "serial" else KernelCompilation(demo.workers)
        make_archive(data, demo.minutes, ACTORS, SEED, demo.workers, demo.console)
        if kernels is not None and not kernels.is_done:
            with Terminal(demo.console).progress("compiling kernels"):
                kernels.wait()
        settings["classes"] = "synthetic"
    demo.message(f"store: {demo.store}")
    return demo.run("annotate", {**settings, "source": str(data)})


def run_tracking_demo(demo: Demo) -> Outcome:
    """Film takes of one actor of a synthetic archive, and stabilise their tracks with the archive of the others."""
    from kinedex.pipelines.simulation.simulated_cameras import RECORDINGS, CameraRequest, simulate_cameras

    demo.ingest()
    file = demo.recordings / RECORDINGS
    if not file.is_file():
        demo.message(f"recordings of the actor '{FILMED}' in {demo.recordings}", "bold")
        with open_store(demo.store) as opened:
            request = CameraRequest(where=CLIPS, seed=SEED)
            made = simulate_cameras(opened, request, demo.recordings, Terminal(demo.console).progress)
        filmed = f"{counted(len(made.recordings), 'recording')}, {counted(made.failures, 'failure')}"
        demo.message(f"    {filmed} in {made.frames:,} frames")
    return demo.run_settled("stabilise", {"recordings": str(file), "train": OTHERS})


def run_depth_demo(demo: Demo) -> Outcome:
    """Film takes of an actor of a synthetic archive by a depth camera; reconstruct them with poses of the others."""
    from kinedex.pipelines.simulation.simulated_depth import RECORDINGS, DepthRequest, simulate_depth

    demo.ingest()
    file = demo.recordings / RECORDINGS
    if not file.is_file():
        demo.message(f"depth recordings of the actor '{FILMED}' in {demo.recordings}", "bold")
        with open_store(demo.store) as opened:
            names = [str(name) for name in opened.takes(CLIPS).sort("name")["name"].to_list()][:DEPTH_TAKES]
            request = DepthRequest(tuple(names), seed=SEED)
            made = simulate_depth(opened, request, demo.recordings, Terminal(demo.console).progress)
        demo.message(f"    {counted(len(made.recordings), 'recording')}, {made.frames:,} frames")
    return demo.run_settled("reconstruct", {"recordings": str(file), "pose_database.where": OTHERS})


def run_inertial_demo(demo: Demo) -> Outcome:
    """Simulate sensors on takes of a synthetic archive, inject errors into the takes, and detect them by the sensors.

    Raises
    ------
    KinedexError
        A stage fails, no take is long enough, or a package of the extra `imu` is missing.
    """
    from kinedex.ops.simulation.imu_sensors import WearOptions
    from kinedex.pipelines.simulation.imu_recordings import ImuRequest, simulate_imu

    for package in ("vqf", "scipy.interpolate"):
        imu_package(package, "the demo of inertial sensors needs")
    demo.ingest()
    recordings = demo.recordings
    with open_store(demo.store) as opened:
        names = _long_takes(opened)
        if not names:
            raise KinedexError(
                f"no take of {demo.minutes:g} minutes of motion lasts {MIN_DURATION_S:g} s, which sensors need to be "
                "synchronised; use --minutes 3"
            )
        if not (recordings / TRUTH).is_file():
            demo.message(f"simulated sensors on {counted(len(names), 'take')} in {recordings}", "bold")
            request = ImuRequest(WORN, "good", WearOptions(SEED))
            made = simulate_imu(opened, names, None, request, recordings, Terminal(demo.console).progress)
            demo.message(f"    {made.seconds:.0f} s of motion, {made.samples:,} samples")
    demo.message(f"store: {demo.store}")
    settings = {
        "source": str(demo.archive),
        "recordings": str(recordings / "recordings"),
        "sensors": str(recordings / "sensors.yaml"),
        "where": f"name IN ({', '.join(repr(name) for name in names)})",
    }
    outcome = demo.run(INERTIAL, settings)
    with open_store(demo.store, at="newest") as opened:
        for line in figures(opened, recordings):
            demo.message(line)
    return outcome


def _long_takes(store: Store) -> list[str]:
    """Return the names of the first takes without a class that are long enough to be synchronised."""
    rows = store.take_rows.to_pylist()
    long = [
        row["name"]
        for row in rows
        if row["class"] is None and in_seconds(row["frames"], store.rate_hz) >= MIN_DURATION_S
    ]
    return sorted(str(name) for name in long)[:WORN_TAKES]


def figures(store: Store, recordings: Path) -> list[str]:
    """Return lines of text that compare estimated clocks, mounts and errors with the truth of the simulation.

    Parameters
    ----------
    store : Store
        The store.
    recordings : Path
        The folder of the simulated sensors, with `truth/sensors.csv`.
    """
    with (recordings / TRUTH).open(newline="", encoding="utf-8") as file:
        truth = {(row["file"], row["sensor"]): row for row in csv.DictReader(file)}
    truth = {(file.removeprefix("recordings/"), sensor): row for (file, sensor), row in truth.items()}
    offsets = {file: float(row["offset_s"]) for (file, _), row in truth.items()}
    clocks = earlier_rows(store, "sensor_sync", f"{INERTIAL}/synchronise")
    late = [
        abs(float(str(row["offset_s"])) - offsets[str(row["recording"])])
        for row in clocks
        if row["offset_s"] is not None
    ]
    mounts = [
        float(
            distance_deg(
                _quaternion(row["q_mount"], ""),
                _quaternion(truth[str(row["recording"]), str(row["sensor"])], "q_mount_"),
            )
        )
        for row in earlier_rows(store, "sensor_calibration", f"{INERTIAL}/calibrate_sensors")
        if row["q_mount"] is not None
    ]
    lines = ["against the truth of the simulated sensors:"]
    if late:
        lines.append(f"    {counted(len(late), 'offset')} of clocks: off by {1000 * max(late):.1f} ms at most")
    if mounts:
        lines.append(
            f"    {counted(len(mounts), 'mount')}: off by {np.median(mounts):.1f} degrees in the median, "
            f"{max(mounts):.1f} at most"
        )
    rows = earlier_rows(store, "limb_error_metrics", f"{INERTIAL}/evaluate_limb_errors")
    return [*lines, *_agreement(rows)]


def _agreement(rows: list[dict[str, Any]]) -> list[str]:
    """Return lines about the agreement with the simulated annotators, at a threshold of 45° and at that of best F."""
    own = [row for row in rows if (row["scope"], row["detector"], row["annotator"]) == ("all", "sensors", "all")]
    known = [row for row in own if row["f1"] is not None]
    if not known:
        return []
    best = max(known, key=lambda row: row["f1"])
    shown = [row for row in known if row["tau_deg"] == 45.0] + [best]
    lines = ["wrong limbs, frames, against simulated annotators:"]
    for row in shown:
        name = "best τ" if row is best else "τ"
        lines.append(
            f"    {name} = {row['tau_deg']:g} degrees: P {row['p1']:.2f}, R {row['r1']:.2f}, F {row['f1']:.2f}"
        )
    return lines


def _quaternion(row: Any, prefix: str) -> F64:
    return np.array([float(row[f"{prefix}{axis}"]) for axis in "wxyz"])


def refuse_other_takes(store: Path, data: Path) -> None:
    """Raise an error if a store has takes, but none of this archive; nothing is written.

    Parameters
    ----------
    store : Path
        Directory of the store, which need not exist.
    data : Path
        Folder of the demo's motion files; only its name is compared, since store and folder may have been moved.

    Raises
    ------
    KinedexError
        The store has takes, but none of this archive.
    """
    if not versions(store):
        return
    rows = open_store(store, at="newest").take_rows.select(["source_root"]).to_pylist()
    roots = {Path(row["source_root"]) for row in rows if row["source_root"]}
    if not roots or any(root.name == data.resolve().name for root in roots):
        return
    raise KinedexError(
        f"{store} holds {counted(len(rows), 'take')} of {name_list(sorted(map(str, roots)))}, and none of {data}: the "
        "demo "
        "would mix others with them; name a folder for its store that does not exist yet, such as "
        f"{store.with_name(store.name + '-demo')}"
    )


def make_archive(
    directory: Path, minutes: float, actors: int, seed: int, workers: int | None, console: Console
) -> ArchiveSummary:
    """Create a synthetic archive, or complete an interrupted one, and print a summary.

    Raises
    ------
    KinedexError
        If the folder holds other files.
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
