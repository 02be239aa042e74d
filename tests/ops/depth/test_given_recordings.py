"""The given recordings are followed from their true first pose by local optimisation alone."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from kinedex.ops.depth.image_search import depth_view
from kinedex.ops.depth.points import Preparation, ray_table
from kinedex.ops.depth.pose_distance import COMPARED
from kinedex.ops.depth.pose_fit import PRINTED_STEPS, STEPS, PoseFit
from kinedex.ops.depth.thinned_poses import bone_lengths_of
from kinedex.storage.formats.depth.camera_file import read_camera
from kinedex.storage.formats.depth.png import read_depth_png
from tests.ops.depth.cone_bodies import BODY


def true_poses(folder: Path, rotation: np.ndarray, place: np.ndarray) -> np.ndarray:
    """The true joints (T, 24, 3) in the axes of the kernels."""
    with (folder / "ground_truth.csv").open() as file:
        rows = np.array(list(csv.reader(file))[1:], float)[:, 1:]
    return np.ascontiguousarray(((rows.reshape(len(rows), 24, 3) - place) @ rotation.T) * (1, -1, -1))


@pytest.mark.parametrize(
    ("name", "most_cm"),
    [("kickLFront1Reps_tof", 2.3), ("squat1Reps_tof", 2.3), ("throwBasketball_structured", 2.1)],
)
def test_poses_stay_within_the_goal(name: str, most_cm: float, shared: Path) -> None:
    folder = shared / "data" / "depth" / "simulated" / name
    camera = read_camera(folder / "camera.yaml")
    truth = true_poses(folder, camera.rotation, camera.place)
    files = sorted((folder / "depth").glob("*.png"))
    background = read_depth_png(folder / "background.png", camera)
    work = Preparation(ray_table(camera.matrix, (), camera.size), background)
    fit = PoseFit(BODY, BODY.standing_height(bone_lengths_of(truth)), depth_view(camera.matrix))
    errors = {"best": [], "printed": []}
    poses = dict.fromkeys(errors, truth[0])
    for file, true in zip(files, truth, strict=True):
        fit.look(work.prepare(read_depth_png(file, camera)))
        for form, steps in (("best", STEPS), ("printed", PRINTED_STEPS)):
            poses[form] = fit.fit(poses[form], steps, form=form)
            errors[form].append(np.linalg.norm((poses[form] - true)[COMPARED], axis=1).mean())
    assert 100 * np.mean(errors["best"]) < most_cm
    assert np.max(errors["best"]) < 0.05
    assert np.mean(errors["printed"]) > 3 * np.mean(errors["best"])
