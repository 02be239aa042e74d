"""Read FBX files: skeletons, moved by the animation stacks of the file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops.body.keyframe_tracks import OFF_GRID, Curve, likely_rate
from kinedex.ops.body.transforms import global_transforms, without_scale
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.fbx_records import FREE_BYTES
from kinedex.storage.formats.motion.fbx_scene import BONES, Clip, Scene, SceneNode
from kinedex.storage.formats.motion.figure_poses import Figure, ScenePoses
from kinedex.storage.formats.motion.figures import FigureReader, figure_bytes, refuse_many_frames
from kinedex.storage.formats.motion.reader import Extent, MotionFile, ReadSettings
from kinedex.storage.formats.motion.scene_figures import (
    FigureClip,
    Group,
    chosen_clip,
    clip_names,
    figure_clips,
    groups_of,
    unique_names,
)

F64 = npt.NDArray[np.float64]

HIDDEN = {"Mesh", "Camera", "CameraSwitcher", "Light", "NurbsCurve", "NurbsSurface", "Patch", "Shape"}
"""Classes of nodes that are not part of a skeleton."""

_KEPT_TIMES = 25
"""The largest ratio of a record's memory to its bytes in the file."""

_ALIKE = 0.05  # largest relative difference of bone lengths between the bind pose and the scene


