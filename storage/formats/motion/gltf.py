"""Read glTF files: skeletons of skins, moved by the animations of the file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops.body.keyframe_tracks import OFF_GRID, likely_rate, sample_track
from kinedex.ops.body.transforms import global_transforms, rotations, without_scale
from kinedex.storage.formats.motion.figure_poses import Figure, ScenePoses
from kinedex.storage.formats.motion.figures import FigureReader, figure_bytes, refuse_many_frames
from kinedex.storage.formats.motion.gltf_document import Animation, Document, Sampler, matrix_parts, read_gltf
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

PATHS = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3"}
"""A dict from the properties that move a node to the types of their values."""

_HALF_TURN = np.diag([-1.0, 1.0, -1.0])
"""The rotation from the axes of VRM 0, whose avatars face −Z, to those of glTF."""


class GltfReader(FigureReader):
    """Reads .gltf and .glb files, and VRM avatars and animations, which use the same format."""

    endings: ClassVar[tuple[str, ...]] = (".glb", ".gltf", ".vrm", ".vrma")
    beside: ClassVar[tuple[str, ...]] = (".bin",)

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Count the frames by the times of the keys, and estimate the memory of JSON, keys and joints."""
        document = read_gltf(file.path)
        clip = chosen_clip(file.path, file.person, _clips(document))
        times = _times(document, clip.content)
        rate_hz, _ = likely_rate(times)
        frames = _frames(times, rate_hz)
        keys = sum(accessor.count for accessor in document.content.accessors) * 16 * 8
        nodes = len(document.content.nodes)
        need = figure_bytes(frames, nodes, joints) + 10 * document.json_bytes + min(keys, 50 * document.size)
        return Extent(frames, need + (4 << 20), settings.rate_of(rate_hz, []))

    def persons(self, file: MotionFile, mappings: Mappings) -> tuple[str, ...]:
        """Return the names of figures and clips; empty if the file has one clip of one figure."""
        names = clip_names(_clips(read_gltf(file.path)))
        return names if len(names) > 1 else ()

    def figure(self, file: MotionFile, settings: ReadSettings) -> Figure:
        """Return the chosen figure with the motion of its clip."""
        document = read_gltf(file.path)
        return _figure(document, chosen_clip(file.path, file.person, _clips(document)))


def _clips(document: Document) -> list[FigureClip[Animation]]:
    """Return the animations of every figure of a document.

    Raises
    ------
    SourceError
        No animation moves a skeleton.
    """
    content = document.content
    # the bones that VRM names, each below its nearest named ancestor
    bones = set(_human_bones(document).values())
    groups = groups_of(document.parents, bones, bones)[:1] if bones else _groups(document)
    found = figure_clips(
        [(group, content.nodes[group.nodes[0]].name or "figure") for group in groups],
        [
            (animation, animation.name or "clip", {channel.target.node for channel in animation.channels})
            for animation in content.animations
        ],
    )
    if not found:
        what = "animations" if not content.animations else "animation of a skeleton (of joints of a skin)"
        raise document.error(f"holds no {what}: {len(content.nodes)} nodes, {len(content.skins)} skins")
    return found


def _groups(document: Document) -> list[Group]:
    """Return the skeletons: connected joints of skins, or else the nodes that animations move."""
    nodes = document.content.nodes
    joints = {joint for skin in document.content.skins for joint in skin.joints}
    if any(joint >= len(nodes) for joint in joints):
        raise document.error(f"skins.joints must be nodes below {len(nodes)}, got {max(joints)}")
    if joints:
        shown = [i for i, node in enumerate(nodes) if (node.mesh is None and node.camera is None) or i in joints]
    else:
        shown = [i for i, node in enumerate(nodes) if node.camera is None]
        channels = [channel for animation in document.content.animations for channel in animation.channels]
        joints = {channel.target.node for channel in channels if channel.target.node is not None}
        joints &= set(range(len(nodes)))
    return groups_of(document.parents, joints, set(shown))


def _human_bones(document: Document) -> dict[str, int]:
    """Return a dict from bone name (such as `leftUpperLeg`) to node; empty for files without the VRM extension."""
    extensions = document.content.extensions
    for key in ("VRMC_vrm", "VRMC_vrm_animation", "VRM"):
        humanoid = extensions[key].get("humanoid") if isinstance(extensions.get(key), dict) else None
        bones = humanoid.get("humanBones") if isinstance(humanoid, dict) else None
        if isinstance(bones, list):  # the form of VRM 0
            pairs = [(bone.get("bone"), bone) for bone in bones if isinstance(bone, dict)]
        else:
            pairs = list(bones.items()) if isinstance(bones, dict) else []
        found = {}
        for name, bone in pairs:
            node = bone.get("node") if isinstance(bone, dict) else None
            if isinstance(name, str) and isinstance(node, int) and 0 <= node < len(document.content.nodes):
                found[name[:60]] = node
        if found:
            return found
    return {}


