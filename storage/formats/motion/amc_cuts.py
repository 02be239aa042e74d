"""Cut intervals of frames out of AMC files with their original numbers, and copy their ASF skeleton."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.body.joint_tree import JOINT_PARENTS
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.acclaim import AmcFile
from kinedex.storage.formats.motion.asf import Skeleton, read_asf
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
from kinedex.storage.formats.motion.text_blocks import before_last_frame
from kinedex.storage.formats.source_files import source_bytes

_NUMBER = re.compile(rb"([ \t]*)[0-9]+")


def write_amc_cut(paths: Sequence[Path], cut: SourceCut) -> None:
    """Write an interval of an AMC file as an AMC file, and its ASF file beside it.

    Header, keywords and all numbers keep the text of the source; frames are numbered from 1. In a mirrored cut, bones
    of the ASF file get the mirrored length, direction and axis of the other side; a symmetric skeleton keeps its text.

    Parameters
    ----------
    paths : sequence of Path
        The AMC file to write, and the ASF file.
    cut : SourceCut
        The interval.

    Raises
    ------
    SourceError
        A source is damaged, was changed, has no such frames, or no channels that can express a change.
    KinedexError
        A file cannot be written.
    """
    check_source(cut)
    if cut.skeleton is None:
        raise SourceError(cut.source, "an AMC file is cut with its ASF skeleton; none is given")
    source = _opened(cut.source, stamp_of(cut.source), cut.skeleton, stamp_of(cut.skeleton))
    check_interval(cut, len(source.rows))
    frames, skeleton = source.rows.read(cut.start, cut.stop), source.skeleton_text
    if cut.is_changed:
        figure = source.figure(cut)
        plane = mirror_plane(figure) if cut.mirror else None
        rows, names = source.tokens(frames)
        frames = [source.text(row, names) for row in edited(figure, cut, rows, plane)]
        skeleton = skeleton if plane is None else mirrored_asf(cut.skeleton, source.skeleton, skeleton, plane)
    write_bytes(paths[0], [source.rows.head, *(numbered(frame, i) for i, frame in enumerate(frames, 1))])
    write_bytes(paths[1], [skeleton])


class AmcSource:
    """An AMC file to be cut, with its skeleton and the byte offsets of its frames."""

    def __init__(self, path: Path, skeleton: Path) -> None:
        self.skeleton = read_asf(skeleton)
        self.skeleton_text = source_bytes(skeleton)
        self.file = AmcFile(path, self.skeleton)
        self.rows = TextRows(path, self.file.start, True, before_last_frame)

    def figure(self, cut: SourceCut) -> Figure:
        """Return the skeleton with the mapping that fits it."""
        skeleton, mappings = self.skeleton, cut.mappings or load_mappings("auto", tuple(JOINT_PARENTS))
        fit = mappings.detect(Path(skeleton.path), "acclaim", skeleton.bones)
        head = self.rows.head.lower()
        angle = 1.0 if b":radians" in head else np.pi / 180.0
        return Figure(self.file.path, skeleton.nodes, fit, angle, skeleton.unit_m / skeleton.length_scale)

    def tokens(self, frames: Sequence[bytes]) -> tuple[Tokens, list[str]]:
        """Return the numbers of frames in the skeleton's column order, and the bones in the order of the lines."""
        rows: Tokens = []
        names: list[str] = []
        for frame in frames:
            lines = [words for line in frame.splitlines() if (words := line.split()) and not words[0].startswith(b"#")]
            found = {words[0].decode("latin-1"): words[1:] for words in lines[1:]}
            names = names or list(found)
            try:
                rows.append([number for name, _ in self.skeleton.channels for number in found[name]])
                whole = len(rows[-1]) == sum(len(dofs) for _, dofs in self.skeleton.channels)
            except KeyError:
                whole = False
            if not whole:
                raise SourceError(
                    self.file.path, f"frame {lines[0][0].decode()} does not have the bones of its skeleton"
                )
        return rows, names

    def text(self, row: Sequence[bytes], names: Sequence[str]) -> bytes:
        """Return the text of a frame with the numbers of a row; its frame number is set later (`numbered`)."""
        at, found = 0, {}
        for name, dofs in self.skeleton.channels:
            found[name] = row[at : at + len(dofs)]
            at += len(dofs)
        lines = [b" ".join([name.encode("latin-1"), *found[name]]) for name in names]
        return self.rows.newline.join([b"0", *lines, b""])


