"""This module adds filler motions to a score: unlabelled movements between the labelled motions of a take."""

from __future__ import annotations

import math
from collections.abc import Callable

from kinedex.ops.synth.floor import deposit_floor, grab_high
from kinedex.ops.synth.gait import hop, turn
from kinedex.ops.synth.score import Score
from kinedex.ops.synth.strikes import throw


def shift_weight(score: Score) -> None:
    """Add the keyframes of a shift of the weight onto one leg."""
    score.begin()
    span = score.beat(0.7)
    sign = score.about(0.0, 1.0)
    sign = math.copysign(min(max(abs(sign), 0.5), 1.2), sign)
    score.pelvis(0.0, span, sign * score.actor.stance * 0.6, 0.0, score.about(0.0, 5.0), roll=-4.0 * sign, py=-0.02)
    score.move(0.0, span, side=3.0 * sign, look=score.about(0.0, 15.0))
    score.after(span + score.beat(0.25))


def look_around(score: Score) -> None:
    """Add the keyframes of a look to one side, which the trunk follows."""
    score.begin()
    span = score.beat(0.5)
    angle = score.about(0.0, 45.0)
    score.move(0.0, span, look=angle, twist=0.3 * angle, nod=score.about(0.0, 10.0))
    score.move(span + 0.2, 2 * span + 0.2, look=score.about(0.0, 10.0), twist=score.about(0.0, 4.0))
    score.after(1.6 * span)


def gesture(score: Score) -> None:
    """Add the keyframes of talking gestures with one or both hands."""
    score.begin()
    sides = ("l", "r", "lr")[int(score.rng.choice(3, p=[0.2, 0.4, 0.4]))]
    t = 0.0
    for _ in range(int(score.rng.integers(2, 6))):
        span = score.beat(0.36)
        for side in sides:
            score.hand(
                side, t, t + span, score.about(0.15, 0.16), score.about(-0.3, 0.2), score.about(0.42, 0.14),
                wrist=score.about(0.0, 25.0), hroll=score.about(0.0, 30.0),
            )  # fmt: skip
        score.move(t, t + span, nod=score.about(2.0, 7.0), look=score.about(0.0, 12.0), twist=score.about(0.0, 5.0))
        t += span
    score.relax(t, t + score.beat(0.6), *sides)
    score.after(t + 0.25)


def scratch(score: Score) -> None:
    """Add the keyframes of scratching the head or the neck, or rubbing the nose."""
    score.begin()
    side = "lr"[int(score.rng.integers(2))]
    up, down = score.beat(0.5), score.beat(0.6)
    x, y, z = ((0.05, 0.5, 0.25), (-0.25, 0.3, 0.35), (0.12, 0.38, 0.05))[int(score.rng.integers(3))]
    score.hand(side, 0.0, up, x, y, z)
    t = up
    for _ in range(int(score.rng.integers(2, 5))):
        span = score.beat(0.14)
        score.hand(side, t, t + span, score.about(x, 0.04), score.about(y, 0.05), score.about(z, 0.04))
        t += span
    score.move(0.0, up, nod=score.about(14.0, 6.0), tilt=score.about(0.0, 7.0))
    score.relax(t, t + down, side, "trunk")
    score.after(t + 0.7 * down)


def swing_arms(score: Score) -> None:
    """Add a motion in which the arms swing to and fro two to four times."""
    score.begin()
    t = 0.0
    phase = 1.0 if score.rng.random() < 0.5 else -1.0
    wide = score.about(0.32, 0.1)
    for _ in range(int(score.rng.integers(2, 5))):
        span = score.beat(0.42)
        score.hand("l", t, t + span, 0.2, -0.85, phase * wide)
        score.hand("r", t, t + span, 0.2, -0.85, -phase * wide if score.rng.random() < 0.6 else phase * wide)
        score.move(t, t + span, twist=-6.0 * phase, py=-0.03 - 0.02 * abs(phase))
        phase = -phase
        t += span
    score.relax(t, t + score.beat(0.4), "l", "r")
    score.after(t + 0.2)


def step_aside(score: Score) -> None:
    """Add the keyframes of a step in any direction but straight ahead; the other foot follows."""
    score.begin()
    angle = score.rng.uniform(0.6, 5.7)  # any direction except straight ahead
    far = score.about(0.34, 0.1)
    x, z = far * math.sin(angle), far * math.cos(angle)
    first = "l" if x > 0 else "r"
    turn = score.about(0.0, 18.0)
    t = 0.0
    for side in (first, "r" if first == "l" else "l"):
        span = score.beat(0.46)
        sign = 1.0 if side == "l" else -1.0
        width = score.actor.stance * score.about(1.0, 0.15)
        place = (x + sign * width * math.cos(math.radians(turn)), z - sign * width * math.sin(math.radians(turn)))
        score.step(side, t, t + span, place, yaw=turn, lift=0.07, heel=18.0, strike=0.0)
        score.pelvis(
            t, t + span, x * (0.6 if side == first else 1.0), z * (0.6 if side == first else 1.0), turn, py=-0.03
        )
        t += 0.9 * span
    score.after(t)
    score.stand(0.0, score.beat(0.35), "trunk")
    score.after(0.15)


