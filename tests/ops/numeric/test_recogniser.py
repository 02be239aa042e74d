"""Motions that examples teach are found in takes, wherever they are, and on whichever side."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.body.facing_direction import mirrored_positions, turn_about_y
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.body.resample import resample
from kinedex.ops.errors import ParameterError
from kinedex.ops.numeric.recogniser import Recogniser, TaughtMotion
from tests.ops.numeric.motions import MIRROR, RATE_HZ, in_a_row, motion

NAMES = ("raise left", "raise right", "bow")
ARCHIVE = [in_a_row(["walk", "stand", "walk"], [60, 50, 40], 500)]
ROW, LENGTHS = ["bow", "stand", "raise right", "raise left", "walk", "bow"], [40, 60, 36, 44, 70, 38]


@pytest.fixture(scope="module")
def taught() -> Recogniser:
    examples = [TaughtMotion(motion(NAMES[k % 3], 34 + 2 * k, k), NAMES[k % 3]) for k in range(9)]
    return Recogniser.fit(examples, ARCHIVE, JOINTS, RATE_HZ, MIRROR)


def test_motions_are_found_between_others(taught: Recogniser) -> None:
    found = taught.label(in_a_row(ROW, LENGTHS, 100), readiness=1.0)
    assert [one.label for one in found] == ["bow", "raise right", "raise left", "bow"]
    edges = np.cumsum([0, *LENGTHS])
    true = [(edges[k], edges[k + 1]) for k in (0, 2, 3, 5)]
    assert all(
        abs(one.start - start) < 15 and abs(one.stop - stop) < 15
        for one, (start, stop) in zip(found, true, strict=True)
    )
    assert all(one.probability > 0.9 for one in found)


@settings(max_examples=12, deadline=None)
@given(yaw=st.floats(-3.1, 3.1), x=st.floats(-50, 50), z=st.floats(-50, 50), size=st.floats(0.4, 2.5))
def test_place_heading_and_size_do_not_matter(taught: Recogniser, yaw: float, x: float, z: float, size: float) -> None:
    take = in_a_row(ROW, LENGTHS, 100)
    found = taught.label(size * (turn_about_y(take, yaw) + np.array([x, 0.0, z])))
    assert [one[:3] for one in found] == [one[:3] for one in taught.label(take)]


@settings(max_examples=8, deadline=None)
@given(sizes=st.lists(st.floats(0.5, 2.0), min_size=9, max_size=9), yaw=st.floats(-3.1, 3.1))
def test_places_and_sizes_of_examples_do_not_matter(taught: Recogniser, sizes: list[float], yaw: float) -> None:
    examples = [
        TaughtMotion(sizes[k] * turn_about_y(motion(NAMES[k % 3], 34 + 2 * k, k), yaw), NAMES[k % 3]) for k in range(9)
    ]
    other = Recogniser.fit(examples, ARCHIVE, JOINTS, RATE_HZ, MIRROR)
    take = in_a_row(ROW, LENGTHS, 100)
    assert [one[:3] for one in other.label(take)] == [one[:3] for one in taught.label(take)]


@pytest.mark.parametrize("source_hz", [60.0, 90.0, 120.0])
def test_rates_of_sources_do_not_matter(taught: Recogniser, source_hz: float) -> None:
    take = in_a_row(ROW, LENGTHS, 100)
    tracks = np.ascontiguousarray(take.transpose(1, 2, 0))
    still = np.tile(np.array([[1.0], [0.0], [0.0], [0.0]]), len(take))
    fine = resample(tracks, still, RATE_HZ, source_hz)
    again = resample(fine.positions, fine.orientation, source_hz, RATE_HZ).positions.transpose(2, 0, 1)
    assert [one[:3] for one in taught.label(again)] == [one[:3] for one in taught.label(take)]


def test_a_mirror_image_has_the_mirrored_labels() -> None:
    one_sided = [
        TaughtMotion(motion(("raise left", "bow")[k % 2], 34 + 2 * k, k), ("raise left", "bow")[k % 2])
        for k in range(6)
    ]
    both = [TaughtMotion(mirrored_positions(one.positions, JOINTS), MIRROR[one.label]) for one in one_sided]
    taught = Recogniser.fit([*one_sided, *both], ARCHIVE, JOINTS, RATE_HZ, MIRROR)
    take = in_a_row(["bow", "raise right", "raise left"], [40, 40, 44], 60)
    found, image = (taught.label(one) for one in (take, mirrored_positions(take, JOINTS)))
    assert [(one.start, one.stop, MIRROR[one.label]) for one in found] == [one[:3] for one in image]


def test_whole_takes_are_classified(taught: Recogniser) -> None:
    for k, name in enumerate(NAMES):
        assert taught.classes[int(taught.classify(motion(name, 41, 200 + k)).argmax())] == name


def test_one_example_of_a_class_is_enough_to_start() -> None:
    taught = Recogniser.fit(
        [TaughtMotion(motion(name, 40, k), name) for k, name in enumerate(NAMES)], [], JOINTS, RATE_HZ
    )
    assert [one.label for one in taught.label(in_a_row(["raise left", "bow"], [40, 44], 90))] == ["raise left", "bow"]


def test_examples_that_teach_nothing_are_refused() -> None:
    with pytest.raises(ParameterError, match="at least one"):
        Recogniser.fit([], ARCHIVE, JOINTS, RATE_HZ)
    with pytest.raises(ParameterError, match="of 3 frames or more"):
        Recogniser.fit([TaughtMotion(motion("bow", 2), "bow")], ARCHIVE, JOINTS, RATE_HZ)
