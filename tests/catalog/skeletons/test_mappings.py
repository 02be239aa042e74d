"""Skeleton mappings: which one fits a skeleton, what it makes of it, and the message when it does not fit."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.catalog.configs import config_names
from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import Mappings, load_mappings, load_skeleton, stripping
from kinedex.catalog.skeletons.units import ADULT_M, HUMAN_M, UNITS_M, contradicted_unit, guess_unit, rival_unit
from kinedex.ops.body import features
from kinedex.ops.errors import ConfigError, SourceError
from tests.bodies import standing, upright
from tests.oracles import features as oracle

JOINTS = load_feature_set().joints
AUTO = load_mappings("auto", JOINTS)
ARMS = ("lelbow", "lwrist", "lfingers", "relbow", "rwrist", "rfingers")


def nodes_of(name: str) -> dict[str, int]:
    """A skeleton that has the nodes which a mapping names first, and no others."""
    mapping = load_skeleton(name, JOINTS)
    names = [node for mixes in mapping.joints.values() if (mix := mixes[0]) and not mix.of_joints for node in mix.names]
    names += [node for bone, weights in mapping.bones.items() for node in (bone, *weights)]
    return {node: i for i, node in enumerate(dict.fromkeys(names))}


def user_file(path: Path, name: str, *changes: tuple[str, str]) -> str:
    """A mapping of the user's own: a shipped one with some text replaced."""
    text = load_skeleton(name, JOINTS).path.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (path / "own.yaml").write_text(text)
    return str(path / "own.yaml")


@pytest.mark.parametrize("name", config_names("skeletons"))
def test_every_shipped_mapping_is_told_by_the_names_of_its_own_skeleton(name: str) -> None:
    mapping = load_skeleton(name, JOINTS)
    fit = AUTO.detect("HDM_bd.c3d" if mapping.only else "x", mapping.format, nodes_of(name))
    assert fit.mapping.name == name
    lacks = {"coco-17": ("ltoes", "rtoes")}
    assert set(fit.unknown) == set(lacks.get(name, ()))
    assert set(fit.joints) == set(JOINTS)


@pytest.mark.parametrize("prefix", ["mixamorig:", "mixamorig7:", "mixamorig1_", "a:b:", ""])
def test_prefixes_of_names_do_not_matter(prefix: str) -> None:
    nodes = {prefix + name: i for name, i in nodes_of("mixamo").items()}
    fit = AUTO.detect("x", "bvh", nodes)
    assert fit.mapping.name == "mixamo"
    assert fit.root == nodes[prefix + "Hips"]
    assert fit.virtual == {}


def test_names_that_a_stripped_prefix_makes_equal_are_not_guessed_between() -> None:
    nodes = {f"{who}:{name}": i for who in "ab" for name, i in nodes_of("mixamo").items()}
    with pytest.raises(SourceError, match="no skeleton mapping fits"):
        AUTO.detect("x", "bvh", nodes)


def test_the_first_choice_that_a_skeleton_has_counts() -> None:
    nodes = nodes_of("mixamo")
    del nodes["LeftHandMiddle1"], nodes["HeadTop_End"], nodes["LeftToe_End"]
    nodes |= {"Head_end": 99, "LeftToeBase": 98}
    fit = AUTO.detect("x", "bvh", nodes)
    assert fit.joints["headtop"] is not None
    assert fit.joints["headtop"].node == "Head_end"
    assert fit.joints["ltoes"] is not None
    assert fit.joints["ltoes"].node == "LeftToeBase"
    assert {joint: str(mix) for joint, mix in fit.virtual.items()} == {"lfingers": "-0.25 lelbow +1.25 lwrist"}


def test_a_skeleton_that_no_mapping_fits_is_told_the_nearest_and_what_it_lacks() -> None:
    nodes = nodes_of("bandai")
    del nodes["Toes_L"], nodes["Foot_R"]
    with pytest.raises(SourceError) as caught:
        AUTO.detect("a.bvh", "bvh", nodes)
    assert "the nearest, 'bandai', finds" in str(caught.value)
    assert "lacks Toes_L (for joint 'ltoes'), Foot_R (for joint 'rankle')" in str(caught.value)
    assert "give it by `skeletons`" in str(caught.value)


