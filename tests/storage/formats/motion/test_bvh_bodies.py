"""Bodies from BVH files: named joints in metres with Y up, whatever the skeleton, its axes, its unit and its gaps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings, load_skeleton
from kinedex.ops.body import features, kinematics
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion import bvh, mapped_body, text_blocks
from kinedex.storage.formats.motion.bvh_parser import BvhFile
from kinedex.storage.formats.motion.reader import Body, MotionFile, ReadSettings
from kinedex.storage.formats.motion.reader_table import read_body, reader_of
from tests.bvh_files import POSITIONS, Joint, bvh_text, dance, mixamo, still
from tests.oracles import bvh as oracle

JOINTS = load_feature_set().joints
AUTO = load_mappings("auto", JOINTS)


def write(path: Path, root: Joint, frames: list[dict[str, list[float]]]) -> Path:
    path.write_text(bvh_text(root, frames))
    return path


def read(tmp_path: Path, root: Joint, frames: list[dict[str, list[float]]]) -> Body:
    return read_body(write(tmp_path / "a.bvh", root, frames), None, AUTO, JOINTS)


def joint(body: Body, name: str) -> np.ndarray:
    return body.positions[JOINTS.index(name)]


def test_named_joints_are_where_the_skeleton_s_own_are(tmp_path: Path) -> None:
    root = mixamo()
    frames = dance(root, 40)
    body = read(tmp_path, root, frames)
    names = {"lwrist": "LeftHand", "rknee": "RightLeg", "headtop": "HeadTop_End", "lfingers": "LeftHandMiddle1"}
    for t in (0, 17, 39):
        expected, _ = oracle.pose(root, frames[t])
        for name, node in names.items():
            np.testing.assert_allclose(joint(body, name)[:, t], 0.01 * expected["mixamorig:" + node], atol=1e-9)
    assert (body.skeleton, body.rate_hz, body.frames, body.unknown) == ("mixamo", 30.0, 40, ())


def test_a_take_is_worked_on_in_stretches_without_a_seam(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = mixamo()
    path = write(tmp_path / "a.bvh", root, dance(root, 400))
    whole = read_body(path, None, AUTO, JOINTS)
    monkeypatch.setattr(mapped_body, "_BLOCK_SIZE", 1)
    parts = read_body(path, None, AUTO, JOINTS)
    np.testing.assert_array_equal(parts.positions, whole.positions)
    np.testing.assert_array_equal(parts.orientation, whole.orientation)


def test_a_body_is_recognised_from_single_frames_of_a_long_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = mixamo(prefix="")
    path = tmp_path / "a.bvh"
    text = bvh_text(root, dance(root, 90)).replace("LeftUpLeg", "left_thigh").replace("RightUpLeg", "right_thigh")
    path.write_text(text)
    whole = read_body(path, None, AUTO, JOINTS)
    assert whole.skeleton == "recognised"
    monkeypatch.setattr(bvh, "_KEPT_BYTES", 0)
    monkeypatch.setattr(text_blocks, "BLOCK", 5000)
    long = read_body(path, None, AUTO, JOINTS)
    np.testing.assert_array_equal(long.positions, whole.positions)
    assert (long.warnings, long.evidence) == (whole.warnings, whole.evidence)
    # the first fault of the file is reported, be it in a frame that is looked at or in another one before it
    lines = text.splitlines(keepends=True)
    first = next(i for i, line in enumerate(lines) if line.startswith("Frame Time")) + 1
    for bad in ((0, 30), (7, 89), (41, 44)):
        damaged = [line.replace(" ", " x", 1) if at - first in bad else line for at, line in enumerate(lines)]
        path.write_text("".join(damaged).replace("left_thigh", "one") if bad[0] == 7 else "".join(damaged))
        with pytest.raises(SourceError, match=f"a.bvh:{first + bad[0] + 1}: not a number: 'x"):
            read_body(path, None, AUTO, JOINTS)


def test_files_with_the_same_hierarchy_share_it_and_others_do_not(tmp_path: Path) -> None:
    root = mixamo()
    texts = [bvh_text(root, dance(root, 3, seed)) for seed in range(2)]
    comment = texts[0].replace("HIERARCHY\n", "HIERARCHY\n# MOTION \n", 1)
    damaged = texts[0].replace("OFFSET", "OFSET", 1)
    files = []
    for i, text in enumerate([*texts, comment, texts[0].replace("Spine", "Rachis")]):
        path = tmp_path / f"{i}.bvh"
        path.write_text(text)
        files.append(BvhFile(path))
    assert files[0].nodes is files[1].nodes
    for other in files[2:]:
        assert other.nodes is not files[0].nodes
    assert [node.name for node in files[2].nodes] == [node.name for node in files[0].nodes]
    assert any(node.name.endswith("Rachis") for node in files[3].nodes)
    for name in ("a", "b"):
        (tmp_path / f"{name}.bvh").write_text(damaged)
        with pytest.raises(SourceError, match=rf"{name}\.bvh:4: expected OFFSET, CHANNELS"):
            BvhFile(tmp_path / f"{name}.bvh")


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "cm"), (0.01, "metres"), (10.0, "mm"), (1 / 2.54, "inches")])
def test_a_guessed_unit_is_said_and_gives_the_same_body(tmp_path: Path, scale: float, unit: str) -> None:
    body = read(tmp_path, mixamo(scale=scale), still(mixamo(scale=scale), 1))
    assert joint(body, "headtop")[1, 0] == pytest.approx(1.8, abs=0.01)
    assert body.unit.endswith("m (guessed)")
    assert not body.warnings
    assert body.evidence[-1] == f"its unit of length is guessed: {unit}, which makes the body 1.78 m high"


def test_a_body_of_a_giant_asks_for_its_unit(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="state `unit_m` in the skeleton mapping"):
        read(tmp_path, mixamo(scale=100.0), still(mixamo(scale=100.0), 1))


def test_limbs_without_ends_are_followed_past_them_and_that_is_said(tmp_path: Path) -> None:
    root = mixamo(fingers=False, ends=False)
    body = read(tmp_path, root, dance(root, 3))
    forearm = joint(body, "lwrist") - joint(body, "lelbow")
    np.testing.assert_allclose(joint(body, "lfingers"), joint(body, "lwrist") + 0.25 * forearm)
    assert body.evidence[0] == (
        "joints that the skeleton lacks are built from others: headtop (-2 neck +3 head), "
        "lfingers (-0.25 lelbow +1.25 lwrist), rfingers (-0.25 relbow +1.25 rwrist)"
    )


def bandai() -> Joint:
    """A standing body whose bones lie along their own X axes, with six channels at every joint."""

    def chain(*names: str, step: tuple[float, float, float]) -> Joint:
        below = [chain(*names[1:], step=step)] if len(names) > 1 else []
        return Joint(names[0], step, (*POSITIONS, "Zrotation", "Xrotation", "Yrotation"), below)

    legs = [
        chain(f"UpperLeg_{s}", f"LowerLeg_{s}", f"Foot_{s}", f"Toes_{s}", step=(-40, y, 3))
        for s, y in (("L", -9), ("R", 9))
    ]
    for leg, y in zip(legs, (-9, 9), strict=True):
        leg.offset = (-5, y, 0)
    arms = [
        chain(f"Shoulder_{s}", f"UpperArm_{s}", f"LowerArm_{s}", f"Hand_{s}", step=(0, y, 0))
        for s, y in (("L", -20), ("R", 20))
    ]
    neck = chain("Neck", "Head", step=(8, 0, 0))
    spine = chain("Spine", "Chest", step=(15, 0, 0))
    spine.children[0].children = [neck, *arms]
    hips = Joint("Hips", (0, 90, 0), (*POSITIONS, "Zrotation", "Xrotation", "Yrotation"), [spine, *legs])
    return Joint("joint_Root", (0, 0, 0), (*POSITIONS, "Zrotation", "Xrotation", "Yrotation"), [hips])


def test_the_root_turns_as_the_body_does_and_not_as_its_bones_lie(tmp_path: Path) -> None:
    root = bandai()
    frames = still(root, 25)
    for t, frame in enumerate(frames):
        # Upright, the X axis of the Hips up; and a turn about the vertical of 3 degrees a frame, 90 a second.
        frame["joint_Root"][3:] = [0.0, 0.0, 3.0 * t]
        frame["Hips"][3:] = [90.0, 0.0, 0.0]
    body = read(tmp_path, root, frames)
    assert body.skeleton == "bandai"
    np.testing.assert_allclose(np.abs(body.orientation[:, 0]), [1, 0, 0, 0], atol=1e-9)
    half = np.deg2rad(3.0 * np.arange(25)) / 2
    np.testing.assert_allclose(body.orientation[0], np.cos(half), atol=1e-9)
    np.testing.assert_allclose(np.abs(body.orientation[2]), np.sin(half), atol=1e-9)
    np.testing.assert_allclose(joint(body, "lhip")[:, 0] - joint(body, "rhip")[:, 0], [0.18, 0, 0], atol=1e-9)
    assert joint(body, "head")[1, 0] > joint(body, "root")[1, 0] + 0.3
    feature_set = load_feature_set()
    words = features.words(body.positions, body.orientation, 30.0, feature_set.rules)
    turning = (words >> np.uint64(feature_set.feature("root_turning").number - 1)) & np.uint64(1)
    assert not turning.any()  # weak above 50, strong above 100 degrees a second
    for frame, t in zip(frames, range(25), strict=True):
        frame["joint_Root"][5] = 4.0 * t
    body = read(tmp_path, root, frames)
    words = features.words(body.positions, body.orientation, 30.0, feature_set.rules)
    turning = (words >> np.uint64(feature_set.feature("root_turning").number - 1)) & np.uint64(1)
    assert turning[:-1].all()


def cmu(thorax: bool) -> Joint:
    """The conversion's skeleton with the bones that it leaves out, or without them."""
    names = load_skeleton("cmu-bvh", JOINTS)
    assert set(names.bones) == {"Neck", "LeftShoulder", "RightShoulder", "LeftFingerBase", "RightFingerBase"}
    lost = (0.0, 2.1, 0.15) if thorax else (0.0, 0.0, 0.0)

    def arm(side: str, sign: float) -> Joint:
        fingers = Joint(f"{side[0]}Fingers", (0.7 * sign, 0, 0), ends=[(0.6 * sign, 0, 0)])
        wrist = (1.75 * sign, 0.0, 0.0) if thorax else (0.0, 0.0, 0.0)
        hand = Joint(
            f"{side}Hand", (3.5 * sign, 0, 0), children=[Joint(f"{side}FingerBase", wrist, children=[fingers])]
        )
        upper = Joint(
            f"{side}Arm", (3.4 * sign, 1.2, 0), children=[Joint(f"{side}ForeArm", (5 * sign, 0, 0), children=[hand])]
        )
        return Joint(f"{side}Shoulder", lost, children=[upper])

    def leg(side: str, sign: float) -> Joint:
        toes = Joint(f"{side}ToeBase", (0, -0.4, 2.3), ends=[(0, 0, 1.2)])
        shin = Joint(
            f"{side}Leg", (2.5 * sign, -6.7, 0), children=[Joint(f"{side}Foot", (2.5 * sign, -7, 0), children=[toes])]
        )
        return Joint(f"{side[0]}HipJoint", children=[Joint(f"{side}UpLeg", (1.3 * sign, -1.8, 0.8), children=[shin])])

    neck = Joint(
        "Neck",
        lost,
        children=[Joint("Neck1", (0, 1.7, 0.2), children=[Joint("Head", (0, 1.8, -0.1), ends=[(0, 1.8, 0)])])],
    )
    chest = Joint("Spine1", (0, 2.1, 0.05), children=[neck, arm("Left", 1), arm("Right", -1)])
    spine = Joint("LowerBack", children=[Joint("Spine", (0, 2.1, -0.15), children=[chest])])
    return Joint(
        "Hips",
        (0, 18, 0),
        (*POSITIONS, "Zrotation", "Yrotation", "Xrotation"),
        [leg("Left", 1), leg("Right", -1), spine],
    )


