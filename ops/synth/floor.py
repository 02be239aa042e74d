"""This module adds motions between levels to a score: sitting, standing up, lying down, getting up, reaching."""

from __future__ import annotations

from kinedex.ops.synth.score import Score


def sit_down(score: Score) -> None:
    """Add the keyframes of sitting down on a chair behind the body, with folded arms."""
    score.begin("sit")
    actor = score.actor
    down, settle = score.beat(0.80), score.beat(0.6)
    chair = 0.60 + actor.habit("chair", -0.04, 0.05)
    lean = score.vary(actor.habit("sit.lean", 36.0, 54.0))
    score.pelvis(0.0, 0.55 * down, 0.0, -0.26, 0.0, py=-0.28, pitch=0.7 * lean)
    score.pelvis(0.55 * down, down, 0.0, -0.50, 0.0, py=-chair, pitch=0.3 * lean, lknee=8.0, rknee=8.0)
    score.move(0.0, 0.6 * down, bend=lean, nod=-0.3 * lean, look=score.about(0.0, 14.0))
    _fold_arms(score, 0.0, 0.35 * down)
    rest = actor.habit("sit.rest", -12.0, 14.0)
    score.move(0.75 * down, down + settle, pitch=score.about(rest - 6.0, 3.0), bend=score.about(rest + 12.0, 4.0))
    score.move(0.75 * down, down + settle, nod=score.about(actor.nod, 5.0), look=0.0)
    _fold_arms(score, down, down + settle)
    score.after(down + settle)


def _fold_arms(score: Score, start: float, stop: float) -> None:
    """Add the keyframes of folding the arms in front of the chest."""
    high = score.actor.habit("fold", -0.36, -0.20)
    score.hand("l", start, stop, -0.30, high - 0.04, 0.34)
    score.hand("r", start, stop, -0.26, high + 0.04, 0.38)


def sit(score: Score, seconds: float) -> None:
    """Add the keyframes of sitting and looking around for a number of seconds."""
    score.begin()
    t = 0.0
    while t < seconds:
        span = score.beat(0.6)
        score.move(t, t + span, bend=score.about(14.0, 6.0), side=score.about(0.0, 3.0), look=score.about(0.0, 20.0))
        t += span
    score.after(t)


def stand_up(score: Score) -> None:
    """Add the keyframes of standing up from a chair, with folded arms."""
    score.begin("stand")
    actor = score.actor
    ready, up = score.beat(0.5), score.beat(0.95)
    lean = score.vary(actor.habit("stand.lean", 40.0, 56.0))
    score.move(0.0, ready, bend=lean, pitch=0.6 * lean, nod=-10.0)
    score.pelvis(0.4 * ready, ready + 0.3 * up, 0.0, -0.28, 0.0, py=-0.36)
    _fold_arms(score, 0.0, ready + 0.5 * up)
    score.stand(ready + 0.2 * up, ready + up, "trunk")
    score.relax(ready + 0.6 * up, ready + up + 0.1, "l", "r")
    score.after(ready + up)