def test_a_skeleton_of_strange_names_is_near_to_no_mapping() -> None:
    with pytest.raises(
        SourceError, match=r"none is near: none knows any of its names; the skeleton has a, b; write one"
    ):
        AUTO.detect("a.bvh", "bvh", {"a": 0, "b": 1})
    with pytest.raises(SourceError) as caught:
        load_mappings("mixamo", JOINTS).detect("x", "bvh", {"Foot_R": 0, "HipsX": 1})
    assert "has no 'Hips'" in str(caught.value)
    assert "did you mean 'HipsX'?" in str(caught.value)
    with pytest.raises(SourceError) as caught:
        load_mappings("named", JOINTS).detect("x", "bvh", {"Foot_R": 0, "Hand_R": 1})
    assert "has no 'root'" in str(caught.value)
    assert "known: Foot_R, Hand_R" in str(caught.value)


@pytest.mark.parametrize(("prefix", "pattern"), [("Bip_", "Bip_"), ("a.b-", r"a\.b\-"), ("Bob", "Bob")])
def test_names_that_only_a_prefix_keeps_from_a_mapping_are_told_so(tmp_path: Path, prefix: str, pattern: str) -> None:
    nodes = {f"{prefix}{name}": i for name, i in nodes_of("bandai").items()}
    output = f"; without '{prefix}' its names fit 'bandai': copy {load_skeleton('bandai', JOINTS).path}"
    for mappings in (AUTO, load_mappings("bandai", JOINTS)):
        with pytest.raises(SourceError) as caught:
            mappings.detect("a.bvh", "bvh", nodes)
        assert f"{output}, with `strip_prefix: '{pattern}'`" in str(caught.value)
    own = user_file(tmp_path, "bandai", ("format: bvh", f"format: bvh\nstrip_prefix: '{pattern}'"))
    assert not load_skeleton(own, JOINTS).fit(nodes).missing


def test_the_nearest_mapping_of_names_with_a_prefix_is_that_of_the_names_without() -> None:
    nodes = {f"Bip_{name}": i for name, i in nodes_of("bandai").items() if name != "Foot_R"}
    with pytest.raises(SourceError) as caught:
        AUTO.detect("a.bvh", "bvh", nodes)
    assert "the nearest, 'bandai' (without the prefix 'Bip_'), finds" in str(caught.value)
    assert "lacks Foot_R (for joint 'rankle')" in str(caught.value)


def test_a_prefix_of_most_names_is_enough_and_two_figures_have_none() -> None:
    nodes = {"Reference": 90} | {f"Bob_{name}": i for name, i in nodes_of("bandai").items()}
    found = AUTO.without_prefix("bvh", nodes)
    assert found is not None
    assert (found[0], found[1].name) == ("Bob_", "bandai")
    two = {f"{who}_{name}": i for who in ("Al", "Bo") for name, i in nodes_of("bandai").items()}
    assert AUTO.without_prefix("bvh", two) is None
    mixamo = {f"Bob_{name}": i for name, i in nodes_of("mixamo").items()}
    prefix, mapping = AUTO.without_prefix("bvh", mixamo) or ("", None)
    assert mapping is not None
    assert stripping(prefix, mapping) == r"`strip_prefix: 'Bob_(?:.*:|mixamorig\d*_)?'`"


def test_the_mapping_that_finds_most_joints_wins_and_a_tie_is_an_error(tmp_path: Path) -> None:
    bandai = load_skeleton("bandai", JOINTS)
    less = load_skeleton(
        user_file(tmp_path, "bandai", ("name: bandai", "name: less"), ("belly: Spine", "belly: null")), JOINTS
    )
    same = load_skeleton(user_file(tmp_path, "bandai", ("name: bandai", "name: same")), JOINTS)
    nodes = nodes_of("bandai")
    assert Mappings({"bvh": (less, bandai)}).detect("x", "bvh", nodes).mapping is bandai
    with pytest.raises(SourceError, match="mappings 'bandai', 'same' fit this skeleton equally well; give one by"):
        Mappings({"bvh": (bandai, same)}).detect("x", "bvh", nodes)


