"""The demo of inertial sensors: simulate sensors on takes, inject errors into the takes, and find them again."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from kinedex.catalog.limbs import WORN
from kinedex.commands.demo import SEED, ingest_archive, recordings_folder
from kinedex.console.terminal import Terminal
from kinedex.ops.errors import KinedexError
from kinedex.ops.inertial.rotations import distance_deg
from kinedex.ops.intervals import in_seconds
from kinedex.ops.packages import imu_package
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.runner import Outcome, run_pipeline
from kinedex.pipelines.recordings.runs import earlier_rows
from kinedex.storage.store.store import Store, open_store

PIPELINE = "chapter7"
"""The pipeline that injects errors into takes and detects them by sensors."""

TAKES, LEAST_S = 4, 15.0
"""Number of takes with simulated sensors, and their least duration in seconds."""

TRUTH = Path("truth") / "sensors.csv"


def run_inertial_demo(store: Path, minutes: float, executor: str, workers: int | None, console: Console) -> Outcome:
    """Simulate sensors on takes of a synthetic archive, inject errors into the takes, and detect them by the sensors.

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
        A stage fails, no take is long enough, or a package of the extra `imu` is missing.
    """
    from kinedex.pipelines.simulation.imu_recordings import Request, simulate_imu
    from kinedex.pipelines.simulation.imu_sensors import Wearing

    for package in ("vqf", "scipy.interpolate"):
        imu_package(package, "the demo of inertial sensors needs")
    terminal = Terminal(console)
    common: dict[str, Any] = {"executor": executor, "workers": workers, "terminal": terminal}
    data = ingest_archive(store, minutes, console, common)
    recordings = recordings_folder(store, minutes)
    with open_store(store) as opened:
        names = _long_takes(opened)
        if not names:
            raise KinedexError(
                f"no take of {minutes:g} minutes of motion lasts {LEAST_S:g} s, which sensors need to be synchronised; "
                "use --minutes 3"
            )
        if not (recordings / TRUTH).is_file():
            console.print(
                f"simulated sensors on {counted(len(names), 'take')} in {recordings}", style="bold", markup=False
            )
            made = simulate_imu(
                opened, names, None, Request(WORN, "good", Wearing(SEED)), recordings, terminal.progress
            )
            console.print(f"    {made.seconds:.0f} s of motion, {made.samples:,} samples", markup=False)
    console.print(f"store: {store}", markup=False)
    chosen = f"name IN ({', '.join(repr(name) for name in names)})"
    settings = {
        "source": str(data),
        "recordings": str(recordings / "recordings"),
        "sensors": str(recordings / "sensors.yaml"),
        "where": chosen,
    }
    outcome = run_pipeline(PIPELINE, store, assignments=settings, **common)
    with open_store(store, at="newest") as opened:
        for line in figures(opened, recordings):
            console.print(line, markup=False)
    return outcome


def _long_takes(store: Store) -> list[str]:
    """Return the first takes that are long enough to be synchronised."""
    rows = store.take_rows.to_pylist()
    long = [row["name"] for row in rows if row["class"] is None and in_seconds(row["frames"], store.rate_hz) >= LEAST_S]
    return sorted(str(name) for name in long)[:TAKES]


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
    clocks = earlier_rows(store, "sensor_sync", f"{PIPELINE}/synchronise")
    late = [
        abs(float(str(row["offset_s"])) - offsets[str(row["recording"])])
        for row in clocks
        if row["offset_s"] is not None
    ]
    mounts = [
        float(distance_deg(_quaternion(row["q_mount"]), _true_mount(truth[str(row["recording"]), str(row["sensor"])])))
        for row in earlier_rows(store, "sensor_calibration", f"{PIPELINE}/calibrate_sensors")
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
    rows = earlier_rows(store, "limb_error_metrics", f"{PIPELINE}/evaluate_limb_errors")
    return [*lines, *_agreement(rows)]


def _agreement(rows: list[dict[str, Any]]) -> list[str]:
    """Return the agreement with the simulated annotators at the thesis's τ and at the best one."""
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


def _quaternion(row: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([row[axis] for axis in "wxyz"])


def _true_mount(row: Mapping[str, str]) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([float(row[f"q_mount_{axis}"]) for axis in "wxyz"])
