"""Seeds, mutations and checks of packed files: archives (.zip) and .gz files with a motion in them."""

from __future__ import annotations

import gzip
import io
import os
import shutil
import tempfile
import warnings
import zipfile
from contextlib import suppress
from pathlib import Path
from random import Random

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.packed_files import split_ending
from kinedex.storage.formats.motion.reader_table import read_body
from kinedex.storage.formats.motion.sources import scan
from kinedex.storage.formats.motion.unpacked_files import unpacked
from kinedex.storage.temporary_folders import PREFIX
from tests.fuzz import seeds
from tests.fuzz.binary import npz_sizes
from tests.fuzz.mutations import ANY, Mutation

_NAMES = (
    "../walk.bvh", "/walk.bvh", "a/../../walk.bvh", "..\\walk.bvh", "C:walk.bvh", "walk.bvh/", "", "walk.bvh\0.png",
    "./walk.bvh", "inner.zip", "walk.bvh.gz", "walk.csv", "a" * 300 + ".bvh", "é/walk.bvh", "._walk.bvh", "x.asf",
    "walk.yaml", "sub/walk.bvh",
)  # fmt: skip


def archives() -> dict[str, bytes]:
    """Archives of a motion and other files, packed and not."""
    files = {"a/walk.bvh": seeds.bvh()["mixamo"], "a/x.txt": b"text", "walk.csv": b"1,2\n"}
    return {"deflated": _zipped(files, zipfile.ZIP_DEFLATED), "stored": _zipped(files, zipfile.ZIP_STORED)}


def packed_bvh() -> dict[str, bytes]:
    """A .gz file as it is written at once, and one of two parts."""
    data = seeds.bvh()["mixamo"]
    parts = [gzip.compress(part, mtime=0) for part in (data, b"\n")]
    return {"one": parts[0], "two": b"".join(parts)}


def _zipped(files: dict[str, bytes], method: int) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as packed:
        for name, data in files.items():
            record = zipfile.ZipInfo(name)
            record.compress_type = method
            packed.writestr(record, data)
    return file.getvalue()


def _files(data: bytes) -> dict[str, bytes]:
    with suppress(Exception), zipfile.ZipFile(io.BytesIO(data)) as packed:
        return {name: packed.read(name) for name in packed.namelist()}
    return {}


def zip_names(data: bytes, random: Random) -> bytes:
    """Files of an archive are called otherwise, there are two of a name, or they are links and pipes."""
    files, file = list(_files(data).items()), io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as packed, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of names that are there twice
        for name, content in (*files, *random.sample(files, min(1, len(files)))):
            record = zipfile.ZipInfo("x")
            record.filename = random.choice((name, *_NAMES))
            record.external_attr = random.choice((0, 0, 0o100644, 0o120777, 0o010644)) << 16
            packed.writestr(record, content)
    return file.getvalue()


def zip_entry(data: bytes, random: Random) -> bytes:
    """A file of an archive is mutated and packed again, so that its checksum is right."""
    files = _files(data)
    if not files:
        return data
    name = random.choice(sorted(files))
    files[name] = random.choice(ANY)(files[name], random)
    return _zipped(files, random.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)))


ZIP: tuple[Mutation, ...] = (zip_names, zip_names, zip_entry, npz_sizes, npz_sizes)
"""Mutations of an archive of files, besides those of its bytes."""


def gz_entry(data: bytes, random: Random) -> bytes:
    """The file in a .gz file is mutated and packed again, once or twice."""
    with suppress(Exception):
        changed = random.choice(ANY)(gzip.decompress(data), random)
        return gzip.compress(changed, mtime=0) * random.choice((1, 1, 2))
    return data


GZ: tuple[Mutation, ...] = (gz_entry,) * 8
"""Mutations of a .gz file, besides those of its bytes."""


def check_packed(path: Path) -> None:
    """Read every motion of a packed file as an ingest does: from a copy below a temporary folder alone."""
    feature_set, mappings = seeds.known()
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "source")
        source.mkdir()
        place = Path(shutil.copy(path, source / f"walk{'.bvh' * (path.suffix == '.gz')}{path.suffix}"))
        found, faults = scan(source), list[SourceError]()
        for motion in found.motions:
            assert not {"..", ".", ""} & set(motion.path.split("/")), f"a path that leads elsewhere: {motion.path!r}"
            try:
                with unpacked(motion.absolute) as copy:
                    _check_place(copy.path, motion.path)
                    read_body(copy.path, None, mappings, feature_set.joints)
            except SourceError as fault:
                faults.append(fault)
        faults += [refused.fault for refused in found.refused]
        for fault in faults:
            assert fault.path.startswith(str(place)), f"an error that does not name the file: {fault}"
            assert PREFIX not in str(fault), f"an error that names the copy: {fault}"
        assert os.listdir(source) == [place.name], "something was written beside the file"
    if faults:
        raise SourceError(path, faults[0].reason)  # without the line, which is that of the file within


def _check_place(copy: Path, path: str) -> None:
    folder = next(folder for folder in copy.parents if folder.name.startswith(PREFIX))
    stem, ending = split_ending(path.removeprefix("walk.zip/"))
    assert copy.resolve() == folder.resolve() / f"{stem}{ending}", f"{path!r} is unpacked into {copy}"
