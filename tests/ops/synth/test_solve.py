"""Angles put hands and feet where the channels want them."""

from __future__ import annotations

import numpy as np
import pytest

from kinedex.ops.synth.body import BALL_HEIGHT, PARENTS, draw_actor
from kinedex.ops.synth.score import CHANNELS, INDEX
from kinedex.ops.synth.solve import columns, solve
from tests.ops.synth.bodies import places

BODY = draw_actor(0, 1).body


def channels(frames: int = 3, **values: float) -> np.ndarray:
    table = np.zeros((frames, len(CHANNELS)))
    start = {"lx": 0.14, "rx": -0.14, "pz": -0.12, "lhx": 0.2, "lhy": -0.9, "rhx": 0.2, "rhy": -0.9}
    for name, value in (start | values).items():
        table[:, INDEX[name]] = value
    return table


def test_feet_on_the_floor_stay_at_their_place_while_the_pelvis_moves() -> None:
    table = channels(5, lhy=0.0, lhz=0.8, rhy=0.0, rhz=0.8)
    table[:, INDEX["py"]] = [-0.1, -0.2, -0.4, -0.5, -0.55]
    table[:, INDEX["px"]] = [0.0, 0.05, -0.05, 0.1, 0.0]
    table[:, INDEX["yaw"]] = [0.0, 10.0, -20.0, 5.0, 0.0]
    found = places(BODY, solve(BODY, table))
    for side, sign in (("l", 1.0), ("r", -1.0)):
        wanted = np.array([sign * 0.14 * BODY.leg, BALL_HEIGHT, 0.0])
        np.testing.assert_allclose(found[side + "foot"], np.tile(wanted, (5, 1)), atol=2e-3)


def test_knees_bend_forwards_and_elbows_backwards() -> None:
    found = places(BODY, solve(BODY, channels(py=-0.5, lhy=-0.6, rhy=-0.6)))
    for side in "lr":
        middle = (found[side + "hipjoint"] + found[side + "tibia"])[0] / 2
        assert found[side + "femur"][0, 2] > middle[2] + 0.1
        middle = (found[side + "clavicle"] + found[side + "wrist"])[0] / 2
        assert found[side + "humerus"][0, 2] < middle[2] - 0.05


@pytest.mark.parametrize("place", [(0.3, -0.6, 0.4), (0.8, 0.1, 0.2), (-0.1, 0.7, 0.4), (0.1, -0.3, 0.6)])
@pytest.mark.parametrize("side", ["l", "r"])
def test_a_hand_goes_where_it_should(side: str, place: tuple[float, float, float]) -> None:
    x, y, z = place
    found = places(BODY, solve(BODY, channels(**{side + "hx": x, side + "hy": y, side + "hz": z})))
    arm = BODY.length(side + "humerus", side + "radius", side + "wrist")
    outwards = 1.0 if side == "l" else -1.0
    reached = (found[side + "wrist"] - found[side + "clavicle"])[0] / arm
    np.testing.assert_allclose(reached, [outwards * x, y, z], atol=2e-3)


def test_a_place_out_of_reach_is_approached_and_not_torn_for() -> None:
    found = places(BODY, solve(BODY, channels(rhx=0.0, rhy=0.3, rhz=3.0)))
    arm = BODY.length("rhumerus", "rradius", "rwrist")
    distance = np.linalg.norm(found["rwrist"] - found["rclavicle"], axis=1)
    assert np.all(distance <= arm)
    assert np.all(distance > 0.97 * arm)


def test_the_pelvis_gives_way_where_legs_are_too_short() -> None:
    found = places(BODY, solve(BODY, channels(lz=0.6, rz=-0.6, py=0.0)))
    np.testing.assert_allclose(found["lfoot"][:, 2], 0.6 * BODY.leg, atol=0.01)
    np.testing.assert_allclose(found["rfoot"][:, 2], -0.6 * BODY.leg, atol=0.01)


def test_nothing_goes_below_the_floor() -> None:
    found = places(
        BODY, solve(BODY, channels(py=-1.2, pitch=-88.0, lfree=1.0, rfree=1.0, ly=0.08, ry=0.08, lz=0.9, rz=0.9))
    )
    assert min(place[:, 1].min() for place in found.values()) > 0.0


def test_every_movable_bone_has_its_columns() -> None:
    table = columns(BODY)
    assert table[0] == ("root", ("tx", "ty", "tz", "rx", "ry", "rz"))
    assert {name for name, _ in table[1:]} == set(PARENTS) - {"lhipjoint", "rhipjoint"}
    assert solve(BODY, channels()).shape[1] == sum(len(dofs) for _, dofs in table)
