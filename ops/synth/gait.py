"""This module adds locomotion to a score: walking, jogging, turning, spinning and hopping."""

from __future__ import annotations

import math
from dataclasses import dataclass

from kinedex.ops.synth.score import Score


@dataclass(frozen=True)
class Gait:
    """The parameters of a gait, with lengths in leg lengths, times in seconds and angles in degrees.

    Attributes
    ----------
    seconds : float
        Time from one step to the next.
    stride : float
        Distance between successive foot placements.
    swing : float
        Time that a foot spends in the air, in steps.
    lift : float
        Height of the foot in the air.
    heel : float
        Pitch of the heel in the air.
    strike : float
        Pitch of the foot at landing, negative for heel first.
    sink : float
        Lowering of the pelvis.
    bob : float
        Vertical amplitude of the pelvis.
    high_when : float
        Phase of the step at which the pelvis is highest, 0 at landing.
    bend : float
        Forward bend of the trunk.
    arms : float
        Amplitude of the hands.
    elbow : float
        Lift of the hands by bent elbows.
    narrow : float
        Half the distance between the feet.
    """

    seconds: float
    stride: float
    swing: float
    lift: float
    heel: float
    strike: float
    sink: float
    bob: float
    high_when: float
    bend: float
    arms: float
    elbow: float
    narrow: float


WALK = Gait(
    seconds=0.52, stride=0.80, swing=0.76, lift=0.10, heel=38.0, strike=-16.0, sink=0.045, bob=0.030, high_when=0.5,
    bend=3.0, arms=0.36, elbow=0.04, narrow=0.085,
)  # fmt: skip
JOG = Gait(
    seconds=0.36, stride=0.80, swing=1.25, lift=0.46, heel=70.0, strike=-4.0, sink=0.075, bob=0.075, high_when=0.95,
    bend=9.0, arms=0.20, elbow=0.60, narrow=0.07,
)  # fmt: skip


def go(score: Score, gait: Gait, first: str, steps: int, curve: float = 0.0) -> list[float]:
    """Add the keyframes of several steps of a gait, which end in standing still.

    Parameters
    ----------
    score : Score
        The score to write to; its `now` advances to the end of the motion.
    gait : Gait
        The parameters of the gait.
    first : str
        The foot that starts, "l" or "r".
    steps : int
        Number of steps.
    curve : float
        Change of direction per step in degrees, positive to the left.

    Returns
    -------
    list of float
        The times in seconds at which a step begins, and the end of the last step.
    """
    score.begin(f"gait{gait.seconds}")
    times = [score.now]
    stride = score.vary(gait.stride, 0.05)
    sink = gait.sink * score.actor.habit("gait.sink" + str(gait.sink), 0.75, 1.25)
    heading = 0.0
    x, z = 0.0, 0.0
    side = first
    for number in range(steps):
        span = score.beat(gait.seconds)
        part = 0.6 if number == 0 else 1.0
        heading += curve
        ahead = stride * part * score.about(1.0, 0.04)
        _stride(score, gait, side, span, (x, z), heading, ahead, sink)
        x += ahead * math.sin(math.radians(heading))
        z += ahead * math.cos(math.radians(heading))
        score.after(span)
        times.append(score.now)
        side = "r" if side == "l" else "l"
    span = score.beat(min(0.9 * gait.seconds + 0.1, 0.62))
    _close(score, gait, side, span, (x, z), heading)
    score.after(span)
    times.append(score.now)
    return times


