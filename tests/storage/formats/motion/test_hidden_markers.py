"""Markers that are hidden for long are placed by their segment, and the take says for how many frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.storage.formats.motion.reader import Body
from kinedex.storage.formats.motion.reader_table import read_body
from tests.bodies import index
from tests.c3d_files import LABELS, standing_markers, write_c3d, z_up

JOINTS = load_feature_set().joints
BY_LABELS = Mappings({"c3d": ()})
FRAMES = 90
GAP = slice(30, 70)


def turning(frames: int = FRAMES) -> np.ndarray:
    """Markers of a body that turns as it walks, so that a straight line does not do."""
    points = standing_markers(frames)
    angles = 1.5 * np.sin(np.arange(frames) / 15)
    cos, sin = np.cos(angles), np.sin(angles)
    x, z = points[:, 0] * cos + points[:, 2] * sin, points[:, 2] * cos - points[:, 0] * sin
    return np.stack([x, points[:, 1], z], axis=1)


def read(path: Path, points: np.ndarray) -> Body:
    return read_body(write_c3d(path, 1000 * z_up(points), LABELS, Y_SCREEN=["+Z"]), None, BY_LABELS, JOINTS)


@pytest.mark.parametrize(("label", "joint"), [("LFWT", "lhip"), ("CLAV", "neck"), ("LFHD", "head")])
def test_a_hidden_marker_does_not_move_the_joint_of_its_segment(tmp_path: Path, label: str, joint: str) -> None:
    points = turning()
    whole = read(tmp_path / "whole.c3d", points)
    points[LABELS.index(label), :, GAP] = np.nan
    found = read(tmp_path / "hidden.c3d", points)
    away = np.linalg.norm(found.positions - whole.positions, axis=1)
    assert np.nanmax(away[index(joint)]) < 1e-3  # numbers of a file are float32, in mm
    assert (found.filled_frames, found.filled_from is not None and found.filled_from >= 3) == (40, True)
    (warning,) = set(found.warnings) - set(whole.warnings)
    assert warning.startswith(f"hidden markers estimated by the pose of their segment: {label} 40 frames (from ")
    assert (whole.filled_frames, whole.filled_from) == (0, None)


def test_short_gaps_are_closed_along_straight_lines_as_ever(tmp_path: Path) -> None:
    points = turning()
    points[LABELS.index("LFWT"), :, 30:36] = np.nan
    found = read(tmp_path / "short.c3d", points)
    assert found.filled_frames == 0
    assert any(warning.startswith("gaps closed along straight lines: LFWT 6 frames") for warning in found.warnings)


def test_a_marker_whose_segment_is_hidden_too_stays_hidden(tmp_path: Path) -> None:
    points = turning()
    for label in ("LFWT", "RFWT"):
        points[LABELS.index(label), :, GAP] = np.nan
    assert read(tmp_path / "hidden.c3d", points).filled_frames == 0