def test_a_chosen_mapping_counts_for_its_format_and_says_what_the_skeleton_lacks() -> None:
    mappings = load_mappings("bandai", JOINTS)
    assert [mapping.name for mapping in mappings.of_format["bvh"]] == ["bandai"]
    assert [mapping.name for mapping in mappings.of_format["acclaim"]] == ["acclaim"]
    with pytest.raises(SourceError, match=r"no 'UpperLeg_L', which mapping 'bandai' .* takes for joint 'lhip'"):
        mappings.detect("x", "bvh", nodes_of("mixamo") | {"Hips": 0})


def test_joints_are_nodes_and_fixed_combinations_in_our_axes(tmp_path: Path) -> None:
    own = user_file(
        tmp_path, "bandai", ("up: y\n", "up: z\n"), ("facing: z\n", "facing: -y\n"),
        ("chest: Chest", "chest: {nodes: {Spine: 0.5, Neck: 0.5}}"), ("belly: Spine", "belly: null"),
    )  # fmt: skip
    nodes = nodes_of("bandai") | {"Spine": 90}
    places = np.random.default_rng(0).normal(size=(91, 3, 4))
    mapping = load_skeleton(own, JOINTS)
    joints = mapping.apply("x", nodes, places, JOINTS)
    found = dict(zip(JOINTS, joints, strict=True))
    room = np.empty((*joints.shape[:2], 9))
    assert mapping.fit(nodes).apply(places, JOINTS, room[:, :, 2:6]).base is room
    np.testing.assert_array_equal(room[:, :, 2:6], joints)

    def ours(node: str) -> np.ndarray:
        x, y, z = places[nodes[node]]
        return np.stack([x, z, -y])

    np.testing.assert_allclose(found["lwrist"], ours("Hand_L"))
    np.testing.assert_allclose(found["chest"], 0.5 * ours("Spine") + 0.5 * ours("Neck"))
    np.testing.assert_allclose(found["lfingers"], 1.25 * ours("Hand_L") - 0.25 * ours("LowerArm_L"))
    assert np.isnan(found["belly"]).all()


def test_a_joint_aside_of_a_plane_lies_as_deep_however_the_body_turns(tmp_path: Path) -> None:
    own = user_file(
        tmp_path,
        "bandai",
        ("chest: Chest", "chest: {nodes: {Chest: 1}, aside: {plane: [Hips, Neck, Spine], times: -0.5}}"),
    )
    nodes = nodes_of("bandai")
    places = np.zeros((len(nodes), 3, 1))
    # The normal of the plane is Z, and its first side 2 long.
    for name, place in {"Chest": (1, 1, 1), "Hips": (0, 0, 0), "Neck": (2, 0, 0), "Spine": (0, 3, 0)}.items():
        places[nodes[name], :, 0] = place
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    for turned in (np.eye(3), turn):
        found = load_skeleton(own, JOINTS).apply("x", nodes, np.einsum("ab,nbt->nat", turned, places), JOINTS)
        np.testing.assert_allclose(found[JOINTS.index("chest"), :, 0], turned @ [1, 1, 0])
    left = user_file(tmp_path, "bandai", ("up: y\n", "up: y\nhandedness: left\n"), ("handedness: right\n", ""), (
        "chest: Chest", "chest: {nodes: {Chest: 1}, aside: {plane: [Hips, Neck, Spine], times: -0.5}}"
    ))  # fmt: skip
    mirrored = load_skeleton(left, JOINTS).apply("x", nodes, places * [[-1], [1], [1]], JOINTS)
    np.testing.assert_allclose(mirrored[JOINTS.index("chest"), :, 0], [1, 1, 0])


def test_another_choice_stands_in_where_a_marker_is_not_seen(tmp_path: Path) -> None:
    own = user_file(tmp_path, "hdm05-c3d", ("lelbow: LELB", "lelbow: [{nodes: {LELB: 0.5, LELM: 0.5}}, LELB, LELM]"))
    nodes = nodes_of("hdm05-c3d") | {"LELM": 201}
    fit = load_mappings(own, JOINTS).detect("x", "c3d", nodes)
    places = np.random.default_rng(0).normal(size=(202, 3, 4))
    whole = fit.apply(places, JOINTS)[JOINTS.index("lelbow")]
    hidden = places.copy()
    hidden[nodes["LELB"], :, 1:] = np.nan
    hidden[nodes["LELM"], :, 3] = np.nan
    found = fit.apply(hidden, JOINTS)[JOINTS.index("lelbow")]
    np.testing.assert_array_equal(found[:, 0], whole[:, 0])
    x, y, z = places[nodes["LELM"], :, 1:3]
    np.testing.assert_array_equal(found[:, 1:3], [x, z, -y])
    assert np.isnan(found[:, 3]).all()
    assert {nodes["LELB"], nodes["LELM"]} <= set(fit.nodes)
    assert [mix.names for mix in fit.instead["lelbow"]] == [("LELB",), ("LELM",)]


