"""Bombs: small or lying files that would take time or memory without end; each is read by a process of its own."""

from __future__ import annotations

import copy
import gzip
import io
import struct
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from random import Random

import numpy as np

from tests.attacks.outcome import Options, Outcome
from tests.bvh_files import bvh_text, dance, mixamo
from tests.fbx_files import Part, dancing_fbx
from tests.gltf_files import dancing_gltf
from tests.mvnx_files import dancing, mvnx_text, subject_text
from tests.pipelines.archives import human_amc, human_asf
from tests.storage.formats.labels.test_limits import CUE, EAF

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 300
"""A bomb may take so long on a loaded machine, the start of a process included."""

JOBS, SAMPLE = 2, 8
"""Bombs at the same time, and in a sample."""

PROGRAM = """
import sys
from pathlib import Path
from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.errors import KinedexError
from kinedex.storage.formats.labels.formats import FORMATS, read_labels
from kinedex.storage.formats.motion.reader_table import read_body
from kinedex.storage.formats.motion.sources import scan
from kinedex.storage.formats.motion.unpacked_files import unpacked
from tests.fuzz.depth_files import check_npz, check_pcd, check_ply, check_png
from tests.large_files import peak_mb
path, harmless = Path(sys.argv[1]), sys.argv[2:]
DEPTH = {"pcd": check_pcd, "ply": check_ply, "png": check_png, "npz": check_npz}
joints = load_feature_set().joints
mappings = load_mappings("auto", joints)
# the libraries and kernels that any file of points needs take 72 MB, which are not the bomb's
read_body(Path(harmless[0]), None, mappings, joints)
check_pcd(Path(harmless[1]))
before = peak_mb()
ending = path.suffix[1:]
try:
    if ending in DEPTH or path.stem.endswith("depth"):
        DEPTH[ending](path)
    elif ending in FORMATS and "motion" not in path.stem:
        read_labels(path)
    elif ending in ("zip", "gz"):
        found = scan(path.parent)
        for refused in found.refused:
            raise refused.fault
        for motion in found.motions:
            with unpacked(motion.absolute) as copy:
                read_body(copy.path, None, mappings, joints)
    else:
        read_body(path, path.with_name("x.asf") if ending == "amc" else None, mappings, joints)
    print("read", end=" ")
except KinedexError as fault:
    print("refused", end=" ")
print(peak_mb() - before)
"""


