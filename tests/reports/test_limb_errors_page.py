"""The page about limb errors, from a store whose results were written by hand."""

from __future__ import annotations

import dataclasses
import json
import re

import numpy as np
import pyarrow as pa
import pytest

from kinedex.ops.inertial.limb_motion import LimbMotion
from kinedex.ops.inertial.rotations import Z_TO_Y
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.inertial.limb_motion import limb_table, struct_array
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.reports.limb_error_diagrams import agreement_chart, box, curve_path, drift_curve, error_top, mapping_curves
from kinedex.reports.stages.report_limb_errors import ReportLimbErrors
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import open_store
from tests.pipelines.archives import context, write_archive

ROLES = {
    "errors": "limb_errors", "clocks": "synchronise", "calibration": "calibrate_sensors", "sensors": "read_imu",
    "limbs": "limb_orientations", "evaluation": "evaluate_limb_errors",
}  # fmt: skip
TAKE, LOST = "x_al_hop_1", "x_al_hop_2"
FRAMES, RATE_HZ = 240, 120.0
TIMES = np.arange(FRAMES) / RATE_HZ
HEADING = "Agreement with simulated annotators"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The page of a take whose left shank is wrong for half a second, and of one without a clock."""
    made = tmp_path_factory.mktemp("page")
    write_archive(made / "source", {f"{TAKE}.amc": FRAMES, f"{LOST}.amc": FRAMES})
    Ingest().run(context(made / "store"), Ingest.parameters(source=str(made / "source")))
    ids = open_store(made / "store").take_ids
    with context(made / "store").writer() as writer:
        for kind, role, table in tables(ids[TAKE], ids[LOST]):
            writer.put_results(kind, table, stage=f"test/{ROLES[role]}", run="run-1")
        writer.commit()
    place = dataclasses.replace(context(made / "store", "report_limb_errors"), inputs=ROLES)
    ReportLimbErrors().run(place, ReportLimbErrors.parameters(demonstration=True))
    return (made / "store" / "results" / "reports" / "test" / "limb-errors.html").read_text(encoding="utf-8")


def tables(take_id: int, lost: int) -> list[tuple[str, str, pa.Table]]:
    """Return the rows of all stages."""
    one = {"run": "run-1", "take_id": take_id, "take": TAKE}
    sensor = {"recording": f"{TAKE}/imu.parquet", "sensor": "<b>s", "limb": "lshank"}
    wrong = np.where((TIMES >= 1.0) & (TIMES < 1.5), 90.0, 2.0)
    errors = [
        {
            **one, **sensor, "source_frame": i, "t": float(t), "degrees": float(e), "swing_deg": float(e),
            "twist_deg": 0.0, "valid": True, "tau_deg": 45.0,
        }
        for i, (t, e) in enumerate(zip(TIMES, wrong, strict=True))
    ]  # fmt: skip
    span = {"start": 120, "stop": 180, "start_seconds": 1.0, "stop_seconds": 1.5, "limb": "lshank"}
    metrics = [
        {
            "run": "run-1", "scope": "all", "name": "all", "detector": "sensors", "annotator": who, "tau_deg": tau,
            "p1": 0.9, "r1": 0.8, "f1": 0.85, "p2": 1.0, "r2": 1.0, "f2": 1.0, "frames_manual": 60,
        }
        for who in ("all", "simulated A1")
        for tau in (5.0, 45.0, 120.0)
    ]  # fmt: skip
    still = np.tile([1.0, 0.0, 0.0, 0.0], (FRAMES, 1))
    world = dict(zip("wxyz", Z_TO_Y.tolist(), strict=True))
    calibration = {
        **one, **sensor, "basis": "full", "q_global": world, "q_mount": world, "inliers": 0.75, "median_deg": 2.0,
        "observability": 0.01, "drift": [{"t": 0.0, "degrees": 0.0}, {"t": 2.0, "degrees": 3.0}],
        "warning": "it hardly turns", "tilt_deg": 0.0,
    }  # fmt: skip
    clock = {**one, "recording": sensor["recording"], "offset_s": 0.25, "ppm": 0.0, "correlation": 0.9, "refined": True}
    refused = {**clock, "take_id": lost, "take": LOST, "offset_s": None, "left_out": "gait repeats itself"}
    schema = result_schema("imu_samples")
    columns = {
        "run": ["run-1"] * FRAMES, "recording": [sensor["recording"]] * FRAMES, "sensor": ["<b>s"] * FRAMES,
        "sample": np.arange(FRAMES), "t": TIMES + 0.25, "orientation": struct_array(still, "wxyz"),
    }  # fmt: skip
    arrays = [columns.get(name, pa.nulls(FRAMES, schema.field(name).type)) for name in schema.names]
    samples = pa.table([pa.array(one) if not isinstance(one, pa.Array) else one for one in arrays], schema=schema)
    shank = LimbMotion(
        "lshank", "full", TIMES, still, np.zeros((FRAMES, 3)), np.tile([0.0, 1.0, 0.0], (FRAMES, 1)),
        np.ones(FRAMES, bool), np.zeros(FRAMES, bool), None,
    )  # fmt: skip
    return [
        _table("limb_errors", "errors", errors),
        _table(
            "limb_error_runs", "errors",
            [{**one, **span, "kind": "distance", "seconds": 0.5, "peak_deg": 90.0, "mean_deg": 90.0, "tau_deg": 45.0}],
        ),
        _table("limb_labels", "evaluation", [{**one, **span, "annotator": "simulated A1"}]),
        _table("limb_error_metrics", "evaluation", metrics),
        _table("sensor_sync", "clocks", [clock, refused]),
        _table("sensor_calibration", "calibration", [calibration]),
        _table("imu_recordings", "sensors", [{**one, **sensor, "channels": ["orientation"]}]),
        ("imu_samples", "sensors", samples),
        ("limb_orientations", "limbs", limb_table(take_id, TAKE, {"lshank": shank}, "run-1")),
    ]  # fmt: skip


def _table(kind: str, role: str, rows: list[dict[str, object]]) -> tuple[str, str, pa.Table]:
    return kind, role, pa.Table.from_pylist(rows, schema=result_schema(kind))


def test_boxes_of_automatic_and_manual_runs_stand_one_above_the_other(page: str) -> None:
    for kind in ("automatic", "manual"):
        box = re.search(
            rf'<rect class="{kind}" x="([\d.]+)%" y="3" width="([\d.]+)%".*?data-start="(\d+)" data-stop', page
        )
        assert box is not None
        assert [float(part) for part in box.groups()] == [50.0, 25.0, 30.0]
    assert page.index('<rect class="automatic"') < page.index('<rect class="manual"')
    assert "1.00 to 1.50 s: 90° at most" in page


def test_the_page_has_offsets_calibration_agreement_and_refusals(page: str) -> None:
    for text in (HEADING, "all simulated annotators", "0.2500", "it hardly turns", "gait repeats itself", "τ = 45°"):
        assert text in page
    assert page.count("<h1>") == 1
    assert "<b>s" not in page.partition("</style>")[2]  # a sensor's name is text, whatever it is
    for heading in re.findall(r"<h[23]>(.*?)</h[23]>", page):
        assert "annotator" not in heading or "simulated" in heading


def test_the_player_has_the_axes_of_take_and_sensor(page: str) -> None:
    data = json.loads(re.search(r'id="motions">(.*?)</script>', page, re.DOTALL)[1])  # type: ignore[index]
    assert [one["take"] for one in data["motions"]] == [TAKE]
    (triads,) = data["triads"]
    assert (triads["limbs"], triads["count"], triads["take"]) == (["lshank"], 7, TAKE)


def test_curves_are_bands_that_stop_where_nothing_counts() -> None:
    degrees = np.array([0.0, 60.0, np.nan, np.nan, 30.0, 30.0])
    path = curve_path(np.arange(6) / 6, degrees, 1.0, 60.0, bins=6)
    assert path.count("M") == 2
    assert path.startswith("M0.5 60.0L1.5 0.0")
    few = curve_path(np.array([0.0, 0.5]), np.array([1.0, 2.0]), 1.0, 60.0, bins=600)
    assert few.count("M") == 1  # columns between the frames of a short take interrupt nothing
    assert curve_path(np.zeros(2), np.full(2, np.nan), 1.0, 60.0) == ""


def test_figures_have_their_places() -> None:
    assert error_top(179.0, 45.0) == 180.0
    assert error_top(10.0, 45.0) == 60.0
    outside = box(-1.0, 99.0, 60, 30.0, "")
    assert (outside.start, outside.stop, outside.left, outside.width) == (0, 60, 0.0, 100.0)
    chart = agreement_chart([15.0, 60.0], [(0.5, 1.0, 0.7), (float("nan"), 0.2, float("nan"))], 45.0)
    assert (chart.best_tau, chart.best_f) == (15.0, 0.7)
    assert drift_curve([], 1.0) is None
    assert drift_curve([(0.0, -1.0), (2.0, 2.0)], 2.0).span_deg == 3.0  # type: ignore[union-attr]


@pytest.mark.parametrize("name", ["limb-errors", "chapter7"])
def test_shipped_pipelines_end_with_the_page(name: str) -> None:
    loaded = load_pipeline(name, {"source": "takes", "recordings": "imu"})
    stages = [stage.name for stage in loaded.stages]
    assert stages[:2] == ["ingest", "read_imu"]
    assert stages[-3:] == ["limb_errors", "evaluate_limb_errors", "report_limb_errors"]
    assert ("break_track" in stages) == (name == "chapter7")


def test_the_page_shows_that_a_wrong_mapping_hides_errors(page: str) -> None:
    right, mount, both = mapping_curves()
    assert (*right.correct, right.peak, right.hidden) == pytest.approx((0.0, 0.0, 70.0, 42.5), abs=1e-9)
    # the thesis: correct frames at 100 degrees, frame 200 only 40 above them, frame 485 at 100 like the correct ones
    assert (*mount.correct, mount.peak, mount.hidden) == pytest.approx((100.0, 100.0, 140.0, 100.0), abs=0.3)
    assert both.correct[1] - both.correct[0] > 40.0
    section = page[page.index('id="mapping"') :]
    assert section.count('class="mapping"') == 3
    assert "off by 42.5°, shows 100° as well" in section
