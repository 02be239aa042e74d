"""MVNX files: the body is where MVN puts its segments, whatever the file has besides, and bad files are refused."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.reader import Body, MotionFile, ReadSettings
from kinedex.storage.formats.motion.reader_table import reader_of
from kinedex.storage.formats.mvnx import count_elements, read_mvnx, subject_names
from tests.bodies import x_axes
from tests.mvnx_files import SEGMENTS, dancing, mvnx_text, rotate, subject_text, tip, write_mvnx

JOINTS = load_feature_set().joints
AUTO = load_mappings("auto", JOINTS)


def read(path: Path, person: str = "", settings: ReadSettings | None = None) -> Body:
    return reader_of(path).read(MotionFile(path, person=person), AUTO, JOINTS, settings or ReadSettings())


def joint(body: Body, name: str) -> np.ndarray:
    return body.positions[JOINTS.index(name)]


def y_up(positions: np.ndarray) -> np.ndarray:
    return positions[..., [1, 2, 0]]


def test_joints_lie_where_the_segments_begin_and_end(tmp_path: Path) -> None:
    positions, orientations = write_mvnx(tmp_path / "a.mvnx")
    body = read(tmp_path / "a.mvnx")
    assert (body.rate_hz, body.unit, body.frames, body.unknown) == (60.0, "1 m", 5, ())
    for name, segment in {"root": "Pelvis", "lknee": "LeftLowerLeg", "relbow": "RightForeArm", "neck": "Neck"}.items():
        expected = y_up(positions[:, SEGMENTS.index(segment)]).T
        np.testing.assert_allclose(joint(body, name), expected, atol=1e-6)
    for name, segment in {"headtop": "Head", "ltoes": "LeftToe"}.items():
        at = SEGMENTS.index(segment)
        expected = [positions[t, at] + rotate(orientations[t, at], tip(segment)) for t in range(5)]
        np.testing.assert_allclose(joint(body, name), y_up(np.array(expected)).T, atol=2e-6)
    assert body.estimated == ("lfingers", "rfingers", "belly", "chest")  # between two nodes of the file each
    along = joint(body, "rfingers") - joint(body, "rwrist")
    np.testing.assert_allclose(np.linalg.norm(along, axis=0), 0.442 * 0.19, atol=0.01)
    assert any("X forward and Z up" in sentence for sentence in body.evidence)


def test_the_root_turns_as_the_pelvis_does(tmp_path: Path) -> None:
    for degrees in (0.0, 90.0, 180.0):
        path = tmp_path / f"{degrees}.mvnx"
        positions, orientations = dancing(3, forward=degrees)
        orientations[:, 0] = [np.cos(np.deg2rad(degrees) / 2), 0, 0, np.sin(np.deg2rad(degrees) / 2)]
        path.write_text(mvnx_text([subject_text(positions, orientations)]))
        left = x_axes(read(path).orientation)[0]
        expected = [np.cos(np.deg2rad(degrees)), 0, -np.sin(np.deg2rad(degrees))]
        np.testing.assert_allclose(left, expected, atol=1e-6)


def test_a_suit_for_the_upper_body_leaves_the_legs_unknown(tmp_path: Path) -> None:
    write_mvnx(tmp_path / "a.mvnx", suit="UpperBody")
    body = read(tmp_path / "a.mvnx")
    assert body.unknown == tuple(joint for joint in JOINTS if joint[1:] in ("hip", "knee", "ankle", "toes"))
    assert any("the suit UpperBody" in warning for warning in body.warnings)


def test_every_subject_is_a_person(tmp_path: Path) -> None:
    first, second = dancing(4, seed=1), dancing(6, seed=2)
    path = tmp_path / "two.mvnx"
    path.write_text(mvnx_text([subject_text(*first, label="Ann"), subject_text(*second, label="Bo")]))
    reader = reader_of(path)
    assert reader.persons(MotionFile(path), AUTO) == ("Ann", "Bo")
    assert [read(path, person).frames for person in ("Ann", "Bo")] == [4, 6]
    np.testing.assert_allclose(joint(read(path, "Bo"), "root"), y_up(second[0][:, 0]).T, atol=1e-6)
    with pytest.raises(SourceError, match="holds 2 figures or clips: 'Ann', 'Bo'"):
        read(path)
    with pytest.raises(SourceError, match="has no person 'Cy'"):
        read(path, "Cy")
    path.write_text(mvnx_text([subject_text(*first, label=""), subject_text(*second, label="")]))
    assert reader.persons(MotionFile(path), AUTO) == ("subject 1", "subject 2")


def test_fields_of_sensors_are_read_for_those_who_want_them(tmp_path: Path) -> None:
    path = tmp_path / "a.mvnx"
    write_mvnx(path, 3, more="<sensorOrientation>1 0 0 0 0 1 0 0</sensorOrientation><jointAngle>1 2 3</jointAngle>")
    (subject,) = read_mvnx(path, ("sensorOrientation", "sensorFreeAcceleration", "jointAngle"))
    assert subject.sensors == ["Pelvis", "Head"]
    assert subject.numbers("sensorOrientation").shape == (3, 2, 4)
    np.testing.assert_array_equal(subject.numbers("sensorOrientation")[2], [[1, 0, 0, 0], [0, 1, 0, 0]])
    np.testing.assert_array_equal(subject.numbers("jointAngle")[:, 0], [[1, 2, 3]] * 3)
    assert subject.numbers("sensorFreeAcceleration").shape == (0, 2, 3)
    assert subject_names([subject]) == ("Ann",)


def test_rates_that_are_missing_can_be_given(tmp_path: Path) -> None:
    path = tmp_path / "a.mvnx"
    write_mvnx(path)
    path.write_text(path.read_text().replace(' frameRate="60"', ""))
    with pytest.raises(SourceError, match="states no frameRate"):
        read(path)
    assert read(path, settings=ReadSettings(rate_hz=100.0)).rate_hz == 100.0


def test_a_file_in_another_encoding_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mvnx"
    write_mvnx(path)
    path.write_bytes(path.read_text().replace("UTF-8", "UTF-16").encode("utf-16"))
    with pytest.raises(SourceError, match="is encoded as UTF-16"):
        read(path)


def test_missing_frames_are_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "a.mvnx"
    write_mvnx(path)
    path.write_text(path.read_text().replace('index="4"', 'index="40"'))
    assert any("36 frames are missing" in warning for warning in read(path).warnings)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<mvnx ", "<other ", "expected the element mvnx, got 'other'|is no XML"),
        ('frameRate="60"', 'frameRate="fast"', "frameRate must be frames per second, got 'fast'"),
        ('frameRate="60"', 'frameRate="1e9"', "frameRate must be 1 to 10000 Hz"),
        ('label="L5"', 'label="Pelvis"', "a segment must have a label of its own"),
        ('label="Pelvis" id', 'label="Hips" id', "has no segment Pelvis"),
        ('type="normal"', 'type="tpose"', "has no frame of type normal"),
        ("<orientation>", "<orientation>1 ", r"<orientation> of frame 0 must be 92 numbers, got 93"),
        ("<orientation>", "<orientation>nan ", r"must be 92 numbers, got 93"),
        ("</position></frame>", "</position>", "is no XML: mismatched tag"),
        ("<position>", "<place>", "is no XML"),
        ('<?xml version="1.0" encoding="UTF-8"?>', '<!DOCTYPE m [<!ENTITY a "b">]>', "declares an entity"),
        ('encoding="UTF-8"', 'encoding="nonsense"', "unknown encoding"),
    ],
)
def test_damaged_files_are_refused_with_the_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "a.mvnx"
    write_mvnx(path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(SourceError, match=message):
        read(path)


def test_numbers_that_are_none_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mvnx"
    write_mvnx(path)
    for bad in ("nan", "inf", "1e300", "one"):
        text = path.read_text()
        at = text.index("<position>", text.index('type="normal"')) + len("<position>")
        path.write_text(text[:at] + bad + text[text.index(" ", at) :])
        with pytest.raises(SourceError, match=r"a.mvnx:\d+: <position> (must be|has) numbers"):
            read(path)
        write_mvnx(path)


def test_a_file_that_is_cut_anywhere_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mvnx"
    write_mvnx(path, 2)
    data = path.read_bytes()
    for stop in (0, 1, 40, 200, 1000, len(data) // 2, len(data) - 20):
        path.write_bytes(data[:stop])
        with pytest.raises(SourceError):
            read(path)


def test_memory_stays_below_its_bound(tmp_path: Path) -> None:
    path = tmp_path / "a.mvnx"
    positions, orientations = dancing(40)
    path.write_text(mvnx_text([subject_text(np.tile(positions, (20, 1, 1)), np.tile(orientations, (20, 1, 1)))]))
    extent = reader_of(path).extent(MotionFile(path), len(JOINTS), ReadSettings())
    assert count_elements(path, "frame") == 803  # with the three poses of calibration
    assert extent.frames == 803
    read(path)
    tracemalloc.start()
    try:
        read(path)
        assert tracemalloc.get_traced_memory()[1] < extent.bytes
    finally:
        tracemalloc.stop()
