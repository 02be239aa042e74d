"""Markers that only a static trial has are placed in its motions by the segments that they belong to."""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.formats.motion.c3d import parse_c3d
from kinedex.storage.formats.motion.points import completed
from kinedex.storage.formats.motion.reader import Body
from kinedex.storage.formats.motion.reader_table import read_body
from kinedex.storage.formats.motion.scanned_files import SourceFile
from kinedex.storage.formats.motion.single_file import file_beside
from kinedex.storage.formats.motion.static_files import static_trial_of, subject_parts, trials_by_folder
from kinedex.storage.formats.motion.unpacked_files import unpacked
from kinedex.storage.store.store import open_store
from tests.bodies import index
from tests.c3d_files import LABELS, standing_markers, write_c3d, z_up
from tests.pipelines.archives import context

JOINTS = load_feature_set().joints
MAPPINGS = load_mappings("auto", JOINTS)

LEFT = {
    "LTHI1": (0.18, 0.80, 0.06), "LTHI2": (0.19, 0.65, -0.05), "LTHI3": (0.15, 0.70, 0.09),
    "LTIB1": (0.17, 0.38, 0.05), "LTIB2": (0.16, 0.25, -0.06), "LTIB3": (0.13, 0.30, 0.06),
    "LKNM": (0.03, 0.50, 0.0), "LANM": (0.03, 0.10, -0.05),
}  # fmt: skip
INNER = ("LKNM", "LANM", "RKNM", "RANM")
WHOLE = (*LABELS, *LEFT, *(f"R{name[1:]}" for name in LEFT))
SEEN = tuple(label for label in WHOLE if label not in INNER)


def person(frames: int) -> np.ndarray:
    """A standing body with clusters on thighs and shanks, and markers on both sides of knees and ankles."""
    left = np.array(list(LEFT.values()))
    legs = np.repeat(np.concatenate([left, left * [-1, 1, 1]])[:, :, None], frames, axis=2)
    legs[:, 2] += 0.01 * np.arange(frames)
    return np.concatenate([standing_markers(frames), legs])


SHANKS = ("KNE", "KNM", "TIB1", "TIB2", "TIB3", "ANK", "ANM", "HEE", "TOE")
THIGHS = ("THI1", "THI2", "THI3", *SHANKS)


def bent(points: np.ndarray, side: str, names: tuple[str, ...], at: tuple[float, float], angles: np.ndarray) -> None:
    """Turn markers about an axis from left to right, at a height and place ahead in the first frame."""
    cos, sin = np.cos(angles), np.sin(angles)
    for marker in (WHOLE.index(side + name) for name in names):
        walked = at[1] + 0.01 * np.arange(len(angles))
        y, z = points[marker, 1] - at[0], points[marker, 2] - walked
        points[marker, 1], points[marker, 2] = at[0] + y * cos - z * sin, walked + y * sin + z * cos


def turned(points: np.ndarray, turn: float = 1.5) -> np.ndarray:
    """The same body, with legs that bend, turning about itself as it walks."""
    points = points.copy()
    phase = np.arange(points.shape[2]) / 12
    for side, ahead in (("L", 0.0), ("R", np.pi)):
        bent(points, side, SHANKS[-2:], (0.10, -0.05), 0.3 * np.sin(phase))
        bent(points, side, SHANKS[2:], (0.50, 0.0), 0.5 - 0.5 * np.cos(phase + ahead))
        bent(points, side, THIGHS, (0.93, 0.0), -0.4 * np.sin(phase + ahead))
    angles = turn * np.sin(np.arange(points.shape[2]) / 15)
    cos, sin = np.cos(angles), np.sin(angles)
    x, z = points[:, 0] * cos + points[:, 2] * sin, points[:, 2] * cos - points[:, 0] * sin
    return np.stack([x, points[:, 1], z], axis=1)


def written(path: Path, points: np.ndarray, labels: tuple[str, ...] = WHOLE, scale: float = 1000.0) -> Path:
    kept = [WHOLE.index(label) for label in labels]
    unit = {1000.0: "mm", 1.0: "m"}[scale]
    return write_c3d(path, scale * z_up(points[kept]), labels, unit=unit, Y_SCREEN=["+Z"])


def read(path: Path, static: Path | None = None) -> Body:
    return read_body(path, static, MAPPINGS, JOINTS)


