"""Tests of a source root: its files, the skeleton of each motion, and the metadata in paths."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from kinedex.ops.errors import SourceError, StoreError
from kinedex.storage.formats.motion.sources import SourceFile, path_groups, scan, skeleton_of


def files(*paths: str) -> list[SourceFile]:
    return [SourceFile("/archive", path, 1, 0) for path in paths]


@pytest.mark.parametrize(
    ("motion", "skeletons", "expected"),
    [
        ("a/01_01.amc", ["a/01_01.asf", "a/01.asf"], "a/01_01.asf"),
        ("a/01_01.amc", ["a/01.asf", "a/02.asf"], "a/01.asf"),
        ("clips/kick/HDM_bd_kick_001.amc", ["clips/HDM_bd.asf", "clips/HDM_bk.asf"], "clips/HDM_bd.asf"),
        (
            "clips/kick/HDM_bd_kick_001.amc",
            ["clips/kick/HDM_b.asf", "clips/HDM_bd_kick_001.asf"],
            "clips/kick/HDM_b.asf",
        ),
        ("A/X_01.AMC", ["A/x_01.ASF"], "A/x_01.ASF"),
        ("deep/er/x1.amc", ["x.asf"], "x.asf"),
    ],
)
def test_the_nearest_folder_and_the_longest_common_prefix_win(motion: str, skeletons: list[str], expected: str) -> None:
    assert skeleton_of(files(motion)[0], files(*skeletons)).path == expected


@pytest.mark.parametrize(
    ("motion", "skeletons", "message"),
    [
        (
            "clips/HDM_mm_1.amc",
            ["clips/HDM_bd.asf", "clips/HDM_bk.asf"],
            "equally well: clips/HDM_bd.asf, clips/HDM_bk.asf",
        ),
        ("a/x.amc", ["b/x.asf"], "found none in its folder nor above"),
        ("a/x.amc", ["a/y.asf", "z.asf"], "found only a/y.asf, z.asf; put e.g. 'x.asf' beside it or in a folder above"),
        ("al_001.amc", [], "found none in its folder nor above, up to the source root; put e.g. 'al.asf' beside it"),
    ],
)
def test_none_or_a_tie_names_the_candidates(motion: str, skeletons: list[str], message: str) -> None:
    with pytest.raises(SourceError, match=re.escape(message)) as caught:
        skeleton_of(files(motion)[0], files(*skeletons))
    assert motion in str(caught.value)


def test_a_path_speaks_through_the_first_pattern_that_fits() -> None:
    patterns = [
        re.compile(r"clips/(?P<class>[^/]+)/.*_(?P<clip>\d+)_"),
        re.compile(r"(?P<actor>\d+)_\d+(?P<take>x)?\."),
    ]
    assert path_groups("hdm/clips/kick/HDM_bd_kick_007_120.amc", patterns) == {"class": "kick", "clip": "007"}
    assert path_groups("01/01_05.amc", patterns) == {"actor": "01"}
    assert path_groups("notes.amc", patterns) is None


def test_a_scan_finds_files_in_any_letter_case_and_sees_changes(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    for name in ("b/x.AMC", "a.amc", "b/S.ASF", "b/y.Bvh", "notes.txt"):
        (tmp_path / name).write_text("1")
    found = scan(tmp_path)
    assert [file.path for file in found.motions] == ["a.amc", "b/x.AMC", "b/y.Bvh"]
    assert [file.format for file in found.motions] == ["amc", "amc", "bvh"]
    assert [file.path for file in found.skeletons] == ["b/S.ASF"]
    assert scan(tmp_path).digest == found.digest
    (tmp_path / "a.amc").write_text("22")
    assert scan(tmp_path).digest != found.digest


def test_motion_files_of_other_formats_are_counted_with_the_way_out(tmp_path: Path) -> None:
    for name in ("a.bip", "b.BIP", "c.htr", "d.bvh", "e.png"):
        (tmp_path / name).write_text("1")
    found = scan(tmp_path)
    assert [file.path for file in found.motions] == ["d.bvh"]
    first, second = found.unread_lines()
    assert second.startswith("1 file of a format not read (.htr): ")
    assert first.startswith("2 files of a format not read (.bip): export it as BVH")


def test_a_source_that_is_no_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="is not a folder"):
        scan(tmp_path / "none")
