"""The demo of inertial sensors: its options, and its figures against the truth of simulated sensors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from typer.testing import CliRunner

from kinedex.commands import demo
from kinedex.commands.cli import app
from kinedex.console.terminal import Console
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.inertial.limb_motion import struct_array
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import open_store
from tests.pipelines.archives import context, write_archive

TRUTH = """file,sensor,offset_s,q_mount_w,q_mount_x,q_mount_y,q_mount_z
recordings/x/imu.parquet,lshank,0.5,1,0,0,0
"""


def test_the_demo_makes_its_own_archive(tmp_path: Path) -> None:
    for options, message in (
        (["--inertial", "--tracking"], "choose one"),
        (["--inertial", "--data", str(tmp_path)], "leave out --data"),
    ):
        done = CliRunner().invoke(app, ["demo", str(tmp_path / "store"), *options])
        assert done.exit_code == 2
        assert message in " ".join(done.output.split())
    assert not (tmp_path / "store").exists()


def test_figures_compare_clocks_mounts_and_agreement_with_the_truth(tmp_path: Path) -> None:
    write_archive(tmp_path / "source", {"x_al_hop_1.amc": 60})
    Ingest().run(context(tmp_path / "store"), Ingest.parameters(source=str(tmp_path / "source")))
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "sensors.csv").write_text(TRUTH)
    one = {"run": "run-1", "take_id": 1, "take": "x", "recording": "x/imu.parquet"}
    turned = np.array([[np.cos(np.radians(1.0)), np.sin(np.radians(1.0)), 0.0, 0.0]])
    with context(tmp_path / "store").writer() as writer:
        for kind, stage, row in (
            ("sensor_sync", "synchronise", {**one, "offset_s": 0.503}),
            ("sensor_calibration", "calibrate_sensors", {**one, "sensor": "lshank", "limb": "lshank"}),
        ):
            table = pa.Table.from_pylist([row], schema=result_schema(kind))
            if kind == "sensor_calibration":
                place = table.schema.get_field_index("q_mount")
                table = table.set_column(place, table.schema.field(place), struct_array(turned, "wxyz"))
            writer.put_results(kind, table, stage=f"chapter7/{stage}", run="run-1")
        rows = [
            {"scope": "all", "name": "all", "detector": "sensors", "annotator": "all", "tau_deg": tau, "p1": 0.9,
             "r1": 0.8, "f1": f1} for tau, f1 in ((25.0, 0.9), (45.0, 0.8))
        ]  # fmt: skip
        table = pa.Table.from_pylist(rows, schema=result_schema("limb_error_metrics"))
        writer.put_results("limb_error_metrics", table, stage="chapter7/evaluate_limb_errors", run="run-1")
        writer.commit()
    lines = demo.figures(open_store(tmp_path / "store", at="newest"), tmp_path)
    assert [line.strip() for line in lines] == [
        "against the truth of the simulated sensors:",
        "1 offset of clocks: off by 3.0 ms at most",
        "1 mount: off by 2.0 degrees in the median, 2.0 at most",
        "wrong limbs, frames, against simulated annotators:",
        "τ = 45 degrees: P 0.90, R 0.80, F 0.80",
        "best τ = 25 degrees: P 0.90, R 0.80, F 0.90",
    ]


def test_an_archive_without_long_takes_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for package in ("vqf", "scipy"):
        pytest.importorskip(package)

    def make(folder: Path, *_: object) -> None:
        write_archive(folder, {"x_al_hop_1.amc": 200})

    monkeypatch.setattr(demo, "make_archive", make)
    with pytest.raises(KinedexError, match=r"no take of 1 minutes of motion lasts 15 s.*use --minutes 3"):
        demo.run_inertial_demo(demo.Demo(tmp_path / "store", 1.0, "serial", None, Console(quiet=True)))
    assert not list(tmp_path.glob("*recordings*"))