@pytest.mark.parametrize("scale", [1000.0, 1.0])
def test_knees_and_ankles_lie_amid_both_markers_of_which_the_inner_one_is_in_the_static_trial(
    tmp_path: Path, scale: float
) -> None:
    motion = turned(person(90))
    truth = read(written(tmp_path / "whole.c3d", motion))
    walk = written(tmp_path / "walk.c3d", motion, SEEN)
    alone = read(walk)
    found = read(walk, written(tmp_path / "static.c3d", person(20), scale=scale))
    for joint in ("lknee", "rknee", "lankle", "rankle"):
        away = [np.linalg.norm(body.positions - truth.positions, axis=1)[index(joint)] for body in (alone, found)]
        assert away[0].min() > 0.005, joint
        assert away[1].max() < 1e-3, joint
        assert joint in alone.estimated
        assert joint not in found.estimated
    (warning,) = set(found.warnings) - set(alone.warnings)
    assert warning.startswith("markers placed by their segments as in the static trial static.c3d: ")
    assert all(f"{label} 90 frames (from " in warning for label in INNER)
    assert (found.filled_frames, found.filled_from) == (90, 5)


def test_a_motion_that_has_all_markers_stays_as_it_is_beside_a_static_trial(tmp_path: Path) -> None:
    whole = written(tmp_path / "whole.c3d", turned(person(60)))
    alone, found = read(whole), read(whole, written(tmp_path / "static.c3d", person(20)))
    np.testing.assert_array_equal(found.positions, alone.positions)
    assert (found.warnings, found.estimated, found.filled_frames) == (alone.warnings, alone.estimated, 0)


def test_a_marker_that_is_hidden_from_the_first_frame_on_appears_by_the_static_trial(tmp_path: Path) -> None:
    motion = turned(person(90))
    truth = read(written(tmp_path / "whole.c3d", motion))
    hidden = motion.copy()
    hidden[WHOLE.index("LKNE"), :, :86] = np.nan  # seen together for too few frames for a shape of its own
    found = read(written(tmp_path / "walk.c3d", hidden), written(tmp_path / "static.c3d", person(20)))
    assert np.linalg.norm(found.positions - truth.positions, axis=1)[index("lknee")].max() < 1e-3
    assert found.valid is None
    assert any("static.c3d: LKNE 86 frames" in warning for warning in found.warnings)


def test_the_static_trial_of_another_person_places_nothing_and_is_warned_of(tmp_path: Path) -> None:
    walk = written(tmp_path / "walk.c3d", turned(person(60)), SEEN)
    alone = read(walk)
    found = read(walk, written(tmp_path / "static.c3d", 1.6 * person(20)))
    np.testing.assert_array_equal(found.positions, alone.positions)
    (warning,) = set(found.warnings) - set(alone.warnings)
    assert warning.startswith(
        "the static trial static.c3d has LKNM, RKNM, LANM, RANM, which this file lacks and no seg"
    )


def test_a_static_trial_that_cannot_be_read_or_is_of_something_else_changes_nothing(tmp_path: Path) -> None:
    walk = written(tmp_path / "walk.c3d", turned(person(60)), SEEN)
    alone = read(walk)
    (tmp_path / "static.c3d").write_bytes(b"\x02\x50broken")
    found = read(walk, tmp_path / "static.c3d")
    np.testing.assert_array_equal(found.positions, alone.positions)
    (warning,) = set(found.warnings) - set(alone.warnings)
    assert warning.startswith("its static trial static.c3d cannot be read, and places no markers: ")
    wand = write_c3d(tmp_path / "cal.c3d", 1000 * z_up(person(20)[:4]), ("W1", "W2", "W3", "W4"))
    assert read(walk, wand).warnings == alone.warnings


def test_markers_of_a_cluster_with_any_names_show_the_pose_of_their_segment(tmp_path: Path) -> None:
    names = {label: f"Q{i}" for i, label in enumerate(label for label in WHOLE if "THI" in label or "TIB" in label)}
    labels = tuple(names.get(label, label) for label in WHOLE)
    motion = turned(person(60))
    for part in ("walk", "static"):
        kept = [i for i, label in enumerate(labels) if part == "static" or label not in INNER]
        points = 1000 * z_up(motion if part == "walk" else person(20))[kept]
        write_c3d(tmp_path / f"{part}.c3d", points, tuple(labels[i] for i in kept), Y_SCREEN=["+Z"])
    truth = read(written(tmp_path / "whole.c3d", motion))
    found = read(tmp_path / "walk.c3d", tmp_path / "static.c3d")
    for joint in ("lknee", "rknee", "lankle", "rankle"):
        assert np.linalg.norm(found.positions - truth.positions, axis=1)[index(joint)].max() < 1e-3, joint


def test_the_subject_of_labels_may_differ_between_static_trial_and_motion(tmp_path: Path) -> None:
    motion = turned(person(60))
    kept = [WHOLE.index(label) for label in SEEN]
    walk = write_c3d(tmp_path / "walk.c3d", 1000 * z_up(motion[kept]), tuple(f"Ann:{name}" for name in SEEN))
    truth = read(written(tmp_path / "whole.c3d", motion))
    found = read(walk, written(tmp_path / "static.c3d", person(20)))
    assert np.linalg.norm(found.positions - truth.positions, axis=1)[index("lknee")].max() < 1e-3


