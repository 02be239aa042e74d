"""`kinedex mapping new`: mappings that read back to the same joints, and proposals for files that are refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import OwnFile, load_mappings, load_skeleton, with_own
from kinedex.catalog.skeletons.recognition.landmarks import load_landmarks
from kinedex.catalog.skeletons.recognition.named_points import nodes_of_landmarks
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.inspection.mapping_proposal import propose_mapping
from kinedex.storage.formats.motion.reader import Body, MotionFile
from kinedex.storage.formats.motion.reader_table import persons_of, read_body
from tests.bvh_files import bvh_text, dance, mixamo
from tests.c3d_files import LABELS, standing_markers, write_c3d, z_up
from tests.commands.test_cli import kinedex
from tests.pipelines.archives import write_archive

JOINTS = load_feature_set().joints
AUTO = load_mappings("auto", JOINTS)


def reread(path: Path, file: Path, text: str, person: str = "") -> tuple[Body, Body]:
    """Return the body of a file as it is detected, and with the mapping that was written."""
    path.write_text(text)
    own = load_mappings(str(path), JOINTS)
    return (
        read_body(file, None, AUTO, JOINTS, person=person),
        read_body(file, None, own, JOINTS, person=person),
    )


def same(first: Body, second: Body) -> bool:
    close = np.allclose(first.positions, second.positions, atol=1e-5, equal_nan=True)
    return close and first.unknown == second.unknown


def unknown_names(path: Path) -> Path:
    """Write a BVH file that recognition knows by its structure, and no mapping by its names."""
    text = bvh_text(mixamo(fingers=False), dance(mixamo(fingers=False), 40))
    for old, new in {"mixamorig:": "Rig_", "UpLeg": "Thigh", "ForeArm": "LowerArm", "Hips": "Pelvis"}.items():
        text = text.replace(old, new)
    path.write_text(text)
    return path


def test_a_recognised_tree_reads_back_as_it_was_recognised(tmp_path: Path) -> None:
    file = unknown_names(tmp_path / "a.bvh")
    text = propose_mapping(file, "rig")
    first, second = reread(tmp_path / "rig.yaml", file, text)
    assert first.confidence < 1.0
    assert same(first, second)
    assert second.skeleton == "rig"
    assert text.startswith("# A skeleton mapping for files like a.bvh.")
    assert "# Recognised with a confidence of" in text


def test_markers_read_back_as_they_were_recognised(tmp_path: Path) -> None:
    labels = ["Ann:" + label for label in LABELS]
    file = write_c3d(tmp_path / "a.c3d", 1000 * z_up(standing_markers(40)), tuple(labels))
    first, second = reread(tmp_path / "own.yaml", file, propose_mapping(file, "own"))
    assert same(first, second)
    other = write_c3d(tmp_path / "b.c3d", 1000 * z_up(standing_markers(40)), tuple("Bob:" + label for label in LABELS))
    assert same(first, read_body(other, None, load_mappings(str(tmp_path / "own.yaml"), JOINTS), JOINTS))


def test_a_file_that_fits_gets_a_copy_of_its_mapping(tmp_path: Path) -> None:
    file = tmp_path / "a.bvh"
    file.write_text(bvh_text(mixamo(), dance(mixamo(), 20)))
    text = propose_mapping(file, "ours")
    assert "# A copy of the mapping 'mixamo'." in text
    assert same(*reread(tmp_path / "ours.yaml", file, text))


def test_a_file_that_is_refused_gets_a_proposal_that_loads(tmp_path: Path) -> None:
    points = 1000 * z_up(standing_markers(40)[:12])
    file = write_c3d(tmp_path / "a.c3d", points, tuple(f"M{i}" for i in range(12)))
    with pytest.raises(KinedexError, match="kinedex mapping new"):
        read_body(file, None, AUTO, JOINTS)
    (tmp_path / "own.yaml").write_text(text := propose_mapping(file, "own"))
    assert "# Without it, the file is refused: " in text
    assert "null  # not found" in text
    assert load_skeleton(tmp_path / "own.yaml", JOINTS).name == "own"


def test_an_acclaim_skeleton_of_other_names_gets_the_nearest_mapping(tmp_path: Path) -> None:
    source = write_archive(tmp_path / "source", {"x_1.amc": 9})
    for file in source.iterdir():
        file.write_text(file.read_text().replace("lfemur", "lthigh"))
    text = propose_mapping(source / "x_1.amc", "ours")
    assert "# The file has no 'lfemur', for joint" in text
    assert "lthigh" in text
    (tmp_path / "ours.yaml").write_text(text.replace("lfemur", "lthigh"))
    own = load_mappings(str(tmp_path / "ours.yaml"), JOINTS)
    assert read_body(source / "x_1.amc", source / "x.asf", own, JOINTS).skeleton == "ours"


def test_the_command_writes_a_file_and_overwrites_none(tmp_path: Path) -> None:
    file, own = unknown_names(tmp_path / "a.bvh"), tmp_path / "my own.yaml"
    assert kinedex("mapping", "new", file, "-o", own).returncode == 0
    assert load_skeleton(own, JOINTS).name == "my own"
    ended = kinedex("mapping", "new", file, "-o", own)
    assert ended.returncode == 1
    assert "exists already" in ended.stderr
    assert kinedex("mapping", "new", file, "-o", own, "--force").returncode == 0
    assert kinedex("inspect", file, "--skeleton", own, "--picture", tmp_path / "a.png").returncode == 0


def test_a_damaged_file_gets_none(tmp_path: Path) -> None:
    file = tmp_path / "a.bvh"
    file.write_text("HIERARCHY\nROOT")
    with pytest.raises(KinedexError, match=r"a\.bvh"):
        propose_mapping(file, "x")


def nonsense(folder: Path) -> tuple[Path, dict[str, str], Body]:
    """Return a trial whose labels say nothing, the landmark of each, and the body by the labels of its marker set."""
    points = 1000 * z_up(standing_markers(40))
    body = read_body(write_c3d(folder / "known.c3d", points, tuple(LABELS)), None, AUTO, JOINTS)
    landmarks = nodes_of_landmarks(load_landmarks().read(LABELS))
    nonsense = {label: f"X{i:02d}q" for i, label in enumerate(LABELS)}
    file = write_c3d(folder / "x.c3d", points, tuple(nonsense.values()))
    return file, {nonsense[label]: name for label, name in landmarks.items()}, body


def test_markers_that_a_person_names_make_the_body_that_their_labels_make(tmp_path: Path) -> None:
    file, named, body = nonsense(tmp_path)
    with pytest.raises(KinedexError, match=r"0 of \d+ labels are known"):
        read_body(file, None, AUTO, JOINTS)
    (tmp_path / "own.yaml").write_text(propose_mapping(file, "own", named=named))
    found = read_body(file, None, load_mappings(str(tmp_path / "own.yaml"), JOINTS), JOINTS)
    assert same(body, found)
    assert set(found.estimated) == set(body.estimated)
    assert [one for one in found.warnings if "estimated" in one] == [one for one in body.warnings if "estimated" in one]


def test_a_marker_named_as_a_joint_is_where_the_joint_is(tmp_path: Path) -> None:
    file, named, _ = nonsense(tmp_path)
    elbow = next(label for label, name in named.items() if name == "lelbowlat")
    text = propose_mapping(file, "own", named=named | {elbow: "lelbow"})
    assert f"\n  lelbow: {elbow}\n" in text
    assert "\n  lelbow:" not in text[text.index("estimated:") :]


def test_a_node_of_a_tree_that_a_person_names_is_that_joint(tmp_path: Path) -> None:
    file = unknown_names(tmp_path / "a.bvh")
    first = read_body(file, None, AUTO, JOINTS)
    text = propose_mapping(file, "rig", named={"Rig_LeftHand": "none", "Rig_LeftLowerArm": "lwrist"})
    (tmp_path / "rig.yaml").write_text(text)
    second = read_body(file, None, load_mappings(str(tmp_path / "rig.yaml"), JOINTS), JOINTS)
    wrist, elbow = JOINTS.index("lwrist"), JOINTS.index("lelbow")
    assert np.allclose(second.positions[wrist], first.positions[elbow])
    assert "lelbow" in second.unknown
    assert np.allclose(second.positions[JOINTS.index("rwrist")], first.positions[JOINTS.index("rwrist")])


@pytest.mark.parametrize(
    ("named", "error"),
    [
        ({"Marker": "lelbow"}, "no node 'Marker'"),
        ({"X00q": "lelbw"}, "there is no joint or landmark 'lelbw'; did you mean"),
        ({"X00q": "lelbow", "X01q": "lelbow"}, "'X00q' and 'X01q' are both named 'lelbow'"),
    ],
)
def test_a_name_that_cannot_be_is_refused(tmp_path: Path, named: dict[str, str], error: str) -> None:
    file, _, _ = nonsense(tmp_path)
    with pytest.raises(KinedexError, match=error):
        propose_mapping(file, "own", named=named)


def test_a_mapping_may_be_for_files_of_some_names_alone(tmp_path: Path) -> None:
    file, named, _ = nonsense(tmp_path)
    other = tmp_path / "other.c3d"
    other.write_bytes(file.read_bytes())
    text = propose_mapping(file, "one", named=named, only=r"^x\.c3d$")
    general = propose_mapping(file, "all", named=named)
    own = with_own(AUTO, [OwnFile(tmp_path / "one.yaml", text)], JOINTS)
    assert read_body(file, None, own, JOINTS).skeleton == "one"
    with pytest.raises(KinedexError, match="kinedex mapping new"):
        read_body(other, None, own, JOINTS)
    both = with_own(AUTO, [OwnFile(tmp_path / "one.yaml", text), OwnFile(tmp_path / "all.yaml", general)], JOINTS)
    assert read_body(file, None, both, JOINTS).skeleton == "one"
    assert read_body(other, None, both, JOINTS).skeleton == "all"


def test_a_copy_of_a_mapping_can_be_for_some_files_alone(tmp_path: Path) -> None:
    file = tmp_path / "a.bvh"
    file.write_text(bvh_text(mixamo(), dance(mixamo(), 20)))
    (tmp_path / "ours.yaml").write_text(propose_mapping(file, "ours", only=r"^a\.bvh$"))
    assert load_skeleton(tmp_path / "ours.yaml", JOINTS).only == r"^a\.bvh$"
    with pytest.raises(KinedexError, match="is no regular expression"):
        propose_mapping(file, "ours", only="(")


def test_the_commands_list_nodes_and_take_their_names(tmp_path: Path) -> None:
    file, named, body = nonsense(tmp_path)
    listed = json.loads(kinedex("mapping", "nodes", file, "--json").stdout)
    assert "no human body" in listed["refused"]
    assert {one["node"] for one in listed["nodes"]} >= named.keys()
    assert {one["reason"] for one in listed["nodes"]} == {"no known name"}
    assert {*named.values()} <= {*listed["names"]}
    words = [word for node, name in named.items() for word in ("--name", f"{node}={name}")]
    ended = kinedex("mapping", "new", file, "-o", tmp_path / "own.yaml", *words)
    assert ended.returncode == 0, ended.stderr
    found = read_body(file, None, load_mappings(str(tmp_path / "own.yaml"), JOINTS), JOINTS)
    assert same(body, found)
    assert "NODE=JOINT" in kinedex("mapping", "new", file, "-o", tmp_path / "b.yaml", "--name", "X").stderr


@pytest.mark.shared
def test_files_of_the_wild_read_back_as_they_were_recognised(shared: Path, tmp_path: Path) -> None:
    files = sorted(path for path in (shared / "data/wild").rglob("*.bvh") if path.stat().st_size < 400_000)
    assert len(files) > 5
    for file in files[::2]:
        person = next(iter(persons_of(MotionFile(file), AUTO)), "")
        text = propose_mapping(file, "own", person)
        try:
            read_body(file, None, AUTO, JOINTS, person=person)
        except KinedexError:
            continue
        assert same(*reread(tmp_path / "own.yaml", file, text, person)), file
