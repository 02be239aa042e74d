"""Keypoint sets: names, orders, and places on the body."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.catalog.configs import config_names, config_path, load_yaml, parse_yaml
from kinedex.catalog.keypoint_sets import keypoint_sets_by_count, likeliest_set, load_keypoint_set, parse_keypoint_set
from kinedex.catalog.kinematics import load_kinematic_chain
from kinedex.ops.body.kinematic_chain import ChainBody
from kinedex.ops.errors import ConfigError, KinedexError

CHAIN = load_kinematic_chain()


@pytest.fixture(scope="module")
def body() -> ChainBody:
    offsets = np.zeros((len(CHAIN.joints), 3))
    offsets[CHAIN.joint("lhip")], offsets[CHAIN.joint("rhip")] = (0.1, -0.08, 0), (-0.1, -0.06, 0.02)
    offsets[CHAIN.joint("lknee")] = (0, -0.42, 0)
    offsets[CHAIN.joint("ltoes")] = (0, -0.07, 0.1874)
    return ChainBody(CHAIN, offsets)


def test_the_number_of_keypoints_decides_the_set() -> None:
    sets = {count: [one.name for one in sets] for count, sets in keypoint_sets_by_count().items()}
    assert sets.pop(25) == ["body-25", "body-25b"]
    assert sets == {17: ["coco-17"], 18: ["coco-18"], 26: ["halpe-26"], 33: ["mediapipe-33"], 133: ["coco-133"]}


@pytest.mark.parametrize("name", ["body-25", "body-25b"])
def test_of_two_sets_with_as_many_keypoints_the_one_with_short_limbs_is_meant(name: str) -> None:
    rest = {"hip": 1.0, "knee": 0.6, "ankle": 0.1, "shoulder": 1.5, "elbow": 1.2, "wrist": 0.9, "eye": 1.7, "ear": 1.7}
    order = load_keypoint_set(name).order
    heights = [next((height for part, height in rest.items() if key.endswith(part)), 0.0) for key in order]
    sides = [0.2 * (key.startswith("left") - key.startswith("right")) for key in order]
    points = np.stack([sides, heights], axis=1)[None]
    points[0, order.index("left_wrist")] = np.nan
    assert likeliest_set(keypoint_sets_by_count()[25], points).name == name


@pytest.mark.parametrize("name", [name for name in config_names("keypoints") if name != "named"])
def test_the_twelve_limb_joints_are_named_joints_in_every_set(name: str) -> None:
    places = load_keypoint_set(name).positions
    for side, long in (("l", "left"), ("r", "right")):
        for part in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist"):
            assert places[f"{long}_{part}"].joint == side + part


def test_only_what_a_body_has_no_place_for_is_left_out() -> None:
    unused = {name: set(load_keypoint_set(name).order) - set(load_keypoint_set(name).positions)
              for name in config_names("keypoints")}  # fmt: skip
    assert {name for name, those in unused.items() if those} == {"coco-133", "mediapipe-33"}
    assert len(unused["coco-133"]) == 68 + 42
    assert {"mouth_left", "left_thumb", "right_eye_inner"} < unused["mediapipe-33"]


def test_the_set_of_3d_keypoints_has_the_same_order() -> None:
    order = load_yaml(config_path("skeletons", "coco-17")).mapping()["order"]
    assert tuple(order) == load_keypoint_set("coco-17").order


def test_keypoints_lie_on_the_body(body: ChainBody) -> None:
    halpe = load_keypoint_set("halpe-26")
    names = ["nose", "right_ear", "left_knee", "mid_hip", "left_heel", "left_big_toe"]
    points = halpe.body_points(names, body)
    assert [CHAIN.nodes[k] for k in points.nodes] == ["neck", "neck", "lhip", "pelvis", "lankle", "lankle"]
    assert [CHAIN.joints[j] if j >= 0 else "" for j in points.joints] == ["", "", "lknee", "", "", "ltoes"]
    assert points.offsets == pytest.approx(np.array([
        [0, 0.17, 0.15], [-0.072, 0.165, 0.035], [0, -0.42, 0], [0, -0.07, 0.01], [0, -0.044, -0.05],
        [0, -0.07, 0.1874],
    ]), abs=1e-3)  # fmt: skip


def test_the_simulated_set_has_a_face_of_its_own(body: ChainBody) -> None:
    points = load_keypoint_set("coco-17-toes").body_points(["nose", "right_ear", "left_hip"], body)
    assert points.offsets[:2].tolist() == [[0, 0.06, 0.12], [-0.075, 0.07, 0.02]]
    assert points.joints[2] == CHAIN.joint("lhip")


def test_named_joints_are_keypoints_by_their_own_names(body: ChainBody) -> None:
    points = load_keypoint_set("named").body_points(["lknee", "left_knee"], body)
    assert points.joints[0] == points.joints[1] == CHAIN.joint("lknee")


def test_a_keypoint_without_a_place_is_refused(body: ChainBody) -> None:
    with pytest.raises(KinedexError, match=r"'left_kne' has no place .* did you mean 'left_knee'"):
        load_keypoint_set("coco-17").body_points(["left_kne"], body)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: a\norder: [nose, nose]", r"a.yaml:2: order\[1\]: keypoint 'nose' stands twice"),
        (
            "name: a\npoints: {x: lkne}",
            "a.yaml:2: points.x: joint must be a joint of the body, got 'lkne'; did you",
        ),
        ("name: a\npoints: {x: {node: knee, offset: [0, 0, 0]}}", "must be a node of the body, got 'knee'"),
        ("name: a\npoints: {x: {node: lknee}}", "must have `node` and `offset` together"),
        ("name: a\npoints: {x: {}}", "must be a joint, or have one of"),
        ("name: a\npoints: {x: {nod: lknee}}", "no such key; did you mean 'node'"),
        ("name: a\npoints: {x: {node: neck, offset: [0, 0, .inf]}}", "must be a finite number"),
        ("name: a\npoints: {x: {middle: [lhip, lknee]}}", "two joints that one node moves"),
        ("name: a\npoints: {x: {node: neck, offset: [0, 0, 1], bone: ltoes}}", "a joint that 'neck' moves"),
        ("name: a\norder: [nose]\npoints: {noes: neck}", "must be one of `order`; did you mean 'nose'"),
    ],
)
def test_wrong_sets_are_refused_with_line_and_key(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse_keypoint_set(parse_yaml(text, "a.yaml"), CHAIN)
