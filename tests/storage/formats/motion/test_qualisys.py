"""TSV files of Qualisys: with and without heads, frame and time; markers that were not seen, and what is no marker."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.reader import DEFAULT_SETTINGS, MotionFile, ReadSettings
from kinedex.storage.formats.motion.reader_table import is_motion_file, read_body, reader_of
from tests.point_files import JOINTS, qualisys_tsv, walk

ORDER = load_feature_set().joints
AUTO = load_mappings("auto", ORDER)
WALK = walk(8)
AWAY = WALK + np.array([0.5, 0.0, 0.5])  # nothing at 0, 0, 0
EXPECTED = AWAY[:, [JOINTS.index(joint) for joint in ORDER]].transpose(1, 2, 0)


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.mark.parametrize("heads", [True, False])
@pytest.mark.parametrize("leading", [0, 1, 2])
def test_markers_come_in_within_a_tenth_of_a_millimetre(tmp_path: Path, heads: bool, leading: int) -> None:
    path = write(tmp_path / "a.tsv", qualisys_tsv(1000 * AWAY, JOINTS, heads=heads, leading=leading))
    assert is_motion_file(path)
    body = read_body(path, None, AUTO, ORDER)
    assert (body.rate_hz, body.unit, body.warnings) == (100.0, "0.001 m", ())
    np.testing.assert_allclose(body.positions, EXPECTED, atol=1e-4)
    assert reader_of(path).extent(MotionFile(path), 24, DEFAULT_SETTINGS).frames == 8


@pytest.mark.parametrize("missing", ["0.000", "NULL", ""])
def test_markers_that_were_not_seen_are_gaps(tmp_path: Path, missing: str) -> None:
    gap = 1000 * AWAY.copy()
    gap[3:5, 4] = np.nan
    body = read_body(write(tmp_path / "a.tsv", qualisys_tsv(gap, JOINTS, missing=missing)), None, AUTO, ORDER)
    assert any("gaps closed" in warning for warning in body.warnings)
    np.testing.assert_allclose(body.positions, EXPECTED, atol=1e-4)
    left = read_body(tmp_path / "a.tsv", None, AUTO, ORDER, ReadSettings(fill_gap_frames=0))
    assert left.valid is not None
    assert np.flatnonzero(~left.valid).tolist() == [3, 4]


def test_what_is_no_marker_or_wrong_is_refused(tmp_path: Path) -> None:
    text = qualisys_tsv(1000 * AWAY, JOINTS)
    for changed, words in (
        (qualisys_tsv(AWAY, ["Box"], included="6D"), "holds no markers but 6D; export 3D data"),
        (text.replace("FREQUENCY\t100\r\nNO_OF", "NO_OF"), "the header has no FREQUENCY"),
        (text.replace("FREQUENCY\t100\r\nNO_OF", "FREQUENCY\t0\r\nNO_OF"), "FREQUENCY must be"),
        (text.replace("rhip\t", "", 1), "expected 69 coordinates of 23 markers"),
        (text.replace("\r\n3\t", "\r\n4\t"), "14: expected the number of the next frame, 3, got 4"),
        ("\n".join(text.splitlines()[:10]), "no frames"),
    ):
        with pytest.raises(SourceError, match=words):
            read_body(write(tmp_path / "a.tsv", changed), None, AUTO, ORDER)
    shorter = write(tmp_path / "b.tsv", text.replace("NO_OF_FRAMES\t8", "NO_OF_FRAMES\t80"))
    assert "states 80 frames, the file holds 8" in read_body(shorter, None, AUTO, ORDER).warnings[0]


def test_other_tables_are_no_motion_files(tmp_path: Path) -> None:
    for text in ("a\tb\n1\t2\n", "NO_OF_FRAMES,8\n", "1\t2\t3\n", ""):
        assert not is_motion_file(write(tmp_path / "a.tsv", text))
