"""Class files: subclasses by name and by pattern, and what is wrong with a file."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinedex.catalog.classes import Classes, MotionClass, load_classes
from kinedex.ops.errors import ConfigError

HDM05 = [
    "depositFloorR",
    "elbowToKnee1RepsLelbowStart",
    "grabHighR",
    "hopBothLegs1hops",
    "jogLeftCircle4StepsRstart",
    "kickLFront1Reps",
    "lieDownFloor",
    "rotateArmsBothBackward1Reps",
    "sneak2StepsLStart",
    "squat1Reps",
    "throwBasketball",
]


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    return path


def test_without_a_file_every_subclass_is_its_own_class():
    classes = load_classes("own", ["walk", "kick", "walk"])
    assert classes.names == ("kick", "walk")
    assert classes.class_of("walk") == "walk"
    assert classes.class_of("swim") is None


def test_the_classes_of_the_thesis_take_the_clip_classes_of_hdm05():
    classes = load_classes(
        "thesis-15", [*HDM05, "standUpSitChair", "sitDownKneelTieShoes", "hopLLeg2hops", "clap1Reps"]
    )
    assert len(classes.names) == 15
    assert classes.of_subclass() == {
        "depositFloorR": "grabDepR",
        "elbowToKnee1RepsLelbowStart": "exercise",
        "grabHighR": "grabDepR",
        "hopBothLegs1hops": "jump",
        "hopLLeg2hops": "hopOneLeg",
        "jogLeftCircle4StepsRstart": "move",
        "kickLFront1Reps": "kick",
        "lieDownFloor": "sitLieDown",
        "rotateArmsBothBackward1Reps": "rotateArms",
        "sitDownKneelTieShoes": "sitLieDown",
        "sneak2StepsLStart": "move",
        "squat1Reps": "exercise",
        "standUpSitChair": "standUp",
        "throwBasketball": "throwR",
    }
    assert classes.without_class == ("clap1Reps",)


def test_the_eleven_classes_of_the_demo_are_described():
    classes = load_classes("hdm05-11", HDM05)
    assert list(classes.names) == HDM05
    assert all(one.description and one.subclasses == (one.name,) for one in classes.classes)


def test_a_list_of_subclasses_is_enough_and_the_order_is_the_files(tmp_path: Path):
    path = written(tmp_path, "legs: [kick*, squat]\narms:\n  subclasses: [wave]\n")
    classes = load_classes(path, ["wave", "squat", "kickR", "kickL", "sit"])
    assert [(one.name, one.subclasses) for one in classes.classes] == [
        ("legs", ("kickL", "kickR", "squat")),
        ("arms", ("wave",)),
    ]
    assert classes.without_class == ("sit",)
    assert classes.class_of("kickR") == "legs"
    assert classes.class_of("legs") == "legs"


def test_a_label_is_looked_up_once_for_all_and_a_class_goes_before_a_subclass(monkeypatch: pytest.MonkeyPatch):
    classes = Classes((MotionClass("kick", "", ("punch",)), MotionClass("arms", "", ("kick",))))
    asked = []
    of_subclass = Classes.of_subclass
    monkeypatch.setattr(Classes, "of_subclass", lambda self: asked.append(self) or of_subclass(self))
    assert [classes.class_of(label) for label in ("kick", "punch", "arms", "swim")] == ["kick", "kick", "arms", None]
    assert len(asked) == 1


def test_an_unknown_subclass_is_named_with_its_line_and_the_nearest_one(tmp_path: Path):
    path = written(tmp_path, "legs:\n  subclasses:\n    - squat\n    - kickk\n")
    with pytest.raises(ConfigError, match=r"mine.yaml:4: .*no subclass 'kickk'; did you mean 'kick'"):
        load_classes(path, ["kick", "squat"])


def test_a_subclass_in_two_classes_is_named_with_both_lines(tmp_path: Path):
    path = written(tmp_path, "legs:\n  subclasses: [kick]\nfight:\n  subclasses: ['k*']\n")
    with pytest.raises(ConfigError, match=r"mine.yaml:4: .*'kick' is in class 'legs' already \(line 2\)"):
        load_classes(path, ["kick"])


def test_wrong_entries_and_missing_files_are_explained(tmp_path: Path):
    with pytest.raises(ConfigError, match="no such key; did you mean 'subclasses'"):
        load_classes(written(tmp_path, "legs:\n  subclases: [kick]\n"), ["kick"])
    with pytest.raises(ConfigError, match=r"mine\.yaml:1: legs: a class needs `subclasses`"):
        load_classes(written(tmp_path, "legs:\n  description: nothing in it\n"), ["kick"])
    with pytest.raises(ConfigError, match=r"did you mean 'thesis-15'.*or use 'own'"):
        load_classes("thesis15", ["kick"])


def test_classes_name_locomotion_and_change_marks(tmp_path: Path):
    text = """\
walk:
  subclasses: [walk]
  locomotion: true
  marks:
    - {constraint: elbow_bent, side: left, columns: [2, 5], name: swing}
    - {constraint: foot_on_ground, remove: true}
"""
    (walk,) = load_classes(written(tmp_path, text), ["walk"]).classes
    assert walk.locomotion
    assert [(one.constraint, one.side, one.columns, one.remove, one.name) for one in walk.marks] == [
        ("elbow_bent", "left", (2, 5), False, "swing"), ("foot_on_ground", None, None, True, ""),
    ]  # fmt: skip
    assert walk.marks[1].where.endswith("mine.yaml:6: walk")


@pytest.mark.parametrize(
    ("mark", "message"),
    [
        ("{constraint: elbow_bend}", r"mine\.yaml:4: .*elbow_bent"),
        ("{constraint: elbow_bent, side: middle}", r"mine\.yaml:4: .*side"),
        ("{constraint: elbow_bent, columns: [5, 2]}", r"mine\.yaml:4: .*first and the last one"),
        ("{constraint: elbow_bent, remove: true, name: swing}", r"mine\.yaml:4: .*take out `name` or `remove`"),
    ],
)
def test_wrong_marks_are_named_with_their_line(tmp_path: Path, mark: str, message: str):
    path = written(tmp_path, f"walk:\n  subclasses: [walk]\n  marks:\n    - {mark}\n")
    with pytest.raises(ConfigError, match=message):
        load_classes(path, ["walk"])