def _stride(
    score: Score,
    gait: Gait,
    side: str,
    span: float,
    place: tuple[float, float],
    heading: float,
    ahead: float,
    sink: float,
) -> None:
    """Add the keyframes of one step of a foot, with the pelvis above the standing foot and the arms opposite."""
    outwards = 1.0 if side == "l" else -1.0
    sine, cosine = math.sin(math.radians(heading)), math.cos(math.radians(heading))
    narrow = gait.narrow * outwards
    x, z = place
    land = (x + ahead * sine + narrow * cosine, z + ahead * cosine - narrow * sine)
    begin = span * (1.0 - gait.swing) * 0.85
    score.step(
        side, begin, begin + gait.swing * span, land, yaw=heading, lift=gait.lift, heel=gait.heel, strike=gait.strike
    )
    # At landing the pelvis is half a step behind the landing foot; in mid-stance it is over the standing foot.
    behind = 0.52 * ahead
    sway = -0.35 * narrow
    px, pz = x + (ahead - behind) * sine + sway * cosine * 0.3, z + (ahead - behind) * cosine - sway * sine * 0.3
    score.pelvis(0.0, span, px, pz, heading + outwards * -8.0 * gait.stride, roll=outwards * 2.0)
    bob = gait.bob * score.actor.habit("bob", 0.7, 1.3)
    score.move(0.0, gait.high_when * span, py=-sink + bob)
    low = (gait.high_when + 0.5) % 1.0
    score.move(
        min(low, gait.high_when) * span, max(low, 0.02) * span + (span if low < gait.high_when else 0.0), py=-sink - bob
    )
    _swing_arms(score, gait, side, span, outwards)


def _swing_arms(score: Score, gait: Gait, side: str, span: float, outwards: float) -> None:
    """Add the keyframes of arms that swing opposite to the legs, and shoulders opposite to the hips."""
    actor = score.actor
    other = "r" if side == "l" else "l"
    swing = gait.arms * actor.swing * score.size
    low = -0.955 + gait.elbow * actor.habit("gait.elbow" + str(gait.elbow), 0.7, 1.2)
    out = actor.hang_out + 0.2 * gait.elbow * actor.habit("gait.out", -0.5, 1.0)
    ahead = 0.06 + 0.50 * gait.elbow
    rise = 0.22 * swing if gait.elbow < 0.2 else 0.6 * swing
    score.hand(other, 0.0, span, out - 0.1 * gait.elbow, low + rise, ahead + swing)
    score.hand(side, 0.0, span, out, low + 0.2 * rise, ahead - 1.1 * swing)
    twist = outwards * 12.0 * min(gait.arms, 0.26) / 0.25 * actor.swing
    bend = gait.bend * actor.habit("gait.bend", 0.5, 1.4) + 0.6 * actor.stoop
    score.move(0.0, span, twist=score.about(twist, 2.0), bend=score.about(bend, 1.5), side=score.about(0.0, 1.0))
    score.move(0.0, span, pitch=score.about(0.15 * gait.bend, 0.8), nod=score.about(actor.nod - 0.4 * bend, 2.0))


def _close(score: Score, gait: Gait, side: str, span: float, place: tuple[float, float], heading: float) -> None:
    """Add the keyframes of bringing the feet together and coming to rest."""
    outwards = 1.0 if side == "l" else -1.0
    sine, cosine = math.sin(math.radians(heading)), math.cos(math.radians(heading))
    width = score.actor.stance * outwards * score.about(1.0, 0.12)
    off = score.about(0.0, 0.05)
    x, z = place
    land = (x + width * cosine + off * sine, z - width * sine + off * cosine)
    score.step(
        side, 0.12 * span, 0.8 * span, land, yaw=score.about(heading, 4.0), lift=0.7 * gait.lift, heel=0.8 * gait.heel
    )
    score.stand(0.0, span)


def spin(score: Score) -> None:
    """Add the keyframes of one full turn to the left, with the arms stretched out."""
    score.begin("spin")
    actor = score.actor
    rise = score.beat(0.45)
    arms = (actor.habit("spin.out", 0.86, 0.95), actor.habit("spin.high", -0.28, 0.02), 0.10)
    score.hands(0.0, rise, *arms)
    score.move(0.0, rise, py=-0.04, twist=-14.0, yaw=score.anchor[2] - 8.0)
    score.after(0.8 * rise)
    turn(score, score.about(360.0, 14.0), 0.30, arms)
    score.stand(0.0, score.beat(0.4))
    score.after(score.beat(0.25))