def _npz(shape: tuple[int, ...], stored: int, name: str = "positions", kind: str = "<f8") -> bytes:
    """Return a packed array whose header states a shape, and that has so many bytes of zeros."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": kind, "fortran_order": False, "shape": shape})
    packed = io.BytesIO()
    with (
        zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as file,
        file.open(f"{name}.npy", "w", force_zip64=True) as entry,
    ):
        entry.write(header.getvalue())
        for _ in range(stored >> 20):
            entry.write(bytes(1 << 20))
    return packed.getvalue()


def _cloud(claimed: int, data: bytes, encoding: str = "ascii") -> bytes:
    """Return a PCD that claims so many points."""
    head = f"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {claimed}\nHEIGHT 1\nDATA {encoding}\n"
    return head.encode() + data


def _zeros(copies: int) -> bytes:
    """Return a packed cloud of 22 zeros a copy, and one more point."""
    packed = b"\x0b" + bytes(12) + b"\xe0\xff\0" * copies
    return _cloud(22 * copies + 1, struct.pack("<II", len(packed), 12 + 264 * copies) + packed, "binary_compressed")


def _vertices(claimed: int, before: int, data: bytes) -> bytes:
    """Return a PLY that claims so many points, and so many rows before them."""
    head = f"ply\nformat ascii 1.0\nelement edge {before}\nproperty int a\nelement vertex {claimed}\n"
    return f"{head}property float x\nproperty float y\nproperty float z\nend_header\n".encode() + data


def _bvh(claimed: int, rows: int = 2) -> bytes:
    return bvh_text(mixamo(), dance(mixamo(), rows), claimed=claimed).encode()


def _deep_bvh(depth: int) -> bytes:
    joints = "".join(f"{'JOINT' if i else 'ROOT'} j{i} {{ OFFSET 0 1 0 CHANNELS 1 Yrotation\n" for i in range(depth))
    return f"HIERARCHY {joints}{'}' * depth} MOTION\nFrames: 1\nFrame Time: 0.01\n{'0 ' * depth}\n".encode()


def _many_bones() -> bytes:
    """Return a skeleton of a hundred thousand bones that no frame has to move."""
    bones = "".join(f" begin\n name b{i}\n direction 0 1 0\n length 1\n axis 0 0 0 XYZ\n end\n" for i in range(100_000))
    names = "".join(f" root b{i}\n" for i in range(100_000))
    return f":units\n length 1\n:root\n order\n axis XYZ\n:bonedata\n{bones}:hierarchy\n begin\n{names} end\n".encode()


def _c3d_counts() -> bytes:
    header = bytearray(512)
    header[0:2] = bytes((2, 0x50))
    struct.pack_into("<4H", header, 2, 0xFFFF, 0xFFFF, 1, 0xFFFF)
    return bytes(header) + bytes((1, 0x50, 1, 84)) + bytes(508) + bytes(4096)


def _points(count: int) -> bytes:
    return ",".join(f"p{i}_{axis}" for i in range(count) for axis in "xyz").encode()


def _attributes(count: int) -> str:
    return " ".join(f'a{i}="1"' for i in range(count))


def _entries(count: int) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as file:
        for number in range(count):
            file.writestr(f"{number}.npy", b"")
    return packed.getvalue()


def _zip(files: dict[str, int], overlap: int = 0) -> bytes:
    """Return an archive with files of so many MB of zeros, of which the last is listed so many times more."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as file:
        for name, megabytes in files.items():
            with file.open(name, "w", force_zip64=True) as entry:
                for _ in range(megabytes):
                    entry.write(bytes(1 << 20))
        for number in range(overlap):
            again = copy.copy(file.infolist()[-1])
            again.filename = f"{number}.bvh"
            file.filelist.append(again)
    return packed.getvalue()


def _gz(megabytes: int) -> bytes:
    packed = io.BytesIO()
    with gzip.GzipFile(fileobj=packed, mode="wb") as file:
        for _ in range(megabytes):
            file.write(bytes(1 << 20))
    return packed.getvalue()


def _many_files(count: int) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as file:
        for number in range(count):
            file.writestr(f"{number}.bvh", b"")
    return packed.getvalue()


def _laughs() -> bytes:
    entities = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10 if i else "ha"}">' for i in range(12))
    text = EAF.format(tier="t", value="&a11;")
    return text.replace("<ANNOTATION_DOCUMENT>", f"<!DOCTYPE a [{entities}]><ANNOTATION_DOCUMENT>").encode()


def _mvnx_laughs() -> bytes:
    entities = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10 if i else "1 "}">' for i in range(12))
    text = mvnx_text([subject_text(*dancing(2))]).replace("<position>", "<position>&a11; ")
    return text.replace("<mvnx", f"<!DOCTYPE mvnx [{entities}]><mvnx", 1).encode()


def _mvnx_line() -> bytes:
    text = mvnx_text([subject_text(*dancing(2))])
    return text.replace("<position>", "<position>" + "1 " * 10**7).encode()


def _gltf_times(seconds: float) -> bytes:
    """Return a clip of four keys, the last of them late."""
    scene = dancing_gltf(mixamo(), dance(mixamo(), 4))
    late = scene.accessor(np.array([0.0, 0.1, 0.2, seconds]))
    for sampler in scene.json["animations"][0]["samplers"]:
        sampler["input"] = late
    return scene.glb()


