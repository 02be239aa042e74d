"""Stage simulate_imu: simulate inertial sensors on the limbs of takes, and write their files with labels."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import ClassVar

from kinedex.catalog.configs import config_path
from kinedex.ops.errors import KinedexError
from kinedex.ops.simulation.imu_sensors import WearOptions
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading, files_digest, hash_of
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.inertial.parameters import SimulateImuParameters
from kinedex.pipelines.inertial.source_limbs import reading_digest
from kinedex.pipelines.simulation.imu_recordings import ImuRequest, Windowing, actors_of, simulate_stored, take_segments
from kinedex.pipelines.simulation.recording_folder import new_folder
from kinedex.storage.store.store import Store


class SimulateImu(Stage[SimulateImuParameters]):
    """Simulates inertial sensors on the limbs of takes, and writes their files with labels (thesis, Appendix A)."""

    name = "simulate_imu"
    parameters = SimulateImuParameters
    inputs: ClassVar = {"limbs": Input("limb_orientations")}

    def reading(self, params: SimulateImuParameters, store: Store) -> Reading:
        """Return a digest of the takes, their actors and their labels."""
        takes = store.takes_table(params.where)["name"].to_pylist()
        wanted = set(takes)
        labels = [(take, found) for take, found in sorted(take_segments(store).items()) if take in wanted]
        actors = [(take, actor) for take, actor in sorted(actors_of(store).items()) if take in wanted]
        return Reading(hash_of(reading_digest(store, takes), labels, actors), counted(len(takes), "take"))

    def external_digest(self, params: SimulateImuParameters, store: Store | None) -> str:
        """Return a hash of the file with the sensor grade."""
        return files_digest([config_path("imu_grades", params.grade)])

    def run(self, context: StageContext, params: SimulateImuParameters) -> dict[str, object]:
        """Simulate the sensors of the takes, and replace their earlier files."""
        store = context.open()
        names = store.takes_table(params.where)["name"].to_pylist()
        if not names:
            raise KinedexError(f"where: no take fits '{params.where}'; `--set {context.stage}.where=true` takes all")
        request = ImuRequest(
            tuple(params.limbs),
            params.grade,
            WearOptions(
                params.seed, params.rate_hz, lever_m=(params.lever_m[0], params.lever_m[1], params.lever_m[2]),
                declination_deg=params.declination_deg, stand_s=params.stand_s, mount=params.mount,
            ),
            params.format,
            Windowing(params.window_s, params.step_s),
        )  # fmt: skip
        folder = context.report_file("imu")
        with new_folder(folder.with_name(f"{folder.name}.new")) as unfinished:
            made = simulate_stored(
                store, context.key(context.inputs["limbs"]), names, request, unfinished, context.progress
            )
        _replace(folder)
        files = sorted(path.relative_to(context.store_path).as_posix() for path in folder.rglob("*") if path.is_file())
        number = counted(len(made.recordings), "take")
        context.message(f"{number}, {made.seconds:,.1f} s, {made.samples:,} samples: {folder.resolve()}")
        context.message(*made.remarks())
        return {
            "takes": len(made.recordings),
            "seconds": round(made.seconds, 3),
            "samples": made.samples,
            "left_out": len(made.left_out),
            "files": files,
        }


def _replace(folder: Path) -> None:
    """Replace the earlier folder by the new one."""
    if folder.exists():
        shutil.rmtree(folder)
    os.replace(folder.with_name(f"{folder.name}.new"), folder)
