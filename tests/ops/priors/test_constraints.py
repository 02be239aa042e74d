"""Logical constraints: the marked regions of templates, and the pulls of each kind."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.body.kinematic_chain import Poses, forward
from kinedex.ops.errors import ParameterError
from kinedex.ops.priors.constraints import (
    Mark,
    MarkEdit,
    front_pulls,
    ground_pulls,
    joined,
    straight_elbow,
    template_marks,
)
from kinedex.ops.templates.templates import QuantisedTemplate
from tests.ops.body.test_kinematic_chain import BODY, CHAIN
from tests.oracles import kinematic_chain as oracle

BITS = {"rfoot_fast": 0, "rfoot_raised": 1, "relbow_bent": 2, "lelbow_bent": 3, "rhand_forwards": 4}


def exp(vector: list[float]) -> np.ndarray:
    """The rotation of a vector."""
    return oracle.exp(np.array(vector, np.float64))


def template(columns: list[str]) -> QuantisedTemplate:
    """Columns of 0, 1 and * for a wildcard, feature by feature."""
    mask = [sum(1 << i for i, c in enumerate(column) if c != "*") for column in columns]
    value = [sum(1 << i for i, c in enumerate(column) if c == "1") for column in columns]
    return QuantisedTemplate(np.array(mask, np.uint64), np.array(value, np.uint64))


STEP = template(["00***", "001**", "001**", "001**", "10*1*", "10*1*", "1*01*", "*0***"])


def test_runs_of_three_columns_that_fix_the_features_are_marked():
    assert template_marks(STEP, BITS) == (
        Mark("foot_on_ground", "right", 0, 4), Mark("elbow_bent", "left", 4, 7), Mark("elbow_bent", "right", 1, 4),
    )  # fmt: skip
    assert Mark("foot_to_front", "right", 4, 7) in template_marks(STEP, BITS, locomotion=True)
    assert template_marks(STEP, {}) == ()


def test_edits_add_remove_and_name_regions():
    edits = [
        MarkEdit("elbow_bent", None, (0, 1), remove=True),
        MarkEdit("foot_on_ground", remove=True),
        MarkEdit("hand_to_front", "right", (5, 7), name="swing"),
        MarkEdit("elbow_bent", "left", (2, 3), name="hold"),
    ]
    assert template_marks(STEP, BITS, edits=edits) == (
        Mark("elbow_bent", "left", 2, 7, "hold"), Mark("elbow_bent", "right", 2, 4),
        Mark("hand_to_front", "right", 5, 8, "swing"),
    )  # fmt: skip
    with pytest.raises(ParameterError, match=r"from 0 to 7.*my\.yaml:3: columns 2 to 8"):
        template_marks(STEP, BITS, edits=[MarkEdit("elbow_bent", "left", (2, 8), where="my.yaml:3")])


def standing_poses(frames: int) -> Poses:
    return Poses(np.zeros((frames, 3)), np.tile(np.eye(3), (frames, len(CHAIN.nodes), 1, 1)))


def test_a_foot_on_the_ground_is_pulled_to_its_own_lowest_places():
    poses = standing_poses(11)
    poses.positions[:, 1] = np.arange(11) / 10
    positions, _ = forward(BODY, poses)
    found = ground_pulls(BODY, positions, np.arange(11) == 7, "left")
    ankle, toes = CHAIN.joint("lankle"), CHAIN.joint("ltoes")
    assert (found.frames.tolist(), found.joints.tolist()) == ([7, 7], [ankle, toes])
    assert found.targets == pytest.approx([positions[ankle, 1, 1], positions[toes, 1, 1]])
    assert found.weights == pytest.approx([1 / 0.03**2] * 2)
    assert found.directions.tolist() == [[0, 1, 0]] * 2


def test_a_hand_that_lags_is_pulled_the_rest_of_its_way_along_the_forward_direction():
    poses = standing_poses(3)
    poses.rotations[:, 0] = exp([0, np.pi / 2, 0])  # facing +X
    positions, _ = forward(BODY, poses)
    wrist, speed = CHAIN.joint("rwrist"), 1.3 * 0.28 / 30
    positions[wrist, 0, 1:] += 0.004
    positions[wrist, 0, 2:] += 0.1
    found = front_pulls(BODY, poses, positions, np.ones(3, np.bool_), "hand_to_front", "right", 30.0)
    assert found.frames.tolist() == [1]  # the first frame has none before it, the last is fast enough
    np.testing.assert_allclose(found.directions, [[1, 0, 0]], atol=1e-12)
    assert found.targets == pytest.approx([positions[wrist, 0, 1] + speed - 0.004])


@pytest.mark.parametrize(("side", "sign"), [("left", -1.0), ("right", 1.0)])
def test_an_elbow_that_is_less_bent_is_pulled_to_60_degrees(side: str, sign: float):
    poses = standing_poses(3)
    node = CHAIN.nodes.index(side[0] + "elbow")
    poses.rotations[1, node], poses.rotations[2, node] = exp([0, sign * 0.9, 0]), exp([0, sign * 1.2, 0])
    found, straight, target = straight_elbow(BODY, poses, np.array([False, True, True]), side)  # type: ignore[arg-type]
    assert (found, straight.tolist()) == (node, [False, True, False])
    np.testing.assert_allclose(target, exp([0, sign * np.pi / 3, 0]), atol=1e-12)


def test_pulls_are_joined_by_frames():
    positions, _ = forward(BODY, standing_poses(2))
    parts = [ground_pulls(BODY, positions, np.array([True, True]), side) for side in ("left", "right")]
    assert joined(parts).frames.tolist() == [0, 0, 0, 0, 1, 1, 1, 1]
    assert len(joined([]).frames) == 0
