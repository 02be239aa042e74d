"""Read MVNX files of Xsens MVN: positions and orientations of the segments of the body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops.arrays import I64
from kinedex.ops.body.transforms import rotations
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.figure_poses import Figure
from kinedex.storage.formats.motion.figures import FigureReader, figure_bytes
from kinedex.storage.formats.motion.reader import FASTEST_HZ, SLOWEST_HZ, Extent, MotionFile, ReadSettings
from kinedex.storage.formats.motion.scene_figures import chosen_person
from kinedex.storage.formats.mvnx import Subject, count_elements, read_mvnx, subject_names

F64 = npt.NDArray[np.float64]

PARENTS = {
    "L5": "Pelvis", "L3": "L5", "T12": "L3", "T8": "T12", "Neck": "T8", "Head": "Neck",
    "RightShoulder": "T8", "RightUpperArm": "RightShoulder", "RightForeArm": "RightUpperArm",
    "RightHand": "RightForeArm",
    "LeftShoulder": "T8", "LeftUpperArm": "LeftShoulder", "LeftForeArm": "LeftUpperArm", "LeftHand": "LeftForeArm",
    "RightUpperLeg": "Pelvis", "RightLowerLeg": "RightUpperLeg", "RightFoot": "RightLowerLeg",
    "RightToe": "RightFoot",
    "LeftUpperLeg": "Pelvis", "LeftLowerLeg": "LeftUpperLeg", "LeftFoot": "LeftLowerLeg", "LeftToe": "LeftFoot",
}  # fmt: skip
"""A dict from segment of MVN's body model to its parent segment; a segment's origin is its upper joint."""

TIPS = {
    "Head": "pTopOfHead", "RightHand": "pRightTopOfHand", "LeftHand": "pLeftTopOfHand", "RightToe": "pRightToe",
    "LeftToe": "pLeftToe",
}  # fmt: skip
"""A dict from segment without children to the point at its end, which becomes a node such as `Head_end`."""

MEASURED = {
    "UpperBody": ("UpperLeg", "LowerLeg", "Foot", "Toe"),
    "LowerBody": ("L5", "L3", "T12", "T8", "Neck", "Head", "Shoulder", "UpperArm", "ForeArm", "Hand"),
}
"""A dict from suit to endings of the names of segments without sensors, which move rigidly with the pelvis."""

_Y_UP = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
"""The matrix from MVN's axes (X forward, Y left, Z up) to kinedex's (X left, Y up, Z forward)."""


class MvnxReader(FigureReader):
    """Reads MVNX files; every subject becomes a separate person."""

    endings: ClassVar[tuple[str, ...]] = (".mvnx",)

    def relevant_settings(self, settings: ReadSettings) -> object:
        """Return the rates, the only settings that affect the result."""
        return settings.rate_hz, settings.override_rate_hz

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Count the frames, and estimate the memory of the motion of all segments and the joints."""
        frames, nodes = count_elements(file.path, "frame"), len(PARENTS) + 1 + len(TIPS)
        in_frame = 8 * (7 * 2 + 1) * nodes  # numbers; twice as many while an array grows
        need = figure_bytes(frames, nodes, joints) + in_frame * frames + (8 << 20)
        return Extent(frames, need, settings.override_rate_hz)

    def persons(self, file: MotionFile, mappings: Mappings) -> tuple[str, ...]:
        """Return the names of the subjects; empty if there is only one."""
        if count_elements(file.path, "subject") < 2:
            return ()
        names = subject_names(read_mvnx(file.path))
        return names if len(names) > 1 else ()

    def figure(self, file: MotionFile, settings: ReadSettings) -> Figure:
        """Return the tree of a subject with its motion."""
        subjects = read_mvnx(file.path, ("position", "orientation"), file.person or None)
        subject = subjects[chosen_person(file.path, file.person, subject_names(subjects))]
        return figure_of(file.path, subject, settings)


