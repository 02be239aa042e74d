"""The study of depth cameras: its recordings, its measure of errors, and its tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.depth.pose_distance import END_EFFECTORS, are_ends_found
from kinedex.ops.depth.thinned_poses import bone_lengths_of
from studies import depth_set
from studies.depth import BOTH, FORWARD, METHODS, OWN, PROTOTYPE, aims, cell, class_table, table
from studies.depth_rows import Tracked, both_ways, errors_cm
from studies.depth_set import Clip, Film, film_set
from tests.bodies import STANDING

STILL = np.array([STANDING[joint] for joint in JOINTS], float)


def track(errors: list[float], found: bool = True) -> Tracked:
    frames = len(errors)
    poses = np.repeat(STILL[None], frames, axis=0)
    return Tracked(poses, np.ones(frames), np.array(errors), np.zeros(frames, bool), np.full(frames, found))


def test_five_ends_are_found_one_to_one() -> None:
    ends = STILL[END_EFFECTORS]
    extrema = np.stack([ends[::-1] + 0.1, ends[[0, 0, 2, 3, 4]], np.full((5, 3), np.nan)])
    assert are_ends_found(extrema, np.stack([STILL] * 3)).tolist() == [True, False, False]


def test_a_frame_without_a_pose_is_off_by_the_height_of_the_person() -> None:
    poses = np.stack([STILL + np.array([0.03, 0.0, 0.0]), np.full_like(STILL, np.nan)])
    height = 100 * np.ptp(STILL[:, 1])
    assert errors_cm(poses, np.stack([STILL, STILL])) == pytest.approx([3.0, height])


def test_both_ways_take_the_track_of_least_cost() -> None:
    truth = np.repeat(STILL[None], 3, axis=0)
    near, far = track([1.0, 1.0, 1.0]), track([1.0, 1.0, 1.0])
    far = Tracked(far.poses + 0.5, 3 * far.costs, far.errors_cm, far.database, far.found)
    assert both_ways(far, near, truth).errors_cm == pytest.approx(0.0)


def test_tables_have_the_prototype_below_and_every_class() -> None:
    tracks = {name: {"squat": track([2.0, 4.0]), "kick": track([12.0], False)} for name in (*METHODS, BOTH)}
    assert cell(tracks[BOTH]) == "6.0 / 4.0, 33.3 %"
    found = {("tof", OWN): tracks}
    lines = table(found, PROTOTYPE)
    assert lines[2].startswith("| tof, own bones | 6.0 / 4.0, 33.3 % |")
    assert lines[3].startswith("| prototype | 10.1 / 7.3, 36 % | 15.4")
    assert [line.split(" | ")[0] for line in class_table(found)[2:-1]] == ["| squat", "| kick", "| all"]
    assert class_table(found)[-2].endswith("| 0 % | 67 % |")
    assert any(line.startswith("| tof, own bones: mean | 6.00 cm | ≤ 2.5 cm") for line in aims(found))
    assert FORWARD in tracks


def test_recordings_of_the_study_are_made_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(depth_set, "BUILD", tmp_path)
    joints = np.repeat(STILL[None], 2, axis=0)
    clips = [Clip("take", "mm", label, joints, np.ones(2, bool)) for label in ("kick", "squat")]
    bones = {"mm": bone_lengths_of(joints)}
    film = Film("tof_small", "second", 45.0)
    made = film_set(clips, bones, film)
    assert [one.name for one in made] == ["kick", "squat"]
    (folder,) = (tmp_path / "depth").iterdir()
    assert folder.name.startswith("mm-tof_small-second-left-45-")
    assert (made[0].truth[..., 2] < -0.8).all()  # the camera looks along −z
    assert len(made[0].images) == 2
    assert (made[0].images[0] != made[1].images[0]).any()  # class i has seed 100 + i
    again = film_set(clips, bones, film)
    assert (again[1].images[1] == made[1].images[1]).all()
