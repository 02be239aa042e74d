"""CSV files of Motive and of Vicon: headers of all versions, sections, subjects, and every fault with its line."""

from __future__ import annotations

from pathlib import Path

import ezc3d
import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.motive import MotiveReader
from kinedex.storage.formats.motion.nexus import NexusReader
from kinedex.storage.formats.motion.reader import DEFAULT_SETTINGS, Body, MotionFile
from kinedex.storage.formats.motion.reader_table import is_motion_file, read_body, reader_of
from tests.point_files import DEVICES, JOINTS, motive_csv, nexus_csv, walk, workstation_csv

ORDER = load_feature_set().joints
AUTO = load_mappings("auto", ORDER)
WALK = walk(8)
EXPECTED = WALK[:, [JOINTS.index(joint) for joint in ORDER]].transpose(1, 2, 0)
SKELETON = tuple(f"Ann:{joint}" for joint in JOINTS)


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def read(path: Path, person: str = "") -> Body:
    return reader_of(path).read(MotionFile(path, person=person), AUTO, ORDER, DEFAULT_SETTINGS)


def refused(path: Path, *words: str, line: int | None = None) -> None:
    with pytest.raises(SourceError) as caught:
        read_body(path, None, AUTO, ORDER)
    for word in words:
        assert word in str(caught.value)
    assert caught.value.line == line or line is None


@pytest.mark.parametrize("version", ["1.21", "1.23", "1.25"])
@pytest.mark.parametrize("unit", ["Meters", "Centimeters", "Millimeters"])
def test_bones_of_motive_come_in_within_a_tenth_of_a_millimetre(tmp_path: Path, version: str, unit: str) -> None:
    scale = {"Meters": 1, "Centimeters": 100, "Millimeters": 1000}[unit]
    text = motive_csv(WALK * scale, SKELETON, version=version, unit=unit, timecode=version == "1.25")
    body = read(write(tmp_path / "a.csv", text))
    assert body.rate_hz == 120.0  # of the export, not of the capture
    np.testing.assert_allclose(body.positions, EXPECTED, atol=1e-4)


def test_markers_of_motive_are_points_where_there_are_no_bones(tmp_path: Path) -> None:
    gap = 1000 * WALK.copy()
    gap[2:4, 3] = np.nan
    names = (*JOINTS, "Unlabeled 1189")
    positions = np.concatenate([gap, gap[:, :1]], axis=1)
    body = read(write(tmp_path / "a.csv", motive_csv(positions, names, kind="Marker")))
    np.testing.assert_allclose(body.positions, EXPECTED, atol=1e-4)
    assert any("type Marker" in warning for warning in body.warnings)


OLDER = {"Hip": "root", "Ab": "belly", "Chest": "chest", "Neck": "neck", "Head": "head"} | {
    f"{side.upper()}{part}": side + joint
    for side in "lr"
    for part, joint in zip(
        ("Shoulder", "UArm", "FArm", "Hand", "Thigh", "Shin", "Foot", "Toe"),
        ("clavicle", "shoulder", "elbow", "wrist", "hip", "knee", "ankle", "toes"), strict=True,
    )
}  # fmt: skip
"""The bones of Motive 1, each with the joint at its beginning."""


@pytest.mark.parametrize("version", ["1.0", "1.1", "1.2"])
@pytest.mark.parametrize("prefix", ["", "Skeleton 001_", "Skeleton 001:", "Skeleton:"])
def test_bones_of_motive_1_are_joints_of_a_body(tmp_path: Path, version: str, prefix: str) -> None:
    points = WALK[:, [JOINTS.index(joint) for joint in OLDER.values()]]
    text = motive_csv(points, [prefix + name for name in OLDER], version=version, unit="Meters")
    if version == "1.0":
        text = text.replace(",Length Units,Meters,Coordinate Space,Global", "").replace("Time (Seconds)", "Time")
    body = read(write(tmp_path / "a.csv", text))
    held = [
        ORDER.index(joint) for joint in OLDER.values() if joint not in ("belly", "chest")
    ]  # a third of the spine each
    np.testing.assert_allclose(body.positions[held], EXPECTED[held], atol=1e-4)
    assert {"lfingers", "rfingers", "headtop"} == set(body.estimated)


