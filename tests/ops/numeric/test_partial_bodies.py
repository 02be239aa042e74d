"""Motions of bodies of which joints are not known are learned and found by the other joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.arrays import F64
from kinedex.ops.body.facing_direction import mirrored_positions
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.numeric.channels import channels
from kinedex.ops.numeric.discriminant import Discriminant
from kinedex.ops.numeric.partial_bodies import (
    channel_columns,
    completed,
    descriptor_columns,
    known_stretches,
    restricted_discriminant,
)
from kinedex.ops.numeric.recogniser import Recogniser, TaughtMotion
from kinedex.ops.numeric.span_descriptors import SpanSums
from tests.ops.numeric.motions import MIRROR, RATE_HZ, in_a_row, motion
from tests.ops.numeric.test_channels import hidden

NAMES = ("raise left", "raise right", "bow")
ARCHIVE = [in_a_row(["walk", "stand", "walk"], [60, 50, 40], 500)]
ROW, LENGTHS = ["bow", "raise right", "raise left", "bow"], [40, 36, 44, 38]
TAKE = in_a_row(ROW, LENGTHS, 100)
HIDDEN = ("lfingers", "rfingers", "ltoes", "rtoes", "rankle", "rknee", "rhip", "head", "relbow")


def examples(without: Sequence[str] = ()) -> list[TaughtMotion]:
    """Return three examples of each class, without some joints."""
    return [TaughtMotion(hidden(motion(NAMES[k % 3], 34 + 2 * k, k), without), NAMES[k % 3]) for k in range(9)]


def names_of(taught: Recogniser, take: F64) -> list[str]:
    """Return the labels of a take."""
    return [one.label for one in taught.label(take)]


@pytest.fixture(scope="module")
def taught() -> Recogniser:
    return Recogniser.fit(examples(), ARCHIVE, JOINTS, RATE_HZ, MIRROR)


@settings(max_examples=15, deadline=None)
@given(st.lists(st.sampled_from(HIDDEN), max_size=4, unique=True))
def test_a_take_is_labelled_by_the_joints_that_it_has(names: list[str]) -> None:
    recogniser = Recogniser.fit(examples(), ARCHIVE, JOINTS, RATE_HZ, MIRROR)
    found = recogniser.label(hidden(TAKE, names))
    assert [one.label for one in found] == ROW
    assert all(one.probability > 0.9 for one in found)
    assert recogniser.classes[int(recogniser.classify(hidden(motion("bow", 40, 70), names)).argmax())] == "bow"


def test_what_no_example_knows_is_not_learned() -> None:
    partial = Recogniser.fit(examples(["lfingers", "head"]), ARCHIVE, JOINTS, RATE_HZ)
    assert {name for name, one in zip(JOINTS, partial.known, strict=True) if not one} == {"lfingers", "head"}
    found = partial.label(TAKE)
    assert [one.label for one in found] == ROW
    assert found == partial.label(hidden(TAKE, ["lfingers", "head"]))


def test_mirror_images_know_what_the_other_side_has() -> None:
    partial = Recogniser.fit(examples(["lfingers", "head"]), ARCHIVE, JOINTS, RATE_HZ, MIRROR)
    assert {name for name, one in zip(JOINTS, partial.known, strict=True) if not one} == {"head"}
    assert names_of(partial, TAKE) == ROW


def test_what_another_example_knows_is_learned() -> None:
    given_ = examples()
    given_[2] = TaughtMotion(hidden(given_[2].positions, ["rwrist", "rfingers"]), given_[2].label)
    recogniser = Recogniser.fit(given_, ARCHIVE, JOINTS, RATE_HZ, MIRROR)
    assert recogniser.known.all()
    assert names_of(recogniser, TAKE) == ROW


def test_unknown_joints_of_an_example_move_as_in_the_others() -> None:
    clips = [motion("bow", frames, seed) for seed, frames in enumerate((30, 30, 30))]
    found = [channels(one, JOINTS, RATE_HZ) for one in (*clips[:2], hidden(clips[2], ["rwrist"]))]
    made, known = completed(found, np.zeros(3, np.int64), JOINTS)
    assert known.all()
    assert made[0] is found[0]
    only = np.array([name == "rwrist" for name in JOINTS])
    columns = channel_columns(only, JOINTS)
    columns[-6:] = False
    np.testing.assert_allclose(made[2].frames[:, columns], (found[0].frames + found[1].frames)[:, columns] / 2)
    np.testing.assert_array_equal(made[2].frames[:, ~columns], found[2].frames[:, ~columns])


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 99), hide=st.sets(st.sampled_from(JOINTS[1:]), max_size=12))
def test_columns_are_those_that_do_not_depend_on_hidden_joints(seed: int, hide: set[str]) -> None:
    known = np.array([name not in hide for name in JOINTS])
    take = motion("walk", 20)
    moved = take.copy()
    moved[:, ~known] += np.random.default_rng(seed).normal(size=(20, int((~known).sum()), 3))
    for side in "lr":  # the heading and the size stay
        for name in ("hip", "knee", "ankle", "shoulder"):
            moved[:, JOINTS.index(side + name)] = take[:, JOINTS.index(side + name)]
    both = [channels(one, JOINTS, RATE_HZ) for one in (take, moved)]
    columns = channel_columns(known, JOINTS)
    assert len(columns) == both[0].frames.shape[1]
    np.testing.assert_array_equal(both[0].frames[:, columns], both[1].frames[:, columns])
    described = [SpanSums(one, RATE_HZ).describe(np.array([0, 3]), np.array([20, 9])) for one in both]
    columns = descriptor_columns(known)
    assert len(columns) == described[0].shape[1]
    np.testing.assert_array_equal(described[0][:, columns], described[1][:, columns])


def test_a_restricted_discriminant_has_its_part_of_the_covariance() -> None:
    generator = np.random.default_rng(4)
    classes = np.repeat(np.arange(3), 8)
    descriptors = generator.normal(size=(3, 6))[classes] + generator.normal(size=(24, 6)) @ generator.normal(
        size=(6, 6)
    )
    whole = Discriminant.fit(descriptors, classes)
    columns = np.array([True, False, True, True, False, True])
    found = restricted_discriminant(whole, columns)
    covariance = (whole.lower @ whole.lower.T)[columns][:, columns]
    np.testing.assert_allclose(found.weights, np.linalg.inv(covariance) @ whole.means[:, columns].T, atol=1e-8)
    own = descriptors[:, columns]
    plain = Discriminant.fit(own, classes)
    np.testing.assert_allclose(found.log_posteriors(own), plain.log_posteriors(own), atol=0.01)
    everything = restricted_discriminant(whole, np.ones(6, bool))
    np.testing.assert_allclose(everything.log_posteriors(descriptors), whole.log_posteriors(descriptors), atol=1e-8)


def test_states_restricted_to_all_channels_are_the_same(taught: Recogniser) -> None:
    frames = channels(TAKE, JOINTS, RATE_HZ).frames
    everything = taught.model.rows.restricted(np.ones(frames.shape[1], bool))
    np.testing.assert_allclose(everything.states, taught.model.rows.states, atol=1e-8)
    np.testing.assert_allclose(everything.project(frames), taught.model.rows.project(frames), atol=1e-3)


def test_no_label_reaches_over_a_long_gap(taught: Recogniser) -> None:
    bow = motion("bow", 40, 70)
    gap = np.full((30, 24, 3), np.nan)
    found = taught.label(np.concatenate([bow[:20], gap, bow[20:], bow]))
    assert all(one.stop <= 20 or one.start >= 50 for one in found)
    assert [one.label for one in found][-1] == "bow"
    assert known_stretches(np.concatenate([gap, bow, gap[:10], bow, gap, bow[:1], gap, bow[:2]]), RATE_HZ) == [
        (30, 120), (181, 183),
    ]  # fmt: skip
    assert taught.label(gap) == []


@settings(max_examples=10, deadline=None)
@given(st.sets(st.sampled_from(["lfingers", "rtoes", "rwrist", "head", "lelbow"]), max_size=3))
def test_labels_of_a_mirror_image_are_mirrored(names: set[str]) -> None:
    one_sided = [one for one in examples() if one.label != "raise right"]
    both = [TaughtMotion(mirrored_positions(one.positions, JOINTS), MIRROR[one.label]) for one in one_sided]
    recogniser = Recogniser.fit(
        [*one_sided, *both], [*ARCHIVE, mirrored_positions(ARCHIVE[0], JOINTS)], JOINTS, RATE_HZ
    )
    take = hidden(TAKE, sorted(names))
    found, image = (recogniser.label(one) for one in (take, mirrored_positions(take, JOINTS)))
    assert [(one.start, one.stop, MIRROR[one.label]) for one in found] == [one[:3] for one in image]