def turn_away(score: Score) -> None:
    """Add the keyframes of a turn to the side."""
    turn(score, math.copysign(float(score.rng.uniform(50.0, 140.0)), score.about(0.0, 1.0)))


def hands_on_hips(score: Score) -> None:
    """Add the keyframes of putting the hands on the hips, or folding the arms, for a moment."""
    score.begin()
    up, hold, down = score.beat(0.6), score.beat(0.6), score.beat(0.6)
    if score.rng.random() < 0.5:
        score.hands(0.0, up, 0.05, -0.55, 0.02, swivel=60.0)
    else:
        score.hand("l", 0.0, up, -0.30, -0.30, 0.34)
        score.hand("r", 0.0, up, -0.26, -0.22, 0.38)
    score.move(0.0, up + hold, look=score.about(0.0, 20.0), nod=score.about(5.0, 8.0), side=score.about(0.0, 3.0))
    score.relax(up + hold, up + hold + down)
    score.after(up + hold + 0.7 * down)


def bow(score: Score) -> None:
    """Add the keyframes of a forward bend, as for brushing the trousers, tying a lace or looking at the floor."""
    score.begin()
    down, up = score.beat(0.7), score.beat(0.7)
    lean = score.vary(32.0, 0.35)
    score.pelvis(0.0, down, 0.0, -0.10, 0.0, py=score.about(-0.16, 0.06), pitch=lean)
    score.move(0.0, down, bend=score.vary(26.0, 0.3), nod=10.0)
    score.hands(0.0, down, score.about(0.0, 0.05), -0.75, 0.5)
    t = down
    for _ in range(int(score.rng.integers(1, 4))):
        span = score.beat(0.22)
        score.hands(t, t + span, score.about(0.0, 0.05), score.about(-0.72, 0.05), score.about(0.5, 0.08))
        t += span
    score.stand(t, t + up)
    score.after(t + 0.9 * up)


def wave(score: Score) -> None:
    """Add the keyframes of waving with one hand."""
    score.begin()
    side = "r" if score.rng.random() < 0.75 else "l"
    up = score.beat(0.55)
    score.hand(side, 0.0, up, 0.35, 0.45, 0.35)
    t, phase = up, 1.0
    for _ in range(int(score.rng.integers(2, 6))):
        span = score.beat(0.2)
        score.hand(side, t, t + span, 0.35 + 0.16 * phase, 0.5, 0.33)
        t, phase = t + span, -phase
    down = score.beat(0.6)
    score.relax(t, t + down, side, "trunk")
    score.after(t + 0.7 * down)


def clap(score: Score) -> None:
    """Add the keyframes of clapping or rubbing the hands in front of the chest."""
    score.begin()
    up = score.beat(0.45)
    score.hands(0.0, up, 0.08, -0.28, 0.5)
    t = up
    for _ in range(int(score.rng.integers(1, 5))):
        span = score.beat(0.15)
        score.hands(t, t + span, -0.22, score.about(-0.28, 0.03), 0.5)
        score.hands(t + span, t + 2 * span, score.about(0.1, 0.06), -0.28, 0.48)
        t += 2 * span
    down = score.beat(0.5)
    score.relax(t, t + down)
    score.after(t + 0.7 * down)


def twist_trunk(score: Score) -> None:
    """Add the keyframes of swinging the trunk to the left and to the right; the arms follow."""
    score.begin()
    t = 0.0
    wide = score.vary(34.0, 0.25)
    way = 1.0 if score.rng.random() < 0.5 else -1.0
    high = score.about(-0.45, 0.2)
    for _ in range(int(score.rng.integers(2, 5))):
        span = score.beat(0.55)
        score.move(t, t + span, twist=way * wide, look=0.5 * way * wide, yaw=score.anchor[2] + 0.3 * way * wide)
        for side, sign in (("l", 1.0), ("r", -1.0)):
            score.hand(side, t, t + span, 0.3 + 0.3 * way * sign, high, 0.45 - 0.3 * way * sign)
        t += span
        way = -way
    score.stand(t, t + score.beat(0.5))
    score.after(t + 0.35)


def stretch(score: Score) -> None:
    """Add the keyframes of a stretch: both arms up, or one arm up and the trunk to the side."""
    score.begin()
    up, hold, down = score.beat(0.8), score.beat(0.4), score.beat(0.8)
    if score.rng.random() < 0.4:
        score.hands(0.0, up, 0.05, 0.92, score.about(0.1, 0.1))
        score.move(0.0, up + hold, bend=-12.0, nod=-20.0, lpitch=18.0, rpitch=18.0)
        score.move(up + hold, up + hold + 0.5 * down, lpitch=0.0, rpitch=0.0)
    else:
        side, sign = ("l", 1.0) if score.rng.random() < 0.5 else ("r", -1.0)
        score.hand(side, 0.0, up, -0.1, 0.88, 0.05)
        score.move(0.0, up + hold, side=score.vary(22.0, 0.2) * sign, roll=5.0 * sign, tilt=8.0 * sign)
    score.stand(up + hold, up + hold + down)
    score.after(up + hold + 0.85 * down)


