"""Mutations of binary formats: arrays as NumPy writes them, alone or packed, and C3D files."""

from __future__ import annotations

import io
import re
import struct
import zipfile
from contextlib import suppress
from random import Random

from tests.fuzz.mutations import ANY, Mutation

# ---- arrays ----------------------------------------------------------------------------------------------

_HEADERS = (
    *(b"(1000000000000, 24, 3)", b"(2, 1000000000, 3)", b"(-1, 24, 3)", b"(0, 24, 3)", b"(24, 3)", b"()", b"(9,)"),
    *(
        b"(99999999999999999999, 24, 3)",
        b"(1, 1, 3)",
        b"(1, 24, 3",
        b"(True, 24, 3)",
        b"(2, 24, 3, 1)",
        b"(1.5, 24, 3)",
    ),
    *(b"(" * 200 + b")" * 200, b"(400000, 24, 3)"),
)
_TYPES = (
    *(b"'<f8'", b"'>f8'", b"'<f4'", b"'<f2'", b"'|O'", b"'<U99999999'", b"'<i8'", b"'|b1'", b"'<c16'", b"'|V8'"),
    *(b"'<M8[ns]'", b"'|S8'", b"'<f16'", b"'zz'", b"[('a', '<f8')]", b"'<U0'", b"1", b"'<u1'", b"'(9999,9999)f8'"),
)


def npy_header(data: bytes, random: Random) -> bytes:
    """Another shape, type or length in the header of an NPY file."""
    match random.randrange(4):
        case 0:
            return re.sub(rb"'shape': \([^)]*\)", b"'shape': " + random.choice(_HEADERS), data, count=1)
        case 1:
            return re.sub(rb"'descr': '[^']*'", b"'descr': " + random.choice(_TYPES), data, count=1)
        case 2:
            return data[:8] + struct.pack("<H", random.choice((0, 1, 10, 117, 119, 65535))) + data[10:]
        case _:
            return data[:6] + bytes(random.choice(((2, 0), (3, 0), (9, 9), (0, 0)))) + data[8:]