def test_two_markers_of_motive_with_one_name_are_not_taken_for_one(tmp_path: Path) -> None:
    points = 1000 * np.concatenate([WALK, WALK[:, :1] + 0.2], axis=1)
    body = read(write(tmp_path / "a.csv", motive_csv(points, (*JOINTS, "lknee"), kind="Marker")))
    assert "several markers are called lknee; none of them is used" in body.warnings
    assert "lknee" in (*body.unknown, *body.estimated)


def test_a_unit_that_nobody_knows_is_guessed_with_a_warning(tmp_path: Path) -> None:
    body = read(write(tmp_path / "a.csv", motive_csv(1000 * WALK, SKELETON, unit="Furlongs")))
    assert body.unit == "0.001 m (guessed)"
    assert any("Length Units" in warning and "'Furlongs'" in warning for warning in body.warnings)
    np.testing.assert_allclose(body.positions, EXPECTED, atol=1e-4)


@pytest.mark.parametrize(("unit", "unit_m"), [("in", 0.0254), ("dm", 0.1), ("ft", 0.3048)])
def test_units_of_other_programs_are_known_in_files_of_nexus(tmp_path: Path, unit: str, unit_m: float) -> None:
    body = read(write(tmp_path / "a.csv", nexus_csv(WALK / unit_m, SKELETON, unit=unit)))
    assert body.unit == f"{unit_m:g} m"
    np.testing.assert_allclose(body.positions, EXPECTED, atol=1e-4)


def test_several_skeletons_are_several_persons(tmp_path: Path) -> None:
    other = WALK + np.array([0.0, 0.0, 3.0])
    names = (*SKELETON, *(f"Bob:{joint}" for joint in JOINTS))
    path = write(tmp_path / "a.csv", motive_csv(1000 * np.concatenate([WALK, other], axis=1), names))
    assert reader_of(path).persons(MotionFile(path), AUTO) == ("Ann", "Bob")
    np.testing.assert_allclose(
        read(path, "Bob").positions - read(path, "Ann").positions, EXPECTED * 0 + [[0], [0], [3]]
    )