@dataclass(frozen=True)
class _Track:
    """A property of a node that an animation moves."""

    node: int
    path: str
    times: F64
    values: F64
    interpolation: str


@dataclass(frozen=True)
class _Local:
    """The transforms of nodes relative to their parents, as functions of time in a clip."""

    linear: F64
    offsets: F64
    rotations: F64
    scales: F64
    tracks: Sequence[_Track]
    late: float

    def __call__(self, seconds: F64) -> tuple[F64, F64]:
        """Return rotations with scale (M, K, 3, 3), and positions (M, K, 3), of M nodes at K times in seconds."""
        offsets = np.repeat(self.offsets[:, None], len(seconds), axis=1)
        linear = np.repeat(self.linear[:, None], len(seconds), axis=1)
        moved: dict[int, dict[str, F64]] = {}
        for track in self.tracks:
            turning = track.path == "rotation"
            found = sample_track(track.times, track.values, seconds, track.interpolation, turning, self.late)
            moved.setdefault(track.node, {})[track.path] = rotations(found[:, [3, 0, 1, 2]]) if turning else found
        for node, parts in moved.items():
            offsets[node] = parts.get("translation", self.offsets[node])
            turns = parts.get("rotation", rotations(self.rotations[node]))
            linear[node] = turns * parts.get("scale", self.scales[node])[..., None, :]
        return linear, offsets


def _figure(document: Document, clip: FigureClip[Animation]) -> Figure:
    """Return a figure with the motion of a clip."""
    tracks, nodes = _tracks(document, clip.content), document.content.nodes
    times = _times(document, clip.content)
    rate_hz, usual = likely_rate(times)
    frames = _frames(times, rate_hz)
    refuse_many_frames(document.path, frames, len(times))
    chain, parents, shown = clip.group.chain(document.parents)
    place = {node: i for i, node in enumerate(chain)}
    turns = np.roll([nodes[node].rotation for node in chain], 1, axis=1)  # w, x, y, z
    scales, offsets = (np.array([getattr(nodes[node], key) for node in chain]) for key in ("scale", "translation"))
    linear = rotations(turns) * scales[:, None, :]
    for i, node in enumerate(chain):
        if nodes[node].matrix is not None:
            linear[i], offsets[i] = matrix_parts(nodes[node])
    axes = _HALF_TURN if "VRM" in document.content.extensions else np.eye(3)
    whole, positions = global_transforms(parents, linear[:, None], offsets[:, None])
    kept = [replace(track, node=place[track.node]) for track in tracks if track.node in place]
    local = _Local(linear, offsets, turns, scales, kept, OFF_GRID / rate_hz)
    whole, positions, posed = _bound(document, chain, parents, (linear, offsets), (whole[:, 0], positions[:, 0]))
    rest = without_scale(whole[list(shown)])
    poses = ScenePoses(parents, shown, local, float(times[0]), rate_hz, axes, rest)
    sampled = f"its keys have times and no rate; they are sampled at {rate_hz:.6g} Hz"
    warnings = () if usual else (f"{sampled}, which is no usual rate: its keys lie on the frames of none",)
    bones = {node: name for name, node in _human_bones(document).items()}
    evidence = ("glTF defines metres, and Y up", *((sampled,) if usual else ()), f"its rest pose is {posed}")
    return Figure(
        names=unique_names([bones.get(node) or nodes[node].name or f"node {node}" for node in clip.group.nodes]),
        parents=clip.group.parents,
        rest=positions[list(shown)] @ axes.T,
        poses=poses,
        frames=frames,
        rate_hz=rate_hz,
        evidence=evidence,
        warnings=warnings,
        turns=axes @ rest,
    )


