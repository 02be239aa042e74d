"""Motions of one quick limb: kicking, punching, throwing."""

from __future__ import annotations

from ops.synth.score import Score


def _other(side: str) -> str:
    return "r" if side == "l" else "l"


def _sign(side: str) -> float:
    return 1.0 if side == "l" else -1.0


def kick(score: Score, side: str) -> None:
    """Kick forwards with one foot and put it back."""
    score.begin("kick")
    actor = score.actor
    sign = _sign(side)
    shift, chamber, strike, hold, back, down = (score.beat(t) for t in (0.30, 0.32, 0.24, 0.12, 0.32, 0.28))
    height = score.vary(actor.habit("kick.height", 0.90, 1.15), 0.10)
    reach = score.about(actor.habit("kick.reach", 0.62, 0.80), 0.04)
    lean = actor.habit("kick.lean", -22.0, -4.0)
    arms = actor.likes("kick.arms", "guard", "guard", "guard", "guard", "open", steady=0.95, rng=score.rng)
    width = actor.stance
    score.pelvis(0.0, shift, -0.75 * sign * width, 0.0, 0.0, roll=-3.0 * sign, py=-0.03)
    t = shift
    # The way of the ankle: up in front of the body with a bent knee, out, back, down.
    wind = actor.habit("kick.wind", 0.0, 0.15)
    x, z = score.room(sign * width, -wind - 0.1)
    score.move(
        0.4 * shift,
        t,
        **{side + "x": x, side + "z": z, side + "y": 0.21 + 0.2 * wind, side + "free": 1.0, side + "pitch": 25.0},
    )
    x, z = score.room(sign * 0.7 * width, 0.25)
    score.move(t, t + chamber, **{side + "x": x, side + "z": z, side + "y": 0.62 * height + 0.08})
    t += chamber
    x, z = score.room(sign * 0.3 * width, reach)
    score.move(
        t, t + strike, **{side + "x": x, side + "z": z, side + "y": height, side + "pitch": score.about(5.0, 10.0)}
    )
    score.pelvis(shift, t + strike, -0.85 * sign * width, 0.08, -12.0 * sign, pitch=lean, py=-0.02)
    score.move(shift, t + strike, bend=score.vary(12.0), twist=score.about(10.0 * sign, 4.0), nod=8.0)
    _kick_arms(score, arms, shift, t + strike)
    t += strike + hold
    x, z = score.room(sign * 0.8 * width, 0.22)
    score.move(t, t + back, **{side + "x": x, side + "z": z, side + "y": 0.62 * height})
    t += back
    x, z = score.room(sign * width + score.about(0.0, 0.03), score.about(0.02, 0.06))
    score.move(t, t + down, **{side + "x": x, side + "z": z, side + "y": 0.0, side + "free": 0.0, side + "pitch": 0.0})
    score.stand(t, t + down + 0.15)
    score.after(t + down + 0.1)


def _kick_arms(score: Score, arms: str, shift: float, stop: float) -> None:
    if arms == "guard":
        score.hands(-0.1, 0.7 * shift, 0.02, 0.20, 0.38)
        score.hands(shift, stop, 0.05, score.about(0.18, 0.05), 0.38)
    else:
        score.hands(0.1, shift, 0.4, -0.75, 0.1)
        score.hands(shift, stop, score.about(0.65, 0.1), -0.55, 0.0)


