"""The tree says what nodes are whose names are wrong, exchanged, or of no known word."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from kinedex.catalog.skeletons.recognition.node_places import exchanged_names, twist_nodes, with_exchanged

ARM = ("Shoulder", "Arm", "ForeArm", "Hand", "HandMiddle1")
NAMES = ("Hips", "Spine", *(f"Left{part}" for part in ARM), *(f"Right{part}" for part in ARM))
PARENTS = (-1, 0, 1, 2, 3, 4, 5, 1, 7, 8, 9, 10)


@given(st.sampled_from(ARM))
def test_one_exchanged_pair_is_found_and_put_right(part: str) -> None:
    pair = NAMES.index(f"Left{part}"), NAMES.index(f"Right{part}")
    wrong = with_exchanged(NAMES, (pair,))
    assert exchanged_names(wrong, PARENTS) == (pair,)
    assert with_exchanged(wrong, exchanged_names(wrong, PARENTS)) == NAMES


def test_names_of_whole_branches_contradict_nothing() -> None:
    wrong = with_exchanged(NAMES, [(i, i + len(ARM)) for i in range(2, 2 + len(ARM))])
    assert exchanged_names(wrong, PARENTS) == exchanged_names(NAMES, PARENTS) == ()


def test_an_end_site_is_renamed_with_its_joint() -> None:
    names = with_exchanged(("LeftHand", "LeftHand_end", "RightHand"), [(0, 2)])
    assert names == ("RightHand", "RightHand_end", "LeftHand")


def test_a_twist_of_the_only_child_divides_a_bone() -> None:
    names, parents = ("Chest", "NeckTwist", "Neck", "Head"), (-1, 0, 1, 2)
    assert twist_nodes(names, parents) == {1}
    assert twist_nodes(("Chest", "NeckTwist01", "NeckTwist02", "Head"), parents) == frozenset()
    assert twist_nodes((*names, "Collar"), (*parents, 1)) == frozenset()
