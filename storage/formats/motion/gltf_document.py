"""Read glTF 2.0 documents: the JSON of .gltf and .glb files, and the numbers of their accessors.

Nothing outside of a file's own folder is read, nothing is downloaded, and no count is used before it is compared with
the bytes present. Meshes, materials and images are not read.
"""

from __future__ import annotations

import base64
import binascii
import json
import struct
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.reader import MAX_POINTS
from kinedex.storage.formats.source_files import file_size, part_of, source_errors

F64 = npt.NDArray[np.float64]

LONGEST_JSON = 64 << 20
"""The largest size of the JSON in bytes; larger ones embed models that belong in a .glb or a .bin file."""

MAX_NUMBERS = 50_000_000
"""The largest number of values of an accessor; as many 32-bit numbers take 200 MB."""

MAX_ENTRIES = 50_000
"""The largest number of entries of a list in the JSON, nested ones included; whole scenes have thousands."""

_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_LARGEST = {"i1": 127.0, "u1": 255.0, "<i2": 32767.0, "<u2": 65535.0}

Index = Annotated[int, Field(ge=0)]
Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e12, le=1e12)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", strict=False)


class Node(_Part):
    """A node of the scene; its transform relative to its parent is a matrix or separate parts."""

    name: str = ""
    children: list[Index] = []
    translation: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    rotation: tuple[Number, Number, Number, Number] = (0.0, 0.0, 0.0, 1.0)
    scale: tuple[Number, Number, Number] = (1.0, 1.0, 1.0)
    matrix: Annotated[list[Number], Field(min_length=16, max_length=16)] | None = None
    mesh: Index | None = None
    camera: Index | None = None


class Skin(_Part):
    """A skin: the joints that deform a mesh."""

    joints: list[Index] = []
    inverseBindMatrices: Index | None = None


class Target(_Part):
    """The node and property that a channel moves."""

    node: Index | None = None
    path: str = ""


class Channel(_Part):
    """A channel: a sampler and its target."""

    sampler: Index
    target: Target


class Sampler(_Part):
    """A sampler: the accessors of its times (input) and values (output)."""

    input: Index
    output: Index
    interpolation: Literal["LINEAR", "STEP", "CUBICSPLINE"] = "LINEAR"


class Animation(_Part):
    """An animation, which is a clip."""

    name: str = ""
    channels: list[Channel] = []
    samplers: list[Sampler] = []


class _Sparse(_Part):
    class Indices(_Part):
        bufferView: Index
        byteOffset: Index = 0
        componentType: int

    class Values(_Part):
        bufferView: Index
        byteOffset: Index = 0

    count: Index
    indices: Indices
    values: Values


class _Accessor(_Part):
    bufferView: Index | None = None
    byteOffset: Index = 0
    componentType: int
    normalized: bool = False
    count: Index
    type: str
    sparse: _Sparse | None = None


class _View(_Part):
    buffer: Index
    byteOffset: Index = 0
    byteLength: Index
    byteStride: Annotated[int, Field(ge=1, le=252)] | None = None
    extensions: dict[str, Any] = {}


class _Buffer(_Part):
    uri: str | None = None
    byteLength: Index


class _Asset(_Part):
    version: str = ""


class Content(_Part):
    """The parts of a document that describe motion."""

    asset: _Asset
    nodes: list[Node] = []
    skins: list[Skin] = []
    animations: list[Animation] = []
    accessors: list[_Accessor] = []
    bufferViews: list[_View] = []
    buffers: list[_Buffer] = []
    extensions: dict[str, Any] = {}