@lru_cache(maxsize=4)  # The clips of a take are cut one after the other.
def _opened(path: Path, _stamp: Stamp, skeleton: Path, _skeleton_stamp: Stamp) -> AmcSource:
    return AmcSource(path, skeleton)


def numbered(frame: bytes, number: int) -> bytes:
    """Return the text of a frame with its frame number replaced."""
    found = _NUMBER.match(frame)
    assert found is not None  # a frame begins with its number
    return found[1] + b"%d" % number + frame[found.end() :]


def mirrored_asf(path: Path, skeleton: Skeleton, text: bytes, plane: MirrorPlane) -> bytes:
    """Return an ASF file in which every bone is the mirror image of its partner.

    Parameters
    ----------
    path : Path
        The file that errors name.
    skeleton : Skeleton
        The skeleton of the ASF file.
    text : bytes
        The content of the ASF file.
    plane : MirrorPlane
        The plane, and the partner of each node.
    """
    bones = _bone_words(text)
    partners = {node.name: skeleton.nodes[image].name for node, image in zip(skeleton.nodes, plane.image, strict=True)}
    lines, section, name = [], b"", ""
    for line in text.splitlines(keepends=True):
        words = line.partition(b"#")[0].split()
        section = words[0].lower() if words and words[0].startswith(b":") else section
        key = words[0].lower() if words else b""
        if section == b":bonedata" and key == b"name":
            name = words[1].decode("latin-1") if len(words) > 1 else ""
        if section == b":bonedata" and key in _MIRRORED and name in partners:
            line = _with_words(line, words, _mirrored_words(key, bones[partners[name]][key], plane))
        elif section == b":root" and key in (b"position", b"orientation"):
            line = _with_words(line, words, _mirrored_words(_ROOT[key], words, plane))
        lines.append(line)
    return b"".join(lines)


_MIRRORED = (b"direction", b"length", b"axis")
_ROOT = {b"position": b"direction", b"orientation": b"axis"}


def _bone_words(text: bytes) -> dict[str, dict[bytes, list[bytes]]]:
    """Return for each bone a dict from keyword to the words of its line, for the lines that mirroring changes."""
    bones: dict[str, dict[bytes, list[bytes]]] = {}
    found: dict[bytes, list[bytes]] = {}
    for line in text.splitlines():
        words = line.partition(b"#")[0].split()
        key = words[0].lower() if words else b""
        if key == b"begin":
            found = {key: [key, b"0", b"0", b"0"] for key in _MIRRORED}
        elif key == b"name" and len(words) > 1:
            bones[words[1].decode("latin-1")] = found
        elif key in _MIRRORED:
            found[key] = words
    return bones


def _mirrored_words(key: bytes, words: Sequence[bytes], plane: MirrorPlane) -> list[bytes]:
    """Return the mirrored words of a line: a direction, a rotation axis, or a length."""
    found = list(words)
    for i in range(3 if key != b"length" else 0):
        if (i == plane.axis) == (key == b"direction"):
            found[1 + i] = negated(found[1 + i])
    return found


def _with_words(line: bytes, own: list[bytes], other: list[bytes]) -> bytes:
    """Return a line with its words replaced by another line's; the same line if their values are equal."""
    try:
        same = [float(word) for word in own[1:4]] == [float(word) for word in other[1:4]] and own[4:] == other[4:]
    except ValueError:
        same = own[1:] == other[1:]
    if same:
        return line
    indent, end = line[: len(line) - len(line.lstrip())], line[len(line.rstrip()) :]
    return indent + b" ".join([own[0], *other[1:]]) + end
