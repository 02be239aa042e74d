"""Motions between levels: sitting, standing up, lying down, getting up, reaching high and low."""

from __future__ import annotations

from ops.synth.score import Score


def sit_down(score: Score) -> None:
    """Sit down on a chair that stands behind."""
    score.begin("sit")
    actor = score.actor
    down, settle = score.beat(0.95), score.beat(0.65)
    chair = 0.60 + actor.habit("chair", -0.04, 0.05)
    lean = score.vary(actor.habit("sit.lean", 36.0, 54.0))
    arms = actor.likes("sit.arms", "knees", "sides", "knees", steady=0.8, rng=score.rng)
    score.pelvis(0.0, 0.55 * down, 0.0, -0.26, 0.0, py=-0.28, pitch=0.7 * lean)
    score.pelvis(0.55 * down, down, 0.0, -0.50, 0.0, py=-chair, pitch=0.3 * lean, lknee=8.0, rknee=8.0)
    score.move(0.0, 0.6 * down, bend=lean, nod=-0.3 * lean, look=score.about(0.0, 14.0))
    if arms == "knees":
        score.hands(0.2 * down, 0.9 * down, -0.05, -0.52, 0.52)
    else:
        score.hands(0.1 * down, 0.9 * down, 0.32, -0.78, -0.22)
    rest = actor.habit("sit.rest", -12.0, 14.0)
    score.move(0.75 * down, down + settle, pitch=score.about(rest - 6.0, 3.0), bend=score.about(rest + 12.0, 4.0))
    score.move(0.75 * down, down + settle, nod=score.about(actor.nod, 5.0), look=0.0)
    score.hands(down, down + settle, 0.02, score.about(-0.55, 0.04), score.about(0.47, 0.05))
    score.after(down + settle)


def sit(score: Score, seconds: float) -> None:
    """Sit for a while: shift about, look around, move a hand."""
    score.begin()
    t = 0.0
    while t < seconds:
        span = score.beat(0.8)
        score.move(t, t + span, bend=score.about(14.0, 7.0), side=score.about(0.0, 4.0), look=score.about(0.0, 22.0))
        side = "lr"[int(score.rng.integers(2))]
        if score.rng.random() < 0.45:
            score.hand(side, t, t + 0.6 * span, score.about(0.1, 0.1), score.about(-0.2, 0.12), 0.5)
        else:
            score.hand(side, t, t + span, score.about(0.02, 0.05), -0.55, score.about(0.47, 0.05))
        t += span
    score.after(t)


def stand_up(score: Score) -> None:
    """Stand up from a chair."""
    score.begin("stand")
    actor = score.actor
    ready, up = score.beat(0.5), score.beat(0.95)
    lean = score.vary(actor.habit("stand.lean", 40.0, 56.0))
    arms = actor.likes("stand.arms", "knees", "swing", "sides", steady=0.8, rng=score.rng)
    score.move(0.0, ready, bend=lean, pitch=0.6 * lean, nod=-10.0)
    score.pelvis(0.4 * ready, ready + 0.3 * up, 0.0, -0.28, 0.0, py=-0.36)
    if arms == "knees":
        score.hands(0.0, ready, 0.0, -0.42, 0.55)
    elif arms == "swing":
        score.hands(0.0, ready, 0.1, -0.3, 0.75)
    else:
        score.hands(0.0, ready, 0.3, -0.75, -0.2)
    score.stand(ready + 0.2 * up, ready + up)
    score.after(ready + up)


def lie_down(score: Score) -> None:
    """Go down to the floor and lie on the back."""
    score.begin("lie")
    actor = score.actor
    crouch, seat, recline, flat = score.beat(0.9), score.beat(0.75), score.beat(1.0), score.beat(0.6)
    score.pelvis(0.0, crouch, 0.0, -0.28, 0.0, py=-0.66, pitch=22.0, lknee=14.0, rknee=14.0)
    score.move(0.0, crouch, bend=score.vary(34.0), nod=-6.0, lpitch=12.0, rpitch=12.0)
    support = "r" if actor.habit("lie.support", 0.0, 1.0) < 0.7 else "l"
    other = "l" if support == "r" else "r"
    score.hand(support, 0.2 * crouch, crouch, 0.3, -0.8, score.about(-0.3, 0.06))
    score.hand(other, 0.2 * crouch, crouch, 0.1, -0.3, 0.65)
    t = crouch
    sat = -1.04
    score.pelvis(t, t + seat, 0.0, -0.62, 0.0, py=sat, pitch=-18.0)
    score.move(t, t + seat, bend=score.vary(30.0), nod=0.0, lpitch=0.0, rpitch=0.0)
    score.hands(t, t + seat, 0.38, -0.72, -0.35)
    t += seat
    score.move(t, t + recline, pitch=-82.0, bend=4.0, py=sat - 0.03, nod=6.0)
    score.hands(t, t + recline, actor.habit("lie.out", 0.25, 0.6), -0.82, -0.05)
    for side, sign, wait in (("l", 1.0, 0.0), ("r", -1.0, actor.habit("lie.wait", 0.0, 0.35))):
        x, z = score.room(sign * actor.stance * 1.1, 0.36)
        legs = {"x": x, "z": z, "y": 0.085, "free": 1.0, "pitch": 10.0, "knee": 12.0}
        score.move(t + wait, t + wait + recline, **{side + name: value for name, value in legs.items()})
    t += recline
    score.move(t, t + flat, pitch=-88.0, bend=0.0, look=score.about(0.0, 12.0), tilt=0.0)
    score.hands(t, t + flat, score.about(0.3, 0.08), -0.85, -0.03)
    score.after(t + flat)