def crouch(score: Score) -> None:
    """Add the keyframes of a crouch on the heels or on one knee, and getting up again."""
    score.begin()
    actor = score.actor
    down, up = score.beat(0.85), score.beat(0.9)
    side, sign = ("l", 1.0) if score.rng.random() < 0.5 else ("r", -1.0)
    score.step(side, 0.0, 0.7 * down, (sign * actor.stance, score.about(0.35, 0.06)), lift=0.07, heel=12.0)
    other = "r" if side == "l" else "l"
    score.move(0.3 * down, down, **{other + "pitch": 45.0})
    score.pelvis(0.0, down, 0.0, 0.12, 0.0, py=score.about(-0.60, 0.05), pitch=20.0)
    score.move(0.0, down, bend=score.vary(40.0, 0.15), nod=12.0, twist=score.about(0.0, 8.0))
    score.hands(0.2 * down, down, -0.05, -0.62, 0.62)
    t = down
    for _ in range(int(score.rng.integers(2, 6))):
        span = score.beat(0.22)
        score.hands(t, t + span, score.about(-0.05, 0.06), score.about(-0.6, 0.06), score.about(0.62, 0.06))
        t += span
    score.step(side, t + 0.2 * up, t + 0.9 * up, (sign * actor.stance, score.about(0.0, 0.04)), lift=0.06, heel=12.0)
    score.move(t, t + 0.6 * up, **{other + "pitch": 0.0})
    score.stand(t, t + up)
    score.after(t + 0.95 * up)


def dance(score: Score) -> None:
    """Add the keyframes of random dance-like poses that belong to no class."""
    score.begin()
    rng, actor = score.rng, score.actor
    t = 0.0
    for _ in range(int(rng.integers(2, 6))):
        span = score.beat(0.5)
        for side in "lr":
            high, wide = math.radians(rng.uniform(-40.0, 85.0)), math.radians(rng.uniform(-20.0, 110.0))
            far = rng.uniform(0.55, 0.95)
            place = (far * math.cos(high) * math.sin(wide), far * math.sin(high), far * math.cos(high) * math.cos(wide))
            score.hand(side, t, t + span, *place, swivel=score.about(10.0, 20.0))
        twist = rng.uniform(-45.0, 45.0)
        score.move(
            t, t + span, twist=twist, bend=rng.uniform(-12.0, 50.0), side=rng.uniform(-18.0, 18.0), look=0.5 * twist
        )
        side, sign = ("l", 1.0) if rng.random() < 0.5 else ("r", -1.0)
        lean = -0.7 * sign * actor.stance
        score.pelvis(
            t, t + span, lean, 0.0, rng.uniform(-30.0, 30.0), py=-rng.uniform(0.02, 0.22), pitch=rng.uniform(-8.0, 35.0)
        )
        if rng.random() < 0.6:
            x, z = score.room(sign * rng.uniform(0.05, 0.55), rng.uniform(-0.45, 0.35))
            lifted = {
                "x": x,
                "z": z,
                "y": rng.uniform(0.25, 0.65),
                "free": 1.0,
                "pitch": 20.0,
                "knee": rng.uniform(-5.0, 40.0),
            }
            score.move(t, t + span, **{side + name: value for name, value in lifted.items()})
            t += span
            span = score.beat(0.35)
        x, z = score.room(sign * actor.stance * rng.uniform(1.0, 2.2), rng.uniform(-0.15, 0.15))
        back = {"x": x, "z": z, "y": 0.0, "free": 0.0, "pitch": 0.0, "knee": 6.0}
        score.move(t + 0.1, t + span, **{side + name: value for name, value in back.items()})
        t += span
    for side, sign in (("l", 1.0), ("r", -1.0)):
        span = score.beat(0.35)
        score.step(side, t, t + span, (sign * actor.stance, score.about(0.0, 0.03)), lift=0.06, heel=12.0)
        t += 0.8 * span
    score.stand(t - 0.5, t + 0.2)
    score.after(t + 0.2)


FILLERS: tuple[tuple[Callable[[Score], None], float], ...] = (
    (shift_weight, 0.3),
    (look_around, 0.3),
    (gesture, 1.0),
    (scratch, 0.8),
    (swing_arms, 0.8),
    (step_aside, 1.0),
    (hands_on_hips, 0.6),
    (bow, 0.5),
    (wave, 0.7),
    (clap, 0.6),
    (dance, 2.0),
    (hop, 0.6),
    (throw, 0.6),
    (grab_high, 0.6),
    (deposit_floor, 0.6),
    (turn_away, 0.8),
    (twist_trunk, 1.2),
    (stretch, 1.1),
    (crouch, 0.5),
)


def fill(score: Score) -> None:
    """Add a filler motion that is drawn at random."""
    weights = [weight for _, weight in FILLERS]
    choice = int(score.rng.choice(len(FILLERS), p=[weight / sum(weights) for weight in weights]))
    FILLERS[choice][0](score)
