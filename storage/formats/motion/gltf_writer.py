"""Write glTF files: a skeleton of the named joints with an animation, and a mesh that shows it (glTF 2.0)."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.ops.body.joint_tree import JOINT_PARENTS
from kinedex.ops.body.kinematics import frames_along, quaternions
from kinedex.ops.body.transforms import rotations
from kinedex.ops.errors import KinedexError
from kinedex.storage.formats.motion.joint_motion import JointMotion

F64 = npt.NDArray[np.float64]

_RADIUS_M = 0.02
_SPINE = ("chest", "neck", "belly", "head")  # the first known one gives the root's up direction
_COLOURS = {
    "left": (0.0137, 0.1589, 0.552), "right": (0.638, 0.0666, 0.1046), "middle": (0.0452, 0.0452, 0.0452),
}  # fmt: skip
"""Colours of the sides of the body, in linear light as glTF defines them."""

_CORNERS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float64)
_FACES = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)]
_EDGES = sorted({(min(pair), max(pair)) for a, b, c in _FACES for pair in ((a, b), (b, c), (c, a))})
_FLOAT, _SHORT, _BYTE = 5126, 5123, 5121
_ARRAY, _ELEMENTS = 34962, 34963


def write_gltf(path: Path, motion: JointMotion) -> None:
    """Write the joints of a motion as a binary glTF file (.glb), in metres with Y up.

    Every joint is a node below its parent, with a key for each frame. The root has the motion's orientation, or that of
    hips and spine; the other nodes do not rotate. A mesh of sticks, blue on the left and red on the right, is bound to
    the nodes. Joints that are missing in all frames are left out.

    Parameters
    ----------
    path : Path
        The file to write.
    motion : JointMotion
        The motion.

    Raises
    ------
    KinedexError
        The root is always missing, or a joint is missing in only some frames, which glTF cannot express.
    """
    names, parents, positions = _tree(motion)
    rotations = _root_rotations(names, positions, motion.orientation)
    document = _Document()
    root = names.index("root")
    local = positions - positions[[max(parent, 0) for parent in parents]]
    local = np.einsum("tba,jtb->jta", rotations, local)
    local[root] = positions[root]
    nodes: list[dict[str, Any]] = [
        {"name": name, "translation": local[i, 0].astype(np.float32).tolist()} for i, name in enumerate(names)
    ]
    for i, parent in enumerate(parents):
        if parent >= 0:
            nodes[parent].setdefault("children", []).append(i)
    nodes.append({"name": "figure", "mesh": 0, "skin": 0})
    bound = _rest(parents, local[:, 0])
    content = {
        "asset": {"version": "2.0", "generator": "kinedex"},
        "scene": 0,
        "scenes": [{"name": motion.name, "nodes": [root, len(names)]}],
        "nodes": nodes,
        "skins": [document.skin(bound, root)],
        "meshes": [document.mesh(names, parents, bound)],
        "materials": [_material(name, colour) for name, colour in _COLOURS.items()],
        "animations": [document.animation(motion, local, rotations, root)],
    }
    document.write(path, content)


def _tree(motion: JointMotion) -> tuple[list[str], list[int], F64]:
    """Return the joints present, parents first, the index of each one's parent, and positions (joints, T, 3)."""
    seen: npt.NDArray[np.bool_] = np.all(np.isfinite(motion.positions), axis=2)
    known = {name: i for i, name in enumerate(motion.joints) if seen[:, i].any()}
    if "root" not in known:
        raise KinedexError(f"'{motion.name}' has no root in any frame; a glTF needs it (csv, trc and c3d do not)")
    lost = [name for name, i in known.items() if not seen[:, i].all()]
    if lost:
        gone = np.count_nonzero(~seen[:, [known[name] for name in lost]].all(axis=1))
        raise KinedexError(
            f"'{motion.name}' is invalid in {gone} of its {len(seen)} frames, where {', '.join(lost)} have no place; a "
            "glTF needs every joint in every frame. Export csv, trc or c3d, or ingest the take again with a larger "
            "fill_gap_frames, which closes longer gaps"
        )
    names = [name for name in JOINT_PARENTS if name in known]
    parents = []
    for name in names:
        above = JOINT_PARENTS[name]
        while above is not None and above not in known:
            above = JOINT_PARENTS[above]
        parents.append(-1 if above is None else names.index(above))
    positions = motion.positions[:, [known[name] for name in names]].astype(np.float64).transpose(1, 0, 2)
    return names, parents, positions


def _root_rotations(names: Sequence[str], positions: F64, orientation: npt.NDArray[np.float32] | None) -> F64:
    """Return the root's rotations (T, 3, 3): from `orientation` if finite, else from hips and spine, else identity."""
    if orientation is not None and np.isfinite(orientation).all():
        return rotations(orientation.astype(np.float64))
    of = dict(zip(names, positions, strict=True))
    spine = next((name for name in _SPINE if name in of), None)
    frames = positions.shape[1]
    if spine is not None and {"lhip", "rhip"} <= of.keys():
        turns = frames_along((of["lhip"] - of["rhip"]).T, (of[spine] - of["root"]).T)
        if np.isfinite(turns).all():
            return turns.reshape(3, 3, frames).transpose(2, 0, 1)
    return np.repeat(np.eye(3)[None], frames, axis=0)


def _rest(parents: Sequence[int], local: F64) -> F64:
    """Return rest positions (joints, 3) of the nodes, with an unrotated root."""
    positions = local.copy()
    for i, parent in enumerate(parents):
        if parent >= 0:
            positions[i] += positions[parent]
    return positions