def files(*paths: str) -> list[SourceFile]:
    return [SourceFile("/archive", path, 1, 1) for path in paths]


def test_a_static_trial_is_known_by_its_name_and_serves_the_motions_of_its_subject() -> None:
    assert subject_parts("subject01_Static2") == [("subject", "01")]
    assert subject_parts("Cal 03 Ann") == [("ann",)]
    assert [subject_parts(name) for name in ("static", "T-Pose", "StaticTrial01", "tpose_2")] == [[], [], [], []]
    assert [subject_parts(name) for name in ("walk_1", "pose_3", "standing_jump")] == [None, None, None]
    archive = files(
        "a/S01_static.c3d", "a/S02_static1.c3d", "a/S02_static2.c3d", "a/S01_walk.c3d", "a/S02_walk.c3d",
        "a/S03_walk.c3d", "a/S01_walk.trc", "b/static.trc", "b/walk.trc", "b/deep/walk.trc",
    )  # fmt: skip
    trials = trials_by_folder(archive)
    found = {file.path: getattr(static_trial_of(file, trials), "path", None) for file in archive}
    assert {path: trial for path, trial in found.items() if trial} == {
        "a/S01_walk.c3d": "a/S01_static.c3d", "a/S02_walk.c3d": "a/S02_static1.c3d", "b/walk.trc": "b/static.trc",
    }  # fmt: skip


def test_a_packed_static_trial_serves_as_an_ordinary_one(tmp_path: Path) -> None:
    walk = written(tmp_path / "walk.c3d", turned(person(60)), SEEN)
    static = written(tmp_path / "static.c3d", person(20))
    plain = read(walk, file_beside(walk))
    (tmp_path / "static.c3d.gz").write_bytes(gzip.compress(static.read_bytes()))
    static.unlink()
    beside = file_beside(walk)
    assert beside == tmp_path / "static.c3d.gz"
    with unpacked(walk, beside) as copy:
        found = read(copy.path, copy.skeleton)
    np.testing.assert_array_equal(found.positions, plain.positions)
    assert found.warnings == plain.warnings
    assert file_beside(tmp_path / "static.c3d.gz") is None


def test_an_archive_keeps_the_static_trial_of_a_take_and_reads_it_again_with_another_one(tmp_path: Path) -> None:
    source, store = tmp_path / "day", tmp_path / "store"
    source.mkdir()
    written(source / "static.c3d", person(20))
    for name in ("walk", "run"):
        written(source / f"{name}.c3d", turned(person(60)), SEEN)

    def take_in(**settings: object) -> dict[str, dict[str, object]]:
        Ingest().run(context(store), Ingest.parameters(source=str(source), **settings))
        return {row["name"]: row for row in open_store(store).takes().to_dicts()}

    first = take_in()
    beside = {name: row["skeleton_source"] for name, row in first.items()}
    assert beside == {"walk": "static.c3d", "run": "static.c3d", "static": None}
    assert not any("unlike the files beside it" in warning for row in first.values() for warning in row["warnings"])
    assert take_in()["walk"]["filled_frames"] == 60
    written(source / "static.c3d", 1.6 * person(20))
    assert take_in()["walk"]["filled_frames"] == 0
    written(source / "other.c3d", person(20))
    assert take_in(skeleton_files={"walk.*": "other.c3d"})["walk"]["filled_frames"] == 60
    with pytest.raises(KinedexError, match="the source has no such static trial"):
        take_in(skeleton_files={"walk.*": "lost.c3d"}, strict=True)


def test_inner_markers_of_a_real_walk_lie_within_2_cm_by_its_first_frames(shared: Path) -> None:
    walk = parse_c3d(shared / "data" / "c3d" / "Qualisys.c3d").seen()
    trial, motion = (replace(walk, positions=walk.positions[:, :, part]) for part in (slice(10), slice(10, None)))
    inner = ("L_FME", "R_FME", "L_TAM", "R_TAM")
    kept = [i for i, name in enumerate(motion.names) if name not in inner]
    lacking = replace(motion, names=tuple(motion.names[i] for i in kept), positions=motion.positions[kept])
    found = completed(lacking, Path("static.c3d"), lambda _: trial)
    for name in inner:
        track = found.positions[found.indices()[name]]
        away = np.linalg.norm(track - motion.positions[motion.indices()[name]], axis=0)
        assert away.mean() < 15, name  # mm
        assert np.percentile(away, 95) < 25, name
