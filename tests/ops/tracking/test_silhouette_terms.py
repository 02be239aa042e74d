"""Silhouettes in the tracker of takes: their place terms, alone and together with rays."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.body.kinematic_chain import Poses, forward
from kinedex.ops.errors import ParameterError
from kinedex.ops.tracking.contours import (
    Observed,
    Silhouettes,
    add_contours,
    contour_buffers,
    contour_sums,
    find_contours,
)
from kinedex.ops.tracking.frame_tracker import track_frames
from kinedex.ops.tracking.take_tracker import (
    TakeTrack,
    silhouette_terms,
    track_take,
    track_take_on_silhouettes,
    with_position_terms,
)
from tests.ops.tracking.scene import BODY, CAPSULES, CHAIN
from tests.ops.tracking.test_frame_tracker import FRAMES, LIMBS, MASKS, POINTS, START, TRUTH, VIEWS, motion, rays
from tests.plain_python import slow_as_python

SILHOUETTES = Silhouettes(VIEWS, MASKS, CAPSULES)
STILL = Poses(np.repeat(START.positions, FRAMES, axis=0), np.repeat(START.rotations, FRAMES, axis=0))


def apart(track: TakeTrack) -> np.ndarray:
    """Return the mean distance of the limbs' joints from the truth in each frame, in metres."""
    return np.linalg.norm(track.positions - TRUTH, axis=2)[:, LIMBS].mean(axis=1)


def test_place_terms_bound_the_squares_of_the_correspondences_and_touch_them() -> None:
    terms, shifts = silhouette_terms(BODY, STILL, SILHOUETTES)
    assert shifts[0] < shifts[-1]
    joints = np.ascontiguousarray(forward(BODY, STILL)[0][:, :, 4])
    sums, buffers = contour_sums(CAPSULES, len(joints)), contour_buffers(CAPSULES, joints)
    for view, mask in SILHOUETTES.seen(4):
        add_contours(view, buffers, find_contours(view, mask, joints, CAPSULES, buffers)[0], sums)
    own = terms.place_frames == 4
    at, weights, targets = (array[own] for array in (terms.place_joints, terms.place_weights, terms.place_targets))

    def bound(moves: np.ndarray) -> float:
        heights = (terms.place_directions[own] * (joints + moves)[at]).sum(axis=1)
        return float((weights * (heights - targets) ** 2).sum())

    def squares(moves: np.ndarray) -> float:
        ends = np.einsum("ni,nik,nk->", moves[CAPSULES.starts], sums.mixed, moves[CAPSULES.ends])
        return float(
            np.einsum("ji,jik,jk->", moves, sums.matrices, moves) + 2 * (sums.vectors * moves).sum() + 2 * ends
        )

    still = np.zeros_like(joints)
    together = np.full_like(joints, 0.02)  # where both ends move alike, the bound is exact
    assert bound(together) - bound(still) == pytest.approx(squares(together), rel=1e-6)
    for seed in range(5):
        moves = np.random.default_rng(seed).normal(0, 0.02, joints.shape)
        assert bound(moves) - bound(still) >= squares(moves)
        small = 1e-6 * moves
        assert bound(small) - bound(still) == pytest.approx(squares(small), rel=1e-3)


@slow_as_python
def test_a_take_is_tracked_on_silhouettes_alone() -> None:
    start = track_frames(Observed(BODY, 30.0, None, None, SILHOUETTES), START)
    track = track_take_on_silhouettes(Observed(BODY, 30.0, None, None, SILHOUETTES), start.poses)
    assert apart(track).max() < 0.012
    assert track.costs.max() < 1.5  # the mean way from the contour to the boundary in pixels


@slow_as_python
def test_silhouettes_show_what_keypoints_do_not() -> None:
    seen = rays()
    hidden = [CHAIN.joint(name) for name in ("lknee", "lankle", "ltoes")]
    seen.confidence[:, :, hidden] = 0.0
    alone = track_take(Observed(BODY, 30.0, seen, POINTS), STILL)
    both = track_take_on_silhouettes(Observed(BODY, 30.0, seen, POINTS, SILHOUETTES), alone.poses)
    assert apart(both)[-1] < 0.5 * apart(alone)[-1]
    assert apart(both).max() < 0.01


def test_priors_stay_beside_the_terms_of_silhouettes() -> None:
    terms, _ = silhouette_terms(BODY, motion(), SILHOUETTES)
    twice = with_position_terms(terms, terms)
    assert len(twice.place_frames) == 2 * len(terms.place_frames)
    assert (np.diff(twice.place_frames) >= 0).all()
    assert twice.turn_weights is terms.turn_weights
    with pytest.raises(ParameterError, match="masks must be those of 5 frames, got 2"):
        track_take_on_silhouettes(Observed(BODY, 30.0, None, None, Silhouettes(VIEWS, MASKS[:2], CAPSULES)), STILL)
