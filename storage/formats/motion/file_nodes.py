"""Read the nodes of a motion file, such as its markers or the joints of its tree, even if the file is refused."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from kinedex.catalog.skeletons.mappings import MappingRequest, Mappings, WatchedMappings
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.reader import DEFAULT_SETTINGS, Body, ReadSettings
from kinedex.storage.formats.motion.reader_table import read_body
from kinedex.storage.formats.motion.single_file import chosen_person, file_beside, motion_ending
from kinedex.storage.formats.motion.unpacked_files import unpacked


@dataclass(frozen=True)
class FileNodes:
    """The nodes of a motion file, and what its reader made of them.

    Attributes
    ----------
    asked : MappingRequest
        The nodes, with their tree and places in sampled frames where the format has these.
    body : Body or None
        The body; None if the file is refused.
    fault : SourceError or None
        The reason of the refusal.
    """

    asked: MappingRequest
    body: Body | None
    fault: SourceError | None


def read_file_nodes(
    file: Path,
    mappings: Mappings,
    person: str = "",
    source: Path | None = None,
    given: ReadSettings = DEFAULT_SETTINGS,
    skeleton: Path | None = None,
) -> FileNodes:
    """Read a motion file, and keep the nodes for which its reader requested a mapping.

    Parameters
    ----------
    file : Path
        The motion file.
    mappings : Mappings
        The mappings to read it with.
    person : str, optional
        The person, in a file with several.
    source : Path, optional
        The source root, up to which the ASF of an AMC file is searched.
    given : ReadSettings, optional
        The rate, gaps and body model given by the user.
    skeleton : Path, optional
        The ASF of an AMC file, or the static trial of a file of markers, if it is known.

    Raises
    ------
    KinedexError
        There is no such file, it is of a format that is not read, or it is damaged so that it has no nodes.
    """
    watched = WatchedMappings.of_mappings(mappings)
    motion_ending(file)
    beside = skeleton or file_beside(file, source)
    body, fault = None, None
    try:
        with unpacked(file, beside) as copy:
            chosen = chosen_person(copy.path, copy.skeleton, watched, person)
            body = read_body(copy.path, copy.skeleton, watched, mappings.joints, given, person=chosen)
            body = copy.restated_body(body)
    except SourceError as refused:
        fault = refused
    if watched.question.form is None:
        raise fault or SourceError(file, "its reader needs no skeleton mapping")
    return FileNodes(watched.question, body, fault)
