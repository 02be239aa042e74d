"""Synthetic actors move as people can, and do what they are labelled with."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.errors import ParameterError
from kinedex.ops.synth.body import actor_name, draw_actor
from kinedex.ops.synth.performance import MOTIONS, RATE_HZ, perform_clip, perform_take
from tests.ops.synth.bodies import places

SEED = 5


def test_the_same_seed_gives_the_same_motion_and_another_one_another() -> None:
    actor = draw_actor(1, SEED)
    first, again, other = (perform_clip(actor, "squat1Reps", 0, seed) for seed in (SEED, SEED, SEED + 1))
    assert first.angles.tobytes() == again.angles.tobytes()
    assert first.angles.tobytes() != other.angles.tobytes()
    assert perform_clip(actor, "squat1Reps", 1, SEED).angles.tobytes() != first.angles.tobytes()


def test_actors_differ_in_size_tempo_and_range() -> None:
    actors = [draw_actor(number, SEED) for number in range(5)]
    assert len({actor.name for actor in actors}) == 5
    for spread in (
        [actor.body.leg for actor in actors],
        [actor.tempo for actor in actors],
        [actor.range for actor in actors],
    ):
        assert max(spread) / min(spread) > 1.08
    assert len({actor_name(number) for number in range(600)}) == 600
    assert all(len(actor_name(number)) == 2 for number in range(600))


@pytest.mark.parametrize("name", [motion.name for motion in MOTIONS])
def test_a_clip_is_labelled_from_end_to_end_and_stays_above_the_floor(name: str) -> None:
    actor = draw_actor(2, SEED)
    performance = perform_clip(actor, name, 0, SEED)
    assert 0.3 * RATE_HZ < len(performance.angles) < 8 * RATE_HZ
    (label,) = performance.labels
    assert (label.start, label.stop) == (0, len(performance.angles))
    found = places(actor.body, performance.angles[::12])
    lowest = min(place[:, 1].min() for place in found.values())
    assert -0.02 < lowest < 0.12


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("squat1Reps", lambda at: at["root"][:, 1].min() < 0.7 * at["root"][:, 1].max()),
        ("jumpingJack1Reps", lambda at: np.ptp(np.abs(at["lfoot"] - at["rfoot"])[:, [0, 2]].max(axis=1)) > 0.4),
        ("cartwheelLeft", lambda at: (at["head"][:, 1] < at["root"][:, 1] - 0.2).any()),
        ("lieDown", lambda at: at["head"][-1, 1] < 0.4),
        ("getUp", lambda at: at["head"][-1, 1] > 1.2),
        ("kickLeft1Reps", lambda at: at["ltoes"][:, 1].max() > 0.5 > at["rtoes"][:, 1].max()),
        ("kickRight1Reps", lambda at: at["rtoes"][:, 1].max() > 0.5 > at["ltoes"][:, 1].max()),
        ("sitDown", lambda at: at["root"][-1, 1] < 0.75 * at["root"][0, 1]),
    ],
)
def test_a_motion_does_what_its_name_says(name: str, what: object) -> None:
    actor = draw_actor(0, SEED)
    assert callable(what)
    assert what(places(actor.body, perform_clip(actor, name, 1, SEED).angles[::6]))


def test_a_take_is_labelled_in_order_without_overlap_and_moves_at_human_speed() -> None:
    actor = draw_actor(3, SEED)
    take = perform_take(actor, 25.0, 0, SEED)
    assert len(take.angles) >= 25.0 * RATE_HZ
    assert len(take.labels) >= 4
    bounds = [bound for label in take.labels for bound in (label.start, label.stop)]
    assert bounds == sorted(bounds)
    assert 0 <= bounds[0] < bounds[-1] <= len(take.angles)
    assert {label.label for label in take.labels} <= {motion.label for motion in MOTIONS}
    found = places(actor.body, take.angles[1200:1800])
    for bone, most in (("root", 4.0), ("lfingers", 14.0), ("rtoes", 11.0), ("head", 7.0)):
        speed = np.linalg.norm(np.diff(found[bone], axis=0), axis=1) * RATE_HZ
        assert speed.max() < most


def test_feet_on_the_floor_do_not_slide() -> None:
    actor = draw_actor(0, SEED)
    clip = perform_clip(actor, "walk4StepsLstart", 0, SEED)
    found = places(actor.body, clip.angles)
    for side in "lr":
        ball = found[side + "foot"]
        down = ball[:-1, 1] < 0.036
        speed = np.linalg.norm(np.diff(ball[:, [0, 2]], axis=0), axis=1) * RATE_HZ
        assert down.mean() > 0.25
        assert np.median(speed[down]) < 0.12


def test_unknown_motions_and_empty_takes_are_refused() -> None:
    with pytest.raises(ParameterError, match="motion must be one of walk"):
        perform_clip(draw_actor(0, SEED), "fly", 0, SEED)
    with pytest.raises(ParameterError, match="seconds must be above 0"):
        perform_take(draw_actor(0, SEED), 0.0, 0, SEED)
