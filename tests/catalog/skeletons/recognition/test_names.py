"""Names of nodes and markers come to one form, whatever program wrote them."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.catalog.skeletons.recognition.names import Vocabulary, load_vocabulary, normal_names, split_name
from kinedex.ops.errors import ConfigError


@pytest.fixture(scope="module")
def joints() -> Vocabulary:
    return load_vocabulary("joints")


@pytest.mark.parametrize(
    ("text", "side", "part"),
    [
        ("mixamorig:LeftUpLeg", "l", "thigh"),
        ("Bip01 L Thigh", "l", "thigh"),
        ("lCollar", "l", "clavicle"),
        ("LHipJoint", "l", "pelvis side"),
        ("rshldr", "r", "upperarm"),
        ("thigh_l", "l", "thigh"),
        ("Clavicle.R", "r", "clavicle"),
        ("KNEE_LEFT", "l", "calf"),
        ("Left Up Leg", "l", "thigh"),
        ("leftuparm", "l", "upperarm"),
        ("ltibia", "l", "calf"),
        ("upperleg01.R", "r", "thigh"),
        ("simHips", "", "hips"),
        ("L5", "", "spine"),
        ("T8", "", "spine"),
        ("CC_Base_L_Thigh", "l", "thigh"),
        ("J_Bip_L_UpperLeg", "l", "thigh"),
        ("DEF-spine.001", "", "spine"),
        ("rThighBend", "r", "thigh"),
    ],
)
def test_a_name_states_its_side_and_part(joints: Vocabulary, text: str, side: str, part: str) -> None:
    name = split_name(text, joints)
    assert name.side == side
    assert part in joints.parts(name)


@pytest.mark.parametrize("text", ["HeadTop_End_end", "Bip01 HeadNub", "LeftToe_End", "LeftFoot_end"])
def test_the_end_of_a_bone_is_marked(joints: Vocabulary, text: str) -> None:
    assert split_name(text, joints).end


def test_numbers_after_the_last_word_count(joints: Vocabulary) -> None:
    assert split_name("Bip01 Spine2", joints).ordinals == (2,)
    assert split_name("toe1-2.R", joints).ordinals == (1, 2)
    assert split_name("spine_03_jnt", joints).ordinals == (3,)


def test_a_prefix_that_most_names_share_is_dropped(joints: Vocabulary) -> None:
    names = normal_names(["Fred_Hips", "Fred_Spine", "Fred_LeftArm", "Fred_Neck"], joints)
    assert [name.words for name in names] == [("hips",), ("spine",), ("arm",), ("neck",)]


PARTS = ["UpLeg", "ForeArm", "Hand", "ToeBase", "Collar", "Thigh"]


@given(
    part=st.sampled_from(PARTS),
    side=st.sampled_from("lr"),
    prefix=st.sampled_from(["", "mixamorig:", "Bip01 ", "Bob:", "char_", "a|b|"]),
    style=st.sampled_from(range(7)),
)
def test_prefix_case_and_side_style_mean_nothing(part: str, side: str, prefix: str, style: int) -> None:
    vocabulary = load_vocabulary("joints")
    word = {"l": "Left", "r": "Right"}[side]
    text = [
        f"{word}{part}", f"{word.lower()}_{part.lower()}", f"{part}_{side.upper()}", f"{part}.{side}",
        f"{side}{part}", f"{side.upper()}_{part}", f"{word.upper()}{part.upper()}",
    ][style]  # fmt: skip
    name = split_name(prefix + text, vocabulary)
    plain = split_name(f"Left{part}", vocabulary)
    assert (name.side, vocabulary.parts(name)) == (side, vocabulary.parts(plain))


def test_words_of_a_user_are_added(joints: Vocabulary, tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text("terms:\n  thigh: [Oberschenkel]\n")
    merged = joints.merged([load_vocabulary(own, tuple(joints.terms))])
    assert merged.parts(split_name("L_Oberschenkel", merged)) == ("thigh",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("terms:\n  thig: [x]\n", "no such part"),
        ("terms:\n  thigh: ['']\n", "needs letters"),
        ("term: {}\n", "no such key"),
        ("terms: {thigh: 3}\n", "list"),
    ],
)
def test_a_wrong_vocabulary_names_file_and_key(joints: Vocabulary, tmp_path: Path, text: str, message: str) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(text)
    with pytest.raises(ConfigError, match=message):
        load_vocabulary(own, tuple(joints.terms))
