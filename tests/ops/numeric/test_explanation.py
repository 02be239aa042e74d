"""A class is explained by quantities whose numbers are those of the motion."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.arrays import F64
from kinedex.ops.body.facing_direction import mirrored_positions, turn_about_y
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.errors import ParameterError
from kinedex.ops.numeric.channels import channels
from kinedex.ops.numeric.class_densities import ClassSums
from kinedex.ops.numeric.explanation import Explanation, Reason, explain, quantities_of
from kinedex.ops.numeric.label_windows import Window, described
from tests.ops.numeric.motions import RATE_HZ, motion

NAMES = ("raise left", "raise right", "bow", "walk")
LABELS = [NAMES[k % 4] for k in range(24)]


def descriptor(body: F64) -> F64:
    return described(Window(body, 0, len(body)), JOINTS, RATE_HZ)


EXAMPLES = np.stack([descriptor(motion(label, 36 + k, k)) for k, label in enumerate(LABELS)])


def explained(body: F64, label: str | None = None) -> Explanation:
    return explain(descriptor(body), EXAMPLES, LABELS, JOINTS, label)


def reason(found: Explanation, quantity: str) -> Reason:
    return next(one for one in found.reasons if one.quantity == quantity)


def read(name: str, body: F64) -> float:
    one = next(one for one in quantities_of(JOINTS) if one.name == name)
    return float(one.read(descriptor(body)[None])[0])


def test_a_raised_hand_speaks_for_raising_it_and_against_the_other_side() -> None:
    found = explained(motion("raise left", 41, 77))
    assert (found.label, found.probability > 0.9) == ("raise left", True)
    assert sum(one.share for one in found.reasons[:5]) > 0
    other = explained(motion("raise left", 41, 77), "raise right")
    assert (other.label, other.other) == ("raise right", "raise left")
    lower = reason(other, "height of the right hand")
    assert lower.share < 0
    assert lower.text.startswith(
        f"height of the right hand {lower.value:.2f} leg lengths, lower than in 100 % of the examples"
    )
    assert lower.value < lower.low <= lower.high


def test_the_value_of_a_quantity_is_that_of_the_motion() -> None:
    body = motion("raise left", 60, 5)
    found = channels(body, JOINTS, RATE_HZ)
    inner = slice(3, -3)  # a tenth of a second at either end is left out
    places = [3 * (JOINTS.index(joint) - 1) + 1 for joint in ("lwrist", "lfingers")]
    assert read("height of the left hand", body) == pytest.approx(found.pose[inner, places].mean())
    assert read("duration", body) == pytest.approx(2.0)
    assert read("height of the hips", body) == pytest.approx(found.root[inner, 5].mean())
    assert read("way forwards", motion("walk", 60, 3)) > 1.5
    assert read("movement of the left hand up and down", body) > 5 * read(
        "movement of the right hand up and down", body
    )
    assert read("speed of the left hand", body) > read("speed of the right hand", body)
    image = mirrored_positions(body, JOINTS)
    for name in ("height of the {} hand", "speed of the {} hand", "movement of the {} hand up and down"):
        assert read(name.format("right"), image) == pytest.approx(read(name.format("left"), body))


def test_a_turn_is_told_in_degrees_with_its_side() -> None:
    def turned(degrees: float, seed: int) -> F64:
        body = motion("stand", 60, seed)
        body = body - body[:1, :1] * [1, 0, 1]
        angles = np.radians(degrees) * np.linspace(-0.1, 1.1, 60)
        return np.stack([turn_about_y(frame, angle) for frame, angle in zip(body, angles, strict=True)])

    labels = ["turn left"] * 8 + ["turn right"] * 8
    every = np.stack([descriptor(turned(sign * (75 + 5 * k), k)) for sign in (1, -1) for k in range(8)])
    found = explain(descriptor(turned(95, 40)), every, labels, JOINTS)
    assert found.label == "turn left"
    told = reason(found, "turn")
    assert told.share > 0
    assert told.text == f"turns left by {round(told.value)}°, examples {round(told.low)}° to {round(told.high)}°"
    assert told.value == pytest.approx(103, abs=6)  # of 60 frames with a tenth of a turn more at either end


def test_shares_add_up_to_the_evidence() -> None:
    one = descriptor(motion("bow", 44, 50))
    classes = np.array([NAMES.index(label) for label in LABELS])
    densities = ClassSums(EXAMPLES, classes, 4).without(np.empty(0, np.int64))
    distances = densities.squared_distances(one[None])[0]
    for other in (0, 1, 3):
        assert densities.shares(one, 2, other).sum() == pytest.approx(0.5 * (distances[other] - distances[2]))
    found = explained(motion("bow", 44, 50))
    other = NAMES.index(found.other)
    assert found.evidence == pytest.approx(0.5 * (distances[other] - distances[2]))


def test_no_number_belongs_to_two_quantities() -> None:
    numbers = [number for one in quantities_of(JOINTS) for number in one.numbers]
    assert len(numbers) == len(set(numbers))
    assert max(numbers) == EXAMPLES.shape[1] - 1


def test_what_cannot_be_explained_is_refused() -> None:
    with pytest.raises(ParameterError, match="a class with examples"):
        explained(motion("bow", 40), "nod")
    with pytest.raises(ParameterError, match="of two classes or more"):
        explain(EXAMPLES[0], EXAMPLES[:1], ["bow"], JOINTS)