def lie_down(score: Score) -> None:
    """Add the keyframes of lying down: go onto one knee, sit down over one hand, and lie on the back."""
    score.begin("lie")
    actor = score.actor
    side = "r" if actor.habit("lie.side", 0.0, 1.0) < 0.75 else "l"
    sign = 1.0 if side == "l" else -1.0
    other = "l" if side == "r" else "r"
    width = actor.stance
    kneel, lean, seat, recline, settle = (score.beat(t) for t in (0.95, 0.75, 0.85, 1.0, 0.8))
    score.step(side, 0.0, 0.7 * kneel, (sign * width, score.about(-0.42, 0.04)), lift=0.08, heel=25.0, strike=40.0)
    score.move(0.6 * kneel, kneel, **{side + "pitch": 58.0})
    score.pelvis(0.1 * kneel, kneel, 0.0, -0.30, 0.0, py=-0.52, pitch=10.0)
    score.move(0.0, kneel, bend=score.vary(26.0), nod=10.0)
    score.hand(other, 0.1 * kneel, kneel, 0.0, -0.55, 0.55)
    score.hand(side, 0.2 * kneel, kneel, 0.25, -0.90, 0.05)
    t = kneel
    score.pelvis(t, t + lean, -0.1 * sign, -0.44, -14.0 * sign, py=-0.76, pitch=4.0, roll=-14.0 * sign)
    score.move(t, t + lean, twist=score.vary(-24.0) * sign, side=score.vary(14.0) * -sign)
    score.hand(side, t, t + lean, 0.42, -0.82, score.about(-0.15, 0.05))
    t += lean
    sat = -1.04
    score.pelvis(t, t + seat, 0.0, -0.62, 0.0, py=sat, pitch=-18.0, roll=0.0)
    _ball(score, side, t, t + seat, sign * width * 1.2, 0.05)
    score.move(t, t + seat, bend=score.vary(30.0), nod=0.0, twist=score.about(0.0, 6.0), side=0.0)
    score.hands(t, t + seat, 0.38, -0.72, -0.35)
    t += seat
    score.move(t, t + recline, pitch=-82.0, bend=4.0, py=sat - 0.03, nod=6.0, roll=score.about(0.0, 5.0))
    score.hands(t, t + recline, actor.habit("lie.out", 0.25, 0.6), -0.82, -0.05)
    for foot, way, wait in ((other, -sign, 0.0), (side, sign, actor.habit("lie.wait", 0.2, 0.6))):
        x, z = score.room(way * width * 1.1, 0.36)
        legs = {"x": x, "z": z, "y": 0.085, "free": 1.0, "pitch": 10.0, "knee": 12.0}
        score.move(t + wait, t + wait + recline, **{foot + name: value for name, value in legs.items()})
    t += recline
    score.move(t, t + settle, pitch=-88.0, bend=0.0, look=score.about(0.0, 14.0), tilt=0.0, roll=0.0)
    score.hands(t, t + settle, score.about(0.3, 0.08), -0.85, -0.03)
    score.after(t + settle)


def _ball(score: Score, side: str, start: float, stop: float, x: float, z: float) -> None:
    """Slide a foot over the floor to a position relative to the anchor, and put it down flat."""
    room_x, room_z = score.room(x, z)
    flat = {"x": room_x, "z": room_z, "y": 0.0, "free": 0.0, "pitch": 6.0, "knee": 14.0}
    score.move(start, stop, **{side + name: value for name, value in flat.items()})


def get_up(score: Score) -> None:
    """Add the keyframes of getting up from the back: sit up, turn over one hand onto one knee, and stand up."""
    score.begin("up")
    actor = score.actor
    side = "r" if actor.habit("up.side", 0.0, 1.0) < 0.75 else "l"
    sign = 1.0 if side == "l" else -1.0
    other = "l" if side == "r" else "r"
    width = actor.stance
    sit_up, tuck, kneel, rise = (score.beat(t) for t in (0.95, 0.75, 0.9, 1.0))
    # The feet of a lying body are in front of its later standing position.
    score.hands(0.0, 0.5 * sit_up, 0.3, -0.7, score.about(0.2, 0.1))
    score.move(0.0, sit_up, pitch=-12.0, bend=score.vary(36.0), nod=-4.0)
    t = sit_up
    score.hand(side, t, t + tuck, 0.45, -0.78, -0.2)
    score.hand(other, t, t + tuck, 0.2, -0.35, 0.5)
    _ball(score, other, t - 0.5 * sit_up, t + tuck, -sign * width, -0.38)
    _ball(score, side, t - 0.5 * sit_up + 0.15, t + tuck, sign * width * 1.3, -0.42)
    score.move(t, t + tuck, twist=score.vary(-22.0) * sign, side=-10.0 * sign)
    t += tuck
    px, pz = score.room(0.0, -0.78)
    score.move(t, t + kneel, px=px, pz=pz, py=-0.52, pitch=16.0, bend=score.vary(30.0), twist=0.0, side=0.0, roll=0.0)
    _ball(score, side, t, t + 0.9 * kneel, sign * width, -0.82)
    score.move(t + 0.2 * kneel, t + kneel, **{side + "pitch": 58.0, side + "knee": 4.0})
    score.hand(side, t, t + kneel, 0.25, -0.9, 0.1)
    score.hand(other, t, t + kneel, 0.0, -0.55, 0.55)
    t += kneel
    score.step(side, t + 0.25 * rise, t + 0.9 * rise, (sign * width, -0.38), lift=0.07, heel=58.0, strike=0.0)
    score.stand(t, t + rise)
    score.after(t + rise)


