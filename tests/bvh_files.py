"""BVH files for tests: hierarchies and motions written out as text, and a human one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

ROTATIONS = ("Zrotation", "Xrotation", "Yrotation")
POSITIONS = ("Xposition", "Yposition", "Zposition")


@dataclass
class Joint:
    """A joint of a hierarchy; `ends` are the OFFSETs of its End Sites."""

    name: str
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    channels: tuple[str, ...] = ROTATIONS
    children: list[Joint] = field(default_factory=list)
    ends: list[tuple[float, float, float]] = field(default_factory=list)

    def all(self) -> list[Joint]:
        """The joint and all below it, in the order of the file."""
        return [self, *(joint for child in self.children for joint in child.all())]


def hierarchy(joint: Joint, keyword: str = "ROOT", indent: str = "") -> list[str]:
    """The lines of a hierarchy."""
    inner = indent + "  "
    lines = [f"{indent}{keyword} {joint.name}", f"{indent}{{", inner + "OFFSET " + " ".join(map(str, joint.offset))]
    if joint.channels:
        lines.append(f"{inner}CHANNELS {len(joint.channels)} " + " ".join(joint.channels))
    for child in joint.children:
        lines += hierarchy(child, "JOINT", inner)
    for end in joint.ends:
        lines += [f"{inner}End Site", f"{inner}{{", f"{inner}  OFFSET " + " ".join(map(str, end)), f"{inner}}}"]
    return [*lines, f"{indent}}}"]


def bvh_text(
    root: Joint,
    frames: Sequence[Mapping[str, Sequence[float]]],
    *,
    frame_time: str = "0.0333333",
    claimed: int | None = None,
    newline: str = "\n",
) -> str:
    """A BVH file; a frame is joint name → the numbers of its channels."""
    lines = ["HIERARCHY", *hierarchy(root), "MOTION", f"Frames: {len(frames) if claimed is None else claimed}"]
    lines.append(f"Frame Time: {frame_time}")
    for frame in frames:
        numbers = [frame[joint.name] for joint in root.all() if joint.channels]
        lines.append(" ".join(repr(float(number)) for row in numbers for number in row))
    return newline.join([*lines, ""])


def small() -> Joint:
    """A hierarchy with everything that BVH joints can have."""
    foot = Joint("foot", (0, -7, 0.5), ("Yrotation", "Xrotation", "Zrotation"), ends=[(0, -1, 2), (0, -1, -1)])
    shin = Joint("shin", (0.3, -7.5, 0), (*POSITIONS, "Xrotation", "Yrotation", "Zrotation"), [foot])
    thigh = Joint("thigh", (1.5, -1, 0.2), ROTATIONS, [shin])
    head = Joint("head", (0, 2, 0.1), ("Yposition", "Zrotation"), ends=[(0, 0, 0)])
    spine = Joint("spine", (0, 4, 0), (), [Joint("twist", (0, 0, 0), ("Yrotation",), [head])])
    return Joint("hips", (1, 90, -3), (*POSITIONS, *ROTATIONS), [thigh, spine])


def still(root: Joint, frames: int = 3) -> list[dict[str, list[float]]]:
    """Frames in which nothing moves but the root, along Z."""
    moving = []
    for t in range(frames):
        frame = {}
        for joint in root.all():
            place = {"X": joint.offset[0], "Y": joint.offset[1], "Z": joint.offset[2] + (t if joint is root else 0)}
            frame[joint.name] = [place[name[0]] if name in POSITIONS else 0.0 for name in joint.channels]
        moving.append(frame)
    return moving


def mixamo(prefix: str = "mixamorig:", *, fingers: bool = True, ends: bool = True, scale: float = 1.0) -> Joint:
    """A standing human with Mixamo's names, arms to the sides; centimetres times `scale`."""

    def joint(name: str, offset: tuple[float, float, float], *children: Joint, end: float | None = None) -> Joint:
        x, y, z = (float(np.float64(number) * scale) for number in offset)
        tip = [] if end is None or not ends else [(0.0, end * scale, 0.0)]
        return Joint(prefix + name, (x, y, z), ROTATIONS, list(children), tip)

    def leg(side: str, sign: float) -> Joint:
        toes = joint(f"{side}ToeBase", (0, -7, 12), *([joint(f"{side}Toe_End", (0, 0, 7), end=0.0)] if ends else []))
        foot = joint(f"{side}Foot", (0, -41, -1), toes)
        return joint(f"{side}UpLeg", (9 * sign, -5, 0), joint(f"{side}Leg", (0, -41, 1), foot))

    def arm(side: str, sign: float) -> Joint:
        knuckle = [joint(f"{side}HandMiddle1", (9 * sign, 0, 0), end=3.0)] if fingers else []
        hand = joint(f"{side}Hand", (26 * sign, 0, 0), *knuckle)
        upper = joint(f"{side}Arm", (13 * sign, -1, 0), joint(f"{side}ForeArm", (27 * sign, 0, 0), hand))
        return joint(f"{side}Shoulder", (5 * sign, 12, 0), upper)

    head = joint("Head", (0, 10, 1), *([joint("HeadTop_End", (0, 19, 1), end=0.0)] if ends else []))
    chest = joint("Spine2", (0, 13, 0), arm("Left", 1.0), joint("Neck", (0, 16, 0), head), arm("Right", -1.0))
    spine = joint("Spine", (0, 10, 0), joint("Spine1", (0, 12, 0), chest))
    hips = joint("Hips", (0, 100, 0), leg("Left", 1.0), leg("Right", -1.0), spine)
    hips.channels = (*POSITIONS, *ROTATIONS)
    return hips


def dance(root: Joint, frames: int, seed: int = 0) -> list[dict[str, list[float]]]:
    """A slow random dance of any hierarchy."""
    random = np.random.default_rng(seed)
    phases = {joint.name: random.uniform(0, 6, len(joint.channels)) for joint in root.all()}
    moving = still(root, frames)
    for t, frame in enumerate(moving):
        for joint in root.all():
            rotations = 30.0 * np.sin(phases[joint.name] + 0.1 * t)
            for i, name in enumerate(joint.channels):
                if name not in POSITIONS:
                    frame[joint.name][i] = round(float(rotations[i]), 4)
    return moving


def write_duet(path: Path, frames: int) -> Path:
    """Write a BVH file of two persons, Ann and Ben, who move alike."""
    tree, motion = bvh_text(mixamo(fingers=False), dance(mixamo(fingers=False), frames)).split("MOTION\n")
    count, rate, *rows = motion.splitlines()
    trees = tree.replace("mixamorig:", "Ann:") + tree.removeprefix("HIERARCHY\n").replace("mixamorig:", "Ben:")
    path.write_text("\n".join([f"{trees}MOTION", count, rate, *(f"{row} {row}" for row in rows), ""]))
    return path