@dataclass(eq=False)
class Document:
    """An open glTF document.

    Attributes
    ----------
    path : Path
        The file.
    content : Content
        The parts of its JSON that describe motion.
    binary : tuple of int
        Start and length of the binary part of a .glb file; (0, 0) if there is none.
    json_bytes, size : int
        Bytes of the JSON, and of the file.
    """

    path: Path
    content: Content
    binary: tuple[int, int]
    json_bytes: int
    size: int
    _embedded: dict[int, bytes] = field(default_factory=dict)

    @cached_property
    def parents(self) -> tuple[int, ...]:
        """The index of every node's parent, −1 for roots.

        Raises
        ------
        SourceError
            A node has two parents, or is its own ancestor.
        """
        nodes = self.content.nodes
        above = [-1] * len(nodes)
        for i, node in enumerate(nodes):
            for child in node.children:
                if child >= len(nodes) or above[child] >= 0:
                    raise self.error(f"nodes.{i}.children must be nodes without another parent, got {child}")
                above[child] = i
        order: list[int] = [i for i, parent in enumerate(above) if parent < 0]
        for i in order:  # `order` grows during the loop
            order += nodes[i].children
        if len(order) != len(nodes):
            first = min(set(range(len(nodes))) - {*order})
            raise self.error(f"nodes.{first} is its own ancestor, or below one that is; `children` must form trees")
        return tuple(above)

    def error(self, message: str) -> SourceError:
        """Return an error that names the file."""
        return SourceError(self.path, message)

    def numbers(self, index: int, kind: str) -> F64:
        """Return the numbers of an accessor (count, components), with normalised integers scaled to −1 to 1.

        Parameters
        ----------
        index : int
            The accessor.
        kind : str
            The required type, such as "VEC3".

        Raises
        ------
        SourceError
            The accessor does not fit its bytes, is compressed, or its bytes are missing.
        """
        accessors = self.content.accessors
        if index >= len(accessors) or accessors[index].type != kind:
            got = accessors[index].type if index < len(accessors) else "none"
            raise self.error(f"accessors.{index} must be of type {kind}, got {got[:40]}")
        accessor, where = accessors[index], f"accessors.{index}"
        size = _SIZES[kind]
        if accessor.count * size > MAX_NUMBERS:
            raise self.error(f"{where} has {accessor.count * size} numbers, more than {MAX_NUMBERS}")
        dtype = self._dtype(accessor.componentType, where)
        if accessor.bufferView is None:
            if accessor.count > 1_000_000:
                raise self.error(f"{where} has {accessor.count} values and no bufferView that holds them")
            raw: npt.NDArray[Any] = np.zeros((accessor.count, size), dtype)
        else:
            raw = self._values(where, accessor.bufferView, accessor.byteOffset, accessor.count, size, dtype)
        values = _normalised(raw, dtype, accessor.normalized)
        if accessor.sparse is not None:
            self._substitute(values, accessor.sparse, where, dtype, accessor.normalized)
        if not (values.min(initial=0.0) >= -1e12 and values.max(initial=0.0) <= 1e12):
            raise self.error(f"{where} has numbers that are NaN, infinite or beyond 1e12")
        return values

    def _substitute(self, values: F64, sparse: _Sparse, where: str, dtype: str, normalized: bool) -> None:
        """Replace, in place, the values that a sparse accessor lists."""
        if sparse.count > len(values):
            raise self.error(f"{where}.sparse lists {sparse.count} of {len(values)} values")
        kind = self._dtype(sparse.indices.componentType, where)
        listed = self._values(where, sparse.indices.bufferView, sparse.indices.byteOffset, sparse.count, 1, kind)
        positions = listed[:, 0]
        if kind == "<f4" or kind.endswith(("i1", "i2")) or (len(positions) and int(positions.max()) >= len(values)):
            raise self.error(f"{where}.sparse.indices must be whole numbers below {len(values)}")
        size = values.shape[1]
        raw = self._values(where, sparse.values.bufferView, sparse.values.byteOffset, sparse.count, size, dtype)
        values[positions.astype(np.int64)] = _normalised(raw, dtype, normalized)

    def _dtype(self, component: int, where: str) -> str:
        if component not in _COMPONENTS:
            raise self.error(f"{where}.componentType must be one of {', '.join(map(str, _COMPONENTS))}")
        return _COMPONENTS[component]

    def _values(self, where: str, view: int, offset: int, count: int, size: int, dtype: str) -> npt.NDArray[Any]:
        """Return values of a buffer view in their stored type (count, size)."""
        if view >= len(self.content.bufferViews):
            raise self.error(f"{where} names bufferViews.{view}, which is not there")
        found = self.content.bufferViews[view]
        packed = sorted(found.extensions.keys() & {"EXT_meshopt_compression", "KHR_meshopt_compression"})
        if packed:
            raise self.error(f"its animation is packed with {packed[0]}; write it without, as with gltfpack -noq -c0")
        width = np.dtype(dtype).itemsize * size
        stride = found.byteStride or width
        need = stride * (count - 1) + width if count else 0
        if stride < width or offset + need > found.byteLength:
            raise self.error(f"{where} needs {offset + need} bytes of bufferViews.{view}, which has {found.byteLength}")
        data = self._bytes(found.buffer, found.byteOffset + offset, need)
        rows = np.lib.stride_tricks.as_strided(np.frombuffer(data, np.uint8), (count, width), (stride, 1))
        return np.ascontiguousarray(rows).view(dtype).reshape(count, size)

    def _bytes(self, buffer: int, start: int, length: int) -> bytes:
        if buffer >= len(self.content.buffers):
            raise self.error(f"a bufferView names buffers.{buffer}, which is not there")
        found = self.content.buffers[buffer]
        if start + length > found.byteLength:
            raise self.error(f"buffers.{buffer} has {found.byteLength} bytes, and {start + length} are needed")
        if found.uri is None:
            if buffer or start + length > self.binary[1]:
                raise self.error(f"buffers.{buffer} has no uri, and the file's binary part {self.binary[1]} bytes")
            return self._read(self.path, self.binary[0] + start, length)
        if found.uri.startswith("data:"):
            data = self._decoded(buffer, found.uri)
            if start + length > len(data):
                raise self.error(f"buffers.{buffer} has {len(data)} bytes in its uri, and {start + length} are needed")
            return data[start : start + length]
        return self._read(self._beside(buffer, found.uri), start, length)

    def _decoded(self, buffer: int, uri: str) -> bytes:
        if buffer not in self._embedded:
            head, _, body = uri.partition(",")
            if not head.endswith(";base64"):
                raise self.error(f"buffers.{buffer}.uri must be base64, got {head[:60]!r}")
            try:
                self._embedded[buffer] = base64.b64decode(body, validate=True)
            except (binascii.Error, ValueError) as fault:
                raise self.error(f"buffers.{buffer}.uri is no base64: {fault}") from None
        return self._embedded[buffer]

    def _beside(self, buffer: int, uri: str) -> Path:
        """Return the file that a relative URI names, which must be in the document's folder or below."""
        name = unquote(uri)
        relative = PurePosixPath(name)
        inside = not relative.is_absolute() and ".." not in relative.parts and not set(name) & set("\\:\0")
        place = self.path.parent / relative
        if not inside or not name or not place.resolve().is_relative_to(self.path.parent.resolve()):
            raise self.error(
                f"buffers.{buffer}.uri must name a file in the same folder or below, got {uri[:100]!r}; nothing else "
                "is read: put the .bin file beside it, or write a .glb"
            )
        return place

    def _read(self, path: Path, start: int, length: int) -> bytes:
        with source_errors(path):
            if not path.is_file():
                raise self.error(f"names {path.name}, which is not there; the .bin file belongs beside it")
        data = part_of(path, length, start)
        if len(data) < length:
            raise self.error(f"{path.name} has {start + len(data)} bytes, and {start + length} are needed; cut off?")
        return data