def _bound(
    document: Document, chain: Sequence[int], parents: Sequence[int], local: tuple[F64, F64], scene: tuple[F64, F64]
) -> tuple[F64, F64, str]:
    """Return rest rotations (M, 3, 3) and positions (M, 3) of a chain, and the pose's name.

    That is the bind pose, in which a mesh was bound to the skeleton, if it differs from the nodes' pose outside of
    clips. Bind matrices may be in other axes than the scene; the rotation between the two, composed of right angles, is
    taken from the first joint.
    """
    whole, positions = scene
    inverse = _binding(document)
    bound = [(i, inverse[node]) for i, node in enumerate(chain) if node in inverse]
    between = [whole[i] @ matrix[:3, :3] for i, matrix in bound]  # from the axes of the bind matrices to the scene's
    usable = bool(bound) and all(abs(np.linalg.det(matrix)) > 1e-12 for matrix in between)
    if not usable:
        return whole, positions, "that of the scene outside of clips"
    rotations = without_scale(np.array(between))
    if (np.einsum("ab,kab->k", rotations[0], rotations) > 3.0 - 1e-3).all():
        return whole, positions, "the pose of binding"
    axes = _right_angles(rotations[0]) * np.cbrt(np.linalg.det(between[0]))
    matrices = {i: np.linalg.inv(matrix) for i, matrix in bound}
    moved = positions[bound[0][0]] - axes @ matrices[bound[0][0]][:3, 3]
    whole, positions = whole.copy(), positions.copy()
    for i, above in enumerate(parents):
        if i in matrices:
            whole[i], positions[i] = axes @ matrices[i][:3, :3], axes @ matrices[i][:3, 3] + moved
        elif above >= 0:
            whole[i], positions[i] = whole[above] @ local[0][i], positions[above] + whole[above] @ local[1][i]
    return whole, positions, "the pose of binding"


def _binding(document: Document) -> dict[int, F64]:
    """Return a dict from node to inverse bind matrix (4, 4), for the joints of skins with invertible matrices."""
    found: dict[int, F64] = {}
    for skin in document.content.skins:
        if skin.inverseBindMatrices is not None:
            columns = document.numbers(skin.inverseBindMatrices, "MAT4").reshape(-1, 4, 4)
            matrices = columns.transpose(0, 2, 1)
            sound = np.abs(np.linalg.det(matrices)) > 1e-12
            for joint, matrix, whole in zip(skin.joints, matrices, sound, strict=False):
                if whole and joint not in found:
                    found[joint] = matrix
    return found


def _right_angles(turn: F64) -> F64:
    """Return the nearest rotation that is composed of right angles about the axes."""
    ways = [[s * np.eye(3)[i] for i in range(3) for s in (1, -1)] for _ in range(2)]
    rotations = [np.array([x, y, np.cross(x, y)]) for x in ways[0] for y in ways[1] if abs(x @ y) < 0.5]
    return max(rotations, key=lambda other: float(np.sum(other * turn)))


def _tracks(document: Document, animation: Animation) -> list[_Track]:
    """Return the tracks of a clip that move nodes."""
    tracks = []
    for channel in animation.channels:
        kind, node = PATHS.get(channel.target.path), channel.target.node
        if kind is None or node is None:
            continue  # weights of morph targets, or an extension's
        sampler = _sampler(document, animation, channel.sampler)
        times = _input(document, sampler)
        values = document.numbers(sampler.output, kind)
        per_key = 3 if sampler.interpolation == "CUBICSPLINE" else 1
        if len(values) != per_key * len(times):
            where = f"accessors.{sampler.output}"
            raise document.error(f"{where} must have {per_key} values for each of {len(times)} keys, got {len(values)}")
        tracks.append(_Track(node, channel.target.path, times, values, sampler.interpolation))
    return tracks


def _sampler(document: Document, animation: Animation, index: int) -> Sampler:
    if index >= len(animation.samplers):
        raise document.error(f"a channel of '{animation.name[:60]}' names samplers.{index}, which is not there")
    return animation.samplers[index]


def _input(document: Document, sampler: Sampler) -> F64:
    times = document.numbers(sampler.input, "SCALAR")[:, 0]
    if not len(times) or (np.diff(times) < 0).any():
        raise document.error(f"accessors.{sampler.input} must be ascending times of at least one key")
    return times


def _times(document: Document, animation: Animation) -> F64:
    """Return the times of all keys of a clip that move nodes."""
    used = {channel.sampler for channel in animation.channels if channel.target.path in PATHS}
    samplers = {_sampler(document, animation, index).input: _sampler(document, animation, index) for index in used}
    times = [_input(document, sampler) for sampler in samplers.values()]
    if not times:
        raise document.error(f"animation '{animation.name[:60]}' moves no node")
    return np.unique(np.concatenate(times))


def _frames(times: F64, rate_hz: float) -> int:
    return 1 + int((times[-1] - times[0]) * rate_hz + 0.1)