def test_bones_that_a_conversion_leaves_out_are_given_back_and_that_is_said(tmp_path: Path) -> None:
    frames = dance(cmu(thorax=True), 8)
    whole, lossy = read(tmp_path, cmu(thorax=True), frames), read(tmp_path, cmu(thorax=False), frames)
    np.testing.assert_allclose(lossy.positions, whole.positions, atol=1e-9)
    assert lossy.warnings[0] == (
        "bones Neck, LeftShoulder, RightShoulder, LeftFingerBase, RightFingerBase have no length in the file; mapping "
        "'cmu-bvh' gives them one"
    )
    assert not any("bones" in warning for warning in whole.warnings)


def own_mapping(tmp_path: Path, old: str, new: str) -> str:
    path = tmp_path / "own.yaml"
    path.write_text(load_skeleton("mixamo", JOINTS).path.read_text().replace(old, new))
    return str(path)


def test_joints_that_a_skeleton_does_not_have_are_unknown_everywhere(tmp_path: Path) -> None:
    own = own_mapping(tmp_path, "  belly: Spine1", "  belly: null")
    path = write(tmp_path / "a.bvh", mixamo(), dance(mixamo(), 3))
    body = read_body(path, None, load_mappings(own, JOINTS), JOINTS)
    assert body.unknown == ("belly",)
    assert np.isnan(joint(body, "belly")).all()
    assert np.isfinite(np.delete(body.positions, JOINTS.index("belly"), axis=0)).all()
    rootless = own_mapping(tmp_path, "  root: Hips", "  root: null")
    assert np.isnan(read_body(path, None, load_mappings(rootless, JOINTS), JOINTS).orientation).all()