def test_markers_may_be_called_otherwise_and_a_file_may_say_what_is_up(tmp_path: Path) -> None:
    own = user_file(tmp_path, "hdm05-c3d", ("only: ", "aliases: {LFWT: [LASI]}\nonly: "))
    nodes = {f"Ann:{'LASI' if name == 'LFWT' else name}": i for name, i in nodes_of("hdm05-c3d").items()}
    fit = load_mappings(own, JOINTS).detect("x", "c3d", nodes)
    assert fit.indices["LFWT"] == nodes["Ann:LASI"]
    assert fit.upright(None) is fit
    assert fit.upright("z") is fit
    for up in "xy":
        axes = fit.upright(up).mapping.axes
        np.testing.assert_array_equal(axes[1], np.eye(3)["xyz".index(up)])
        assert np.linalg.det(axes) == 1.0


def test_a_mapping_of_one_archive_is_detected_in_its_files_only() -> None:
    nodes = nodes_of("hdm05-c3d")
    assert AUTO.detect("HDM_bd_01.c3d", "c3d", nodes).mapping.name == "hdm05-c3d"
    assert AUTO.detect("x", "c3d", {f"Bastian:{name}": i for name, i in nodes.items()}).mapping.name == "hdm05-c3d"
    assert load_mappings("hdm05-c3d", JOINTS).detect("x", "c3d", nodes).mapping.name == "hdm05-c3d"
    assert AUTO.exact("x", "c3d", nodes) is None
    with pytest.raises(SourceError, match="no skeleton mapping for c3d files"):
        AUTO.detect("x", "c3d", nodes)


