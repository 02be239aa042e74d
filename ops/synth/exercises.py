"""This module adds gymnastic motions to a score: squats, jumping jacks, arm circles, cartwheels."""

from __future__ import annotations

import math

from kinedex.ops.synth.score import Score


def squat(score: Score, times: int) -> list[float]:
    """Add the keyframes of deep squats, with the arms held out in front.

    Returns
    -------
    list of float
        The times at which a squat begins, and the end of the last one, seconds.
    """
    score.begin("squat")
    actor = score.actor
    ready, leave = score.beat(0.30), score.beat(0.36)
    goal = (actor.habit("squat.out", -0.10, 0.12), actor.habit("squat.high", 0.22, 0.38), 0.86)
    heel = actor.habit("squat.heel", -10.0, 30.0)
    score.hands(0.0, ready, *goal)
    score.after(0.55 * ready)
    moments = [score.now]
    for _ in range(times):
        down, hold, up = score.beat(0.80), score.beat(0.12), score.beat(0.78)
        deep = min(score.vary(actor.habit("squat.depth", 0.68, 0.84), 0.05), 0.86)
        lean = score.vary(actor.habit("squat.lean", 14.0, 30.0))
        knees = actor.habit("squat.knees", 6.0, 26.0)
        back = 0.02 if heel > 8 else -0.10 - 0.10 * deep
        score.pelvis(0.0, down, 0.0, back, 0.0, py=-deep, pitch=lean, lknee=knees, rknee=knees)
        score.move(0.0, down, bend=score.vary(lean), nod=-0.6 * lean)
        score.hands(0.0, down, *goal)
        t = down + hold
        if heel > 8:
            score.move(0.1 * down, 0.8 * down, lpitch=heel, rpitch=heel)
            score.move(t + 0.2 * up, t + 0.9 * up, lpitch=0.0, rpitch=0.0)
        score.stand(t, t + up, "trunk")
        score.hands(t, t + up, *goal)
        score.after(t + up)
        moments.append(score.now)
    score.stand(-0.1, leave)
    score.after(leave)
    return moments


def elbow_to_knee(score: Score, times: int) -> list[float]:
    """Add the keyframes of elbow-to-knee exercises: each elbow meets the opposite knee, left knee first.

    Returns
    -------
    list of float
        The times at which a pair begins, and the end of the last one, seconds.
    """
    score.begin("elbow")
    ready, leave = score.beat(0.30), score.beat(0.34)
    score.hands(0.0, ready, -0.22, 0.38, 0.06)
    score.move(0.0, ready, nod=6.0)
    score.after(0.55 * ready)
    moments = [score.now]
    for _ in range(times):
        for side in "lr":
            _raise_knee(score, side)
        moments.append(score.now)
    score.stand(-0.1, leave)
    score.after(leave)
    return moments


def _raise_knee(score: Score, side: str) -> None:
    actor = score.actor
    sign = 1.0 if side == "l" else -1.0
    up, back = score.beat(0.44), score.beat(0.42)
    high = score.vary(actor.habit("elbow.high", 0.50, 0.66), 0.06)
    width = actor.stance
    x, z = score.room(0.35 * sign * width, 0.30)
    knee = {"x": x, "z": z, "y": high, "free": 1.0, "pitch": 25.0, "knee": -8.0}
    score.pelvis(-0.05, up, -0.8 * sign * width, 0.0, -8.0 * sign, py=-0.03, pitch=6.0)
    score.move(0.0, up, **{side + name: value for name, value in knee.items()})
    score.move(0.0, up, bend=score.vary(34.0, 0.1), twist=score.vary(42.0, 0.1) * sign, side=4.0 * sign)
    score.hands(0.0, up, -0.22, 0.36, 0.10)
    x, z = score.room(sign * width + score.about(0.0, 0.02), score.about(0.0, 0.03))
    foot = {"x": x, "z": z, "y": 0.0, "free": 0.0, "pitch": 0.0, "knee": 4.0}
    score.move(up, up + back, **{side + name: value for name, value in foot.items()})
    score.move(up, up + back, bend=actor.stoop, twist=0.0, side=0.0)
    score.hands(up, up + back, -0.22, 0.38, 0.06)
    score.after(up + back)