def punch(score: Score, side: str) -> None:
    """Punch straight forwards with one fist out of a guard, and let the guard go."""
    score.begin("punch")
    actor = score.actor
    sign, other = _sign(side), _other(side)
    ready, wind, strike, hold, back, down = (score.beat(t) for t in (0.32, 0.24, 0.18, 0.10, 0.27, 0.32))
    guard = actor.habit("punch.guard", 0.08, 0.24)
    high = score.about(actor.habit("punch.height", 0.06, 0.26), 0.05)
    stance = actor.likes("punch.stance", "step", "step", "step", "square", steady=0.85, rng=score.rng)
    turn = score.vary(actor.habit("punch.turn", 30.0, 50.0))
    score.hands(0.0, ready, 0.0, guard, 0.36)
    score.move(0.0, ready, bend=score.about(8.0, 3.0), nod=4.0, py=-0.05, twist=sign * 6.0)
    if stance == "step":
        place = score.about(0.34, 0.05)
        score.step(other, 0.05, ready, -sign * actor.stance, place, lift=0.06, heel=15.0)
        score.pelvis(0.0, ready, 0.0, 0.35 * place)
    t = ready
    score.hand(side, t, t + wind, 0.1, guard - 0.12, score.about(0.12, 0.05))
    score.move(t, t + wind, twist=sign * 0.6 * turn)
    t += wind
    score.hand(side, t, t + strike, -0.16, high, 0.97, swivel=score.about(30.0, 10.0), hroll=40.0)
    score.hand(other, t, t + strike, 0.05, guard - 0.04, 0.24)
    score.move(t, t + strike, twist=-sign * turn, yaw=score.anchor[2] - sign * 0.4 * turn, bend=12.0)
    t += strike + hold
    score.hand(side, t, t + back, 0.02, guard, 0.36, swivel=10.0, hroll=0.0)
    score.move(t, t + back, twist=0.0, yaw=score.anchor[2])
    t += back
    if stance == "step":
        score.step(other, t, t + down, -sign * actor.stance, score.about(0.0, 0.03), lift=0.06, heel=15.0)
    score.stand(t, t + down)
    score.after(t + down)


def throw(score: Score) -> None:
    """Throw a ball forwards over the head with both hands, stepping out with one foot."""
    score.begin("throw")
    actor = score.actor
    lift, wind, strike, follow, back = (score.beat(t) for t in (0.40, 0.50, 0.26, 0.30, 0.50))
    far = score.vary(actor.habit("throw.step", 0.28, 0.6), 0.1)
    arch = score.vary(actor.habit("throw.arch", 8.0, 20.0))
    side = actor.likes("throw.foot", "l", "l", "r", steady=0.85, rng=score.rng)
    other = _other(side)
    width = actor.stance * _sign(side)
    score.hands(0.0, lift, -0.18, -0.25, 0.48)
    score.move(0.0, lift, nod=6.0, bend=score.about(8.0, 3.0), py=-0.04)
    t = lift
    score.hands(t, t + 0.5 * wind, -0.10, 0.45, 0.50)
    score.hands(t + 0.5 * wind, t + wind, score.about(-0.08, 0.04), score.about(0.62, 0.05), -0.22)
    score.pelvis(t, t + wind, 0.0, -0.06, 0.0, py=-0.06, pitch=-6.0)
    score.move(t, t + wind, bend=-arch, nod=-8.0, twist=score.about(0.0, 6.0))
    t += wind
    score.step(side, t - 0.35 * wind, t + 0.3 * strike, width, far, lift=0.14, heel=20.0, strike=-10.0)
    score.hands(t, t + 0.5 * strike, -0.1, 0.85, 0.25)
    score.hands(t + 0.5 * strike, t + strike, -0.12, score.about(0.3, 0.06), 0.88)
    score.pelvis(t, t + strike, 0.0, 0.65 * far, 0.0, py=-0.08, pitch=8.0)
    score.move(t, t + strike, bend=score.vary(26.0), nod=-6.0)
    score.move(t - 0.1, t + strike, **{other + "pitch": 35.0})
    t += strike
    score.hands(t, t + follow, 0.05, score.about(-0.45, 0.1), 0.7)
    score.move(t, t + follow, bend=score.vary(34.0), nod=-12.0, **{other + "pitch": 50.0})
    t += follow
    score.move(t, t + 0.3 * back, **{other + "pitch": 0.0})
    if actor.likes("throw.return", "back", "forwards", steady=0.8, rng=score.rng) == "back":
        score.step(side, t + 0.1, t + back, width, score.about(0.0, 0.03), lift=0.06, heel=12.0)
    else:
        score.step(other, t + 0.1, t + back, -width, far + score.about(0.0, 0.03), lift=0.09)
    score.stand(t, t + back)
    score.after(t + back)
