"""Time a take of ten minutes with five sensors from its files to the page, on two cores, stage by stage.

The take is a performance of the synthetic archive's first actor; its sensors are simulated before anything is timed, as
one text file each. polars stands beside the reading of these files: it parses the numbers, without units and checks.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import polars as pl

from benchmarks.archive import BUILD
from benchmarks.harness import Figure, seconds, silent, sized
from kinedex.ops.simulation.imu_sensors import WearOptions
from kinedex.ops.synth.body import Actor, draw_actor
from kinedex.ops.synth.performance import perform_take
from kinedex.ops.synth.solve import columns
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.simulation.imu_recordings import RECORDINGS, SENSORS, ImuRequest, simulate_imu
from kinedex.storage.formats.motion.acclaim_writer import Dialect, write_amc, write_asf
from kinedex.storage.store.store import Store, open_store

SECONDS, SEED, AIM_S, CORES, RUNS = sized(600.0, 40.0), 2026, 10.0, 2, sized(3, 1)
PIPELINE = "limb-errors"
LIMBS = ("torso", "lthigh", "rthigh", "lshank", "rshank")
"""The limbs that wear sensors: none of them turns so fast that the simulator would cut the take."""


def figures(_: Store) -> list[Figure]:
    """Time the pipeline, each of its stages, and the reading of the sensors' files by polars."""
    folder = BUILD / "inertial"
    take, sensors = _files(folder)
    runs = [_stage_seconds(folder / "store", take, sensors) for _ in range(1 + RUNS)][1:]  # the first loads kernels
    best = min(runs, key=lambda one: sum(one.values()))
    texts = sorted((sensors / RECORDINGS).rglob("*.txt"))
    by_polars = seconds(lambda: [_columns(path) for path in texts], RUNS)
    beside = {"read_imu": ("polars read_csv of the same files", by_polars)}
    whole = f"inertial: files to page, {SECONDS / 60:g} minutes, {len(texts)} sensors"
    return [
        Figure(whole, SECONDS, "s of take", sum(best.values()), f"at most {AIM_S:g} s", AIM_S),
        *(
            Figure(f"inertial: stage {stage}", SECONDS, "s of take", took, *beside.get(stage, ()))
            for stage, took in best.items()
        ),
    ]


def _files(folder: Path) -> tuple[Path, Path]:
    """Return the folders of the take and of its sensors; they are made once."""
    take, sensors = folder / "take", folder / "sensors"
    if not (sensors / SENSORS).is_file():
        shutil.rmtree(folder, ignore_errors=True)
        take.mkdir(parents=True)
        _write_take(take, draw_actor(0, SEED))
        path = folder / "source"
        run_pipeline("ingest", path, assignments={"source": str(take)}, terminal=silent())
        with open_store(path) as store:
            names = store.takes()["name"].to_list()
            request = ImuRequest(LIMBS, "good", WearOptions(SEED), "xsens-txt")
            simulate_imu(store, names, None, request, sensors, silent().progress)
    return take, sensors


def _write_take(folder: Path, actor: Actor) -> None:
    dialect = Dialect()
    write_asf(folder / f"SYN_{actor.name}.asf", actor.body, actor.name, dialect)
    performance = perform_take(actor, SECONDS, 0, SEED)
    write_amc(folder / f"SYN_{actor.name}_take1.amc", columns(actor.body), performance.angles, dialect)


def _stage_seconds(path: Path, take: Path, sensors: Path) -> dict[str, float]:
    """Return the seconds of each stage of a run into a new store."""
    shutil.rmtree(path, ignore_errors=True)
    settings = {"source": str(take), "recordings": str(sensors / RECORDINGS), "sensors": str(sensors / SENSORS)}
    outcome = run_pipeline(PIPELINE, path, assignments=settings, executor="processes", workers=CORES, terminal=silent())
    records = open_store(path, at="newest").manifest.stages
    names = {stage.name: f"{PIPELINE}/{stage.name}" for stage in outcome.pipeline.stages}
    return {name: records[key].seconds for name, key in names.items() if key in records}


def _columns(path: Path) -> pl.DataFrame:
    """Return the numbers of a text file of a sensor."""
    lines = path.read_text().splitlines()
    head = sum(line.startswith("//") for line in lines[:50])
    return pl.read_csv(path, separator="\t", skip_rows=head)