def test_a_number_out_of_this_world_is_refused_with_joint_and_frame(tmp_path: Path) -> None:
    frames = still(mixamo(), 4)
    frames[2]["mixamorig:Hips"][1] = 1e200
    with pytest.raises(SourceError, match="joint 'root' is more than 100 km away in source frame 2"):
        read(tmp_path, mixamo(), frames)
    frames[2]["mixamorig:Hips"][1] = 1e308
    with pytest.raises(SourceError, match="in source frame 2"):
        read(tmp_path, mixamo(), frames)


def test_the_ending_of_a_file_tells_its_format_in_any_letter_case(tmp_path: Path) -> None:
    path = write(tmp_path / "A.BVH", mixamo(), still(mixamo()))
    assert read_body(path, None, AUTO, JOINTS).rate_hz == 30.0
    with pytest.raises(SourceError, match="is read with its ASF skeleton"):
        read_body(tmp_path / "a.amc", None, AUTO, JOINTS)


def test_a_rate_that_is_given_counts_in_place_of_the_file_s_and_that_is_said(tmp_path: Path) -> None:
    path = write(tmp_path / "a.bvh", mixamo(), still(mixamo()))
    body = read_body(path, None, AUTO, JOINTS, ReadSettings(rate_hz=50.0, override_rate_hz=60.0))
    assert body.rate_hz == 60.0
    assert "the file states 30 Hz; it is read at 60 Hz, which was given" in body.warnings
    for given in (ReadSettings(rate_hz=50.0), ReadSettings(override_rate_hz=30.0)):
        same = read_body(path, None, AUTO, JOINTS, given)
        assert same.rate_hz == 30.0
        assert not any("Hz" in warning for warning in same.warnings)