def jumping_jack(score: Score, times: int) -> list[float]:
    """Add the keyframes of jumping jacks: jumps with the legs apart and the arms up, and back.

    Returns
    -------
    list of float
        The times at which a jump apart begins, and the end of the last jump, seconds.
    """
    score.begin("jack")
    actor = score.actor
    dip = score.beat(0.14)
    score.move(0.0, dip, py=-0.09, bend=score.about(8.0, 2.0))
    score.after(0.5 * dip)
    moments = [score.now]
    for _ in range(times):
        out, back = score.beat(0.44), score.beat(0.46)
        wide = score.vary(actor.habit("jack.wide", 0.48, 0.62), 0.07)
        top = score.vary(actor.habit("jack.top", 0.78, 1.0), 0.06)
        high = score.vary(0.10, 0.15)
        score.move(0.0, 0.55 * out, py=high, bend=2.0)
        score.move(0.55 * out, out + 0.06, py=-0.07)
        score.hands(-0.06, 0.55 * out, 0.92, score.about(0.0, 0.1), 0.1)
        score.hands(0.55 * out, out, max(-0.1, 0.62 - 0.8 * top), min(0.93, top), 0.10)
        score.move(0.0, out, nod=-6.0)
        _jump_sideways(score, 0.0, out, wide, high)
        t = out + 0.06
        score.move(t, t + 0.5 * back, py=high)
        score.move(t + 0.5 * back, t + back, py=-0.07)
        score.hands(t, t + 0.5 * back, 0.92, score.about(0.0, 0.1), 0.1)
        score.hands(t + 0.5 * back, t + back, actor.hang_out, -0.95, 0.05)
        _jump_sideways(score, t, back, actor.stance, high)
        score.after(t + back + 0.05)
        moments.append(score.now)
    leave = score.beat(0.30)
    score.stand(0.0, leave)
    score.after(leave)
    return moments


def _jump_sideways(score: Score, start: float, span: float, width: float, high: float) -> None:
    for side, sign in (("l", 1.0), ("r", -1.0)):
        late = score.about(0.0, 0.012)
        x, z = score.room(sign * width, score.about(0.0, 0.015))
        lift, land = start + 0.12 * span + late, start + span + late
        score.move(start - 0.05, lift + 0.05, **{side + "pitch": 35.0})
        score.move(lift, land, **{side + "x": x, side + "z": z})
        score.move(lift, (lift + land) / 2, **{side + "y": high + 0.02})
        score.move((lift + land) / 2, land, **{side + "y": 0.0, side + "pitch": 4.0})
        score.move(land, land + 0.08, **{side + "pitch": 0.0})


def arm_circles(score: Score, times: int) -> list[float]:
    """Add the keyframes of backward circles of the stretched right arm, with feet apart and the left hand at the hip.

    Returns
    -------
    list of float
        The times at which a circle begins, and the end of the last one, seconds.
    """
    score.begin("circles")
    actor = score.actor
    out = actor.habit("circles.out", 0.25, 0.5)
    ready, leave = score.beat(0.34), score.beat(0.36)
    _straddle(score, actor.habit("circles.straddle", 0.52, 0.64), ready)
    score.hand("l", -0.1, ready, 0.05, -0.55, 0.03, swivel=60.0)
    score.after(0.3 * ready)
    moments = [score.now]
    for _ in range(times):
        span = score.beat(1.2)
        radius = score.vary(actor.habit("circles.radius", 0.80, 0.92), 0.04)
        points = 8
        for i in range(1, points + 1):
            angle = 2 * math.pi * i / points
            ahead, height = math.sin(angle) * radius, -math.cos(angle) * radius
            # Behind the body the arm passes farther outwards than in front of it.
            place = (out - 0.35 * min(ahead / radius, 0.0), height, ahead * (0.62 if ahead < 0 else 1.0))
            score.hand("r", (i - 1) / points * span, i / points * span, *place)
        score.hand("l", 0.0, span, 0.05, -0.55, 0.03, swivel=60.0)
        sway = score.vary(7.0)
        score.move(0.0, 0.5 * span, bend=actor.stoop - sway, twist=8.0, py=-0.02)
        score.move(0.5 * span, span, bend=actor.stoop + 0.5 * sway, twist=-8.0, py=-0.03)
        score.after(span)
        moments.append(score.now)
    _straddle(score, actor.stance, leave)
    score.stand(-0.1, leave)
    score.after(leave)
    return moments


