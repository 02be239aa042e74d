"""FBX files for tests, written by hand, binary and as text: a hierarchy as bones, and clips of its motion."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tests.bvh_files import POSITIONS, Joint

TICKS = 46186158000
HEAD = b"Kaydara FBX Binary  \x00\x1a\x00"
ORDERS = ("XYZ", "XZY", "YZX", "YXZ", "ZXY", "ZYX")

Motion = Sequence[Mapping[str, Sequence[float]]]


@dataclass
class Part:
    """A record: its name, values (texts, whole numbers, numbers, arrays), and the records below it."""

    name: str
    values: tuple[Any, ...] = ()
    below: list[Part] = field(default_factory=list)


def properties(**given: Sequence[float]) -> Part:
    """The properties of an object; `_` in a name stands for a space."""
    lines = [
        Part("P", (name.replace("_", " "), "Number", "", "A", *values)) for name, values in given.items()
    ]  # fmt: skip
    return Part("Properties70", (), lines)


class Builder:
    """A scene that grows: objects with numbers, and connections between them."""

    def __init__(self, **settings: Sequence[float]) -> None:
        usual: dict[str, Sequence[float]] = {
            "UpAxis": [1], "UpAxisSign": [1], "FrontAxis": [2], "FrontAxisSign": [1], "CoordAxis": [0],
            "CoordAxisSign": [1], "UnitScaleFactor": [1.0], "TimeMode": [6],
        }  # fmt: skip
        self.settings = Part("GlobalSettings", (), [properties(**(usual | settings))])
        self.objects = Part("Objects")
        self.links = Part("Connections")
        self.numbers = 1000

    def add(self, kind: str, name: str, what: str, *below: Part) -> int:
        """An object, and its number."""
        self.numbers += 1
        short = {"AnimationStack": "AnimStack", "AnimationLayer": "AnimLayer"}.get(kind, kind)
        self.objects.below.append(Part(kind, (self.numbers, (short, name), what), list(below)))
        return self.numbers

    def link(self, below: int, above: int, name: str = "") -> None:
        """A connection."""
        self.links.below.append(Part("C", ("OP", below, above, name) if name else ("OO", below, above)))

    def bones(self, root: Joint, kind: str = "LimbNode", above: int = 0, scale: float = 1.0) -> dict[str, int]:
        """The joints of a hierarchy as bones, and their numbers by name."""
        order = "".join(name[0] for name in root.channels if name not in POSITIONS)[::-1]
        given = {"RotationActive": [1], "RotationOrder": [ORDERS.index(order)]}
        offset = [scale * float(number) for number in root.offset]
        numbers = {root.name: self.add("Model", root.name, kind, properties(Lcl_Translation=offset, **given))}
        self.link(numbers[root.name], above)
        for child in root.children:
            numbers |= self.bones(child, kind, numbers[root.name], scale)
        return numbers

    def clip(self, name: str, bones: Mapping[str, int], root: Joint, motion: Motion, rate_hz: float = 30.0) -> int:
        """A clip of the turns of all joints and of the root's place; returns the number of its layer."""
        stop = round(TICKS * (len(motion) - 1) / rate_hz)
        stack = self.add("AnimationStack", name, "", properties(LocalStart=[0], LocalStop=[stop]))
        layer = self.add("AnimationLayer", "BaseLayer", "")
        self.link(layer, stack)
        times = np.array([round(TICKS * t / rate_hz) for t in range(len(motion))])
        for joint in root.all():
            rotations = {
                c[0]: [f[joint.name][i] for f in motion] for i, c in enumerate(joint.channels) if c not in POSITIONS
            }
            self.curves(layer, bones[joint.name], "Lcl Rotation", times, rotations)
        moved = {axis: [frame[root.name][i] for frame in motion] for i, axis in enumerate("XYZ")}
        self.curves(layer, bones[root.name], "Lcl Translation", times, moved)
        return layer

    def curves(
        self, layer: int, bone: int, what: str, times: np.ndarray, values: Mapping[str, Sequence[float]], flag: int = 4
    ) -> None:
        """Curves of a property, by axis; the flag is 2 for steps, 4 for lines, 8 for cubics."""
        node = self.add("AnimationCurveNode", what[-1], "")
        self.link(node, layer)
        self.link(node, bone, what)
        for axis, numbers in values.items():
            keys = [
                Part("KeyTime", (times.astype("<i8"),)), Part("KeyValueFloat", (np.array(numbers, "<f4"),)),
                Part("KeyAttrFlags", (np.array([flag], "<i4"),)), Part("KeyAttrDataFloat", (np.zeros(4, "<f4"),)),
                Part("KeyAttrRefCount", (np.array([len(times)], "<i4"),)),
            ]  # fmt: skip
            curve = self.add("AnimationCurve", "", "", *keys)
            self.link(curve, node, f"d|{axis}")

    def parts(self) -> list[Part]:
        """The top records, among them one that readers skip."""
        mesh = Part("Geometry", (1, ("Geometry", "skin"), "Mesh"), [Part("Vertices", (np.arange(9.0),))])
        objects = Part("Objects", (), [mesh, *self.objects.below])
        return [self.settings, Part("Definitions", (), [Part("Version", (100,))]), objects, self.links]

    def binary(self, version: int = 7400, packed: bool = True) -> bytes:
        """The scene as a binary file."""
        data = HEAD + struct.pack("<I", version)
        for part in self.parts():
            data += _binary(part, len(data), version >= 7500, packed)
        return data + b"\0" * (25 if version >= 7500 else 13)

    def text(self, version: int = 7400) -> bytes:
        """The scene as a text file."""
        head = f"; FBX {version // 1000}.{version // 100 % 10}.0 project file\n; ----\n\nFBXHeaderExtension:  {{\n"
        head += f"\tFBXVersion: {version}\n}}\n"
        return (head + "".join(_text(part, "") for part in self.parts())).encode()


