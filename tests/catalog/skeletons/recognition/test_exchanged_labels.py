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
from tests.bodies import STANDING
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


def read_points(
    names: dict[str, str], points: np.ndarray | None = None, known: tuple[str, ...] = LABELS
) -> tuple[Body, Body] | None:
    """The bodies of points, by default of the standing figure, with labels renamed and with their own.

    None if the first is refused.
    """
    points = standing_markers(8) if points is None else points
    with tempfile.TemporaryDirectory() as folder:
        whole = read(Path(folder) / "whole.c3d", points, known)
        assert not any("exchanged" in warning for warning in whole.warnings)
        labels = tuple(names.get(one, one) for one in known)
        try:
            return read(Path(folder) / "other.c3d", points, labels), whole
        except SourceError:
            return None


MORE = {
    "RBAK": (-0.09, 1.40, -0.12), "LGT": (0.17, 0.90, 0.0), "RGT": (-0.17, 0.90, 0.0), "LTIB": (0.14, 0.28, 0.03),
    "*7": (0.0, 1.44, 0.07),
}  # fmt: skip
"""Markers beside those of HDM05, in metres: on the right shoulder blade, the trochanters, a shin, and one upon CLAV."""


@pytest.mark.parametrize(
    ("a", "b", "words"),
    [
        ("RSHO", "RBAK", "RBAK is above RSHO"),
        ("C7", "RBAK", "RBAK is above C7"),
        ("C7", "RSHO", "RSHO is on the left of C7"),
        ("LFWT", "LGT", "LGT is above LFWT"),
        ("LTOE", "LTIB", "LTOE is nearer to LKNE than LHEE"),
        ("STRN", "*7", "are at the same place"),
    ],
)
def test_labels_that_are_exchanged_with_a_neighbour_contradict_each_other(a: str, b: str, words: str) -> None:
    extra = np.array(list(MORE.values()))[:, :, None] + np.array([[0.0], [0.0], [0.01]]) * np.arange(8)
    found = read_points({a: b, b: a}, np.concatenate([standing_markers(8), extra]), (*LABELS, *MORE))
    assert found is not None
    assert any("may be exchanged" in warning and words in warning for warning in found[0].warnings), found[0].warnings


def test_a_head_that_is_exchanged_with_the_nose_is_warned_of() -> None:
    joints = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
    points = {f"{side.upper()}{joint.title()}": STANDING[f"{side}{joint}"] for joint in joints for side in "lr"}
    points |= {"Neck": STANDING["neck"], "Head": (0.0, 1.78, 0.0), "Nose": (0.0, 1.64, 0.12)}
    walk = np.array(list(points.values()))[:, :, None] + np.array([[0.0], [0.0], [0.01]]) * np.arange(8)
    found = read_points({"Head": "Nose", "Nose": "Head"}, walk, tuple(points))
    assert found is not None
    assert any("Head and Nose" in warning for warning in found[0].warnings), found[0].warnings


def test_a_foot_marker_that_is_taken_for_the_ankle_moves_against_the_shank() -> None:
    foot, shin = (0.13, 0.06, -0.02), {"LTB1": (0.15, 0.4, 0.04), "LTB2": (0.18, 0.3, 0.0), "LTB3": (0.15, 0.2, 0.04)}
    extra = np.array([foot, *shin.values()])[:, :, None] + np.array([[0.0], [0.0], [0.01]]) * np.arange(32)
    extra[0, 1] += 0.012 * np.sin(np.arange(32))  # the foot turns about the ankle
    points = np.concatenate([standing_markers(32), extra])
    found = read_points({"LANK": "P1", "P1": "LANK"}, points, (*LABELS, "P1", *shin))
    assert found is not None
    assert any("P1 moves less against the shank than LANK beside it" in warning for warning in found[0].warnings)


def test_a_joint_whose_markers_are_hidden_for_long_is_estimated(tmp_path: Path) -> None:
    points = standing_markers(60)
    points[LABELS.index("LWRA"), :, :30] = np.nan
    body = read(tmp_path / "a.c3d", points)
    assert "lwrist" in body.estimated
    assert any("lwrist (from other points in 30 of 60 frames)" in sentence for sentence in body.evidence)
    points[LABELS.index("LWRA"), :, 4:] = standing_markers(60)[LABELS.index("LWRA"), :, 4:]
    assert "lwrist" not in read(tmp_path / "b.c3d", points).estimated


def test_a_mirrored_scene_is_warned_of(tmp_path: Path) -> None:
    mirrored = standing_markers(8) * np.array([[-1.0], [1.0], [1.0]])
    (warning,) = (one for one in read(tmp_path / "a.c3d", mirrored).warnings if "exchanged" in one)
    assert "by left and right the body faces backwards" in warning
    assert not any("exchanged" in one for one in read(tmp_path / "b.c3d", standing_markers(8)).warnings)
