"""glTF files whose JSON and numbers are changed in place, for `studies.mutations`."""

from __future__ import annotations

import base64
import copy
import json
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from kinedex.ops.arrays import F64
from kinedex.ops.body.kinematics import quaternions
from studies.skeleton_mutations import BvhText, about, local_motion, node_names

_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_KINDS = {size: kind for kind, size in _SIZES.items()}


@dataclass
class GltfScene:
    """A glTF file: its JSON without accessors, and the values of each accessor.

    Attributes
    ----------
    name : str
        The file that it was made of.
    ending : str
        ".glb", or ".gltf" for a file with its numbers in the JSON.
    content : dict
        The JSON.
    arrays : list of array (count, components)
        The values of the accessors.
    """

    name: str
    ending: str
    content: dict[str, Any]
    arrays: list[npt.NDArray[Any]] = field(default_factory=list)

    form: ClassVar[str] = "glTF"

    def copied(self) -> GltfScene:
        """Return a copy whose JSON can be changed; arrays are replaced and never changed."""
        return GltfScene(self.name, self.ending, copy.deepcopy(self.content), list(self.arrays))

    @property
    def names(self) -> dict[int, str]:
        """A dict from each joint of the skin to its name, parents first."""
        joints = self.content["skins"][0]["joints"]
        above = self.parents
        depth = {}
        for joint in joints:
            at, depth[joint] = joint, 0
            while at in above:
                at, depth[joint] = above[at], depth[joint] + 1
        return {joint: self.content["nodes"][joint]["name"] for joint in sorted(joints, key=depth.__getitem__)}

    @property
    def parents(self) -> dict[int, int]:
        """A dict from each node to its parent, without roots."""
        return {
            child: i for i, node in enumerate(self.content["nodes"]) for child in node.get("children", ())
        }  # fmt: skip

    def offset(self, node: int) -> F64:
        """Return the place of a node relative to its parent, outside of clips."""
        return np.array(self.content["nodes"][node].get("translation", (0.0, 0.0, 0.0)))

    def rename(self, node: int, name: str) -> None:
        """Give a node another name."""
        self.content["nodes"][node]["name"] = name

    def move(self, node: int, change: Callable[[F64], F64]) -> None:
        """Change a node's places relative to its parent, outside of clips and in them."""
        self.content["nodes"][node]["translation"] = change(self.offset(node)).tolist()
        for clip in self.content["animations"]:
            for channel in clip["channels"]:
                if channel["target"] == {"node": node, "path": "translation"}:
                    sampler = clip["samplers"][channel["sampler"]]
                    sampler["output"] = self._added(change(self.arrays[sampler["output"]]).astype("<f4"))

    def divide(self, node: int, name: str) -> None:
        """Insert a node without rotation halfway between a node and its parent."""
        above, nodes, twist = self.parents[node], self.content["nodes"], len(self.content["nodes"])
        self.move(node, lambda place: place / 2)
        nodes.append({"name": name, "translation": self.offset(node).tolist(), "children": [node]})
        nodes[above]["children"] = [twist if child == node else child for child in nodes[above]["children"]]
        for clip in self.content["animations"]:
            moved = [c for c in clip["channels"] if c["target"] == {"node": node, "path": "translation"}]
            for channel in moved:
                target = {"node": twist, "path": "translation"}
                clip["channels"].append({"sampler": channel["sampler"], "target": target})
        worlds = self.bound
        if worlds:
            worlds[twist] = worlds[above].copy()
            worlds[twist][:3, 3] = (worlds[above][:3, 3] + worlds[node][:3, 3]) / 2
        self.content["skins"][0]["joints"].append(twist)
        self.bind(worlds)

    def add_end(self, node: int, name: str, offset: F64) -> None:
        """Add a node below another."""
        nodes = self.content["nodes"]
        nodes[node].setdefault("children", []).append(len(nodes))
        nodes.append({"name": name, "translation": offset.tolist()})
        worlds = self.bound
        if worlds:
            worlds[len(nodes) - 1] = worlds[node].copy()
            worlds[len(nodes) - 1][:3, 3] += worlds[node][:3, :3] @ offset
        self.content["skins"][0]["joints"].append(len(nodes) - 1)
        self.bind(worlds)

    def hang(self, degrees: float, scale: float) -> None:
        """Hang the scene from a node that is turned about X and scaled."""
        turn = quaternions(about(0, np.deg2rad([degrees])).reshape(-1, 9).T).T[0, [1, 2, 3, 0]]
        roots = [node for node in self.names if node not in self.parents]
        nodes = self.content["nodes"]
        nodes.append({"name": "Armature", "rotation": turn.tolist(), "scale": [scale] * 3, "children": roots})
        for scene in self.content.get("scenes", ()):
            scene["nodes"] = [len(nodes) - 1, *(node for node in scene["nodes"] if node not in roots)]

    def pace(self, factor: float) -> None:
        """Let the clips run so many times as fast."""
        inputs = {sampler["input"] for clip in self.content["animations"] for sampler in clip["samplers"]}
        for i in inputs:
            self.arrays[i] = (self.arrays[i] / factor).astype("<f4")

    def shuffle(self, random: np.random.Generator) -> None:
        """List the nodes in another order."""
        nodes = self.content["nodes"]
        order = random.permutation(len(nodes)).tolist()
        place = {old: new for new, old in enumerate(order)}
        self.content["nodes"] = [nodes[old] for old in order]
        for node in nodes:
            if "children" in node:
                node["children"] = [place[child] for child in node["children"]]
        for skin in self.content["skins"]:
            skin["joints"] = [place[joint] for joint in skin["joints"]]
            if "skeleton" in skin:
                skin["skeleton"] = place[skin["skeleton"]]
        for scene in self.content.get("scenes", ()):
            scene["nodes"] = [place[node] for node in scene["nodes"]]
        for clip in self.content["animations"]:
            for channel in clip["channels"]:
                channel["target"]["node"] = place[channel["target"]["node"]]

    @property
    def bound(self) -> dict[int, F64]:
        """A dict from joint to its matrix in the pose of binding; empty if the file has none."""
        skin = self.content["skins"][0]
        if "inverseBindMatrices" not in skin:
            return {}
        matrices = self.arrays[skin["inverseBindMatrices"]].reshape(-1, 4, 4).transpose(0, 2, 1)
        return dict(zip(skin["joints"], np.linalg.inv(matrices.astype(np.float64)), strict=True))

    def bind(self, worlds: Mapping[int, F64]) -> None:
        """Replace the pose of binding."""
        skin = self.content["skins"][0]
        if worlds:
            inverse = np.linalg.inv(np.array([worlds[joint] for joint in skin["joints"]]))
            skin["inverseBindMatrices"] = self._added(inverse.transpose(0, 2, 1).reshape(-1, 16).astype("<f4"))

    def write(self, path: Path) -> None:
        """Write the file."""
        content, binary = copy.deepcopy(self.content), bytearray()
        content["accessors"], content["bufferViews"] = [], []
        components = {np.dtype(kind): number for number, kind in _COMPONENTS.items()}
        for i, values in enumerate(self.arrays):
            data = np.ascontiguousarray(values).tobytes()
            content["bufferViews"].append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
            content["accessors"].append(
                {"bufferView": i, "componentType": components[values.dtype], "count": len(values),
                 "type": _KINDS[values.shape[1]]}
            )  # fmt: skip
            binary += data + b"\0" * (-len(data) % 4)
        content["buffers"] = [{"byteLength": len(binary)}]
        if self.ending == ".gltf":
            content["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(binary).decode()
            path.write_text(json.dumps(content))
            return
        text = json.dumps(content).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)

    def _added(self, values: npt.NDArray[Any]) -> int:
        self.arrays.append(values.reshape(len(values), -1))
        return len(self.arrays) - 1


