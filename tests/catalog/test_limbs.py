"""Limbs: names, joints, sides and groups."""

from __future__ import annotations

import pytest

from kinedex.catalog.limbs import GROUPS, LIMB_NAMES, LIMBS, WORN, chosen_limbs, limb_of
from kinedex.ops.body.joint_tree import JOINT_PARENTS
from kinedex.ops.errors import KinedexError


def _above(joint: str) -> list[str]:
    found = []
    parent = JOINT_PARENTS[joint]
    while parent is not None:
        found.append(parent)
        parent = JOINT_PARENTS[parent]
    return found


def test_limbs_run_outwards_between_named_joints() -> None:
    assert len(LIMB_NAMES) == 15
    for limb in LIMBS.values():
        assert limb.near in _above(limb.far)
        assert limb.bend is None or limb.bend in {*JOINT_PARENTS}
        assert limb_of(limb.opposite).opposite == limb.name


def test_hinges_are_thighs_shanks_and_arms() -> None:
    hinges = {limb.name[1:] for limb in LIMBS.values() if limb.bend}
    assert hinges == {"upperarm", "forearm", "thigh", "shank"}
    assert (LIMBS["lshank"].near, LIMBS["lshank"].far, LIMBS["lshank"].bend) == ("lknee", "lankle", "lhip")


def test_groups_hold_every_limb_once() -> None:
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(LIMB_NAMES)
    assert set(GROUPS["legs"]) == {"lthigh", "rthigh", "lshank", "rshank", "lfoot", "rfoot"}
    assert GROUPS["hands"] == ("lhand", "rhand")


def test_limbs_are_chosen_by_name_and_group() -> None:
    assert chosen_limbs([]) == LIMB_NAMES
    assert chosen_limbs(WORN) == ("torso", "lhand", "rhand", "lshank", "rshank")
    assert chosen_limbs(["hands", "head"]) == ("head", "lhand", "rhand")
    with pytest.raises(KinedexError, match=r"no limb is named 'lshanks'; did you mean 'lshank'\?.*pelvis"):
        chosen_limbs(["lshanks"])