def turned(joint: Joint) -> Joint:
    """The same joints with Z up, as exports of Blender have them: X stays, Y becomes Z, and Z becomes -Y."""
    x, y, z = joint.offset
    ends = [(a, -c, b) for a, b, c in joint.ends]
    return Joint(joint.name, (x, -z, y), joint.channels, [turned(child) for child in joint.children], ends)


def z_up(frames: list[dict[str, list[float]]]) -> list[dict[str, list[float]]]:
    """Standing frames whose root's place is that with Z up."""
    found = []
    for frame in frames:
        moved = dict(frame)
        x, y, z = frame["mixamorig:Hips"][:3]
        moved["mixamorig:Hips"] = [x, -z, y, *frame["mixamorig:Hips"][3:]]
        found.append(moved)
    return found


def test_a_file_with_z_up_stands_where_the_one_with_y_up_does(tmp_path: Path) -> None:
    frames = still(mixamo(), 20)
    upright = read(tmp_path, mixamo(), frames)
    exported = read(tmp_path, turned(mixamo()), z_up(frames))
    assert exported.skeleton == "mixamo"
    assert exported.evidence[0].startswith("z is up in this file, not the axis of mapping 'mixamo': ")
    np.testing.assert_allclose(exported.positions[:, 1], upright.positions[:, 1], atol=1e-9)
    sideways = exported.positions[:, :, 0] - exported.positions[:1, :, 0]
    across = np.linalg.norm(sideways[:, [0, 2]], axis=1)
    expected = upright.positions[:, :, 0] - upright.positions[:1, :, 0]
    np.testing.assert_allclose(across, np.linalg.norm(expected[:, [0, 2]], axis=1), atol=1e-9)