def test_faults_of_motive_are_refused_with_the_way_out(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    refused(write(path, motive_csv(WALK, SKELETON, space="Local")), "Coordinate Space: Global", line=1)
    refused(write(path, motive_csv(WALK, ["Box"] * 24, kind="Rigid Body")), "only Rigid Body", "export it with bones")
    text = motive_csv(WALK, SKELETON)
    refused(write(path, text.replace("Frame,Time", "Frames,Time")), "expected a row 'Frame,Time", line=1)
    lines = text.splitlines()
    refused(
        write(path, "\n".join([*lines[:9], *lines[10:]])), "expected the number of the next frame, 2, got 3", line=10
    )
    refused(write(path, "\n".join(lines[:7])), "no frames")
    refused(write(path, text.replace("1.450000", "x", 1)), "not a number", line=8)


def test_trajectories_of_nexus_come_in_between_other_sections(tmp_path: Path) -> None:
    for before, after in (("", ""), (DEVICES, ""), ("", ",,,\r\n" + DEVICES), (DEVICES, "\r\n\r\n" + DEVICES)):
        path = write(tmp_path / "a.csv", nexus_csv(1000 * WALK, SKELETON, before=before, after=after))
        assert reader_of(path).persons(MotionFile(path), AUTO) == ()
        body = read(path)
        assert (body.rate_hz, body.unit) == (100.0, "0.001 m")
        np.testing.assert_allclose(body.positions, EXPECTED, atol=1e-4)
        assert reader_of(path).extent(MotionFile(path), 24, DEFAULT_SETTINGS).frames == 8


def test_workstation_files_have_no_unit_and_no_sub_frames(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", workstation_csv(WALK, JOINTS))
    assert NexusReader().points(MotionFile(path), DEFAULT_SETTINGS).unit_m is None
    np.testing.assert_allclose(read(path).positions, EXPECTED, atol=1e-4)


def test_things_beside_a_person_are_not_used_and_are_named(tmp_path: Path) -> None:
    names = (*SKELETON, "box:a", "box:b", "*11")
    positions = 1000 * np.concatenate([WALK, WALK[:, :3]], axis=1)
    path = write(tmp_path / "a.csv", nexus_csv(positions, names))
    body = read(path)
    assert any("points of box are not used" in warning for warning in body.warnings)
    np.testing.assert_allclose(body.positions, EXPECTED, atol=1e-4)
    wand = (*SKELETON, *(f"wand:{i}" for i in range(12)))
    write(path, nexus_csv(1000 * np.concatenate([WALK, WALK[:, :12]], axis=1), wand))
    assert reader_of(path).persons(MotionFile(path), AUTO) == ()
    np.testing.assert_allclose(read(path).positions, EXPECTED, atol=1e-4)
    both = (*SKELETON, *(f"Bob:{joint}" for joint in JOINTS))
    write(path, nexus_csv(1000 * np.concatenate([WALK, WALK], axis=1), both))
    assert reader_of(path).persons(MotionFile(path), AUTO) == ("Ann", "Bob")
    np.testing.assert_allclose(read(path, "Bob").positions, EXPECTED, atol=1e-4)
    refused(path, "holds 2 persons, Ann, Bob")


def test_faults_of_nexus_are_refused_with_their_line(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    refused(write(path, DEVICES), "no section with positions", "only: Devices", "export trajectories", line=1)
    text = nexus_csv(1000 * WALK, SKELETON, before=DEVICES)
    refused(write(path, text.replace("100,,", "0,,", 1)), "expected a rate", line=9)
    refused(write(path, text.replace("\r\n8,0,", "\r\n9,0,", 1)), "the next frame, 8, got 9", line=15)
    refused(write(path, text.replace("\r\n8,0,", "\r\n8,0,x", 1)), "not a number", line=15)
    refused(write(path, nexus_csv(WALK, SKELETON, unit="deg")), "labelled points in mm or another unit of length")


def test_other_tables_are_no_motion_files(tmp_path: Path) -> None:
    for text in (
        "a,b\n1,2\n",
        "1,0,44.1,-276.8\n",
        "Format,Version\n",
        "Trajectories of planes\n1,2\n",
        "",
        "Events\n",
    ):
        assert not is_motion_file(write(tmp_path / "a.csv", text))


def test_files_of_nexus_and_workstation_in_the_wild_hold_what_their_c3d_holds(shared: Path) -> None:
    folder = shared / "data" / "wild"
    plain = NexusReader().points(MotionFile(folder / "pyCGM" / "Sample_Static.csv"), DEFAULT_SETTINGS)
    c3d = ezc3d.c3d(str(folder / "pyCGM" / "Sample_Static.c3d"))
    labels = [name.strip() for name in c3d["parameters"]["POINT"]["LABELS"]["value"]]
    for name in ("LFHD", "RASI", "LTOE", "RFIN"):
        expected = c3d["data"]["points"][:3, labels.index(name)]
        np.testing.assert_allclose(
            plain.positions[plain.names.index(name)][:, : expected.shape[1]], expected, atol=0.01
        )
    model = NexusReader().points(MotionFile(folder / "pyCGM" / "Movement_trial.csv"), DEFAULT_SETTINGS)
    assert (model.rate_hz, model.positions.shape[2], model.unit_m) == (120.0, 323, 0.001)
    assert {"LFEO", "PELO", "RHUO"} <= set(model.names)
    arm = NexusReader().points(MotionFile(folder / "pyomeca" / "markers.csv"), DEFAULT_SETTINGS)
    assert (arm.rate_hz, arm.positions.shape) == (100.0, (43, 3, 580))
    assert any("boite" in warning for warning in arm.warnings)
    assert not is_motion_file(folder / "pyomeca" / "markers_without_header.csv")
    assert not MotiveReader().sniff(folder / "pyomeca" / "markers.csv")
