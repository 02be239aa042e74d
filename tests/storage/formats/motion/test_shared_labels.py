"""Labels that markers share: copies of one marker are that marker, and different points are none."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.c3d import parse_c3d
from kinedex.storage.formats.motion.positions import parse_positions
from kinedex.storage.formats.motion.reader import DEFAULT_SETTINGS, MotionFile
from kinedex.storage.formats.motion.reader_table import is_motion_file, read_body, reader_of
from kinedex.storage.formats.motion.shared_labels import unique_names
from tests.c3d_files import LABELS, standing_markers, write_c3d
from tests.point_files import motive_csv, nexus_csv, qualisys_tsv
from tests.storage.formats.motion.test_positions import trc

FRAMES = 8
TABLES = {"motive.csv": partial(motive_csv, kind="Marker"), "nexus.csv": nexus_csv, "qualisys.tsv": qualisys_tsv}
"""File → the writer of a table of markers, as another program writes it."""

KNEE = LABELS.index("LKNE")


def markers() -> np.ndarray:
    """Standing markers (N, 3, T) in millimetres, which sway."""
    return 1000 * standing_markers(FRAMES) + 10 * np.sin(np.arange(FRAMES))


def named(labels: list[str], positions: np.ndarray, unit_m: float | None = 1e-3) -> tuple[tuple[str, ...], list[str]]:
    warnings: list[str] = []
    return unique_names(labels, positions, unit_m, warnings), warnings


@pytest.mark.parametrize("copy", ["LKNE", "LKNE (1)", "LKNE_1"])
def test_two_halves_of_one_marker_are_joined_where_both_are_seen_at_one_place(copy: str) -> None:
    whole = markers()
    points = np.concatenate([whole, whole[KNEE : KNEE + 1] + 0.3])
    points[KNEE, :, 5:], points[-1, :, :4] = np.nan, np.nan
    names, warnings = named([*LABELS, copy], points)
    assert names[: len(LABELS)] == tuple(LABELS)
    assert len(set(names)) == len(names)
    np.testing.assert_allclose(points[KNEE], whole[KNEE], atol=0.31)
    assert np.isnan(points[-1]).all()
    assert warnings == [
        "labels with a number, or of several markers, whose copies are never seen or lie at one place, are taken for "
        "one marker: LKNE (2 copies)"
    ]


@pytest.mark.parametrize("copy", ["LKNE (1)", "LKNE_1"])
def test_a_copy_stands_for_a_marker_that_is_never_seen(copy: str) -> None:
    points = np.concatenate([markers(), markers()[KNEE : KNEE + 1]])
    points[KNEE] = np.nan
    names, warnings = named([*LABELS, copy], points)
    assert names[-1] == "LKNE"
    assert names[KNEE] != "LKNE"
    assert warnings[0].endswith(f"LKNE ({copy})")


@pytest.mark.parametrize(("shift", "unit_m"), [(5.0, 1e-3), (5.0, None), (5.0, 1e-5), (300.0, 1e-3)])
@pytest.mark.parametrize("copy", ["LKNE", "LKNE (1)"])
def test_different_points_of_one_label_are_not_used_whatever_unit_the_file_states(
    copy: str, shift: float, unit_m: float | None
) -> None:
    points = np.concatenate([markers(), markers()[KNEE : KNEE + 1] + shift])
    before = points.copy()
    names, warnings = named([*LABELS, copy], points, unit_m)
    assert "LKNE" not in names
    assert len(set(names)) == len(names)
    np.testing.assert_array_equal(points, before)
    assert warnings == ["several markers are called LKNE; none of them is used"]


def test_copies_that_are_never_seen_together_do_not_prove_that_they_are_one() -> None:
    points = np.concatenate([markers(), markers()[KNEE : KNEE + 1] + 300.0])
    points[KNEE, :, 4:], points[-1, :, :4] = np.nan, np.nan
    assert named([*LABELS, "LKNE"], points)[1] == ["several markers are called LKNE; none of them is used"]


def test_clusters_and_numbered_labels_stay_as_they_are() -> None:
    labels = ["LTHI", "LTHI_1", "LTHI_2", "Point (1)", "Point (2)", "LSHN", "LSHN_1"]
    points = np.random.default_rng(0).normal(size=(len(labels), 3, 4)) * 1000
    points[0] = np.nan  # a wand that is hidden, beside a cluster
    assert named(labels, points) == (tuple(labels), [])


def test_trc_and_c3d_files_come_in_with_the_copies_of_a_marker(tmp_path: Path) -> None:
    points = np.concatenate([markers(), markers()[KNEE : KNEE + 1]])
    points[KNEE, :, 2:4] = np.nan
    labels = (*LABELS, "LKNE")
    (tmp_path / "a.trc").write_text(trc(points.transpose(2, 0, 1), labels))
    for found in (parse_positions(tmp_path / "a.trc"), parse_c3d(write_c3d(tmp_path / "a.c3d", points, labels))):
        assert any("taken for one marker: LKNE (2 copies)" in warning for warning in found.warnings)
        np.testing.assert_allclose(found.positions[found.names.index("LKNE")], markers()[KNEE], atol=0.01)


@pytest.mark.parametrize(("name", "written"), TABLES.items())
@pytest.mark.parametrize("copy", ["LKNE", "LKNE (1)", "LKNE_1"])
def test_tables_of_programs_come_in_with_the_copies_of_a_marker(
    tmp_path: Path, name: str, written: Callable[..., str], copy: str
) -> None:
    points = np.concatenate([markers(), markers()[KNEE : KNEE + 1]]).transpose(2, 0, 1)
    points[2:4, KNEE] = np.nan
    labels = [f"Ann:{label}" for label in (*LABELS, copy)]
    path = tmp_path / name
    path.write_text(written(points, labels), newline="")
    found = reader_of(path).points(MotionFile(path), DEFAULT_SETTINGS)
    assert any("taken for one marker: LKNE (2 copies)" in warning for warning in found.warnings)
    np.testing.assert_allclose(found.positions[found.names.index("LKNE")], markers()[KNEE], atol=0.01)


def test_markers_of_soma_come_in_as_those_of_a_c3d_file(tmp_path: Path) -> None:
    points = markers()
    points[KNEE, :, 3] = 0.0
    content = {"markers": points.transpose(2, 0, 1), "labels": list(LABELS), "frame_rate": 100.0}
    path = tmp_path / "a.pkl"
    path.write_bytes(pickle.dumps(content, protocol=2))
    assert is_motion_file(path)
    joints = load_feature_set().joints
    found, expected = (
        read_body(each, None, load_mappings("auto", joints), joints)
        for each in (path, write_c3d(tmp_path / "a.c3d", points.astype(np.float64), LABELS))
    )
    assert found.rate_hz == 100.0
    np.testing.assert_allclose(found.positions, expected.positions, atol=1e-5)
    path.write_bytes(pickle.dumps(content | {"labels": list(LABELS[1:])}))
    with pytest.raises(SourceError, match="`labels` must be"):
        read_body(path, None, load_mappings("auto", joints), joints)