def grab_high(score: Score) -> None:
    """Add the keyframes of taking a box from a high shelf with both hands and holding it in front of the chest."""
    score.begin("grab")
    actor = score.actor
    reach, hold, take, lower = score.beat(0.70), score.beat(0.30), score.beat(0.55), score.beat(0.40)
    height = min(score.vary(actor.habit("grab.height", 0.62, 0.84), 0.05), 0.92)
    toes = actor.habit("grab.toes", 0.0, 34.0)
    first = actor.likes("grab.step", "stay", "l", "r", steady=0.75, rng=score.rng)
    ahead = 0.0
    if first != "stay":
        ahead = score.about(0.30, 0.06)
        score.step(
            first, 0.0, 0.7 * reach, (actor.stance * (1.0 if first == "l" else -1.0), ahead), lift=0.07, heel=15.0
        )
    score.hands(0.0, 0.5 * reach, -0.05, -0.05, 0.60)
    score.hands(0.5 * reach, reach, -0.10, height, score.about(0.42, 0.06))
    score.pelvis(0.0, reach, 0.0, 0.6 * ahead + 0.05, 0.0, py=-0.01)
    score.move(0.0, reach, nod=-24.0, bend=-5.0)
    raised = {side + "pitch": toes for side in "lr" if side != first}
    score.move(0.3 * reach, reach, **raised)
    t = reach + hold
    score.hands(t, t + take, -0.08, score.about(-0.16, 0.07), 0.50)
    score.move(t, t + take, nod=10.0, bend=actor.stoop + 3.0, **dict.fromkeys(raised, 0.0))
    t += take
    if first != "stay":
        score.step(
            first, t, t + lower, (actor.stance * (1.0 if first == "l" else -1.0), score.about(0.0, 0.03)), lift=0.06
        )
    score.stand(t, t + lower)
    score.after(t + lower)


def deposit_floor(score: Score) -> None:
    """Add the keyframes of putting something down on the floor in front with both hands."""
    score.begin("deposit")
    actor = score.actor
    down, hold, up = score.beat(0.75), score.beat(0.55), score.beat(0.75)
    bow = actor.habit("deposit.bow", 0.3, 1.0)
    deep = score.vary(0.42 + 0.26 * (1.0 - bow), 0.08)
    lean = score.vary(56.0 + 20.0 * bow, 0.07)
    step = actor.likes("deposit.step", "stay", "step", "stay", steady=0.75, rng=score.rng)
    ahead = 0.0
    if step == "step":
        ahead = score.about(0.34, 0.06)
        score.step("l", 0.0, 0.55 * down, (actor.stance, ahead), lift=0.07, heel=15.0)
        score.move(0.4 * down, down, rpitch=28.0)
    score.hands(0.0, 0.45 * down, 0.0, -0.40, 0.55)
    score.pelvis(
        0.1 * down, down, 0.0, 0.45 * ahead - 0.16 - 0.1 * bow, 0.0, py=-deep, pitch=lean, lknee=12.0, rknee=12.0
    )
    score.move(0.1 * down, down, bend=score.vary(40.0), nod=-14.0, twist=score.about(12.0, 4.0))
    score.hands(0.45 * down, down, -0.05, score.about(-0.30, 0.06), 0.88)
    t = down + hold
    if step == "step":
        score.step("l", t + 0.35 * up, t + up, (actor.stance, score.about(0.0, 0.03)), lift=0.06, heel=12.0)
    score.move(t, t + 0.5 * up, rpitch=0.0)
    score.stand(t, t + up)
    score.after(t + up)