def _material(name: str, colour: tuple[float, float, float]) -> dict[str, Any]:
    shine = {"baseColorFactor": [*colour, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.9}
    return {"name": name, "pbrMetallicRoughness": shine, "doubleSided": True}


@dataclass
class _Document:
    """A glTF document being written: its accessors and their bytes."""

    accessors: list[dict[str, Any]] = field(default_factory=list)
    views: list[dict[str, Any]] = field(default_factory=list)
    parts: list[bytes] = field(default_factory=list)
    size: int = 0

    def accessor(self, values: npt.NDArray[Any], kind: str, target: int | None = None, limits: bool = False) -> int:
        """Append numbers (count, components) and return the index of their accessor."""
        component = {"f": _FLOAT, "H": _SHORT, "B": _BYTE}[values.dtype.char]
        data = np.ascontiguousarray(values).tobytes()
        entry: dict[str, Any] = {
            "bufferView": len(self.views), "componentType": component, "count": len(values), "type": kind,
        }  # fmt: skip
        if limits:
            rows = values.reshape(len(values), -1)
            entry |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        view: dict[str, Any] = {"buffer": 0, "byteOffset": self.size, "byteLength": len(data)}
        self.views.append(view | ({} if target is None else {"target": target}))
        self.parts.append(data + b"\0" * (-len(data) % 4))
        self.size += len(self.parts[-1])
        self.accessors.append(entry)
        return len(self.accessors) - 1

    def skin(self, bound: F64, root: int) -> dict[str, Any]:
        """Return the skin of nodes with bind positions (joints, 3)."""
        matrices = np.tile(np.eye(4, dtype=np.float32), (len(bound), 1, 1))
        matrices[:, 3, :3] = -bound  # glTF stores matrices by columns
        inverse = self.accessor(matrices.reshape(-1, 16), "MAT4")
        return {"joints": list(range(len(bound))), "inverseBindMatrices": inverse, "skeleton": root}

    def mesh(self, names: Sequence[str], parents: Sequence[int], bound: F64) -> dict[str, Any]:
        """Return a mesh of octahedra at the joints and sticks between them, each vertex bound to one joint.

        A stick joins corresponding edges of two octahedra by faces, so that it has volume in every direction, although
        the nodes do not rotate.
        """
        corners = (bound[:, None] + _RADIUS_M * _CORNERS).reshape(-1, 3).astype(np.float32)
        joints = np.zeros((len(corners), 4), np.uint8)
        joints[:, 0] = np.repeat(np.arange(len(bound)), len(_CORNERS))
        weights = np.zeros((len(corners), 4), np.float32)
        weights[:, 0] = 1.0
        attributes = {
            "POSITION": self.accessor(corners, "VEC3", _ARRAY, limits=True),
            "JOINTS_0": self.accessor(joints, "VEC4", _ARRAY),
            "WEIGHTS_0": self.accessor(weights, "VEC4", _ARRAY),
        }
        triangles: dict[str, list[tuple[int, int, int]]] = {side: [] for side in _COLOURS}
        for i, parent in enumerate(parents):
            side = {"l": "left", "r": "right"}.get(names[i][0] if names[i] != "root" else "", "middle")
            at, above = len(_CORNERS) * i, len(_CORNERS) * parent
            triangles[side] += [(at + a, at + b, at + c) for a, b, c in _FACES]
            for a, b in _EDGES if parent >= 0 else ():
                triangles[side] += [(above + a, above + b, at + a), (above + b, at + b, at + a)]
        primitives = []
        for material, found in enumerate(triangles.values()):
            if found:
                indices = self.accessor(np.array(found, np.uint16).reshape(-1, 1), "SCALAR", _ELEMENTS)
                primitives.append({"attributes": attributes, "indices": indices, "material": material})
        return {"name": "sticks", "primitives": primitives}

    def animation(self, motion: JointMotion, local: F64, rotations: F64, root: int) -> dict[str, Any]:
        """Return a clip with a key for each frame: positions (joints, T, 3) of all nodes, and rotations of the root."""
        seconds = (np.arange(local.shape[1]) / motion.rate_hz).astype(np.float32)
        times = self.accessor(seconds.reshape(-1, 1), "SCALAR", limits=True)
        samplers: list[dict[str, Any]] = []
        channels: list[dict[str, Any]] = []
        tracks = [(i, "translation", track.astype(np.float32), "VEC3") for i, track in enumerate(local)]
        wxyz = quaternions(np.ascontiguousarray(rotations.reshape(-1, 9).T)).T
        tracks.append((root, "rotation", wxyz[:, [1, 2, 3, 0]].astype(np.float32), "VEC4"))
        for node, path, values, kind in tracks:
            channels.append({"sampler": len(samplers), "target": {"node": node, "path": path}})
            samplers.append({"input": times, "output": self.accessor(values, kind), "interpolation": "LINEAR"})
        return {"name": motion.name, "channels": channels, "samplers": samplers}

    def write(self, path: Path, content: dict[str, Any]) -> None:
        """Write the content and the bytes as one file."""
        content |= {
            "accessors": self.accessors, "bufferViews": self.views, "buffers": [{"byteLength": self.size}],
        }  # fmt: skip
        text = json.dumps(content, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        length = 12 + 8 + len(text) + 8 + self.size
        if length >= 1 << 32:
            raise KinedexError(f"a .glb holds 4 GB at most, and this one needs {length / 1e9:.1f} GB; export ranges")
        with path.open("wb") as file:
            file.write(struct.pack("<4sII", b"glTF", 2, length))
            file.write(struct.pack("<I4s", len(text), b"JSON") + text)
            file.write(struct.pack("<I4s", self.size, b"BIN\0"))
            file.writelines(self.parts)
