"""Files of kinematic chains: the shipped one, and what is wrong in others."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinedex.catalog.configs import parse_yaml, shipped_configs
from kinedex.catalog.features import load_feature_set
from kinedex.catalog.kinematics import load_kinematic_chain, load_surface, parse_kinematic_chain, parse_surface
from kinedex.ops.errors import ConfigError

LIMBS = ("hip", "knee", "ankle", "toes", "shoulder", "elbow", "wrist", "fingers")
TEXT = (shipped_configs() / "kinematics" / "body48.yaml").read_text(encoding="utf-8")


def test_the_shipped_chain_moves_the_named_joints_and_bends_elbows_forwards() -> None:
    chain = load_kinematic_chain()
    assert sorted(chain.joints) == sorted(load_feature_set("body40").joints)
    elbows = {chain.nodes[axis.node]: axis.sign for axis in chain.axes if chain.nodes[axis.node].endswith("elbow")}
    assert elbows == {"lelbow": -1.0, "relbow": 1.0}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("parent: spine1, centre: chest", "parent: spin1, centre: chest", "a node before it, got 'spin1'; did"),
        ("  spine0:    {parent: pelvis, centre", "  spine0:    {centre", "nodes.spine0: must have a parent"),
        ("centre: belly", "centre: bely", "nodes.spine1.centre: must be one of `joints`, got 'bely'"),
        ("centre: lwrist", "centre: lelbow", "'lelbow' moves; 'lelbow' is moved by 'lshoulder'"),
        ("axes: [x, z]", "axes: [x, -x]", "must name each axis once"),
        ("axes: [x, z]", "axes: [x, w]", "nodes.head.axes"),
        ("pull: 0.6", "pull: 0", "greater than 0"),
        ("axes: [-y], pull: 1.5, hinge: [-3, 155]", "axes: [-y], hinge: [155, -3]", "the least and the greatest turn"),
        ("{node: head, from", "{node: heads, from", "joints.headtop.node: must be one of `nodes`, got 'heads'"),
        ("{node: pelvis, measured: true}", "{node: pelvis}", "must have one of `along`"),
        ("from: lankle, along: [0, -0.35, 0.937]", "along: [0, -0.35, 0.937]", "`along` and `from` together"),
        ("at: neck}", "at: nek}", "joints.lclavicle.at: must be one of `joints`, got 'nek'"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_refused_with_the_line_and_the_key(old: str, new: str, message: str, tmp_path: Path) -> None:
    assert old in TEXT
    with pytest.raises(ConfigError, match=rf"own.yaml:\d+: .*{message}"):
        parse_kinematic_chain(parse_yaml(TEXT.replace(old, new, 1), tmp_path / "own.yaml"))


def test_the_shipped_surface_covers_the_body_from_the_toes_to_the_top_of_the_head() -> None:
    chain, surface = load_kinematic_chain(), load_surface()
    assert surface.height_m == 1.58
    assert [chain.joints[joint] for joint in (*surface.low, surface.high)] == ["lankle", "rankle", "headtop"]
    covered = {chain.joints[joint] for capsule in surface.capsules for joint in (capsule.start, capsule.end)}
    assert {"headtop", "lfingers", "rfingers", "ltoes", "rtoes", "root"} <= covered
    radii = {frozenset((chain.joints[c.start], chain.joints[c.end])): c.radius for c in surface.capsules}
    mirrored = {
        frozenset({"l": "r", "r": "l"}[n[0]] + n[1:] if n[1:] in LIMBS else n for n in key): r
        for key, r in radii.items()
    }
    assert mirrored == radii


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "to: headtop, metres",
            "to: headtip, metres",
            "surface.height.to: must be one of `joints`, got 'headtip'; did",
        ),
        ("[lankle, rankle]", "[lankle, rankl]", "surface.height.from.1.: must be one of `joints`, got 'rankl'"),
        ("metres: 1.58", "metres: 0", "surface.height.metres.* greater than 0"),
        ("to: belly, radius", "to: bely, radius", "surface.capsules.0..to: must be one of `joints`, got 'bely'"),
        ("to: belly, radius", "to: root, radius", "surface.capsules.0.: must be between two joints"),
        ("radius: 0.14", "radius: -0.14", "surface.capsules.0..radius.* greater than 0"),
        ("radius: 0.14", "width: 0.14", "surface.capsules.0..width: no such key"),
        ("surface:\n", "outside:\n", "outside: no such key"),
    ],
)
def test_a_wrong_surface_is_refused_with_the_line_and_the_key(old: str, new: str, message: str, tmp_path: Path) -> None:
    assert old in TEXT
    with pytest.raises(ConfigError, match=rf"own.yaml:\d+: .*{message}"):
        parse_surface(parse_yaml(TEXT.replace(old, new, 1), tmp_path / "own.yaml"))


def test_a_chain_without_a_surface_says_where_to_find_one(tmp_path: Path) -> None:
    text = TEXT[: TEXT.index("\nsurface:")]
    parse_kinematic_chain(parse_yaml(text, tmp_path / "own.yaml"))
    with pytest.raises(ConfigError, match="no `surface`, which silhouettes need; copy that of"):
        parse_surface(parse_yaml(text, tmp_path / "own.yaml"))