def _straddle(score: Score, width: float, span: float) -> None:
    """Add the keyframes of two steps that move the feet apart to a straddle of the given width."""
    for side, sign, begin, end in (("l", 1.0, 0.0, 0.6), ("r", -1.0, 0.45, 1.0)):
        score.step(
            side, begin * span, end * span, (sign * width, score.about(0.0, 0.02)), lift=0.05, heel=10.0, strike=0.0
        )


def cartwheel(score: Score) -> None:
    """Add the keyframes of a cartwheel to the left."""
    score.begin("wheel")
    actor = score.actor
    prepare, span, end = score.beat(0.55), score.beat(1.25), score.beat(0.5)
    width = actor.stance
    far = score.vary(actor.habit("wheel.far", 1.7, 2.3), 0.06)
    straddle = score.vary(actor.habit("wheel.straddle", 34.0, 58.0), 0.07)
    bent = actor.habit("wheel.bent", 0.80, 0.97)
    score.hands(0.0, prepare, 0.22, 0.9, 0.1)
    score.move(0.0, prepare, bend=0.0, side=0.0, twist=0.0, nod=-10.0)
    score.step("l", 0.3 * prepare, prepare, (width + 0.42, 0.02), yaw=40.0, lift=0.2)
    score.pelvis(0.2 * prepare, prepare, 0.2, 0.0, 0.0, py=-0.06)
    points = 18
    for i in range(1, points + 1):
        u = i / points
        _wheel_point(score, prepare + (i - 1) / points * span, prepare + u * span, u, far, straddle, bent)
    t = prepare + span
    score.hands(prepare + 0.55 * span, t, 0.3, 0.85, 0.05)
    score.wound -= 360.0
    score.anchor = (*score.room(0.2 + far, 0.0), score.anchor[2])
    score.step("r", t, t + 0.6 * end, (-width, 0.0), lift=0.08)
    score.step("l", t + 0.4 * end, t + end, (width, 0.0), lift=0.06)
    score.stand(t, t + end)
    score.after(t + end)


def _wheel_point(score: Score, start: float, stop: float, u: float, far: float, straddle: float, bent: float) -> None:
    """Add the keyframes of a cartwheel at fraction `u` (0 to 1): the pelvis on its arc, the straddled legs, the hands.

    The pelvis moves by `far` in all. A leg in the air is spread from the axis of the trunk by up to `straddle` degrees.
    Its ankle is at the distance `bent` from the pelvis. Both lengths are in leg lengths.
    """
    turned = 360.0 * (u - math.sin(2 * math.pi * u) / (2 * math.pi) * 0.35)
    over = math.radians(turned)
    # Upside down the pelvis is supported by trunk and arms instead of legs.
    height = -0.06 - 0.10 * math.sin(over) ** 2 + 0.38 * (1 - math.cos(over)) / 2
    x = 0.2 + far * u
    score.pelvis(start, stop, x, 0.0, 0.0, roll=-turned, py=height)
    pelvis = (x, 1.0 + height + 0.10)
    for side, sign, leaves, lands in (("r", -1.0, 0.10, 0.80), ("l", 1.0, 0.26, 0.93)):
        if leaves < u < lands:
            spread = math.radians(straddle) * min(1.0, 2.5 * math.sin(math.pi * u))
            angle = over - sign * spread
            x_room, z_room = score.room(pelvis[0] - bent * math.sin(angle), 0.0)
            ankle = {
                "x": x_room,
                "z": z_room,
                "y": max(pelvis[1] - bent * math.cos(angle), 0.2),
                "free": 1.0,
                "pitch": 30.0,
            }
            score.move(start, stop, **{side + name: value for name, value in ankle.items()})
        elif u >= lands and score.value(side + "free") > 0:
            x_room, z_room = score.room(0.2 + far + sign * 0.30, 0.0)
            ball = {"x": x_room, "z": z_room, "y": 0.0, "free": 0.0, "pitch": 0.0}
            score.move(start, stop, **{side + name: value for name, value in ball.items()})
    # The hands stay above the head; on the floor they are fixed in the world.
    score.hands(start, stop, 0.2, 0.93, 0.1 * math.sin(over))