def test_the_axis_that_a_mapping_of_the_user_states_counts(tmp_path: Path) -> None:
    path = write(tmp_path / "a.bvh", turned(mixamo()), z_up(still(mixamo(), 20)))
    own = load_mappings(own_mapping(tmp_path, "name: mixamo", "name: own"), JOINTS)
    body = read_body(path, None, own, JOINTS)
    assert [line for line in body.evidence if "is up" in line] == []
    assert joint(body, "head")[1, 0] == pytest.approx(joint(body, "root")[1, 0], abs=0.2)


def test_each_root_of_a_file_is_a_person(tmp_path: Path) -> None:
    first, second = mixamo("Ann:"), mixamo("Bob:", scale=0.9)
    frames = [one | other for one, other in zip(dance(first, 12), dance(second, 12, seed=1), strict=True)]
    text = bvh_text(first, frames)
    other = bvh_text(second, frames)
    hierarchy = other[other.index("ROOT") : other.index("MOTION")]
    rows = [f"{a} {b}" for a, b in zip(text.splitlines()[-12:], other.splitlines()[-12:], strict=True)]
    head = text[: text.index("MOTION")] + hierarchy + text[text.index("MOTION") : text.index("Frame Time")]
    path = tmp_path / "two.bvh"
    path.write_text("\n".join([head + "Frame Time: 0.0333333", *rows, ""]))
    reader = reader_of(path)
    assert reader.persons(MotionFile(path), AUTO) == ("Ann", "Bob")
    for person, root, seed in (("Ann", first, 0), ("Bob", second, 1)):
        alone = read(tmp_path, root, dance(root, 12, seed))
        body = reader.read(MotionFile(path, person=person), AUTO, JOINTS, ReadSettings())
        np.testing.assert_allclose(body.positions, alone.positions, atol=1e-12)
    with pytest.raises(SourceError, match="holds 2 figures or clips: 'Ann', 'Bob'"):
        reader.read(MotionFile(path), AUTO, JOINTS, ReadSettings())


def test_a_spine_longer_than_mixamos_is_divided_by_its_length(tmp_path: Path) -> None:
    root = mixamo()
    chest = root.children[2].children[0].children[0]
    lower = Joint("mixamorig:Spine3", (0, 13, 0), chest.channels, chest.children)
    chest.children = [lower]
    body = read(tmp_path, root, still(root, 5))
    assert body.skeleton == "recognised"
    heights = [joint(body, name)[1, 0] for name in ("root", "belly", "chest", "neck")]
    np.testing.assert_allclose(np.diff(heights), 0.01 * (10 + 12 + 13 + 13 + 16) / 3, atol=1e-4)


