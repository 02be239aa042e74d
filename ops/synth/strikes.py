"""This module adds quick motions of the limbs to a score: kicking, punching, throwing."""

from __future__ import annotations

from kinedex.ops.synth.score import Score


def _other(side: str) -> str:
    return "r" if side == "l" else "l"


def _sign(side: str) -> float:
    return 1.0 if side == "l" else -1.0


def kick(score: Score, side: str, times: int) -> list[float]:
    """Add the keyframes of forward kicks with one foot, with the arms spread for balance.

    Returns
    -------
    list of float
        The times in seconds at which the kicks begin, followed by the end of the last kick.
    """
    score.begin("kick")
    actor = score.actor
    ready = score.beat(0.28)
    arms = (actor.habit("kick.out", 0.78, 0.92), actor.habit("kick.arms", -0.30, 0.05))
    _kick_arms(score, arms, 0.0, ready)
    score.move(0.0, ready, py=-0.04, bend=score.about(8.0, 3.0))
    score.after(0.55 * ready)
    moments = [score.now]
    for _ in range(times):
        _kick_once(score, side, arms)
        moments.append(score.now)
    back = score.beat(0.34)
    score.stand(-0.1, back)
    score.after(back)
    return moments


def _kick_once(score: Score, side: str, arms: tuple[float, float]) -> None:
    actor, sign = score.actor, _sign(side)
    shift, chamber, strike, hold, back, down = (score.beat(t) for t in (0.24, 0.30, 0.24, 0.12, 0.30, 0.28))
    height = score.vary(actor.habit("kick.height", 0.90, 1.15), 0.08)
    reach = score.about(actor.habit("kick.reach", 0.62, 0.80), 0.04)
    lean = actor.habit("kick.lean", -22.0, -4.0)
    wind = actor.habit("kick.wind", 0.0, 0.15)
    width = actor.stance
    score.pelvis(0.0, shift, -0.75 * sign * width, 0.0, 0.0, roll=-3.0 * sign, py=-0.03)
    # The path of the ankle: up in front of the body with a bent knee, out, back, down.
    _ankle(score, side, 0.3 * shift, shift, sign * width, 0.21 + 0.2 * wind, -wind - 0.1, free=1.0, pitch=25.0)
    t = shift
    _ankle(score, side, t, t + chamber, 0.7 * sign * width, 0.62 * height + 0.08, 0.25)
    t += chamber
    _ankle(score, side, t, t + strike, 0.3 * sign * width, height, reach, pitch=score.about(5.0, 10.0))
    score.pelvis(shift, t + strike, -0.85 * sign * width, 0.08, -12.0 * sign, pitch=lean, py=-0.02)
    score.move(shift, t + strike, bend=score.vary(12.0), twist=score.about(10.0 * sign, 4.0), nod=8.0)
    _kick_arms(score, arms, shift, t + strike)
    t += strike + hold
    _ankle(score, side, t, t + back, 0.8 * sign * width, 0.62 * height, 0.22)
    t += back
    _ankle(score, side, t, t + down, sign * width, 0.0, score.about(0.0, 0.04), free=0.0, pitch=0.0)
    score.pelvis(t, t + down, 0.0, 0.0, 0.0, pitch=0.0, roll=0.0, py=-0.04)
    score.move(t, t + down, bend=score.about(8.0, 3.0), twist=0.0, nod=actor.nod)
    score.after(t + down)


def _ankle(score: Score, side: str, start: float, stop: float, x: float, y: float, z: float, **others: float) -> None:
    """Move a lifted foot to a position relative to the anchor."""
    room_x, room_z = score.room(x, z)
    targets = {"x": room_x, "y": y, "z": room_z} | others
    score.move(start, stop, **{side + name: value for name, value in targets.items()})


def _kick_arms(score: Score, arms: tuple[float, float], start: float, stop: float) -> None:
    score.hands(start, stop, arms[0], score.about(arms[1], 0.05), 0.12)


def punch(score: Score, side: str, times: int) -> list[float]:
    """Add the keyframes of straight forward punches with one fist, out of a guard.

    Returns
    -------
    list of float
        The times at which a punch begins, and the end of the last one, seconds.
    """
    score.begin("punch")
    actor = score.actor
    sign, other = _sign(side), _other(side)
    ready, leave = score.beat(0.32), score.beat(0.36)
    guard = actor.habit("punch.guard", -0.30, -0.16)
    score.hands(0.0, ready, 0.0, guard, 0.36, swivel=55.0)
    score.move(0.0, ready, bend=score.about(8.0, 3.0), nod=4.0, twist=sign * 8.0)
    lunge = score.about(actor.habit("punch.lunge", 0.66, 0.82), 0.03)
    score.step(other, 0.0, ready, (-sign * actor.stance, lunge), lift=0.06, heel=15.0)
    score.pelvis(0.0, ready, 0.0, 0.5 * lunge, py=-score.about(actor.habit("punch.deep", 0.20, 0.27), 0.015))
    score.move(0.0, ready, **{side + "pitch": 40.0})
    score.after(0.65 * ready)
    moments = [score.now]
    for _ in range(times):
        _punch_once(score, side, guard)
        moments.append(score.now)
    score.move(0.0, 0.6 * leave, **{side + "pitch": 0.0})
    score.step(other, 0.0, leave, (-sign * actor.stance, score.about(0.0, 0.03)), lift=0.06, heel=15.0)
    score.stand(-0.05, leave)
    score.after(leave)
    return moments


def _punch_once(score: Score, side: str, guard: float) -> None:
    actor = score.actor
    sign, other = _sign(side), _other(side)
    wind, strike, hold, back, wait = (score.beat(t) for t in (0.24, 0.18, 0.10, 0.28, 0.10))
    high = score.about(actor.habit("punch.height", -0.22, -0.06), 0.05)
    turn = score.vary(actor.habit("punch.turn", 30.0, 50.0))
    score.hand(side, 0.0, wind, 0.1, guard - 0.08, score.about(0.12, 0.05), swivel=60.0)
    score.move(0.0, wind, twist=sign * 0.6 * turn)
    t = wind
    score.hand(side, t, t + strike, -0.16, high, 0.97, swivel=score.about(50.0, 10.0), hroll=40.0)
    score.hand(other, t, t + strike, 0.05, guard - 0.03, 0.26, swivel=55.0)
    score.move(t, t + strike, twist=-sign * turn, yaw=score.anchor[2] - sign * 0.4 * turn, bend=12.0)
    t += strike + hold
    score.hand(side, t, t + back, 0.02, guard, 0.36, swivel=55.0, hroll=0.0)
    score.hand(other, t, t + back, 0.02, guard, 0.36, swivel=55.0)
    score.move(t, t + back, twist=sign * 8.0, yaw=score.anchor[2], bend=8.0)
    score.after(t + back + wait)


def throw(score: Score) -> None:
    """Add the keyframes of an overhead throw of a ball with both hands, stepping out with one foot."""
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
    score.step(side, t - 0.35 * wind, t + 0.3 * strike, (width, far), lift=0.14, heel=20.0, strike=-10.0)
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
        score.step(side, t + 0.1, t + back, (width, score.about(0.0, 0.03)), lift=0.06, heel=12.0)
    else:
        score.step(other, t + 0.1, t + back, (-width, far + score.about(0.0, 0.03)), lift=0.09)
    score.stand(t, t + back)
    score.after(t + back)
