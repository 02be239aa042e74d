"""Files of kinematic chains: the shipped one, and what is wrong in others."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinedex.catalog.configs import parse_yaml, shipped_configs
from kinedex.catalog.features import load_feature_set
from kinedex.catalog.kinematics import load_kinematic_chain, parse_kinematic_chain
from kinedex.ops.errors import ConfigError

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