def figure_of(path: Path, subject: Subject, settings: ReadSettings) -> Figure:
    """Return the tree of a subject's segments and their end points.

    Raises
    ------
    SourceError
        The subject has no frames, no rate, or a segment that MVN's model of the body does not have.
    """
    if not subject.frames:
        raise SourceError(path, "has no frame of type normal: it holds no motion")
    if not len(subject.fields["position"]) or not len(subject.fields["orientation"]):
        raise SourceError(path, "has no <position> or no <orientation> of segments in its frames; export both from MVN")
    rate_hz = subject.rate_hz or settings.override_rate_hz or settings.rate_hz
    if rate_hz is None:
        raise SourceError(path, "states no frameRate: give `rate_hz`, or --rate")
    if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        raise SourceError(path, f"frameRate must be {SLOWEST_HZ:g} to {FASTEST_HZ:g} Hz, got {rate_hz:g}")
    lost = MEASURED.get(subject.configuration, ())
    used = [name for name in subject.segments if name in ("Pelvis", *PARENTS) and not name.endswith(lost)]
    if "Pelvis" not in used:
        raise SourceError(path, f"has no segment Pelvis; it has {', '.join(subject.segments[:30])}")
    names = [name for name in ("Pelvis", *PARENTS) if name in used]
    parents = [-1, *(_parent(name, names) for name in names[1:])]
    tips = [name for name in names if TIPS.get(name) in subject.points[name]]
    steps = np.diff(np.frombuffer(subject.indices, np.int64))
    missing = int(np.sum(steps[steps > 1] - 1))
    gaps = f"{missing} frames are missing between others, by their index; the motion jumps there"
    warnings = [f"the file was recorded with the suit {subject.configuration}, so the rest is unknown"] if lost else []
    return Figure(
        names=(*names, *(f"{name}_end" for name in tips)),
        parents=(*parents, *(names.index(name) for name in tips)),
        rest=_rest(subject, names, parents, tips),
        poses=_Segments(
            subject,
            [subject.segments.index(name) for name in names],
            tips,
            subject.numbers("position"),
            subject.numbers("orientation"),
        ),
        frames=subject.frames,
        rate_hz=rate_hz,
        evidence=("the file is of Xsens MVN, whose axes are X forward and Z up, in metres",),
        warnings=(*warnings, *([gaps] if missing else [])),
        upright=True,
    )


def _parent(name: str, names: list[str]) -> int:
    """Return the index of a segment's nearest ancestor that the file has."""
    above = PARENTS[name]
    while above not in names:
        above = PARENTS[above]
    return names.index(above)


def _rest(subject: Subject, names: list[str], parents: list[int], tips: list[str]) -> F64:
    """Return the T-pose positions of the nodes, from the points that neighbouring segments share."""
    rest = np.zeros((len(names), 3))
    for i, name in enumerate(names[1:], 1):
        above = names[parents[i]]
        own = [label for label, place in subject.points[name].items() if not any(place)]
        shared = next((label for label in own if label in subject.points[above]), None)
        if shared is not None:
            rest[i] = rest[parents[i]] + np.array(subject.points[above][shared])
        else:  # no points: use the distances of the first frame, which give sizes but no directions
            positions = subject.numbers("position")[0]
            ends = positions[subject.segments.index(name)] - positions[subject.segments.index(above)]
            rest[i] = rest[parents[i]] + ends
    ends_of_tips = [rest[names.index(name)] + np.array(subject.points[name][TIPS[name]]) for name in tips]
    placed: F64 = np.concatenate([rest, np.array(ends_of_tips).reshape(-1, 3)]) @ _Y_UP.T
    return placed


@dataclass(frozen=True)
class _Segments:
    """The motion of a subject: the segments in use, and the end points that follow them."""

    subject: Subject
    used: list[int]
    tips: list[str]
    positions: F64
    orientations: F64

    def at(self, frames: I64, oriented: Sequence[int]) -> tuple[F64, F64]:
        """Return positions (N, 3, K) of all nodes and rotations (M, 9, K) of `oriented` ones in K frames.

        They are in metres with Y up.
        """
        turns = self.orientations[frames]
        all_places = self.positions[frames]
        positions = [all_places[:, self.used]]
        for name in self.tips:
            place = self.subject.segments.index(name)
            point = np.array(self.subject.points[name][TIPS[name]])
            positions.append((all_places[:, place] + rotations(turns[:, place]) @ point)[:, None])
        found = np.concatenate(positions, axis=1) @ _Y_UP.T
        ends = [*self.used, *(self.subject.segments.index(name) for name in self.tips)]
        turned = _Y_UP @ rotations(turns[:, [ends[node] for node in oriented]]) @ _Y_UP.T
        rows = turned.transpose(1, 2, 3, 0).reshape(len(oriented), 9, len(frames))
        return np.ascontiguousarray(found.transpose(1, 2, 0)), rows
