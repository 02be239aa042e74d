"""Rounds of priors on a squat whose legs are not tracked for half a second."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.ops.body.features import words as feature_words
from kinedex.ops.body.kinematic_chain import ChainBody, Poses, forward
from kinedex.ops.errors import ParameterError
from kinedex.ops.priors.archive_poses import PriorMotion, pose_table
from kinedex.ops.priors.stabilisation import Settings, StabilisedTrack, Track, stabilise
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.tracking.contours import Observed
from kinedex.ops.tracking.observations import JointPositions, PriorTerms
from kinedex.ops.tracking.take_tracker import TakeTrack, track_take
from kinedex.ops.tracking.trust import restart, trust
from tests.ops.body.test_kinematic_chain import BODY, CHAIN
from tests.oracles.kinematic_chain import exp
from tests.plain_python import slow_as_python

FRAMES, FAILS = 40, slice(12, 26)
FEATURES = load_feature_set("body40")
SQUAT = slice(4, 36)
"""The frames that the template knows."""


def squat(depth: float) -> Poses:
    """A body that bends hips and knees and stretches again."""
    bend = depth * np.sin(np.linspace(0, np.pi, FRAMES)) ** 2
    rotations = np.tile(np.eye(3), (FRAMES, len(CHAIN.nodes), 1, 1))
    positions = np.tile([0.0, 1.0, 0.0], (FRAMES, 1))
    for t, angle in enumerate(bend):
        for side in "lr":
            rotations[t, CHAIN.nodes.index(f"{side}hip")] = exp(np.array([-angle, 0, 0]))
            rotations[t, CHAIN.nodes.index(f"{side}knee")] = exp(np.array([2 * angle, 0, 0]))
        positions[t, 1] = 0.1 + 0.84 * np.cos(angle)
    return Poses(positions, rotations)


TRUTH = squat(1.0)
JOINTS = np.moveaxis(forward(BODY, TRUTH)[0], 2, 0)


def words_of(poses: Poses) -> np.ndarray:
    positions, _ = forward(BODY, poses)
    upright = np.tile([[1.0], [0.0], [0.0], [0.0]], (1, len(poses.positions)))
    return feature_words(positions[[CHAIN.joint(j) for j in FEATURES.joints]], upright, 30.0, FEATURES.rules)


def words(track: Track) -> np.ndarray:
    return words_of(track.poses)


def motion(name: str, depths: tuple[float, ...], template: np.ndarray) -> PriorMotion:
    frames = np.arange(SQUAT.start, SQUAT.stop)
    table = pose_table([squat(depth) for depth in depths], [frames] * len(depths))
    return PriorMotion(name, QuantisedTemplate(np.full(len(frames), (1 << 40) - 1, np.uint64), template[SQUAT]), table)


KNOWN = motion("squat", (0.9, 1.0, 1.1), words_of(TRUTH))


@dataclass(frozen=True)
class PlaceTracker:
    """The tracker of whole takes, on places of joints."""

    observations: JointPositions
    body: ChainBody = BODY
    rate_hz: float = 30.0
    carries_over: bool = False

    def track(self, start: Poses, priors: PriorTerms | None) -> TakeTrack:
        return track_take(Observed(self.body, self.rate_hz, self.observations), start, priors, schedule=(3.0,))

    def nodes_seen(self, track: Track) -> np.ndarray:
        return trust(self.body, self.observations, None, track.poses).nodes_seen

    def restart(self, poses: Poses, nodes_seen: np.ndarray) -> Poses:
        return restart(self.body, poses, nodes_seen)


def failing() -> PlaceTracker:
    """A track without legs for half a second, but for an ankle that is far off."""
    random = np.random.default_rng(3)
    positions = JOINTS + random.normal(0, 0.003, JOINTS.shape)
    legs = [CHAIN.joint(side + name) for side in "lr" for name in ("knee", "ankle", "toes")]
    positions[FAILS, legs] = np.nan
    positions[FAILS, legs[1]] = JOINTS[FAILS, legs[1]] + [0.5, 0.2, 0.3]
    return PlaceTracker(JointPositions(positions, np.full(positions.shape[:2], 0.02)))


TRACKER = failing()


@pytest.fixture(scope="module")
def without() -> TakeTrack:
    return TRACKER.track(squat(0.6), None)


def error_mm(track: Track) -> float:
    return float(1000 * np.linalg.norm(track.positions[FAILS] - JOINTS[FAILS], axis=2).mean())


def run(without: TakeTrack, motions: list[PriorMotion], **settings: object) -> StabilisedTrack:
    return stabilise(TRACKER, without, words, motions, Settings(**{"threshold": 0.3, **settings}))  # type: ignore[arg-type]


@slow_as_python
def test_the_archive_repairs_the_legs_and_two_runs_give_the_same_bytes(without: TakeTrack):
    first, second = run(without, [KNOWN]), run(without, [KNOWN])
    assert error_mm(first.track) < 0.5 * error_mm(without)
    assert first.track.positions.tobytes() == second.track.positions.tobytes()
    assert ("archive", "squat", True) in {(row.kind, row.motion, row.kept) for row in first.rounds[0].rows}
    assert first.moved_mm.shape == (FRAMES, 24)
    np.testing.assert_array_equal(first.rounds[-1].costs, first.track.costs)


@slow_as_python
def test_without_a_hit_nothing_changes(without: TakeTrack):
    other = motion("other", (1.0,), words_of(TRUTH) ^ np.uint64((1 << 40) - 1))
    for motions in ([], [other]):
        done = run(without, motions)
        assert done.track is without
        assert [one.rows for one in done.rounds] == [()]
        assert not done.moved_mm.any()


@slow_as_python
def test_without_weight_the_track_is_the_one_without_priors(without: TakeTrack):
    done = run(without, [KNOWN], factors={"archive": 0.0}, guard=np.inf)
    same = TRACKER.track(TRACKER.restart(without.poses, TRACKER.nodes_seen(without)), None)
    assert done.rounds[0].rows
    np.testing.assert_allclose(done.track.positions, same.positions, atol=2e-3)


@slow_as_python
def test_a_prior_that_is_the_track_changes_nothing():
    tracker = PlaceTracker(JointPositions(JOINTS, np.full(JOINTS.shape[:2], 0.02)))
    track = tracker.track(TRUTH, None)
    frames = np.arange(SQUAT.start, SQUAT.stop)
    own = PriorMotion("own", KNOWN.template, pose_table([track.poses], [frames]))
    done = stabilise(tracker, track, words, [own], Settings(threshold=0.3))
    assert done.rounds[0].rows
    assert done.moved_mm.max() < 1.0


@slow_as_python
def test_when_every_hit_is_withdrawn_the_track_is_the_one_without_priors(without: TakeTrack):
    done = run(without, [KNOWN], guard=0.0, rounds=1)
    assert done.track is without
    rows = done.rounds[0].rows
    assert rows
    assert not any(row.kept for row in rows)
    assert all("times as badly as without priors" in row.reason for row in rows)


@slow_as_python
def test_another_motion_takes_the_place_of_one_that_the_observations_refute(without: TakeTrack):
    table = KNOWN.poses
    assert table is not None
    random = np.random.default_rng(5)
    shaken = np.array([[exp(v) for v in row] for row in random.normal(0, 0.5, (*table.means.shape[:2], 3))])
    wrong = PriorMotion("wrong", KNOWN.template, table._replace(means=shaken))
    done = run(without, [wrong, KNOWN], rounds=1, factors={"archive": 3.0})
    found = {(row.motion, row.kept) for row in done.rounds[0].rows}
    assert {("wrong", False), ("squat", True)} <= found
    assert error_mm(done.track) < 0.5 * error_mm(without)


@slow_as_python
def test_a_round_that_fits_worse_as_a_whole_is_undone_where_priors_carry_over(without: TakeTrack):
    inside = (np.arange(FRAMES) >= SQUAT.start) & (np.arange(FRAMES) < SQUAT.stop)
    better = replace(without, costs=np.where(inside, without.costs, 0.0))  # beyond the hit
    settings = Settings(threshold=0.3, guard=10.0)
    done = stabilise(replace(TRACKER, carries_over=True), better, words, [KNOWN], settings)
    assert done.track is better
    assert len(done.rounds) == 1
    assert any(not row.kept and "all frames together" in row.reason for row in done.rounds[0].rows)


@slow_as_python
def test_the_priors_of_the_thesis_alone_run_through(without: TakeTrack):
    done = run(without, [KNOWN], kinds=("logical", "pose"), rounds=1)
    assert np.isfinite(done.track.positions).all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"kinds": ("poses",)}, "kinds must be of logical, pose, archive"),
        ({"factors": {"arch": 1.0}}, "factors must be not negative"),
        ({"threshold": 0.0}, "threshold must be above 0"),
        ({"guard": -1.0}, "guard must be 0 or above"),
        ({"rounds": 0}, "rounds must be 1 or more"),
    ],
)
def test_settings_out_of_range_are_refused(settings: dict[str, object], message: str):
    with pytest.raises(ParameterError, match=message):
        Settings(**settings)  # type: ignore[arg-type]
