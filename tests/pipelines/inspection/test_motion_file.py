"""Inspect: the report on a file that comes in, and all the more on one that does not."""

from __future__ import annotations

import re
import subprocess
import sys
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageColor
from typer.testing import CliRunner

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.commands.cli import app
from kinedex.ops.errors import KinedexError, SourceError
from kinedex.ops.words import NO_WORD
from kinedex.pipelines.ingestion.analysis import analyse
from kinedex.pipelines.inspection.feature_shares import feature_shares
from kinedex.pipelines.inspection.motion_file import Inspection, inspect_file
from kinedex.pipelines.inspection.stick_figures import LEFT, MIDDLE, RIGHT
from kinedex.reports.stick_figures import write_picture
from kinedex.storage.formats.motion.reader import ReadSettings
from kinedex.storage.formats.motion.reader_table import read_body
from tests.bodies import standing
from tests.bvh_files import bvh_text, dance, mixamo
from tests.c3d_files import LABELS, standing_markers, write_c3d, z_up
from tests.pipelines.archives import write_archive

JOINTS = load_feature_set().joints


def message(found: Inspection, what: str) -> str:
    return " | ".join(text for name, text in found.lines if name == what)


def write_bvh(path: Path, *, frames: int = 40, **changes: str) -> Path:
    text = bvh_text(mixamo(fingers=False), dance(mixamo(fingers=False), frames))
    for old, new in changes.items():
        text = text.replace(old, new)
    path.write_text(text)
    return path


def inks(path: Path, left: float = 0.0, right: float = 1.0) -> dict[str, int]:
    """Count the pixels of each side's colour in a part of a picture."""
    with Image.open(path) as image:
        pixels = np.asarray(image.convert("RGB"))[70:].astype(int)
    part = pixels[:, round(left * pixels.shape[1]) : round(right * pixels.shape[1])]
    return {
        colour: int((np.abs(part - ImageColor.getrgb(colour)).max(axis=2) < 8).sum())
        for colour in (LEFT, RIGHT, MIDDLE)
    }


def test_a_bvh_file_that_comes_in_is_described_and_drawn(tmp_path: Path) -> None:
    found = inspect_file(write_bvh(tmp_path / "wave.bvh"))
    assert found.fault is None
    assert message(found, "format") == "BVH"
    assert message(found, "nodes").startswith("25: mixamorig:Hips, mixamorig:LeftUpLeg")
    assert message(found, "mapping").startswith("mixamo (found by the names of the joints)")
    assert (message(found, "rate"), message(found, "length")) == ("30 Hz", "40 frames, 1.33 s")
    assert message(found, "unit") == "0.01 m (guessed)"
    assert message(found, "height").startswith("1.78 m")
    assert "lfingers (-0.25 lelbow +1.25 lwrist)" in " ".join(text for _, text in found.lines)
    assert "F13 rhand_fast 100%" in message(found, "features on")
    assert "F39" in message(found, "never on")
    assert write_picture(found, tmp_path / "wave.png")
    assert all(count > 300 for count in inks(tmp_path / "wave.png").values())


@pytest.mark.parametrize("frames", [1, 2, 5, 6, 400])
def test_the_picture_shows_the_first_frame_the_last_and_some_between(tmp_path: Path, frames: int) -> None:
    found = inspect_file(write_bvh(tmp_path / "a.bvh", frames=frames))
    assert found.figure is not None
    assert len(found.figure.times) == min(frames, 6)
    assert found.figure.times[0] == "0.00 s (frame 0)"
    assert found.figure.times[-1].endswith(f"(frame {frames - 1})")
    hips = found.figure.points[[1, 5]]  # left, right
    np.testing.assert_allclose(hips[0, 2], hips[1, 2], atol=1e-9)
    assert (hips[0, 0] > hips[1, 0]).all()


def test_the_skeleton_of_an_amc_file_is_found_above_it_up_to_the_source(tmp_path: Path) -> None:
    root = write_archive(tmp_path / "archive", {"a/b/x_1.amc": 30})
    for source in (None, root):
        found = inspect_file(root / "a" / "b" / "x_1.amc", source=source)
        assert found.fault is None
        assert message(found, "skeleton file") == str(root / "x.asf")
        assert message(found, "rate") == "120 Hz (assumed: Acclaim files do not contain it)"
    found = inspect_file(root / "a" / "b" / "x_1.amc", source=root / "a")
    assert "no ASF skeleton whose whole name begins 'x_1'" in str(found.fault)
    assert not write_picture(found, tmp_path / "no.png")
    found = inspect_file(root / "a" / "b" / "x_1.amc", source=tmp_path / "elsewhere")
    assert "does not lie below it" in str(found.fault)
    (root / "x.asf").rename(root / "skeleton.asf")
    found = inspect_file(root / "a" / "b" / "x_1.amc", source=root)
    assert message(found, "skeleton file").startswith(
        f"{root}/skeleton.asf (its skeleton skeleton.asf is taken because"
    )