def npy_numbers(data: bytes, random: Random) -> bytes:
    """Numbers of an array are none, infinite or huge."""
    changed = bytearray(data)
    value = random.choice((float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 1e-308, 1e5, 1e12, 0.0))
    for _ in range(random.choice((1, 3, 1000))):
        if len(changed) > 200:
            at = 128 + 8 * random.randrange((len(changed) - 136) // 8 + 1)
            changed[at : at + 8] = struct.pack("<d", value)
    return bytes(changed)


NPY: tuple[Mutation, ...] = (npy_header, npy_header, npy_numbers, npy_numbers)
"""Mutations of an NPY file, besides those of its bytes."""


def npz_entry(data: bytes, random: Random) -> bytes:
    """One array inside an NPZ file is mutated and packed again, so that its checksum is right."""
    entries = _unpacked(data)
    if not entries:
        return data
    name = random.choice(sorted(entries))
    entries[name] = random.choice((*ANY, *NPY, *NPY))(entries[name], random)
    return _packed(entries, random)


def npz_names(data: bytes, random: Random) -> bytes:
    """Arrays of an NPZ file are called otherwise, are missing, or are no arrays."""
    entries = _unpacked(data)
    if not entries:
        return data
    name = random.choice(sorted(entries))
    content = entries.pop(name)
    new = random.choice(
        (
            *("fps.npy", "poses.npy", "names.npy", "positions", "../positions.npy", "joints.npy", "rate_hz.npy"),
            *("pose_body.npy", "trans.npy", "betas.npy", "gender.npy", "mocap_framerate.npy"),
        )
    )
    for changed, value in random.choice((((new, content),), ((new, content), (name, content)), ((name, b""),), ())):
        entries[changed] = value
    return _packed(entries, random)


def npz_bomb(data: bytes, random: Random) -> bytes:
    """An array of an NPZ file unpacks to far more than there is."""
    entries = _unpacked(data)
    if not entries:
        return data
    name = random.choice(sorted(entries))
    header = entries[name][:128].replace(b"'shape': (", b"'shape': (9")
    entries[name] = header + b"\0" * random.choice((1 << 20, 8 << 20))
    return _packed(entries, random)


def npz_sizes(data: bytes, random: Random) -> bytes:
    """The directory of an NPZ file gives other sizes and places than there are."""
    at = data.rfind(b"PK\x01\x02")
    if at < 0:
        return data
    changed = bytearray(data)
    field = at + random.choice((8, 10, 16, 20, 24, 28, 30, 32, 42))
    changed[field : field + 4] = struct.pack("<I", random.choice((0, 1, 1000, 0x7FFFFFFF, 0xFFFFFFFF)))
    return bytes(changed[: len(data)])


NPZ: tuple[Mutation, ...] = (npz_entry, npz_entry, npz_entry, npz_names, npz_bomb, npz_sizes)
"""Mutations of an NPZ file, besides those of its bytes."""


def _unpacked(data: bytes) -> dict[str, bytes]:
    with suppress(Exception), zipfile.ZipFile(io.BytesIO(data)) as packed:
        return {name: packed.read(name) for name in packed.namelist()}
    return {}


def _packed(entries: dict[str, bytes], random: Random) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", random.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as packed:
        for name, content in entries.items():
            packed.writestr(zipfile.ZipInfo(name), content)
    return file.getvalue()


# ---- markers ---------------------------------------------------------------------------------------------

_WORDS = (0, 1, 2, 3, 7, 80, 84, 85, 86, 255, 256, 511, 512, 513, 32767, 32768, 65534, 65535)
_C3D_NAME = re.compile(rb"[A-Z][A-Z0-9_]{3,}")


def c3d_header(data: bytes, random: Random) -> bytes:
    """A number of two bytes of a C3D file's header is another one: a count, a frame, a block, a processor."""
    at = random.choice((0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 512, 514))
    return data[:at] + struct.pack("<H", random.choice(_WORDS)) + data[at + 2 :]


def c3d_parameter(data: bytes, random: Random) -> bytes:
    """Change a byte or two after the name of a C3D parameter (offset of the next, type, dimensions, value)."""
    found = list(_C3D_NAME.finditer(data, 512, 8192))
    if not found:
        return data
    match = random.choice(found)
    at = match.end() + random.randrange(8) if random.random() < 0.8 else max(0, match.start() - random.randint(1, 2))
    new = random.choice((struct.pack("<H", random.choice(_WORDS)), bytes([random.choice((0, 1, 2, 4, 127, 128, 255))])))
    return data[:at] + new + data[at + len(new) :]


def c3d_numbers(data: bytes, random: Random) -> bytes:
    """Coordinates, residuals or the scale of a C3D file are none, infinite or huge."""
    value = struct.pack("<f", random.choice((float("nan"), float("inf"), -1.0, 0.0, 3e38, -3e38, 1e-40, 1e9)))
    at = 12 if random.random() < 0.2 else random.randrange(len(data) // 2, len(data) + 1) // 4 * 4
    return data[:at] + (value * random.choice((1, 4, 400)))[: len(data) - at] + data[at + 4 :]


C3D: tuple[Mutation, ...] = (c3d_header, c3d_header, c3d_parameter, c3d_parameter, c3d_parameter, c3d_numbers)
"""Mutations of a C3D file, besides those of its bytes."""


# ---- scenes ----------------------------------------------------------------------------------------------


def glb_header(data: bytes, random: Random) -> bytes:
    """Change a number of the header of a GLB file or of its first chunk."""
    at = random.choice((4, 8, 12, 16))
    return data[:at] + struct.pack("<I", random.choice((0, 1, 2, 19, 1000, 0x7FFFFFFF, 0xFFFFFFFF))) + data[at + 4 :]


def glb_json(data: bytes, random: Random) -> bytes:
    """Change numbers of the JSON of a GLB file, whose length stays as it was."""
    if len(data) < 20:
        return data
    stop = 20 + int.from_bytes(data[12:16], "little")
    found = list(re.finditer(rb"(?<=[ :\[])-?[0-9.]+(?=[,}\] ])", data[20:stop]))
    changed = bytearray(data)
    for match in random.sample(found, min(len(found), random.choice((1, 1, 2, 8)))):
        new = random.choice(
            (b"0", b"1", b"2", b"3", b"-1", b"9", b"99999", b"1e9", b"5120", b"0.5", b"[]", b'""', b"null")
        )
        changed[20 + match.start() : 20 + match.end()] = new[: match.end() - match.start()].ljust(
            match.end() - match.start()
        )
    return bytes(changed)


def glb_numbers(data: bytes, random: Random) -> bytes:
    """Numbers of the binary part of a GLB file are none, infinite, huge or small."""
    if len(data) < 20:
        return data
    start = 28 + int.from_bytes(data[12:16], "little")
    value = struct.pack("<f", random.choice((float("nan"), float("inf"), 0.0, -1.0, 1.0, 1e5, 3e38, 1e-40)))
    at = start + 4 * random.randrange(max(1, (len(data) - start) // 4))
    return data[:at] + (value * random.choice((1, 4, 100)))[: max(0, len(data) - at)] + data[at + 4 :]


GLB: tuple[Mutation, ...] = (glb_header, glb_json, glb_json, glb_json, glb_numbers)
"""Mutations of a GLB file, besides those of its bytes."""


_FBX_NAMES = (b"KeyTime", b"KeyValueFloat", b"KeyAttrFlags", b"Model", b"Connections", b"Objects", b"P", b"C")


def fbx_record(data: bytes, random: Random) -> bytes:
    """Change a number before or after the name of a record of an FBX file: an end, a count, a length."""
    found = [match.start() for match in re.finditer(re.escape(random.choice(_FBX_NAMES)), data)]
    if not found:
        return data
    at = random.choice(found) + random.choice((-25, -17, -13, -9, -5, -1, 1, 7, 8, 12, 16, 20))
    new = random.choice((struct.pack("<I", random.choice((0, 1, 13, 1000, 0x7FFFFFFF, 0xFFFFFFFF))), b"\xff", b"\0"))
    return data[: max(0, at)] + new + data[max(0, at) + len(new) :]


def fbx_number(data: bytes, random: Random) -> bytes:
    """A number of 64 bits of an FBX file is none, infinite, huge, or another object's."""
    found = [match.start() for match in re.finditer(rb"[DL]", data)]
    if not found:
        return data
    at = random.choice(found) + 1
    values = (float("nan"), float("inf"), -1e300, 0.0, 1e6)
    new = random.choice(
        (struct.pack("<d", random.choice(values)), struct.pack("<q", random.choice((0, -1, 1001, 1 << 62))))
    )
    return data[:at] + new + data[at + 8 :]


FBX: tuple[Mutation, ...] = (fbx_record, fbx_record, fbx_number)
"""Mutations of a binary FBX file, besides those of its bytes."""
