"""Cut intervals of frames out of BVH files, with their own skeleton, rate and numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from kinedex.catalog.skeletons.mappings import Mappings, load_mappings
from kinedex.ops.body.joint_tree import JOINT_PARENTS
from kinedex.ops.body.kinematics import Step
from kinedex.storage.formats.motion.bvh import FittedPerson, fitted_person, persons_of
from kinedex.storage.formats.motion.bvh_parser import BvhFile, frame_time
from kinedex.storage.formats.motion.channel_cuts import (
    SourceCut,
    Stamp,
    TextRows,
    check_interval,
    check_source,
    stamp_of,
    write_bytes,
)
from kinedex.storage.formats.motion.channel_edits import Figure, MirrorPlane, Tokens, edited, mirror_plane, negated
from kinedex.storage.formats.motion.scene_figures import chosen_person
from kinedex.storage.formats.motion.text_blocks import after_last_line

Replacements = dict[tuple[int, int], bytes]
"""A dict from start and stop of a part of a text to the text that replaces it."""


def write_bvh_cut(paths: Sequence[Path], cut: SourceCut) -> None:
    """Write an interval of a BVH file as a BVH file.

    The hierarchy, the frame time and all numbers keep the text of the source; the number of frames is the cut's. From a
    file of several persons, only the take's person is written. A mirrored cut has the joints of the source in the same
    order, and each OFFSET is the mirrored one of the other side; a symmetric skeleton keeps its text.

    Parameters
    ----------
    paths : sequence of Path
        The file to write.
    cut : SourceCut
        The interval, and the changes to apply.

    Raises
    ------
    SourceError
        The source is damaged, was changed, has no such frames, or no channels that can express a change.
    KinedexError
        The file cannot be written.
    """
    check_source(cut)
    source = _opened(cut.source, stamp_of(cut.source))
    check_interval(cut, len(source.rows))
    rows, newline = source.rows.read(cut.start, cut.stop), source.rows.newline
    layout, members, changes = source.file.layout, None, {}
    if cut.is_changed:
        figure, members = source.figure(cut)
        plane = mirror_plane(figure) if cut.mirror else None
        tokens = edited(figure, cut, _tokens(rows, source.columns(members)), plane)
        changes = {} if plane is None else _mirrored_offsets(source.file, members, plane)
        if cut.rate_hz is not None:
            changes[layout.frame_time] = frame_time(cut.rate_hz).encode()
        rows = [b" ".join(row) + newline for row in tokens]
    elif cut.person:
        members = source.members(cut.person)
        rows = [b" ".join(row) + newline for row in _tokens(rows, source.columns(members))]
    gap = b"" if layout.text[layout.frames[0] - 1 : layout.frames[0]].isspace() else b" "
    changes[layout.frames] = gap + b"%d" % len(rows)
    write_bytes(paths[0], [*_head(source.file, members, changes), source.rows.head[len(layout.text) :], *rows])


class BvhSource:
    """A BVH file to be cut: its hierarchy, and the byte offsets of its frames."""

    def __init__(self, path: Path) -> None:
        self.file = BvhFile(path)
        self.rows = TextRows(path, len(self.file.layout.text), False, after_last_line)
        self._fitted: dict[tuple[str, int], tuple[Mappings, FittedPerson]] = {}

    def members(self, person: str) -> tuple[int, ...]:
        """Return the nodes of a person; raise a SourceError that lists the persons if the choice is not clear."""
        persons = persons_of(self.file)
        return persons[chosen_person(self.file.path, person, [person.name for person in persons])].members

    def columns(self, members: Sequence[int]) -> tuple[int, int]:
        """Return start and stop of the channels of some nodes, which are contiguous."""
        found = [step.column for i in members for step in self.file.nodes[i].steps]
        return min(found, default=0), max(found, default=-1) + 1

    def figure(self, cut: SourceCut) -> tuple[Figure, tuple[int, ...]]:
        """Return the person of a cut with the skeleton mapping that fits, and its nodes in the file."""
        mappings = cut.mappings or load_mappings("auto", tuple(JOINT_PARENTS))
        key = (cut.person or "", id(mappings))
        if key not in self._fitted:
            fitted = fitted_person(self.file, key[0], mappings, mappings.joints)
            nowhere = np.empty((0, 0, 0))  # node positions of a long take need not be kept
            self._fitted[key] = mappings, fitted._replace(positions=nowhere, turned=nowhere)
        found = self._fitted[key][1]
        first, _ = self.columns(found.members)
        nodes = tuple(
            replace(node, steps=tuple(Step(step.kind, step.column - first) for step in node.steps))
            for node in found.nodes
        )
        return Figure(self.file.path, nodes, found.fit, np.pi / 180.0), found.members


@lru_cache(maxsize=4)  # The clips of a take are cut one after the other.
def _opened(path: Path, _stamp: Stamp) -> BvhSource:
    return BvhSource(path)


def _tokens(rows: Sequence[bytes], columns: tuple[int, int]) -> Tokens:
    """Return the numbers of some columns in every row, as text."""
    return [row.split(maxsplit=columns[1])[columns[0] : columns[1]] for row in rows]


def _head(file: BvhFile, members: tuple[int, ...] | None, changes: Replacements) -> list[bytes]:
    """Return the text before the frames with parts replaced, reduced to one root's tree if its nodes are given."""
    text, joints = file.layout.text, file.layout.joints
    spans = [(0, len(text))]
    if members is not None:
        first, last = min(start for start, _ in joints), max(stop for _, stop in joints)
        spans = [(0, first), joints[members[0]], (last, len(text))]
    pieces = []
    for start, stop in spans:
        at = start
        for (begin, end), new in sorted(changes.items()):
            if start <= begin and end <= stop:
                pieces += [text[at:begin], new]
                at = end
        pieces.append(text[at:stop])
    return pieces


def _mirrored_offsets(file: BvhFile, members: Sequence[int], plane: MirrorPlane) -> Replacements:
    """Return the mirrored numbers of each OFFSET that mirroring changes, by the bytes that hold its own numbers."""
    changes: Replacements = {}
    for i, image in zip(members, plane.image, strict=True):
        own, other = (file.layout.text[slice(*file.layout.offsets[at])].split() for at in (i, members[image]))
        other[plane.axis] = negated(other[plane.axis])
        if [float(number) for number in own] != [float(number) for number in other]:
            changes[file.layout.offsets[i]] = b" ".join(other)
    return changes