def test_positions_beside_an_offset_are_added_to_it_where_they_are_nothing(tmp_path: Path) -> None:
    plain, beside = mixamo(), mixamo()
    for part in beside.all()[1:]:
        part.channels = (*POSITIONS, *part.channels)
    frames = dance(plain, 6)
    added = [
        {name: (numbers if name == "mixamorig:Hips" else [0.0, 0.0, 0.0, *numbers]) for name, numbers in frame.items()}
        for frame in frames
    ]
    np.testing.assert_allclose(read(tmp_path, beside, added).positions, read(tmp_path, plain, frames).positions)


def test_a_frame_time_of_one_second_gives_way_to_the_likely_rate(tmp_path: Path) -> None:
    root = mixamo()
    path = tmp_path / "a.bvh"
    path.write_text(bvh_text(root, dance(root, 400), frame_time="1.0"))
    body = read_body(path, None, AUTO, JOINTS)
    assert body.rate_hz > 5
    assert any("its rate is wrong: it states 1 Hz" in warning for warning in body.warnings)


def test_wild_files_come_in_upright_and_of_human_height_or_are_no_human(shared: Path) -> None:
    refused = []
    for path in sorted((shared / "data" / "wild").rglob("*.bvh")):
        try:
            body = read_body(path, None, AUTO, JOINTS)
        except SourceError as fault:
            refused.append((path.stem, "not human" in str(fault)))
            continue
        assert body.unknown == ()
        lifted = np.nanmedian(joint(body, "head")[1] - joint(body, "root")[1])
        assert 0.35 < lifted < 0.8, path
    assert refused == [("test", True), ("Dog_example", True), ("dog_std", True)]


def test_cmus_skeleton_under_other_names_keeps_the_joints_that_the_file_names(shared: Path, tmp_path: Path) -> None:
    path = next((shared / "data" / "cmu").rglob("*.bvh"))
    exact = read_body(path, None, AUTO, JOINTS)
    assert exact.skeleton == "cmu-bvh"
    renamed = tmp_path / "a.bvh"
    renamed.write_text(path.read_text().replace("LFingers", "LeftHandIndex1").replace("RFingers", "RightHandIndex1"))
    body = read_body(renamed, None, AUTO, JOINTS)
    assert (body.skeleton, body.warnings, body.estimated) == ("recognised", (), ("belly", "chest"))
    for name in ("root", "lhip", "rknee", "lankle", "rtoes"):
        np.testing.assert_allclose(joint(body, name), joint(exact, name), atol=1e-3)
    file = BvhFile(path)
    places, _ = kinematics.forward(file.nodes, file.channels()[::50])
    at = {node.name: places[i] for i, node in enumerate(file.nodes)}
    named = {"neck": "Neck", "lclavicle": "LeftShoulder", "rshoulder": "RightArm", "lelbow": "LeftForeArm"}
    for name, node in (named | {"rwrist": "RightHand", "head": "Head"}).items():
        np.testing.assert_allclose(joint(body, name)[:, ::50] * 0.45 / 0.0254, at[node], atol=1e-3)


def test_one_node_named_chest_is_the_chest_and_others_are_estimated(tmp_path: Path) -> None:
    root = mixamo(prefix="")
    text = bvh_text(root, dance(root, 20)).replace("UpLeg", "Thigh")
    paths = {}
    for name in ("Spine2", "Chest", "Rachis"):
        paths[name] = tmp_path / f"{name}.bvh"
        paths[name].write_text(text.replace("Spine2", name))
    plain, chest, nameless = (read_body(path, None, AUTO, JOINTS) for path in paths.values())
    node = [oracle.pose(root, frame)[0]["Spine2"] for frame in dance(root, 20)]
    np.testing.assert_allclose(joint(chest, "chest"), 0.01 * np.array(node).T, atol=1e-9)
    np.testing.assert_array_equal(joint(plain, "chest"), joint(nameless, "chest"))
    assert "chest" in plain.estimated
    assert "chest" not in chest.estimated