class FbxReader(FigureReader):
    """Reads FBX files, binary and text, of versions 7.0 to 7.7."""

    endings: ClassVar[tuple[str, ...]] = (".fbx",)
    reads_whole: ClassVar[bool] = True

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Count the frames by the times of the keys, and estimate the memory of file, records and joints."""
        scene = Scene(file.path, file.data)
        clip = chosen_clip(file.path, file.person, clips_of(scene))
        _, frames, rate_hz, _ = _frames(scene, clip)
        need = figure_bytes(frames, len(scene.nodes), joints) + _KEPT_TIMES * scene.size + FREE_BYTES
        return Extent(frames, need, settings.rate_of(rate_hz, []))

    def persons(self, file: MotionFile, mappings: Mappings) -> tuple[str, ...]:
        """Return the names of figures and clips; empty if the file has one clip of one figure."""
        names = clip_names(clips_of(Scene(file.path, file.data)))
        return names if len(names) > 1 else ()

    def figure(self, file: MotionFile, settings: ReadSettings) -> Figure:
        """Read the chosen figure of the file, with the motion of its animation clip."""
        scene = Scene(file.path, file.data)
        return figure_of(scene, chosen_clip(file.path, file.person, clips_of(scene)))


def clips_of(scene: Scene) -> list[FigureClip[Clip]]:
    """Return the animation stacks that move each figure; raise SourceError if there are none."""
    groups = skeletons(scene)
    found = figure_clips(
        [(group, scene.nodes[group.nodes[0]].name or "figure") for group in groups],
        [(clip, clip.name, {node for node, _, _ in clip.curves}) for clip in scene.clips],
    )
    if not found:
        raise SourceError(
            scene.path,
            f"holds no animation of a skeleton: none of its clips (animation stacks: {len(scene.clips)}) moves one of "
            f"its skeletons ({len(groups)})",
        )
    return found


def skeletons(scene: Scene) -> list[Group]:
    """Return the skeletons: connected bones, or else the other nodes that clips move."""
    bones = {i for i, node in enumerate(scene.nodes) if node.kind in BONES}
    if not bones:
        moved = {node for clip in scene.clips for node, _, _ in clip.curves}
        bones = {node for node in moved if scene.nodes[node].kind not in HIDDEN}
    shown = {i for i, node in enumerate(scene.nodes) if node.kind not in HIDDEN}
    return groups_of(scene.parents, bones, shown)


def _frames(scene: Scene, clip: FigureClip[Clip]) -> tuple[float, int, float, str]:
    """Return the time of the first frame in seconds, the number of frames, their rate, and a sentence on its origin."""
    chain, _, _ = clip.group.chain(scene.parents)
    nodes = set(chain)
    curves = [curve for (node, _, _), curve in clip.content.curves.items() if node in nodes]
    times = np.unique(np.concatenate([curve.times for curve in curves]))
    rate_hz, usual = likely_rate(times)
    stated = scene.rate_hz
    if stated is not None and abs(stated - rate_hz) > 1e-4 * stated and (not usual or _on_frames(times, stated)):
        rate_hz, sentence = stated, f"the file states {stated:g} Hz, at which its curves are sampled"
    else:
        sentence = f"the keys of the file lie on frames of {rate_hz:g} Hz, at which its curves are sampled"
    start, stop = float(times[0]), float(times[-1])
    span = clip.content.span
    if span is not None and start < span[1] and span[0] < stop:
        start, stop = max(start, span[0]), min(stop, span[1])
    frames = 1 + int((stop - start) * rate_hz + 0.1)
    refuse_many_frames(scene.path, frames, len(times))
    return start, frames, rate_hz, sentence


def _on_frames(times: F64, rate_hz: float) -> bool:
    frames = (times - times[0]) * rate_hz
    return bool(np.abs(frames - np.round(frames)).max() <= OFF_GRID)


def figure_of(scene: Scene, clip: FigureClip[Clip]) -> Figure:
    """Return a figure with the motion of a clip.

    Raises
    ------
    SourceError
        Axes, unit or times of the file are not valid.
    """
    start, frames, rate_hz, sentence = _frames(scene, clip)
    chain, parents, shown = clip.group.chain(scene.parents)
    nodes = [scene.nodes[node] for node in chain]
    place = {node: i for i, node in enumerate(chain)}
    curves = {(place[key[0]], key[1], key[2]): curve for key, curve in clip.content.curves.items() if key[0] in place}
    rest, positions, posed = rest_of(scene, clip.group)
    warnings = []
    if clip.content.layers > 1:
        warnings.append(f"clip '{clip.clip}' has several layers; only the first is read")
    unit = 100.0 * abs(np.linalg.det(scene.axes)) ** (1 / 3)
    return Figure(
        names=unique_names([scene.nodes[node].name or f"node {node}" for node in clip.group.nodes]),
        parents=clip.group.parents,
        rest=positions @ scene.axes.T,
        poses=ScenePoses(parents, shown, _Local(nodes, curves, OFF_GRID / rate_hz), start, rate_hz, scene.axes, rest),
        frames=frames,
        rate_hz=rate_hz,
        evidence=(_axes_in_words(scene.axes, unit), sentence, f"its rest pose is {posed}"),
        warnings=tuple(warnings),
        turns=100.0 / unit * scene.axes @ rest,
    )


def _axes_in_words(axes: F64, unit: float) -> str:
    _, up, forward = ("xyz"[int(np.argmax(np.abs(row)))] for row in axes)
    signs = ["-" if row[np.argmax(np.abs(row))] < 0 else "" for row in axes]
    return f"the file states {signs[1]}{up} as up and {signs[2]}{forward} as front, and a unit of {unit:.6g} cm"


def rest_of(scene: Scene, group: Group) -> tuple[F64, F64, str]:
    """Return rest rotations (N, 3, 3) and positions (N, 3) of a figure in the scene's axes, and the pose's name.

    That is the bind pose, in which a mesh was bound to the skeleton, if the file has it for more than half of the
    figure's nodes and its bones are as long as the scene's; else the pose of the scene outside of clips.
    """
    chain, parents, shown = group.chain(scene.parents)
    parts = [scene.nodes[node].local(*(move[None] for move in scene.nodes[node].moves)) for node in chain]
    linear, offsets = (np.stack([part[i] for part in parts]) for i in range(2))
    whole, positions = global_transforms(parents, linear, offsets)
    own, bound = _lengths(parents, shown, positions[:, 0]), scene.bind_pose()
    if bound:
        for i, above in enumerate(parents):
            if (matrix := bound.get(chain[i])) is not None:
                whole[i, 0], positions[i, 0] = matrix[:3, :3], matrix[:3, 3]
            elif above >= 0:
                whole[i], positions[i] = whole[above] @ linear[i], positions[above] + whole[above, 0] @ offsets[i, 0]
        lengths = _lengths(parents, shown, positions[:, 0])
        alike = np.abs(lengths - own) <= _ALIKE * own.max(initial=0.0)
        if alike.all() and sum(chain[i] in bound for i in shown) > len(shown) // 2:
            return without_scale(whole[list(shown), 0]), positions[list(shown), 0], "the pose of binding"
        whole, positions = global_transforms(parents, linear, offsets)
    return without_scale(whole[list(shown), 0]), positions[list(shown), 0], "that of the scene outside of clips"


def _lengths(parents: Sequence[int], shown: Sequence[int], positions: F64) -> F64:
    """Return the distance of each of a figure's nodes from its parent."""
    pairs = [(i, parents[i]) for i in shown[1:] if parents[i] >= 0]
    lengths: F64 = np.array([np.linalg.norm(positions[i] - positions[above]) for i, above in pairs], np.float64)
    return lengths


@dataclass(frozen=True)
class _Local:
    """The transforms of nodes relative to their parents, as functions of time in a clip."""

    nodes: Sequence[SceneNode]
    curves: Mapping[tuple[int, int, int], Curve]
    late: float

    def __call__(self, seconds: F64) -> tuple[F64, F64]:
        """Return rotations with scale (M, K, 3, 3), and positions (M, K, 3), of M nodes at K times in seconds."""
        linear = np.empty((len(self.nodes), len(seconds), 3, 3))
        offsets = np.empty((len(self.nodes), len(seconds), 3))
        moves = [[np.repeat(move[None], len(seconds), axis=0) for move in node.moves] for node in self.nodes]
        for (place, what, axis), curve in self.curves.items():
            moves[place][what][:, axis] = curve.at(seconds, self.late)
        for i, node in enumerate(self.nodes):
            linear[i], offsets[i] = node.local(*moves[i])
        return linear, offsets