def _gltf_zeros(count: int) -> bytes:
    """Return a clip whose turns claim to be zeros that no bytes hold."""
    scene = dancing_gltf(mixamo(), dance(mixamo(), 4))
    scene.json["accessors"].append({"componentType": 5126, "count": count, "type": "VEC4"})
    scene.json["animations"][0]["samplers"][0]["output"] = len(scene.json["accessors"]) - 1
    return scene.glb()


def _fbx_array(count: int) -> bytes:
    """Return a binary file of which an array unpacks to much more than the file has."""
    scene = dancing_fbx(mixamo(), dance(mixamo(), 3))
    curve = next(part for part in scene.objects.below if part.name == "AnimationCurve")
    curve.below[0].values = (np.zeros(count, "<i8"),)
    return scene.binary()


def _deep_fbx(depth: int) -> bytes:
    """Return a binary file of records in records."""
    part = Part("a")
    for _ in range(depth):
        part = Part("a", (), [part])
    scene = dancing_fbx(mixamo(), dance(mixamo(), 3))
    scene.objects.below.append(Part("Pose", (), [part]))
    return scene.binary()


def _pickle_of(shape: int) -> bytes:
    """Return a pickle of an array that claims 2^shape numbers and has one byte."""
    head = b"\x80\x02}U\x05posescnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R(K\x01"
    size = b"\x8a\x09" + (1 << shape).to_bytes(9, "little")
    return head + size + b"\x85cnumpy\ndtype\nU\x02f8K\x00K\x01\x87R\x89U\x01xtbs."


