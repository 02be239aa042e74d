"""MVNX files for tests, written by hand as MVN lays them out: X forward, Y left, Z up, in metres."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from kinedex.storage.formats.motion.mvnx import PARENTS, TIPS

F64 = np.ndarray

SEGMENTS = (
    *("Pelvis", "L5", "L3", "T12", "T8", "Neck", "Head"),
    *("RightShoulder", "RightUpperArm", "RightForeArm", "RightHand"),
    *("LeftShoulder", "LeftUpperArm", "LeftForeArm", "LeftHand"),
    *("RightUpperLeg", "RightLowerLeg", "RightFoot", "RightToe"),
    *("LeftUpperLeg", "LeftLowerLeg", "LeftFoot", "LeftToe"),
)
"""The segments in MVN's order."""

OFFSETS = {
    "L5": (0, 0, 0.11), "L3": (0, 0, 0.1), "T12": (0, 0, 0.09), "T8": (0, 0, 0.09), "Neck": (0, 0, 0.13),
    "Head": (0.01, 0, 0.09), "Shoulder": (0, 0.03, 0.07), "UpperArm": (0, 0.14, 0), "ForeArm": (0, 0.28, 0),
    "Hand": (0, 0.24, 0), "UpperLeg": (0, 0.09, 0), "LowerLeg": (0, 0, -0.42), "Foot": (0, 0, -0.41),
    "Toe": (0.15, 0, -0.07), "pTopOfHead": (0, 0, 0.18), "TopOfHand": (0, 0.19, 0), "pToe": (0.06, 0, -0.01),
}  # fmt: skip
"""The place of a segment (of the left side) in the axes of the one that it hangs from, and those of the tips."""


def offset(name: str) -> F64:
    """The place of a segment, or of the tip of one, in the axes of the one above."""
    place = np.array(OFFSETS[name.removeprefix("Left").removeprefix("Right")], float)
    return place * [1, -1, 1] if name.startswith("Right") else place


def tip(segment: str) -> F64:
    """The place of a segment's tip in its axes."""
    side = segment.removesuffix("Hand").removesuffix("Toe")
    key = "pTopOfHead" if segment == "Head" else side + ("TopOfHand" if segment.endswith("Hand") else "pToe")
    return offset(key)


def dancing(frames: int, seed: int = 0, forward: float = 0.0) -> tuple[F64, F64]:
    """Positions (T, 23, 3) and orientations (T, 23, 4) of a slow dance, the body turned by `forward` degrees."""
    random = np.random.default_rng(seed)
    phase, axes = random.uniform(0, 6, 23), random.normal(size=(23, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    positions, orientations = np.zeros((frames, 23, 3)), np.zeros((frames, 23, 4))
    turn = np.deg2rad(forward) / 2
    for t in range(frames):
        angle = 0.3 * np.sin(phase + 0.2 * t)
        for i, name in enumerate(SEGMENTS):
            own = np.array([np.cos(angle[i] / 2), *(np.sin(angle[i] / 2) * axes[i])])
            if name == "Pelvis":
                orientations[t, i] = multiply(np.array([np.cos(turn), 0, 0, np.sin(turn)]), own)
                positions[t, i] = [0.02 * t, 0.01 * t, 1.0]
                continue
            above = SEGMENTS.index(PARENTS[name])
            orientations[t, i] = multiply(orientations[t, above], own)
            positions[t, i] = positions[t, above] + rotate(orientations[t, above], offset(name))
    return positions, orientations


def multiply(a: F64, b: F64) -> F64:
    """The product of two quaternions w, x, y, z."""
    w, v, u, x = a[0], a[1:], b[0], b[1:]
    return np.array([w * u - v @ x, *(w * x + u * v + np.cross(v, x))])


def rotate(q: F64, vector: F64) -> F64:
    """A vector turned by a unit quaternion."""
    return vector + 2 * np.cross(q[1:], np.cross(q[1:], vector) + q[0] * vector)


def segment_text(name: str) -> str:
    """A segment with the points at its joints and its tip."""
    points = [("jOrigin" + name, np.zeros(3))]
    points += [("jOrigin" + child, offset(child)) for child, above in PARENTS.items() if above == name]
    points += [(TIPS[name], tip(name))] if name in TIPS else []
    lines = [f'<point label="{label}"><pos_b>{numbers(place)}</pos_b></point>' for label, place in points]
    number = SEGMENTS.index(name) + 1
    return f'<segment label="{name}" id="{number}"><points>{"".join(lines)}</points></segment>'


def numbers(values: F64) -> str:
    """Numbers as MVN writes them."""
    return " ".join(f"{value:.6f}" for value in np.ravel(values))


def subject_text(
    positions: F64, orientations: F64, *, label: str = "Ann", rate: str = "60", suit: str = "FullBody", more: str = ""
) -> str:
    """A subject with the three poses of calibration before its frames; `more` stands in every frame."""
    still = f"<orientation>{numbers(orientations[0])}</orientation><position>{numbers(0 * positions[0])}</position>"
    lines = [f'<frame time="0" type="{kind}">{still}</frame>' for kind in ("identity", "tpose", "tpose-isb")]
    for t, (places, rotations) in enumerate(zip(positions, orientations, strict=True)):
        fields = f"<orientation>{numbers(rotations)}</orientation><position>{numbers(places)}</position>{more}"
        lines.append(f'<frame time="{t * 17}" index="{t}" tc="0" ms="{t}" type="normal">{fields}</frame>')
    segments = "".join(segment_text(name) for name in SEGMENTS)
    return (
        f'<subject label={quoteattr(label)} frameRate="{rate}" segmentCount="23" configuration="{suit}">'
        f"<comment></comment><segments>{segments}</segments>"
        '<sensors><sensor label="Pelvis"/><sensor label="Head"/></sensors>'
        '<joints><joint label="jL5S1"><connector1>Pelvis/jL5S1</connector1></joint></joints>\n'
        f'<frames segmentCount="23" sensorCount="2" jointCount="1">\n{chr(10).join(lines)}\n</frames></subject>'
    )


def mvnx_text(subjects: Sequence[str], version: int = 4) -> str:
    """An MVNX file of some subjects."""
    head = '<?xml version="1.0" encoding="UTF-8"?>\n<mvnx xmlns="http://www.xsens.com/mvn/mvnx" '
    return f'{head}version="{version}">\n<mvn version="2019.0.0"/><comment/>{"".join(subjects)}</mvnx>\n'


def write_mvnx(path: Path, frames: int = 5, **given: str) -> tuple[F64, F64]:
    """Write a file of one subject; its positions and orientations."""
    positions, orientations = dancing(frames)
    path.write_text(mvnx_text([subject_text(positions, orientations, **given)]))
    return positions, orientations