def _normalised(raw: npt.NDArray[Any], dtype: str, normalized: bool) -> F64:
    with np.errstate(invalid="ignore"):  # a float may be NaN, which is refused later
        values: F64 = raw.astype(np.float64)
    return np.maximum(values / _LARGEST[dtype], -1.0) if normalized and dtype in _LARGEST else values


def read_gltf(path: Path) -> Document:
    """Open a .gltf or .glb file and check the parts that describe motion.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    SourceError
        The file is not glTF 2.0, or a part is not valid; the error names its key.
    """
    text, binary = _parts(path)
    try:
        found = json.loads(text.decode("utf-8-sig"))
    except (ValueError, RecursionError) as fault:
        raise SourceError(path, f"its JSON cannot be read: {str(fault)[:200]}; is the file cut off?") from None
    if not isinstance(found, dict) or "asset" not in found:
        raise SourceError(path, "is no glTF: its JSON has no `asset`")
    _refuse_long_lists(path, found)
    try:
        content = Content.model_validate(found)
    except ValidationError as fault:
        first = fault.errors(include_url=False, include_input=False)[0]
        key = ".".join(str(part) for part in first["loc"])[:200]
        raise SourceError(path, f"{key}: {first['msg'][:200]}") from None
    if not content.asset.version.startswith("2."):
        raise SourceError(path, f"asset.version must be 2.x, got {content.asset.version[:20]!r}; write it as glTF 2.0")
    return Document(path, content, binary, len(text), file_size(path))


def _refuse_long_lists(path: Path, found: dict[str, Any]) -> None:
    """Raise SourceError for lists whose entries would take too much memory."""
    lists = {key: found.get(key) for key in Content.model_fields}
    clips = lists["animations"] if isinstance(lists["animations"], list) else []
    parts = [clip.get(key) for clip in clips if isinstance(clip, dict) for key in ("channels", "samplers")]
    sizes = {key: len(entries) for key, entries in lists.items() if isinstance(entries, list)}
    sizes["animations"] = len(clips) + sum(len(part) for part in parts if isinstance(part, list))
    for key, size in sizes.items():
        most = MAX_POINTS if key == "nodes" else MAX_ENTRIES
        if size > most:
            raise SourceError(path, f"{key} has {size} entries, more than {most}")


def _parts(path: Path) -> tuple[bytes, tuple[int, int]]:
    """Return the JSON of a file, and start and length of its binary part in bytes."""
    size = file_size(path)
    with source_errors(path), path.open("rb") as file:
        head = file.read(20)
        if head[:4] != b"glTF":
            if size > LONGEST_JSON:
                raise SourceError(path, f"has JSON of more than {LONGEST_JSON >> 20} MB; write it as .glb")
            return head + file.read(), (0, 0)
        if len(head) < 20:
            raise SourceError(path, "is cut off in its header")
        version, _, length, kind = struct.unpack("<IIII", head[4:])
        if version != 2 or kind != 0x4E4F534A:
            raise SourceError(path, f"is no .glb of version 2 that begins with JSON (version {version})")
        if length > min(size - 20, LONGEST_JSON):
            raise SourceError(path, f"has JSON of {length} bytes by its header, in a file of {size}; is it cut off?")
        text = file.read(length)
        chunk = file.read(8)
    if len(chunk) < 8:
        return text, (0, 0)
    length, kind = struct.unpack("<II", chunk)
    start = 20 + len(text) + 8
    return text, (start, min(length, size - start)) if kind == 0x004E4942 else (0, 0)


def matrix_parts(node: Node) -> tuple[F64, F64]:
    """Return rotation and scale (3, 3) and position (3,) from a node's matrix, which is stored by columns."""
    matrix = np.array(node.matrix, np.float64).reshape(4, 4).T
    return matrix[:3, :3], matrix[:3, 3]
