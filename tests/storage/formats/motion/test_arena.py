"""CSV files of OptiTrack's programs before Motive are read by the names of markers or of rigid bodies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.arena import ArenaReader
from kinedex.storage.formats.motion.reader_table import is_motion_file, read_body, reader_of
from tests.c3d_files import LABELS, standing_markers
from tests.point_files import JOINTS as NAMES
from tests.point_files import arena_csv, walk

JOINTS = load_feature_set().joints
MAPPINGS = load_mappings("auto", JOINTS)


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "take.csv"
    path.write_text(text)
    return path


def test_markers_with_names_are_a_body(tmp_path: Path) -> None:
    points = standing_markers(20).transpose(2, 0, 1)
    points[5, 3] = np.nan
    path = write(tmp_path, arena_csv(points, LABELS))
    assert isinstance(reader_of(path), ArenaReader)
    body = read_body(path, None, MAPPINGS, JOINTS)
    assert body.rate_hz == pytest.approx(100)
    assert body.unit.startswith("1 m")
    ankle = body.positions[JOINTS.index("lankle")]
    assert ankle[1].mean() == pytest.approx(0.1, abs=0.03)
    assert any("gaps closed along straight lines: LANK 1 frames" in warning for warning in body.warnings)


@pytest.mark.parametrize("version", ["1", "1.1"])
def test_rigid_bodies_with_the_names_of_joints_are_a_body_where_no_marker_has_a_name(
    tmp_path: Path, version: str
) -> None:
    points = walk(20)
    body = read_body(write(tmp_path, arena_csv(points, NAMES, version=version, bodies=True)), None, MAPPINGS, JOINTS)
    for joint in ("lknee", "rwrist", "neck"):
        np.testing.assert_allclose(body.positions[JOINTS.index(joint)].T, points[:, NAMES.index(joint)], atol=1e-6)
    assert "its markers have no names; the body is that of its rigid bodies" in body.warnings


def test_left_handed_axes_are_turned_into_right_handed_ones(tmp_path: Path) -> None:
    points = walk(20)
    mirrored = points * [1, 1, -1]
    path = write(tmp_path, arena_csv(mirrored, NAMES, bodies=True, hand="lefthanded"))
    body = read_body(path, None, MAPPINGS, JOINTS)
    np.testing.assert_allclose(body.positions[JOINTS.index("lknee")].T, points[:, NAMES.index("lknee")], atol=1e-6)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda text: text.replace("frame,3,", "frame,4,"), "expected the number of the next frame, 3, got 4"),
        (lambda text: text.replace("frame,3,0.03000000,0,30", "frame,3,0.03000000,0,29"), "for each of 29 markers"),
        (lambda text: text.replace("frame,3,0.03000000,0", "frame,3,0.03000000,-1"), "a number of bodies or markers"),
        (lambda text: text.replace("frame,3,0.03000000,0", "frame,3,0.03000000,7000"), "the row of the frame ends"),
        (lambda text: text.replace("frame,", "#frame,"), "expected rows that begin with 'frame', found none"),
    ],
)
def test_what_is_wrong_in_a_file_is_said_with_its_line(tmp_path: Path, change, fault: str) -> None:
    text = arena_csv(standing_markers(9).transpose(2, 0, 1), LABELS)
    assert change(text) != text
    with pytest.raises(SourceError, match=fault):
        read_body(write(tmp_path, change(text)), None, MAPPINGS, JOINTS)


def test_markers_without_names_are_refused_with_a_way_out(tmp_path: Path) -> None:
    text = arena_csv(standing_markers(9).transpose(2, 0, 1), LABELS, version="1")
    with pytest.raises(SourceError, match="have no names, and it tracks no rigid body: open the recording in Motive"):
        read_body(write(tmp_path, text), None, MAPPINGS, JOINTS)


def test_other_tables_are_none_of_these_files(tmp_path: Path) -> None:
    assert not is_motion_file(write(tmp_path, "comment,value\ninfo,3\n"))
