"""Find the reader of a motion file by its extension, among built-in readers and those of plugins."""

from __future__ import annotations

import os
from functools import lru_cache
from pathlib import Path

import numpy as np

from kinedex.catalog.plugins import Plugins
from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.reader import DEFAULT_SETTINGS, Body, MotionFile, Reader, ReadSettings

READERS: Plugins[type[Reader]] = Plugins(
    "kinedex.readers",
    "reader",
    {
        "acclaim": "kinedex.storage.formats.motion.acclaim:AcclaimReader",
        "bvh": "kinedex.storage.formats.motion.bvh:BvhReader",
        "c3d": "kinedex.storage.formats.motion.c3d:C3dReader",
        "motive": "kinedex.storage.formats.motion.motive:MotiveReader",
        "nexus": "kinedex.storage.formats.motion.nexus:NexusReader",
        "arena": "kinedex.storage.formats.motion.arena:ArenaReader",
        "opensim": "kinedex.storage.formats.motion.opensim:OpenSimReader",
        "qualisys": "kinedex.storage.formats.motion.qualisys:QualisysReader",
        "keypoints": "kinedex.storage.formats.motion.keypoint_json:KeypointReader",
        "pickled_keypoints": "kinedex.storage.formats.motion.pickled_keypoints:PickledKeypointsReader",
        "amass": "kinedex.storage.formats.motion.amass:AmassReader",
        "humanml": "kinedex.storage.formats.motion.humanml:HumanMlReader",
        "positions": "kinedex.storage.formats.motion.positions:PositionsReader",
        "mvnx": "kinedex.storage.formats.motion.mvnx:MvnxReader",
        "gltf": "kinedex.storage.formats.motion.gltf:GltfReader",
        "fbx": "kinedex.storage.formats.motion.fbx:FbxReader",
    },
)
"""The readers by name. For a shared extension, readers of plugins are tried first, then these in this order."""


def readers_by_ending() -> dict[str, tuple[Reader, ...]]:
    """Return a dict from extension to readers in the order of trial; the last one accepts without checking."""
    return dict(_readers_by_ending(tuple(READERS)))


@lru_cache(maxsize=4)
def _readers_by_ending(names: tuple[str, ...]) -> dict[str, tuple[Reader, ...]]:
    found: dict[str, tuple[Reader, ...]] = {}
    for name, kind in READERS.loadable():
        reader = kind()
        reader.distribution = READERS.distribution(name)
        for ending in reader.endings:
            others = found.get(ending, ())
            found[ending] = (reader, *others) if reader.distribution else (*others, reader)
    return found


def motion_endings() -> tuple[str, ...]:
    """Return the extensions of all supported motion files, with the dot."""
    return tuple(readers_by_ending())


def reader_of(path: str | Path) -> Reader:
    """Return the reader of a motion file by its extension and, if several readers share it, by its content.

    Raises
    ------
    SourceError
        No reader reads files with this extension.
    """
    file = path if isinstance(path, Path) else Path(path)
    readers = _readers_by_ending(tuple(READERS)).get(file.suffix.lower(), ())
    if not readers:
        raise SourceError(file, f"is not read; kinedex reads {', '.join(motion_endings())}")
    return next((reader for reader in readers[:-1] if reader.sniff(file)), readers[-1])


def is_known_by_ending(ending: str) -> bool:
    """Return whether all files with the given extension are motion files, whatever their content."""
    return _accepts_all(_readers_by_ending(tuple(READERS)).get(ending, ()))


def _accepts_all(readers: tuple[Reader, ...]) -> bool:
    # the last reader of an ending is the most general one, which mostly accepts every file
    return bool(readers) and type(readers[-1]).sniff is Reader.sniff


def is_motion_file(path: str | Path) -> bool:
    """Return whether a reader recognises a file as one of its format."""
    readers = _readers_by_ending(tuple(READERS)).get(os.path.splitext(path)[1].lower(), ())
    if _accepts_all(readers):
        return True
    return any(reader.sniff(Path(path)) for reader in reversed(readers))


def read_body(
    path: Path,
    skeleton: Path | None,
    mappings: Mappings,
    joints: tuple[str, ...],
    settings: ReadSettings = DEFAULT_SETTINGS,
    data: bytes | None = None,
    person: str = "",
) -> Body:
    """Read a motion file of any format.

    Parameters
    ----------
    path : Path
        The file.
    skeleton : Path, optional
        The skeleton file of an AMC file; files of other formats have none.
    mappings : Mappings
        Skeleton mappings in which the file's nodes are looked up.
    joints : tuple of str
        The named joints, in the order of the result.
    settings : ReadSettings, optional
        Settings of the user.
    data : bytes, optional
        The file's bytes, if its reader `reads_whole` and they have been read already.
    person : str, optional
        The person to read, one of `persons_of`.

    Raises
    ------
    SourceError
        The file cannot be read; the error names the file and the place of the first fault.
    """
    with np.errstate(over="ignore"):  # huge numbers are refused with a message; numpy would warn as well
        return reader_of(path).read(MotionFile(path, skeleton, data, person), mappings, joints, settings)


def persons_of(file: MotionFile, mappings: Mappings) -> tuple[str, ...]:
    """Return the names of the persons in a motion file of several; empty for a file of one person.

    Parameters
    ----------
    file : MotionFile
        The file.
    mappings : Mappings
        Skeleton mappings in which the file's nodes are looked up.

    Raises
    ------
    SourceError
        The file cannot be read, or its persons cannot be distinguished by their names.
    """
    persons = reader_of(file.path).persons(file, mappings)
    if len(persons) < 2:
        return ()
    twice = [name for name in dict.fromkeys(persons) if persons.count(name) > 1 or not name.strip()]
    if twice or any(name != name.encode("utf-8", "replace").decode() for name in persons):
        raise SourceError(
            file.path,
            f"holds {len(persons)} persons that their names do not distinguish ({', '.join(persons)}); rename them in "
            "the file",
        )
    return persons