FAULTS = {
    "an unknown joint": (("belly: Spine", "bely: Spine"), "joints.bely", "did you mean 'belly'"),
    "a missing joint": (("  belly: Spine\n", ""), "joints", "write `belly: null`"),
    "keys of all kinds": (("belly: Spine", "belly: {.nan: 1, x: 2}"), "joints.belly", "joints.belly"),
    "weights of two": (("-2, head: 3", "-2, head: 4"), "joints.headtop", "the weights must add up to 1, got 2"),
    "a virtual of one below": (("neck: -2, head: 3", "lfingers: -2, head: 3"), "joints.headtop", "'lfingers' is none"),
    "no kind of mix": (("{virtual: {neck: -2, head: 3}}", "{}"), "joints.headtop", "expected `virtual`"),
    "a unit of nothing": (("unit_m: 0.01", "unit_m: -1"), "unit_m", "a positive number of metres, or guess; got -1"),
    "a unit beyond all numbers": (
        ("unit_m: 0.01", f"unit_m: {10**320}"),
        "unit_m",
        "a positive number of metres, or guess",
    ),
    "a unit of a name": (("unit_m: 0.01", "unit_m: cm"), "unit_m", "a positive number of metres, or guess; got 'cm'"),
    "one axis twice": (("facing: z\nroot", "facing: -y\nroot"), "facing", "different axes"),
    "a root's axis twice": (("up: x, facing: z", "up: x, facing: x"), "root_axes", "different axes"),
    "a prefix that is none": (
        ("unit_m: 0.01", "unit_m: 0.01\nstrip_prefix: '('"),
        "strip_prefix",
        "no regular expression",
    ),
    "a plane of two": (
        ("chest: Chest", "chest: {nodes: {Chest: 1}, aside: {plane: [Neck, Hips], times: 1}}"),
        "joints.chest.aside.plane",
        "at least 3 entries",
    ),
    "aside of joints": (
        ("{virtual: {neck: -2, head: 3}}", "{virtual: {neck: 1}, aside: {plane: [Neck, Hips, Head], times: 1}}"),
        "joints.headtop",
        "`aside` goes with `nodes`",
    ),
    "a key of other formats": (("unit_m: 0.01", "unit_m: 0.01\nscreen: true"), "screen", "nothing for format bvh"),
    "a misspelt key": (("unit_m: 0.01", "unit_m: 0.01\nstrip: x"), "strip", "no such key"),
    "another format": (("format: bvh", "format: fbx"), "format", "'positions', 'c3d' or 'amass'"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_a_mapping_file_is_named_with_line_and_key(tmp_path: Path, fault: str) -> None:
    change, key, message = FAULTS[fault]
    with pytest.raises(ConfigError, match=re.escape(message)) as caught:
        load_skeleton(user_file(tmp_path, "bandai", change), JOINTS)
    assert caught.value.line is not None
    assert str(caught.value.key).startswith(key)


@given(height=st.floats(ADULT_M, HUMAN_M[1], exclude_min=True, exclude_max=True), unit=st.sampled_from(list(UNITS_M)))
def test_the_unit_is_the_one_that_makes_a_body_as_high_as_a_human(height: float, unit: str) -> None:
    body = standing(1)
    _, _, metres = guess_unit("x", body, JOINTS)
    found, unit_m, guessed = guess_unit("x", body * (height / metres / UNITS_M[unit]), JOINTS)
    assert (found, unit_m) == (unit, UNITS_M[unit])
    assert guessed == pytest.approx(height)


@pytest.mark.parametrize("unit", ["metres", "inches", "cm", "mm"])
def test_children_in_common_units_are_as_high_as_they_are_without_a_doubt(unit: str) -> None:
    _, _, metres = guess_unit("x", standing(1), JOINTS)
    found, unit_m, height = guess_unit("x", standing(1) * (1.05 / metres / UNITS_M[unit]), JOINTS)
    assert (found, height) == (unit, pytest.approx(1.05))
    assert rival_unit(unit_m, height) is None


@given(height=st.floats(1.0, HUMAN_M[1], exclude_min=True, exclude_max=True))
def test_decimetres_are_read_as_such_or_have_a_rival(height: float) -> None:
    _, _, metres = guess_unit("x", standing(1), JOINTS)
    name, unit_m, guessed = guess_unit("x", standing(1) * (10 * height / metres), JOINTS)
    assert name == "dm (MakeHuman)"
    assert guessed == pytest.approx(height)
    rival = rival_unit(unit_m, guessed)
    assert (rival is not None) == (height * 0.0254 / 0.45 / 0.1 >= 1.0)


def test_feet_are_tried_last() -> None:
    _, _, metres = guess_unit("x", standing(1), JOINTS)
    name, _, height = guess_unit("x", standing(1) * (5.8 / metres), JOINTS)
    assert (name, height) == ("feet", pytest.approx(5.8 * 0.3048))


@pytest.mark.parametrize("factor", [10.0, 100.0, 1000.0])
def test_a_body_that_was_divided_once_too_often_is_restored(factor: float) -> None:
    _, other_m, height = contradicted_unit(standing(1) / factor, JOINTS, 1.0) or ("", 0.0, 0.0)
    assert other_m == factor
    assert height == pytest.approx(1.75, abs=0.12)
    for size in (0.6, 1.2):  # a child and a tall person are right as they are
        assert contradicted_unit(standing(1) * size, JOINTS, 1.0) is None


def test_never_two_common_units_make_a_human_height() -> None:
    sizes = sorted(UNITS_M.values())
    assert all(larger / smaller > HUMAN_M[1] / HUMAN_M[0] for smaller, larger in pairwise(sizes))


def test_a_standing_body_is_as_high_as_it_looks_and_a_lying_one_no_lower() -> None:
    body = standing(1)
    _, _, height = guess_unit("x", body, JOINTS)
    assert height == pytest.approx(1.75, abs=0.12)
    assert guess_unit("x", body[:, [0, 2, 1]], JOINTS)[2] == pytest.approx(height)


def test_a_body_of_no_human_height_or_without_legs_has_no_unit_to_guess() -> None:
    with pytest.raises(SourceError, match=r"units high, which is 0\.7 to 4\.1 m in none of metres"):
        guess_unit("x", standing(1) * 1e5, JOINTS)
    body = standing(1)
    body[[JOINTS.index(joint) for joint in ("lknee", "rhip", "lelbow", "rwrist")]] = np.nan
    with pytest.raises(SourceError, match=r"without a whole leg or arm; state `unit_m`"):
        guess_unit("x", body, JOINTS)


@pytest.mark.parametrize(
    ("units", "unit", "height"),
    [
        (0.9, "metres", 0.9),
        (88, "cm", 0.88),
        (2.25, "metres", 2.25),
        (3.5, "metres", 3.5),
        (310, "cm", 3.1),
        (7.5, "dm", 0.75),
    ],
)
def test_children_giants_and_cartoons_get_the_unit_that_is_likeliest(units: float, unit: str, height: float) -> None:
    _, _, metres = guess_unit("x", standing(1), JOINTS)
    name, _, found = guess_unit("x", standing(1) * units / metres, JOINTS)
    assert (name.split(" ")[0], found) == (unit, pytest.approx(height))


@pytest.mark.parametrize(("stated", "found"), [(1.0, "mm"), (0.01, "mm"), (0.001, None), (0.0004, None), (1e-6, "mm")])
def test_a_stated_unit_that_makes_no_body_is_contradicted(stated: float, found: str | None) -> None:
    other = contradicted_unit(standing(1) * 1000, JOINTS, stated)
    assert (other and other[0]) == found
    assert contradicted_unit(standing(1) * 1e12, JOINTS, stated) is None


@pytest.mark.parametrize(
    "lost",
    [
        [joint for joint in JOINTS if joint[1:] in ("hip", "knee", "ankle", "toes")],
        [joint for joint in JOINTS if joint != "root" and joint[1:] not in ("hip", "knee", "ankle", "toes")],
    ],
)
def test_half_a_body_is_about_as_high_as_the_whole_one(lost: list[str]) -> None:
    body = standing(1)
    _, _, height = guess_unit("x", body, JOINTS)
    body[[JOINTS.index(joint) for joint in lost]] = np.nan
    assert guess_unit("x", body, JOINTS)[2] == pytest.approx(height, rel=0.2)


@given(lost=st.sets(st.sampled_from(JOINTS), min_size=1, max_size=3), seed=st.integers(0, 1000))
def test_features_that_are_known_without_a_joint_are_as_before(lost: set[str], seed: int) -> None:
    feature_set = load_feature_set()
    random = np.random.default_rng(seed)
    body = standing(20) + random.normal(0, 0.15, (len(JOINTS), 3, 20))
    before = features.words(body, upright(20), 30.0, feature_set.rules)
    body[[JOINTS.index(joint) for joint in lost]] = np.nan
    after = features.words(body, upright(20), 30.0, feature_set.rules)
    off, narrowed, scaled = feature_set.without(lost)
    for feature in feature_set.features:
        bit = np.uint64(feature.number - 1)
        was, now = (before >> bit) & np.uint64(1), (after >> bit) & np.uint64(1)
        assert (feature in off) == (not feature_set.known(lost) >> int(bit) & 1)
        if feature not in (*off, *narrowed, *scaled):
            np.testing.assert_array_equal(was, now)


@pytest.mark.parametrize(
    ("lost", "unknown"),
    [
        ((), []),
        (("lankle",), [15, 16, 19, 21, 22, 23, 24, 26, 31, 38]),  # the toes still tell where the ground is
        (("lankle", "ltoes"), [15, 16, 17, 18, 19, 21, 22, 23, 24, 26, 31, 33, 34, 37, 38]),
        (("headtop",), [37, 38]),
    ],
)
def test_heights_are_known_as_long_as_both_feet_are(lost: tuple[str, ...], unknown: list[int]) -> None:
    known = load_feature_set().known(lost)
    assert [number for number in range(1, 41) if not known >> (number - 1) & 1] == unknown


def test_a_lost_joint_costs_the_features_that_name_it() -> None:
    off, narrowed, scaled = load_feature_set().without(["lfingers"])
    assert scaled == ()
    assert [feature.number for feature in off] == [14, 34]
    assert [feature.number for feature in narrowed] == [17, 18, 33, 37]
    assert set(oracle.JOINTS) == set(JOINTS)