def test_a_skeleton_that_no_mapping_fits_is_told_all_that_is_missing_and_drawn_as_it_is(tmp_path: Path) -> None:
    changes = {"LeftUpLeg": "ThighL", "RightUpLeg": "ThighR"}
    found = inspect_file(write_bvh(tmp_path / "odd.bvh", **changes), "mixamo")
    assert isinstance(found.fault, SourceError)
    assert message(found, "mapping").startswith("none fits; the nearest is 'mixamo'")
    assert message(found, "") == "lacks LeftUpLeg, for joint 'lhip' | lacks RightUpLeg, for joint 'rhip'"
    assert message(found, "length") == "40 frames, 1.33 s"
    assert write_picture(found, tmp_path / "odd.png")
    assert inks(tmp_path / "odd.png")[MIDDLE] > 1000


def test_a_skeleton_under_other_names_is_recognised_unless_a_mapping_is_given(tmp_path: Path) -> None:
    strange = tmp_path / "strange.bvh"
    text = write_bvh(tmp_path / "own.bvh").read_text()
    names = re.findall(r"(?:ROOT|JOINT) (\S+)", text)
    strange.write_text(re.sub(r"(ROOT|JOINT) (\S+)", lambda found: f"{found[1]} n{names.index(found[2])}", text))
    assert message(inspect_file(strange), "mapping") == "recognised: no mapping fits all these names"
    strange.write_text(re.sub(r"(ROOT|JOINT) (?:mixamorig:)?(\S+)", r"\1 Bob_\2", text))
    found = inspect_file(strange, "bandai")
    assert message(found, "mapping").startswith("none fits; the nearest is 'bandai'")


def test_a_number_out_of_this_world_is_said_and_not_drawn(tmp_path: Path) -> None:
    path = write_bvh(tmp_path / "far.bvh")
    lines = path.read_text().splitlines()
    lines[-1] = "1e200 " + lines[-1].split(" ", 1)[1]
    path.write_text("\n".join(lines))
    found = inspect_file(path)
    assert "km away in source frame 39" in str(found.fault)
    assert not write_picture(found, tmp_path / "far.png")


def test_positions_are_described_with_their_gaps_and_drawn_as_dots_until_they_come_in(tmp_path: Path) -> None:
    track = np.moveaxis(standing(30), 2, 0).copy()
    track[3:5, JOINTS.index("lknee")] = np.nan
    np.savez(tmp_path / "a.npz", positions=track, names=np.array(JOINTS))
    found = inspect_file(tmp_path / "a.npz")
    assert message(found, "length") == "30 frames; the rate is not in the file"
    assert message(found, "gaps") == "1 in 1 points, the longest of 2 frames"
    assert message(found, "mapping").startswith("named-positions")
    assert "give `rate_hz`, or --rate" in str(found.fault)
    assert write_picture(found, tmp_path / "dots.png")
    found = inspect_file(tmp_path / "a.npz", given=ReadSettings(override_rate_hz=30.0, fill_gap_frames=2))
    assert found.fault is None
    assert message(found, "rate") == "30 Hz (given)"
    assert "lknee 2 frames" in message(found, "warnings")


def test_the_rate_of_a_table_is_that_of_its_times(tmp_path: Path) -> None:
    file = tmp_path / "walk.csv"
    names = [f"{joint}_{axis}" for joint in load_feature_set().joints for axis in "xyz"]
    rows = [[f"{row / 50:.4f}", *(str(0.01 * (row + column)) for column in range(len(names)))] for row in range(40)]
    file.write_text("\n".join(",".join(cells) for cells in [["time", *names], *rows]))
    lines = dict(inspect_file(file).lines)
    assert lines["rate"] == "50 Hz (by its column of times)"
    file.write_text("\n".join(",".join(cells[1:]) for cells in [["time", *names], *rows]))
    assert dict(inspect_file(file, given=ReadSettings(rate_hz=60)).lines)["rate"] == "60 Hz (given)"