def parse_glb(path: Path) -> GltfScene:
    """Read a .glb file whose accessors have buffer views of their own."""
    data = path.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    content = json.loads(data[20 : 20 + size])
    binary = data[28 + size :]
    arrays = []
    for accessor in content["accessors"]:
        start = content["bufferViews"][accessor["bufferView"]]["byteOffset"] + accessor.get("byteOffset", 0)
        width, kind = _SIZES[accessor["type"]], _COMPONENTS[accessor["componentType"]]
        values = np.frombuffer(binary, kind, accessor["count"] * width, start)
        arrays.append(values.reshape(-1, width))
    return GltfScene(path.name, ".glb", content, arrays)


def gltf_of(made: BvhText, unit_m: float, rate_hz: float, ending: str, bound: bool) -> GltfScene:
    """Return the skeleton and motion of a BVH file as a glTF file with a skin.

    Parameters
    ----------
    made : BvhText
        The BVH file.
    unit_m : float
        Its unit in metres.
    rate_hz : float
        The rate of the keys.
    ending : str
        ".glb" or ".gltf".
    bound : bool
        True for a file with the pose of binding.
    """
    names = node_names(made)
    offsets = np.array([one.offset for one in made.nodes]) * unit_m
    nodes: list[dict[str, Any]] = [
        {"name": name, "translation": offset} for name, offset in zip(names, offsets.tolist(), strict=True)
    ]
    worlds = np.tile(np.eye(4), (len(nodes), 1, 1))
    for i, one in enumerate(made.nodes):
        worlds[i, :3, 3] = offsets[i]
        if one.parent >= 0:
            nodes[one.parent].setdefault("children", []).append(i)
            worlds[i, :3, 3] += worlds[one.parent, :3, 3]
    clip: dict[str, Any] = {"name": "clip", "channels": [], "samplers": []}
    skin: dict[str, Any] = {"joints": list(range(len(nodes)))}
    scene = GltfScene(
        made.name, ending, {"asset": {"version": "2.0"}, "nodes": nodes, "skins": [skin], "animations": [clip]}
    )
    times = scene._added((np.arange(len(made.values)) / rate_hz).astype("<f4"))
    for i in range(len(nodes)):
        turns, places = local_motion(made, i)
        wxyz = quaternions(np.ascontiguousarray(turns.reshape(-1, 9).T)).T
        for path, values in (("rotation", wxyz[:, [1, 2, 3, 0]]), ("translation", places)):
            if values is not None:
                scaled = values * (unit_m if path == "translation" else 1.0)
                clip["channels"].append({"sampler": len(clip["samplers"]), "target": {"node": i, "path": path}})
                clip["samplers"].append({"input": times, "output": scene._added(scaled.astype("<f4"))})
    if bound:
        scene.bind(dict(enumerate(worlds)))
    return scene
