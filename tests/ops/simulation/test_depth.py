"""The simulated depth camera against a naive ray marcher, analytic depths, and the recordings of the design."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.simulation.depth_rays import ConeRays, cone_ends, draw_surface, facing
from kinedex.ops.simulation.depth_scene import CameraPlace, DepthScene, on_floor, place_camera
from kinedex.ops.simulation.depth_sensors import BASELINE_M, SENSORS, DepthSensor, ExtraErrors, measured
from tests.bodies import STANDING
from tests.ops.simulation.cone_table import table_flesh
from tests.oracles.naive_rays import naive_depth, naive_shadow

STILL = np.array([[STANDING[joint] for joint in JOINTS]], float)
SMALL = DepthSensor("structured", (48, 40), 40.0)
SPHERE = np.array([[[0.2, -0.1, 3.0], [0.2, -0.1, 3.0]]])


def rays(sensor: DepthSensor, waves_m: float = 0.0, folds_m: float = 0.0) -> ConeRays:
    surface = draw_surface(table_flesh((0.9, 1.1), waves_m, folds_m), 1.7, np.random.default_rng(3))
    return ConeRays(surface, sensor.focal_px, sensor.centre, sensor.size)


def sphere_rays(sensor: DepthSensor, radius: float) -> ConeRays:
    made = rays(sensor)
    surface = type(made.surface)(np.full((1, 2), radius), 0.0, 0.0, np.array([[0.0, 1.0, 0.0]]))
    return ConeRays(surface, sensor.focal_px, sensor.centre, sensor.size)


def test_a_sphere_has_the_depth_of_the_quadratic_formula() -> None:
    sensor = SENSORS["tof"]
    depth = sphere_rays(sensor, 0.3).depth(SPHERE)
    v, u = np.indices(depth.shape)
    way = np.stack([(u - sensor.centre[0]) / 252.0, (v - sensor.centre[1]) / 252.0, np.ones(u.shape)], axis=-1)
    along, square = way @ SPHERE[0, 0], (way**2).sum(axis=-1)
    root = along**2 - square * (SPHERE[0, 0] @ SPHERE[0, 0] - 0.3**2)
    hit = root >= 0
    true = (along - np.sqrt(np.where(hit, root, 0.0))) / square
    clear = root > 0.01  # rays that touch the sphere end within a millimetre of it
    assert np.isfinite(depth[clear]).all()
    assert np.abs(depth - true)[clear].max() < 0.004
    assert np.median(np.abs(depth - true)[clear]) < 0.001
    assert not np.isfinite(depth[root < -0.05]).any()


def test_a_cone_seen_from_its_side_is_as_deep_as_its_radius() -> None:
    sensor = SENSORS["tof"]
    made = sphere_rays(sensor, 0.1)
    cone = np.array([[[-0.5, 0.0, 2.0], [0.5, 0.0, 2.0]]])
    made.surface.radii[0] = [0.1, 0.2]
    depth = made.depth(cone)
    slope = np.arcsin(0.1)  # of the outline of the two balls; q is the foot of the perpendicular on the axis
    middle = depth[143:145, 159:161]
    assert middle == pytest.approx(2.0 - 0.15, abs=0.002)
    assert depth[143, 110] - depth[143, 210] == pytest.approx(0.1 * 100 * 1.85 / 252.0 / np.cos(slope), abs=0.004)


@pytest.mark.parametrize(("waves_m", "folds_m"), [(0.0, 0.0), (0.004, 0.0), (0.0, 0.012)])
def test_bounds_change_no_depth_of_a_naive_ray_marcher(waves_m: float, folds_m: float) -> None:
    made = rays(SMALL, waves_m, folds_m)
    place = place_camera(SMALL, STILL, 0.4)
    ends = np.ascontiguousarray(place.seen(cone_ends(table_flesh(), STILL))[0])
    depth, true = made.depth(ends), naive_depth(made.surface, ends, SMALL)
    both = np.isfinite(depth) & np.isfinite(true)
    assert both.sum() > 50
    assert (np.isfinite(depth) != np.isfinite(true)).sum() <= 1
    away = np.abs(depth[both] - true[both])
    assert away.max() < 0.01  # rays along a surface are within a millimetre of it for long
    assert np.median(away) < 0.001
    room = np.where(np.isfinite(true), true, 6.0)
    hidden, dark = made.shadow(ends, room, BASELINE_M), naive_shadow(made.surface, ends, SMALL, room, BASELINE_M)
    assert dark.sum() > 5
    assert (hidden != dark).sum() <= 2


def test_noise_has_the_deviation_of_each_sensor() -> None:
    flat = np.full((288, 320), 3.0)
    nothing = np.zeros(flat.shape, bool)
    flight = measured(SENSORS["tof"], flat, nothing, nothing, ExtraErrors(), np.random.default_rng(0))
    assert flight.std() == pytest.approx(1000 * (0.004 + 0.0015 * 9), rel=0.02)
    assert (flight > 0).all()
    pattern = measured(SENSORS["structured"], flat[:240], nothing[:240], nothing[:240], ExtraErrors(),
                       np.random.default_rng(0))  # fmt: skip
    assert (pattern == 0).mean() == pytest.approx(0.001, abs=0.0005)
    steps = np.diff(np.unique(pattern[pattern > 0]))
    assert steps.mean() == pytest.approx(25.9, abs=1.0)
    dark = ExtraErrors(noise=2.0, correlation=0.5, dropouts=0.1)
    worse = measured(SENSORS["tof"], flat, ~nothing, nothing, dark, np.random.default_rng(0))
    assert (worse == 0).mean() == pytest.approx(0.1, abs=0.01)
    assert worse[worse > 0].std() == pytest.approx(2000 * (0.004 + 0.0015 * 9), rel=0.02)


def test_half_of_the_edge_pixels_fly_and_a_third_are_holes_of_structured_light() -> None:
    step = np.repeat(np.where(np.arange(320) < 160, 2.0, 3.0)[None], 288, axis=0)
    nothing = np.zeros(step.shape, bool)
    edge = np.zeros(step.shape, bool)
    edge[:, 159:161] = True
    flight = measured(SENSORS["tof"], step, nothing, nothing, ExtraErrors(), np.random.default_rng(0)) / 1000
    flying = (flight > 2.1) & (flight < 2.9)
    assert not flying[~edge].any()
    assert flying[edge].mean() == pytest.approx(0.5 * 0.8, abs=0.05)
    pattern = measured(SENSORS["structured"], step[:240], nothing[:240], nothing[:240], ExtraErrors(),
                       np.random.default_rng(0))  # fmt: skip
    assert (pattern[edge[:240]] == 0).mean() == pytest.approx(0.3, abs=0.05)


def test_the_wall_is_hidden_to_the_left_of_a_body_from_a_projector_to_the_right() -> None:
    sensor = SENSORS["structured"]
    made = sphere_rays(sensor, 0.3)
    ball = np.array([[[0.0, 0.0, 2.0], [0.0, 0.0, 2.0]]])
    body = made.depth(ball)
    hidden = made.shadow(ball, np.minimum(body, 4.0), BASELINE_M)
    u = np.flatnonzero(hidden[119])
    left = int(np.flatnonzero(np.isfinite(body[119]))[0])
    assert u.max() <= left + 2
    assert len(u) == pytest.approx(285.6 * 0.075 * (1 / 2 - 1 / 4), abs=3)


def test_a_take_stands_on_the_floor_and_faces_forwards() -> None:
    assert np.percentile(on_floor(STILL)[:, [4, 8], 1].min(axis=1), 5) == pytest.approx(0.03)
    assert facing(STILL)[0] == pytest.approx([0.0, 0.0, 1.0])


def test_azimuth_films_from_the_persons_left_and_far_takes_are_reported() -> None:
    ahead, left = (place_camera(SENSORS["tof"], STILL, turn) for turn in (0.0, np.pi / 2))
    assert ahead.place == pytest.approx([0.0, 1.1, 3.0], abs=0.05)
    assert left.place == pytest.approx([3.0, 1.1, 0.0], abs=0.05)
    assert not ahead.outside.any()
    wide = np.concatenate([STILL, STILL + np.array([30.0, 0.0, 0.0])])
    assert place_camera(SENSORS["tof"], wide).outside.all()


@pytest.mark.parametrize(
    ("name", "sensor"),
    [("kickLFront1Reps_tof", "tof"), ("squat1Reps_tof", "tof"), ("throwBasketball_structured", "structured")],
)
def test_recordings_of_the_design_have_our_cameras_and_statistics(shared: Path, name: str, sensor: str) -> None:
    folder = shared / "data" / "depth" / "simulated" / name
    with (folder / "ground_truth.csv").open() as file:
        head, *rows = csv.reader(file)
    assert tuple(column[:-2] for column in head[1::3]) == JOINTS
    joints = np.array(rows, float)[:, 1:].reshape(len(rows), -1, 3)
    place = place_camera(SENSORS[sensor], on_floor(joints))
    pose = yaml.safe_load((folder / "camera.yaml").read_text())["pose"]
    assert np.abs(place.rotation - pose["rotation"]).max() < 1e-5
    assert np.abs(place.place - pose["place"]).max() < 1e-4
    chosen = range(0, len(rows), 10)
    given = np.array([np.asarray(Image.open(folder / "depth" / f"{frame:06d}.png")) for frame in chosen], float)
    theirs = statistics(given, np.asarray(Image.open(folder / "background.png"), float))
    ours = statistics(*filmed(SENSORS[sensor], joints, place, chosen))
    assert ours["pixels"] == pytest.approx(theirs["pixels"], rel=0.12)  # flesh is drawn at random
    assert ours["depth"] == pytest.approx(theirs["depth"], abs=25)
    assert ours["noise"] == pytest.approx(theirs["noise"], rel=0.03)
    assert ours["edges"] == pytest.approx(theirs["edges"], rel=0.10)
    assert ours["holes"] == pytest.approx(theirs["holes"], abs=0.005)


def filmed(sensor: DepthSensor, joints: np.ndarray, place: CameraPlace, frames: range) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(1)
    scene = DepthScene(sensor, table_flesh((0.88, 1.18), 0.004), ExtraErrors(), joints, 1.63, place, generator)
    background = scene.background().astype(float)
    return np.array([scene.frame(frame) for frame in frames], float), background


def statistics(frames: np.ndarray, background: np.ndarray) -> dict[str, float]:
    body = (frames > 0) & (background - frames > 60 + 0.015 * frames)
    room = (frames - background)[~body & (frames > 0)]
    return {
        "pixels": body.sum(axis=(1, 2)).mean(),
        "depth": float(np.median(frames[body])),
        "noise": float(room[np.abs(room) < 150].std()),
        "edges": float((np.abs(np.diff(frames, axis=2)) > 200).sum(axis=(1, 2)).mean()),
        "holes": float((frames == 0).mean()),
    }