def test_markers_are_described_and_drawn_in_frames_that_are_whole(tmp_path: Path) -> None:
    points = standing_markers(90)
    points[LABELS.index("LKNE"), :, 30:] = np.nan
    found = inspect_file(write_c3d(tmp_path / "a.c3d", 1000 * z_up(points)))
    assert message(found, "format") == "C3D, markers"
    assert message(found, "nodes").startswith("30: LFWT, ")
    assert message(found, "mapping") == "recognised markers: no mapping fits all these names"
    assert message(found, "gaps") == "1 in 1 points, the longest of 60 frames"
    assert message(found, "valid frames") == "30 of 90; the other frames are invalid"
    assert "LKNE 60 frames" in message(found, "warnings")
    assert found.figure is not None
    assert found.figure.times[-1] == "0.24 s (frame 29)"
    assert write_picture(found, tmp_path / "a.png")
    ink = inks(tmp_path / "a.png")
    assert ink[LEFT] > 500 < ink[RIGHT]
    other = inspect_file(write_c3d(tmp_path / "b.c3d", 1000 * z_up(points[:2]), ("one", "two")))
    assert "no human body is recognised" in str(other.fault)
    assert other.figure is not None
    assert other.figure.views[0][0] == "x to the right, z up"


def test_features_are_counted_as_the_word_of_every_frame_says(tmp_path: Path) -> None:
    path = write_bvh(tmp_path / "wave.bvh", frames=200)
    found = inspect_file(path)
    assert found.features is not None
    body = read_body(path, None, load_mappings("auto", JOINTS), JOINTS)
    _, _, words = analyse(body, load_feature_set(), 30.0)
    for number, row in enumerate(found.features.to_pylist(), 1):
        bits = [bool(int(word) >> (number - 1) & 1) for word in words]
        stretches = [len(list(group)) for holds, group in groupby(bits) if holds]
        assert row["feature"] == f"F{number}"
        assert row["percent"] == pytest.approx(100 * sum(bits) / len(bits))
        assert (row["runs"], row["longest_seconds"]) == (len(stretches), max(stretches, default=0) / 30)
        assert row["remark"] is None


def test_features_that_miss_a_joint_say_which() -> None:
    words = np.array([3, NO_WORD, 1, 2], np.uint64)
    rows = {row["name"]: row for row in feature_shares(words, 30.0, load_feature_set(), ["ltoes"]).to_pylist()}
    assert rows["rhand_forwards"]["percent"] == pytest.approx(200 / 3)
    assert rows["rhand_forwards"]["runs"] == 2
    off = [name for name, row in rows.items() if row["remark"] == "unknown: no ltoes"]
    without = [name for name, row in rows.items() if row["remark"] == "without ltoes"]
    affected = load_feature_set().without(["ltoes"])
    assert off == [feature.name for feature in affected.unknown]
    assert without == [feature.name for feature in affected.narrowed]
    assert off


def test_joint_angles_are_described_with_and_without_a_body_model(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", poses=np.zeros((9, 156)), trans=np.zeros((9, 3)), mocap_framerate=120)
    found = inspect_file(tmp_path / "a.npz")
    assert message(found, "format") == "NPZ, joint angles (AMASS)"
    assert message(found, "mapping").startswith("smpl-amass")
    assert message(found, "figure") == "neutral, 0 numbers of shape"
    assert "give `body_model`" in str(found.fault)


def test_what_is_no_motion_file_is_refused_with_the_way_out(tmp_path: Path) -> None:
    (tmp_path / "a.bip").write_bytes(b"Biped")
    (tmp_path / "a.txt").write_text("hello")
    with pytest.raises(SourceError, match="export it as BVH"):
        inspect_file(tmp_path / "a.bip")
    with pytest.raises(SourceError, match="is not read: kinedex reads"):
        inspect_file(tmp_path / "a.txt")
    with pytest.raises(KinedexError, match="no such file"):
        inspect_file(tmp_path / "b.bvh")
    with pytest.raises(KinedexError, match="is a folder; give a file of it, or read them all: kinedex ingest"):
        inspect_file(tmp_path)


def test_the_command_prints_what_it_knows_first_and_the_fault_last(tmp_path: Path) -> None:
    write_bvh(tmp_path / "odd.bvh", LeftUpLeg="ThighL")
    shown = CliRunner().invoke(
        app, ["inspect", str(write_bvh(tmp_path / "w.bvh")), "--features", "--picture", str(tmp_path / "w.png")]
    )
    assert re.search(r"F13 +rhand_fast +100 +1 +1\.333 +–", shown.stdout)
    command = [
        sys.executable,
        "-m",
        "kinedex.commands.cli",
        "inspect",
        str(tmp_path / "odd.bvh"),
        "--skeleton",
        "mixamo",
        "--picture",
    ]
    done = subprocess.run([*command, str(tmp_path / "o.png")], capture_output=True, text=True, check=False, timeout=240)
    assert done.returncode == 1
    assert "lacks LeftUpLeg, for joint 'lhip'" in done.stdout
    assert str(tmp_path / "o.png") in done.stdout
    assert (tmp_path / "o.png").is_file()
    assert done.stderr.startswith("kinedex: ")
    assert "the skeleton has no 'LeftUpLeg'" in done.stderr
