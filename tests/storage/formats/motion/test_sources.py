"""Tests of a source root: its files, the skeleton of each motion, and the metadata in paths."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from kinedex.ops.errors import SourceError, StoreError
from kinedex.storage.formats.motion.scanned_files import SourceFile
from kinedex.storage.formats.motion.skeleton_files import given_skeleton, skeleton_doubt, skeleton_of
from kinedex.storage.formats.motion.sources import path_groups, scan


def files(*paths: str) -> list[SourceFile]:
    return [SourceFile("/archive", path, 1, 0) for path in paths]


@pytest.mark.parametrize(
    ("motion", "skeletons", "expected"),
    [
        ("a/01_01.amc", ["a/01_01.asf", "a/01.asf"], "a/01_01.asf"),
        ("a/01_01.amc", ["a/01.asf", "a/02.asf"], "a/01.asf"),
        ("01_14.amc", ["01.asf", "01_1.asf", "03.asf"], "01.asf"),
        ("clips/kick/HDM_bd_kick_001.amc", ["clips/HDM_bd.asf", "clips/HDM_bk.asf"], "clips/HDM_bd.asf"),
        ("HDM_bd_01-01_01_120.amc", ["HDM_bd.asf", "HDM_b.asf"], "HDM_bd.asf"),
        ("clips/kick/HDM_bd_kick_001.amc", ["clips/kick/HDM_b.asf", "clips/HDM_bd.asf"], "clips/HDM_bd.asf"),
        ("A/X_01.AMC", ["A/x_01.ASF"], "A/x_01.ASF"),
        ("A/x_01.amc", ["A/X_01.asf", "A/X-01.asf"], "A/X_01.asf"),
        ("deep/er/x1.amc", ["x.asf"], "x.asf"),
        ("JohnWalk2.amc", ["john.asf", "jo.asf"], "john.asf"),
        ("subject12_walk.amc", ["subject1.asf", "Subject12.asf"], "Subject12.asf"),
    ],
)
def test_the_skeleton_whose_whole_name_begins_that_of_the_motion_wins(
    motion: str, skeletons: list[str], expected: str
) -> None:
    found = skeleton_of(files(motion)[0], files(*skeletons))
    assert found.path == expected
    assert skeleton_doubt(Path(motion), Path(found.path)) is None


@pytest.mark.parametrize(
    ("motion", "skeletons", "expected"),
    [
        ("a/walk.amc", ["a/skeleton.asf"], "a/skeleton.asf"),
        ("s1/walks/fast.amc", ["s1/Actor_Skeleton.asf", "s2/skeleton.asf"], "s1/Actor_Skeleton.asf"),
        ("01/walk_3.amc", ["01/01.asf"], "01/01.asf"),
    ],
)
def test_the_only_skeleton_of_a_folder_counts_with_a_warning_if_it_names_nobody_else(
    motion: str, skeletons: list[str], expected: str
) -> None:
    found = skeleton_of(files(motion)[0], files(*skeletons))
    assert found.path == expected
    assert f"its skeleton {Path(expected).name} is taken because there is no other" in str(
        skeleton_doubt(Path(motion), Path(found.path))
    )


@pytest.mark.parametrize(
    ("motion", "skeletons", "message"),
    [
        ("01_14.amc", ["03.asf"], "begins '01_14': found only 03.asf; put e.g. '01.asf' beside it, or if it is one of"),
        ("01_14.amc", ["0.asf", "01_1.asf"], "found only 0.asf, 01_1.asf"),
        (
            "clips/HDM_mm_1.amc",
            ["clips/HDM_bd.asf", "clips/HDM_bk.asf"],
            "found only clips/HDM_bd.asf, clips/HDM_bk.asf",
        ),
        ("01/02_05.amc", ["01/01.asf"], "found only 01/01.asf"),
        ("walk.amc", ["skeleton.asf", "actor.asf"], "found only skeleton.asf, actor.asf"),
        ("walk.amc", ["subject7.asf"], "found only subject7.asf"),
        ("x_1.amc", ["X.asf", "x.asf"], "equally well: X.asf, x.asf"),
        ("a/x.amc", ["b/x.asf"], "found none in its folder nor above"),
        ("a/x.amc", ["a/y.asf", "z.asf"], "found only a/y.asf, z.asf; put e.g. 'x.asf' beside it or in a folder above"),
        ("al_001.amc", [], "found none in its folder nor above, up to the source root; put e.g. 'al.asf' beside it"),
    ],
)
def test_a_strangers_skeleton_is_refused_with_the_candidates(motion: str, skeletons: list[str], message: str) -> None:
    with pytest.raises(SourceError, match=re.escape(message)) as caught:
        skeleton_of(files(motion)[0], files(*skeletons))
    assert motion in str(caught.value)


def test_a_setting_gives_a_skeleton_by_path_or_by_name() -> None:
    skeletons = files("a/03.asf", "b/03.asf", "b/04.asf")
    motion = files("b/walk_1.amc")[0]
    for given, expected in (
        ({"b/walk_*.amc": "a/03.asf"}, "a/03.asf"),
        ({"walk_?.amc": "04.asf", "*": "a/03.asf"}, "b/04.asf"),
        ({"run_*.amc": "04.asf"}, None),
    ):
        found = given_skeleton(motion, skeletons, given)
        assert (found and found.path) == expected
    with pytest.raises(
        SourceError, match=re.escape("'05.asf', but the source has no such skeleton: it has a/03.asf, ")
    ):
        given_skeleton(motion, skeletons, {"*": "05.asf"})
    with pytest.raises(SourceError, match=r"several skeletons have this name: it has a/03\.asf, b/03\.asf"):
        given_skeleton(motion, skeletons, {"*": "03.asf"})


def test_all_real_motions_find_their_skeletons_without_a_doubt(shared: Path) -> None:
    for archive in ("hdm05", "cmu"):
        found = scan(shared / "data" / archive)
        motions = [motion for motion in found.motions if motion.format == "amc"]
        assert motions
        for motion in motions:
            skeleton, doubts = found.chosen_skeleton(motion, {})
            assert motion.stem.startswith(f"{skeleton.stem}_")
            assert not doubts


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
