"""This module defines the channels in which motions are written: pelvis, feet, spine, head and hands, not joint angles.

Lengths of pelvis and feet are in leg lengths of the actor, those of the hands in arm lengths, angles in degrees,
so that one motion fits every body.

- px py pz: the pelvis in the world; py is relative to upright standing. yaw (left is positive), pitch (forwards), roll
(to
  the right).
- per foot (l, r): x y z of the ball of the foot in the room (of the ankle, where free = 1), yaw, pitch (heel up), knee
  (turned outwards), free (0: the foot holds its angle in the room, 1: it hangs from the shin).
- bend side twist: the spine, forwards, to the right, to the left. nod look tilt: neck and head likewise.
- per hand: hx (outwards) hy (up) hz (forwards) of the wrist from the shoulder in the frame of the chest, swivel of the
  elbow about the line from shoulder to wrist, wrist (flexion) and hroll of the hand.
"""

from __future__ import annotations

PELVIS = ("px", "py", "pz", "yaw", "pitch", "roll")
FOOT = ("x", "y", "z", "yaw", "pitch", "knee", "free")
TRUNK = ("bend", "side", "twist")
HEAD = ("nod", "look", "tilt")
HAND = ("hx", "hy", "hz", "swivel", "wrist", "hroll")

CHANNELS: tuple[str, ...] = (
    *PELVIS,
    *("l" + part for part in FOOT),
    *("r" + part for part in FOOT),
    *TRUNK,
    *HEAD,
    *("l" + part for part in HAND),
    *("r" + part for part in HAND),
)
INDEX: dict[str, int] = {name: i for i, name in enumerate(CHANNELS)}

# Channels of one body part share their timing errors, so that the part is early or late as a whole.
GROUP: dict[str, str] = dict.fromkeys(PELVIS, "pelvis")
GROUP |= {side + part: side + "foot" for side in "lr" for part in FOOT}
GROUP |= dict.fromkeys(TRUNK, "trunk") | dict.fromkeys(HEAD, "head")
GROUP |= {side + part: side + "hand" for side in "lr" for part in HAND}