def turn(score: Score, degrees: float, seconds: float = 0.46, arms: tuple[float, float, float] | None = None) -> None:
    """Add the keyframes of a turn on the spot in several steps, to the left for positive angles.

    Parameters
    ----------
    seconds : float
        Duration of a step in seconds.
    arms : tuple[float, float, float] or None
        Position at which the hands are held; None for hanging hands.
    """
    score.begin()
    first, second = ("l", "r") if degrees > 0 else ("r", "l")
    pairs = max(1, math.ceil(abs(degrees) / score.actor.habit("turn.step", 80.0, 130.0)))
    done = 0.0
    for _ in range(pairs):
        goal = done + degrees / pairs
        for side, over in ((first, (done + goal) / 2), (second, goal)):
            _turning_step(score, side, score.beat(seconds), goal, over, math.copysign(12.0, degrees), arms)
        done = goal
    if arms is None:
        span = score.beat(0.4)
        score.stand(0.0, span)
        score.after(0.8 * span)


def _turning_step(
    score: Score, side: str, span: float, goal: float, over: float, lead: float, arms: tuple[float, float, float] | None
) -> None:
    """Add the keyframes of a step that sets a foot in direction `goal`, and turns the head and the pelvis."""
    actor = score.actor
    sign = 1.0 if side == "l" else -1.0
    angle, turned = math.radians(goal), math.radians(over)
    off = score.about(0.0, 0.04)
    place = (sign * actor.stance * math.cos(angle) + off, -sign * actor.stance * math.sin(angle) + off)
    score.step(side, 0.05 * span, 0.8 * span, place, yaw=score.about(goal, 3.0), heel=22.0, strike=0.0)
    x = actor.over_toes * math.sin(turned) - 0.025 * sign
    z = actor.over_toes * (math.cos(turned) - 1.0)
    score.pelvis(0.0, span, x, z, over + 0.4 * lead, py=-0.03, roll=score.about(0.0, 1.5))
    score.move(0.0, 0.7 * span, look=score.about(2.0 * lead, 6.0), twist=score.about(0.8 * lead, 3.0))
    for hand, way in (("l", sign), ("r", -sign)):
        score.hand(hand, 0.0, span, *(arms or _hanging(score, 0.05 * way)))
    score.after(span)


def _hanging(score: Score, ahead: float) -> tuple[float, float, float]:
    actor = score.actor
    swing = 1.6 * actor.swing
    return actor.hang_out + score.about(0.05, 0.03), -0.9, actor.hang_ahead + swing * ahead


def hop(score: Score, ahead: float = 0.6) -> None:
    """Add the keyframes of one hop forwards on both legs."""
    score.begin("hop")
    actor = score.actor
    down, up, land = score.beat(0.36), score.beat(0.40), score.beat(0.42)
    far = score.vary(ahead, 0.18)
    high = score.vary(0.26, 0.12)
    deep = score.vary(0.30, 0.12)
    back = actor.habit("hop.back", 0.1, 0.55)
    rise = actor.habit("hop.rise", -0.1, 0.5)
    score.pelvis(0.0, down, 0.0, -0.05, 0.0, py=-deep, pitch=18.0)
    score.move(0.0, down, bend=score.vary(22.0), nod=-10.0)
    score.hands(0.0, down, 0.2, -0.88, -back)
    score.hands(down, down + 0.5 * up, 0.22, rise, 0.6)
    score.pelvis(down, down + up, 0.0, far - 0.04, 0.0)
    score.move(down, down + 0.5 * up, py=high, pitch=4.0, bend=6.0)
    score.move(down + 0.5 * up, down + up + 0.45 * land, py=-0.8 * deep, pitch=14.0, bend=score.vary(20.0))
    width = actor.stance
    for side, sign in (("l", 1.0), ("r", -1.0)):
        late = score.about(0.0, 0.012)
        x, z = score.room(sign * width, far)
        take_off = down + 0.12 * up + late
        score.move(take_off, down + up + late, **{side + "x": x, side + "z": z})
        score.move(down - 0.15, take_off + 0.06, **{side + "pitch": 45.0})
        score.move(take_off, down + 0.55 * up + late, **{side + "y": high + 0.03})
        score.move(down + 0.55 * up + late, down + up + late, **{side + "y": 0.0, side + "pitch": 6.0})
        score.move(down + up + late, down + up + 0.1, **{side + "pitch": 0.0})
    score.hands(down + 0.5 * up, down + up + 0.5 * land, 0.25, -0.65, 0.45)
    score.after(down + up + 0.45 * land)
    score.stand(0.0, score.beat(0.4))
    score.after(score.beat(0.4))