TEN_TO_12 = 10**12
LONG_LINE = b"1 " * 40_000_000
BOMBS: dict[str, tuple[str, Callable[[], bytes]]] = {
    "a BVH header of 10^12 frames": ("bvh", lambda: _bvh(TEN_TO_12)),
    "a deep hierarchy": ("bvh", lambda: _deep_bvh(9_000)),
    "a deeper hierarchy": ("bvh", lambda: _deep_bvh(200_000)),
    "a hierarchy of comments": ("bvh", lambda: b"HIERARCHY\n" + b"#\n" * 3_000_000),
    "a line of 80 MB in BVH": ("bvh", lambda: _bvh(2) + LONG_LINE),
    "a line of 80 MB in AMC": ("amc", lambda: human_amc(2, 0).encode() + LONG_LINE),
    "a header of 80 MB in AMC": ("amc", lambda: b":" + LONG_LINE),
    "frames without numbers": ("many.amc", lambda: b"".join(b"%d\nroot\n" % i for i in range(1, 200_000))),
    "line ends alone": ("bvh", lambda: _bvh(2) + b"\n" * 30_000_000),
    "a CSV of 10,000 points": (
        "motion.csv",
        lambda: _points(10_000) + b"\n" + b"1," * 29_999 + b"1",
    ),
    "a CSV of 200,000 points": (
        "motion.csv", lambda: _points(200_000) + b"\n1",
    ),
    "a CSV line of 80 MB": ("motion.csv", lambda: b"a_x,a_y,a_z\n" + LONG_LINE),
    "an NPZ header of 10^12 frames": ("npz", lambda: _npz((TEN_TO_12, 24, 3), 1 << 20)),
    "an NPZ of 2.4 GB in 2 MB": ("npz", lambda: _npz((4_096_000, 24, 3), 2250 << 20)),
    "an NPZ of 100,000 entries": ("npz", lambda: _entries(100_000)),
    "a BVH of 2.4 GB in 2 MB": ("walk.bvh.gz", lambda: _gz(2400)),
    "an archive of 2.4 GB in 2 MB": ("zip", lambda: _zip({"walk.bvh": 2400})),
    "an archive of 100 GB that share their bytes": ("zip", lambda: _zip({"walk.bvh": 60}, 1700)),
    "an archive of 150,000 files": ("zip", lambda: _many_files(150_000)),
    "an archive of 400,000 files": ("zip", lambda: _many_files(400_000)),
    "a pickle of 2^60 numbers": ("pkl", lambda: _pickle_of(60)),
    "a pickle with a place far out": ("pkl", lambda: b"\x80\x02}r\xff\xff\xff\x7f."),
    "a pickle of tuples in tuples": ("pkl", lambda: b"\x80\x02})" + b"\x85" * 5_000_000 + b"K\x01s."),
    "a pickle of 5 million lists": ("pkl", lambda: b"\x80\x02}U\x05poses(" + b"]" * 5_000_000 + b"ls."),
    "levels of keypoints": ("motion.json", lambda: b'{"people":' + b"[" * 30_000_000),
    "frames without points": ("motion.json", lambda: b'{"frames":[' + b"{}," * 10_000_000 + b"{}]}"),
    "a JSON of 70 MB": ("motion.json", lambda: b'{"joints_3d":"' + b"x" * 70_000_000 + b'"}'),
    "a header of 30 MB in CSV": ("motion.csv", lambda: b"Format Version,1.23\n," + b"Bone," * 6_000_000 + b"\n"),
    "sections without end": ("motion.csv", lambda: b"Trajectories\n100\n\n" * 3_000_000),
    "C3D counts of 65,535": ("c3d", _c3d_counts),
    "a billion laughs in MVNX": ("mvnx", _mvnx_laughs),
    "levels of MVNX": ("mvnx", lambda: b"<mvnx>" + b"<a>" * 5_000_000),
    "a million subjects": ("mvnx", lambda: b"<mvnx>" + b'<subject label="a"/>' * 1_000_000 + b"</mvnx>"),
    "an MVNX text of 60 MB": ("mvnx", _mvnx_line),
    "levels of glTF": ("gltf", lambda: b"[" * 60_000_000),
    "a million nodes": ("gltf", lambda: b'{"asset":{"version":"2.0"},"nodes":[' + b"{}," * 10**6 + b"{}]}"),
    "a clip of 10^9 seconds": ("glb", lambda: _gltf_times(1e9)),
    "a clip of 3,000 seconds and four keys": ("glb", lambda: _gltf_times(3000.0)),
    "10^9 zeros in glTF": ("glb", lambda: _gltf_zeros(10**9)),
    "an FBX array of 160 MB in 0.2 MB": ("fbx", lambda: _fbx_array(20_000_000)),
    "levels of FBX": ("fbx", lambda: _deep_fbx(800)),
    "levels of FBX text": ("fbx", lambda: b"; FBX\nFBXVersion: 7400\nObjects: {" + b"Pose: {" * 5_000_000),
    "comments of FBX text": ("fbx", lambda: b"; FBX\nFBXVersion: 7400\n" + b"; x \n" * 10_000_000),
    "an annotation of 50 MB": ("eaf", lambda: EAF.format(tier="t", value="x" * 50_000_000).encode()),
    "text between elements": ("eaf", lambda: EAF.format(tier="t", value="x\n<b/>" * 1_000_000).encode()),
    "a billion laughs": ("eaf", _laughs),
    "levels of XML": ("eaf", lambda: EAF.format(tier="t", value="<b>" * 5_000_000).encode()),
    "attributes": ("eaf", lambda: EAF.format(tier="t", value="<b " + _attributes(10**6)).encode()),
    "a label file of 100 MB": ("vtt", lambda: b"WEBVTT\n\n" + b"\n" * 100_000_000),
    "blank lines of 60 MB": ("vtt", lambda: b"WEBVTT\n\n" + b"\n" * 60_000_000),
    "a reference of 10^6 digits": ("vtt", lambda: CUE.format(text="&#" + "9" * 10**6 + ";").encode()),
    "unclosed tags": ("vtt", lambda: CUE.format(text="<" * 10**7).encode()),
    "a cloud of 10^9 points": ("pcd", lambda: _cloud(10**9, b"0 0 1\n")),
    "a cloud of 4 million points": ("pcd", lambda: _cloud(4_000_000, b"0 0 1\n" * 10)),
    "a line of 80 MB in PCD": ("pcd", lambda: _cloud(4_000_000, LONG_LINE)),
    "a packed cloud of 32 MB in 0.4 MB": ("pcd", lambda: _zeros(120_000)),
    "vertices after 10^12 edges": ("ply", lambda: _vertices(3, TEN_TO_12, b"1\n")),
    "line ends alone in PLY": ("ply", lambda: _vertices(4_000_000, 3, b"\n" * 60_000_000)),
    "depth images of 10^12 pixels": ("depth.npz", lambda: _npz((10**6, 1000, 1000), 1 << 20, "depth", "<u2")),
    "depth images of 600 MB in 0.6 MB": ("depth.npz", lambda: _npz((409_600, 24, 32), 600 << 20, "depth", "<u2")),
    "levels of JSON": ("json", lambda: b"[" * 60_000_000),
    "lists of JSON": ("json", lambda: b'{"takes":[' + b"[]," * 20_000_000 + b"0]}"),
    "a number of 10^7 digits": ("json", lambda: b'{"takes":[' + b"9" * 10**7 + b"]}"),
    "a million columns": ("csv", lambda: b"take,class,start,stop" + b",a" * 10**6 + b"\n" + b"," * 10**7),
    "a cell of 60 MB": ("csv", lambda: b'take,class,start,stop\n"' + b"\n" * 60_000_000),
    "tabs": ("txt", lambda: b"\t" * 60_000_000),
}  # fmt: skip
"""Name → ending of the file, and the function that makes its bytes."""


