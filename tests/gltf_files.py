"""glTF files for tests, written by hand: a hierarchy as nodes, a skin, and clips of its motion."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tests.bvh_files import POSITIONS, Joint

KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
COMPONENTS = {"f4": 5126, "i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123}


class Builder:
    """A document that grows."""

    def __init__(self) -> None:
        self.binary = b""
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0"}, "nodes": [], "accessors": [], "bufferViews": [], "buffers": [],
        }  # fmt: skip

    def view(self, data: bytes, **given: Any) -> int:
        """A buffer view of some bytes."""
        self.binary += b"\0" * (-len(self.binary) % 4)
        place = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)}
        self.binary += data
        self.json["bufferViews"].append(place | given)
        return len(self.json["bufferViews"]) - 1

    def accessor(self, values: np.ndarray, kind: str = "f4", **given: Any) -> int:
        """An accessor of values (count, components)."""
        rows = np.asarray(values, "<" + kind).reshape(len(values), -1)
        entry = {"bufferView": self.view(rows.tobytes()), "componentType": COMPONENTS[kind], "count": len(rows)}
        self.json["accessors"].append(entry | {"type": KINDS[rows.shape[1]]} | given)
        return len(self.json["accessors"]) - 1

    def nodes(self, root: Joint, scale: float = 0.01) -> dict[str, int]:
        """The joints of a hierarchy as nodes, and their indices by name."""
        places = {}
        for joint in root.all():
            places[joint.name] = len(self.json["nodes"])
            offset = [scale * float(number) for number in joint.offset]
            self.json["nodes"].append({"name": joint.name, "translation": offset})
        for joint in root.all():
            if joint.children:
                below = [places[child.name] for child in joint.children]
                self.json["nodes"][places[joint.name]]["children"] = below
        return places

    def clip(
        self,
        name: str,
        places: Mapping[str, int],
        root: Joint,
        motion: Sequence[Mapping[str, Sequence[float]]],
        *,
        rate_hz: float = 30.0,
        scale: float = 0.01,
    ) -> dict[str, Any]:
        """A clip of the turns of all joints and of the root's place."""
        times = self.accessor(np.arange(len(motion)) / rate_hz)
        clip: dict[str, Any] = {"name": name, "channels": [], "samplers": []}
        for joint in root.all():
            rotations = np.array([quaternion(joint, frame[joint.name]) for frame in motion])
            self.channel(clip, places[joint.name], "rotation", times, self.accessor(rotations))
        moved = np.array([[frame[root.name][i] for i in range(3)] for frame in motion]) * scale
        self.channel(clip, places[root.name], "translation", times, self.accessor(moved))
        self.json.setdefault("animations", []).append(clip)
        return clip

    def channel(
        self, clip: dict[str, Any], node: int, path: str, times: int, values: int, interpolation: str = "LINEAR"
    ) -> None:
        """A channel of a clip."""
        clip["samplers"].append({"input": times, "output": values, "interpolation": interpolation})
        target = {"node": node, "path": path}
        clip["channels"].append({"sampler": len(clip["samplers"]) - 1, "target": target})

    def glb(self) -> bytes:
        """The document as .glb."""
        self.json["buffers"] = [{"byteLength": len(self.binary)}]
        text = json.dumps(self.json).encode()
        text += b" " * (-len(text) % 4)
        binary = self.binary + b"\0" * (-len(self.binary) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x4E4942) + binary
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def gltf(self, uri: str | None = None) -> bytes:
        """The document as .gltf, its buffer in the JSON or in the file that `uri` names."""
        embedded = "data:application/octet-stream;base64," + base64.b64encode(self.binary).decode()
        self.json["buffers"] = [{"byteLength": len(self.binary), "uri": uri or embedded}]
        return json.dumps(self.json).encode()


def quaternion(joint: Joint, numbers: Sequence[float]) -> np.ndarray:
    """The turn x, y, z, w of a joint's rotation channels, multiplied in their order."""
    whole = np.array([0.0, 0.0, 0.0, 1.0])
    for channel, degrees in zip(joint.channels, numbers, strict=True):
        if channel not in POSITIONS:
            half = np.deg2rad(degrees) / 2
            turn = np.zeros(4)
            turn["XYZ".index(channel[0])], turn[3] = np.sin(half), np.cos(half)
            (a, w), (b, v) = (whole[:3], whole[3]), (turn[:3], turn[3])
            whole = np.array([*(w * b + v * a + np.cross(a, b)), w * v - a @ b])
    return whole


def dancing_gltf(
    root: Joint, motion: Sequence[Mapping[str, Sequence[float]]], *, rate_hz: float = 30.0, skin: bool = True
) -> Builder:
    """A document of one figure and one clip, in metres."""
    document = Builder()
    places = document.nodes(root)
    if skin:
        document.json["skins"] = [{"joints": list(places.values())}]
    document.clip("dance", places, root, motion, rate_hz=rate_hz)
    return document
