"""Files of bodies for depth images: the shipped one, and what is wrong in others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.bodies import load_body, parse_body, standing_height
from kinedex.catalog.configs import parse_yaml, shipped_configs
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.errors import ConfigError

TEXT = (shipped_configs() / "bodies" / "cones20.yaml").read_text(encoding="utf-8")


def test_the_shipped_body_has_two_like_halves() -> None:
    body = load_body()
    assert (len(body.cone_names), len(body.pivots), len(body.sample_cones), body.height_m) == (20, 19, 160, 1.7)
    for c, name in enumerate(body.cone_names):
        if name.startswith("left"):
            twin = body.cone_names.index(name.replace("left", "right"))
            np.testing.assert_array_equal(body.radii[twin], body.radii[c])
            np.testing.assert_array_equal(body.shares[twin], body.shares[c])
            assert [JOINTS[j].lstrip("l") for j in body.joints[c].flat] == [
                JOINTS[j].lstrip("r") if JOINTS[j] != "root" else "root" for j in body.joints[twin].flat
            ]


def test_the_standing_height_adds_bones_up() -> None:
    lengths = np.zeros(24)
    lengths[[JOINTS.index(n) for n in ("lknee", "rknee", "lankle", "rankle")]] = 0.4
    lengths[[JOINTS.index(n) for n in ("lhip", "rhip")]] = 0.1
    lengths[[JOINTS.index(n) for n in ("belly", "chest", "neck", "head", "headtop")]] = 0.14
    lengths[JOINTS.index("lelbow")] = 0.3
    assert standing_height(lengths) == pytest.approx(0.8 + 0.07 + 0.7 + 0.05)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("{root: 0, belly: 2,", "{belly: 2,", "pivots.belly: must begin with 'root'"),
        ("lclavicle: 6, ", "", "pivots.lshoulder: must come after 'lclavicle'"),
        ("rknee: 0.3, rankle: 1}", "rknee: 0.3}", "pivots: must have every joint .*; rankle missing"),
        ("rankle: 1}", "rankle: 1, rtoes: 1}", "pivots.rtoes: must be a joint with another one below it"),
        ("rankle: 1}", "rankl: 1}", "pivots.rankl: must be a named joint, got 'rankl'; did you mean"),
        ("from: lhip, to: rhip", "from: lhp, to: rhip", "cones.pelvis.from: must be a named joint, got 'lhp'; did"),
        ("from: lhip, to: rhip", "from: rhip, to: rhip", "cones.pelvis: must be between two places"),
        ("from: lhip, to: rhip", "from: lknee, to: rhip", None),
        ("from: lhip, to: rhip", "from: lknee, to: rknee", "cones.pelvis: .* and 'lhip' and 'rhip' move different"),
        ("{lhip: 0.6, root: 0.4}", "{lhip: 0.6, root: 0.5}", "left side.from: must have shares .*, got 1.1"),
        ("radii: [0.100, 0.100]", "radii: [0.100, 0]", "cones.pelvis.radii.1.: .*greater than 0"),
        ("radii: [0.100, 0.100]", "radii: [0.1]", "cones.pelvis.radii"),
        ("samples: [0.5]", "samples: [1.5]", "less than or equal to 1"),
        ("plus: 0.05", "plas: 0.05", "height.plas: no such key; did you mean 'plus'"),
        ("lknee: 0.5,", "lkne: 0.5,", "height.bones.lkne: must be a named joint"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_refused_with_the_line_and_the_key(old: str, new: str, message: str, tmp_path: Path) -> None:
    assert old in TEXT
    located = parse_yaml(TEXT.replace(old, new, 1), tmp_path / "own.yaml")
    if message is None:
        parse_body(located)
        return
    with pytest.raises(ConfigError, match=rf"own.yaml:\d+: .*{message}"):
        parse_body(located)