def get_up(score: Score) -> None:
    """Get up from lying on the back."""
    score.begin("up")
    actor = score.actor
    # Whoever lies has his feet in front of the place where he is going to stand.
    x, z, yaw = score.standing()
    score.anchor = (x, z, yaw)
    sit_up, tuck, rise = score.beat(0.95), score.beat(0.7), score.beat(1.2)
    score.hands(0.0, 0.5 * sit_up, 0.3, -0.7, score.about(0.2, 0.1))
    score.move(0.0, sit_up, pitch=-12.0, bend=score.vary(36.0), nod=-4.0)
    t = sit_up
    score.hand("l", t, t + tuck, 0.35, -0.75, -0.3)
    score.hand("r", t, t + tuck, 0.2, -0.35, 0.5)
    for side, sign, wait in (("l", 1.0, 0.0), ("r", -1.0, 0.15)):
        fx, fz = score.room(sign * actor.stance, -0.38)
        feet = {"x": fx, "z": fz, "y": 0.0, "free": 0.0, "pitch": 8.0, "knee": 12.0}
        score.move(t - 0.5 * sit_up + wait, t + tuck, **{side + name: value for name, value in feet.items()})
    t += tuck
    px, pz = score.room(0.0, -0.62)
    score.move(t, t + 0.45 * rise, px=px, pz=pz, py=-0.62, pitch=28.0, bend=score.vary(38.0), lpitch=14.0, rpitch=14.0)
    score.hands(t, t + 0.45 * rise, 0.0, -0.4, 0.7)
    score.move(t + 0.5 * rise, t + rise, lpitch=0.0, rpitch=0.0)
    score.stand(t + 0.45 * rise, t + rise)
    score.after(t + rise)


def grab_high(score: Score) -> None:
    """Take a box from a high shelf with both hands and hold it in front of the chest."""
    score.begin("grab")
    actor = score.actor
    reach, hold, take, lower = score.beat(0.70), score.beat(0.30), score.beat(0.55), score.beat(0.40)
    height = min(score.vary(actor.habit("grab.height", 0.62, 0.84), 0.05), 0.92)
    toes = actor.habit("grab.toes", 0.0, 34.0)
    first = actor.likes("grab.step", "stay", "l", "r", steady=0.75, rng=score.rng)
    ahead = 0.0
    if first != "stay":
        ahead = score.about(0.30, 0.06)
        score.step(first, 0.0, 0.7 * reach, actor.stance * (1.0 if first == "l" else -1.0), ahead, lift=0.07, heel=15.0)
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
            first, t, t + lower, actor.stance * (1.0 if first == "l" else -1.0), score.about(0.0, 0.03), lift=0.06
        )
    score.stand(t, t + lower)
    score.after(t + lower)


def deposit_floor(score: Score) -> None:
    """Put something down on the floor in front with both hands."""
    score.begin("deposit")
    actor = score.actor
    down, hold, up = score.beat(0.9), score.beat(0.30), score.beat(0.85)
    bow = actor.habit("deposit.bow", 0.3, 1.0)
    deep = score.vary(0.42 + 0.26 * (1.0 - bow), 0.08)
    lean = score.vary(56.0 + 20.0 * bow, 0.07)
    step = actor.likes("deposit.step", "stay", "step", "stay", steady=0.75, rng=score.rng)
    ahead = 0.0
    if step == "step":
        ahead = score.about(0.34, 0.06)
        score.step("l", 0.0, 0.55 * down, actor.stance, ahead, lift=0.07, heel=15.0)
        score.move(0.4 * down, down, rpitch=28.0)
    score.hands(0.0, 0.45 * down, 0.0, -0.40, 0.55)
    score.pelvis(
        0.1 * down, down, 0.0, 0.45 * ahead - 0.16 - 0.1 * bow, 0.0, py=-deep, pitch=lean, lknee=12.0, rknee=12.0
    )
    score.move(0.1 * down, down, bend=score.vary(40.0), nod=-14.0, twist=score.about(12.0, 4.0))
    score.hands(0.45 * down, down, -0.05, score.about(-0.30, 0.06), 0.88)
    t = down + hold
    if step == "step":
        score.step("l", t + 0.35 * up, t + up, actor.stance, score.about(0.0, 0.03), lift=0.06, heel=12.0)
    score.move(t, t + 0.5 * up, rpitch=0.0)
    score.stand(t, t + up)
    score.after(t + up)
