"""A label that is lost, or exchanged with another, moves no joint without a word."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.reader import Body
from kinedex.storage.formats.motion.reader_table import read_body
from tests.c3d_files import LABELS, standing_markers, write_c3d, z_up

JOINTS = load_feature_set().joints
BY_LABELS = Mappings({"c3d": ()})
"""Mappings that recognise each body by its labels, as those of HDM05's files name these labels, too."""

RIGHT_M, ESTIMATED_M = 0.02, 0.05


def read(path: Path, points: np.ndarray, labels: tuple[str, ...] = LABELS) -> Body:
    return read_body(write_c3d(path, 1000 * z_up(points), labels, Y_SCREEN=["+Z"]), None, BY_LABELS, JOINTS)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Body:
    return read(tmp_path_factory.mktemp("whole") / "whole.c3d", standing_markers(24))


def moved(body: Body, whole: Body) -> dict[str, float]:
    """The joints that are farther than 2 cm from where they are without the change, in metres."""
    away = np.nan_to_num(np.linalg.norm(body.positions - whole.positions, axis=1))  # unknown places do not count
    return {joint: float(off.max()) for joint, off in zip(JOINTS, away, strict=True) if off.max() > RIGHT_M}


def silent(body: Body, whole: Body) -> dict[str, float]:
    """The joints that are wrong although no warning is new and nothing says that they are estimated."""
    found = moved(body, whole)
    if set(body.warnings) > set(whole.warnings):
        return {}
    return {joint: off for joint, off in found.items() if joint not in body.estimated or off > ESTIMATED_M}


@pytest.mark.parametrize("how", ["hidden", "removed", "renamed", "hidden at first"])
def test_a_lost_label_moves_no_joint_without_a_word(tmp_path: Path, whole: Body, how: str) -> None:
    kept = 0
    for i, label in enumerate(LABELS):
        points, labels = standing_markers(24), list(LABELS)
        if how == "removed":
            points, labels = np.delete(points, i, axis=0), [other for other in LABELS if other != label]
        elif how == "renamed":
            labels[i] = "XQZ"
        else:
            points[i, :, : 12 if how == "hidden at first" else None] = np.nan
        try:
            body = read(tmp_path / "lost.c3d", points, tuple(labels))
        except SourceError:
            continue
        assert not silent(body, whole), label
        wrong = {joint: off for joint, off in moved(body, whole).items() if joint not in body.estimated}
        kept += not wrong
    assert kept >= 0.8 * len(LABELS) or how == "hidden at first"


@given(st.sampled_from([label for label in LABELS if label[0] == "L"]))
def test_labels_of_both_sides_that_are_exchanged_are_warned_of(label: str) -> None:
    here = read_points({label: "R" + label[1:], "R" + label[1:]: label})
    assert here is None or not silent(*here)


@pytest.mark.parametrize(("a", "b"), [("LKNE", "LANK"), ("LELB", "LWRA"), ("LSHO", "LELB"), ("LFWT", "LBWT")])
def test_labels_of_one_side_that_are_exchanged_are_warned_of(a: str, b: str) -> None:
    here = read_points({a: b, b: a})
    assert here is None or any("may be exchanged" in warning for warning in here[0].warnings)


def read_points(names: dict[str, str]) -> tuple[Body, Body] | None:
    """The bodies of the standing figure with labels renamed and with its own; None if the first is refused."""
    with tempfile.TemporaryDirectory() as folder:
        whole = read(Path(folder) / "whole.c3d", standing_markers(8))
        labels = tuple(names.get(one, one) for one in LABELS)
        try:
            return read(Path(folder) / "other.c3d", standing_markers(8), labels), whole
        except SourceError:
            return None


def test_a_mirrored_scene_is_warned_of(tmp_path: Path) -> None:
    mirrored = standing_markers(8) * np.array([[-1.0], [1.0], [1.0]])
    (warning,) = (one for one in read(tmp_path / "a.c3d", mirrored).warnings if "exchanged" in one)
    assert "by left and right the body faces backwards" in warning
    assert not any("exchanged" in one for one in read(tmp_path / "b.c3d", standing_markers(8)).warnings)