def _binary(part: Part, start: int, wide: bool, packed: bool) -> bytes:
    values = b"".join(_value(value, packed) for value in part.values)
    name = part.name.encode()
    size = 25 if wide else 13
    at = start + size + len(name) + len(values)
    below = b""
    for other in part.below:
        below += _binary(other, at + len(below), wide, packed)
    below += b"\0" * size if part.below else b""
    head = struct.pack("<QQQB" if wide else "<IIIB", at + len(below), len(part.values), len(values), len(name))
    return head + name + values + below


def _value(value: Any, packed: bool) -> bytes:
    if isinstance(value, np.ndarray):
        data = value.tobytes()
        content = zlib.compress(data) if packed else data
        kind = {"f4": b"f", "f8": b"d", "i4": b"i", "i8": b"l"}[value.dtype.str[1:]]
        return kind + struct.pack("<III", len(value), int(packed), len(content)) + content
    if isinstance(value, tuple | str):
        text = (value[1] + "\0\1" + value[0] if isinstance(value, tuple) else value).encode()
        return b"S" + struct.pack("<I", len(text)) + text
    return b"L" + struct.pack("<q", value) if isinstance(value, int) else b"D" + struct.pack("<d", value)


def _text(part: Part, indent: str) -> str:
    if part.values and isinstance(part.values[0], np.ndarray):
        numbers = ",".join(repr(number) for number in part.values[0].tolist())
        return f"{indent}{part.name}: *{len(part.values[0])} {{\n{indent}\ta: {numbers}\n{indent}}} \n"
    shown = [f'"{v[0]}::{v[1]}"' if isinstance(v, tuple) else f'"{v}"' if isinstance(v, str) else repr(v)
             for v in part.values]  # fmt: skip
    line = f"{indent}{part.name}: {', '.join(shown)}"
    if not part.below:
        return line + "\n"
    return f"{line} {{\n{''.join(_text(other, indent + chr(9)) for other in part.below)}{indent}}}\n"


def dancing_fbx(root: Joint, motion: Motion, rate_hz: float = 30.0, **settings: Sequence[float]) -> Builder:
    """A scene of one figure with one clip, in centimetres."""
    scene = Builder(**settings)
    scene.clip("dance", scene.bones(root), root, motion, rate_hz)
    return scene