UNPACKED_MB = {
    "a clip of 3,000 seconds and four keys": 80.0,
    "a packed cloud of 32 MB in 0.4 MB": 100.0,
    "depth images of 600 MB in 0.6 MB": 60.0,
}
"""Memory that files may take beside, which are read and are much larger there."""


def most_mb(name: str, size: int) -> float:
    """Return the memory that a file of some bytes may take: in proportion to its size, and bounded.

    The program itself, and what the harmless files load, are not in it, so a reader that takes 20 MB more than a deep
    hierarchy needs is found.
    """
    return min(1500.0, 25.0 + 40.0 * size / 1e6) + UNPACKED_MB.get(name, 0.0)


def run(folder: Path, options: Options) -> Outcome:
    """Let a process read each bomb; it must end in a body, in labels or in an error, in time and within its memory."""
    names = [name for name in BOMBS if options.case in (None, name)]
    if options.size == "sample" and options.case is None:
        names = Random(options.seed).sample(names, SAMPLE)
    (folder / "harmless.bvh").write_bytes(_bvh(2))
    (folder / "harmless.pcd").write_bytes(_zeros(3))
    outcome = Outcome()
    with ThreadPoolExecutor(JOBS) as pool:
        for name, (how, problem) in zip(names, pool.map(lambda name: _read(folder, name), names), strict=True):
            outcome.cases += 1
            outcome.count(how)
            if problem:
                outcome.fail(name, problem)
    return outcome


def _read(folder: Path, name: str) -> tuple[str, str]:
    """Let a process read a bomb; return how it ended, and the problem."""
    ending, make = BOMBS[name]
    data = make()
    with tempfile.TemporaryDirectory(dir=folder) as place:
        path = Path(place, ending if "." in ending else f"bomb.{ending}")
        path.write_bytes(data)
        path.with_name("x.asf").write_bytes(_many_bones() if ending == "many.amc" else human_asf().encode())
        harmless = [str(folder / f"harmless.{kind}") for kind in ("bvh", "pcd")]
        command = [sys.executable, "-c", PROGRAM, str(path), *harmless]
        try:
            done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=SECONDS, check=False)
        except subprocess.TimeoutExpired:
            return "hung", f"takes more than {SECONDS} s"
    if done.returncode:
        return "crashed", f"ends with {done.returncode}: {done.stderr[-300:]}"
    how, peak = done.stdout.split()
    most = most_mb(name, len(data))
    return how, f"takes {float(peak):.0f} MB, more than {most:.0f}" if float(peak) > most else ""
